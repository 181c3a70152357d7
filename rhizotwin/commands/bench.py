"""Run reconstruction methods on standard benchmarks and compare them.

A benchmark is a set of simulated scans with exact ground truth. A method is any program that reads a dataset and writes
a mesh, voxels, points, centre lines or a table of traits.

Examples
--------
rhizotwin bench make quick-1 -o my_quick
rhizotwin bench run quick-1 my_quick --method "python my_method.py {dataset} {output}" -o mine.json
rhizotwin bench run quick-1 my_quick --method hull -o hull.json
rhizotwin bench table mine.json hull.json -o results.html
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from cyclopts import Parameter

from rhizotwin import command_steps
from rhizotwin.arguments import Device, OutputFile, OutputFolder, Progress, list_of, option, read_number, with_metavar
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from rhizotwin.bench.benchmarks import Benchmark

TIMEOUT_LIMITS_S = (1.0, 1e6)
Cases: TypeAlias = Annotated[tuple[str, ...], option(list_of(str), "NAME,NAME,...")]
BenchmarkFolder: TypeAlias = Annotated[Path, with_metavar("FOLDER")]


def read_timeout_s(text: str) -> float:
    """Read a time limit."""
    return read_number(text, TIMEOUT_LIMITS_S, "s")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options for running a method."""

    label: Annotated[str | None, with_metavar("TEXT")] = None
    """Name of the method in tables; default: its command line."""
    cases: Cases = ()
    """Cases to run; default: all."""
    cameras: Literal["estimated", "true"] = "estimated"
    """Cameras given to the method: estimated (from the markers) or true (as rendered)."""
    timeout_s: Annotated[float, option(read_timeout_s, "S")] = 3600.0
    """Time limit per case in seconds."""
    keep: Annotated[Path | None, with_metavar("FOLDER")] = None
    """Folder in which to keep the output of the method, with one subfolder per case; default: the output is deleted."""


def list_() -> None:
    """List the benchmarks and their cases.

    Examples
    --------
    rhizotwin bench list
    """
    from rhizotwin.bench.benchmarks import BENCHMARKS

    for benchmark in BENCHMARKS.values():
        print(f"{benchmark.name}: {benchmark.description}")
        for case in benchmark.cases:
            pictures = f"{case.views * case.rings} pictures of {case.image_wh[0]}x{case.image_wh[1]}"
            print(f"  {case.name:<16}{case.scene}, {case.profile}, {pictures}, seed {case.seed}")


def make(
    name: Annotated[str, with_metavar("NAME")],
    /,
    *,
    output: OutputFolder,
    cases: Cases = (),
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Render a benchmark and verify its pictures.

    One dataset is rendered for each case, and the pictures are compared with stored reference values, so that results
    of different computers are comparable. If interrupted, run the same command again to continue.

    Parameters
    ----------
    name : str
        Name of the benchmark, as listed by 'rhizotwin bench list'.
    output : Path
        Folder of the datasets.
    cases : tuple of str
        Cases to render; default: all.
    device : str
        Compute device: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available).
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin bench make quick-1 -o my_quick
    rhizotwin bench make roots-1 -o my_roots --cases bean,maize
    """
    from rhizotwin.bench.benchmarks import find
    from rhizotwin.bench.make import make as render

    benchmark = find(name).chosen(cases)
    command_steps.start_engine(device, quiet=progress.quiet)
    with progress.bar(render=float(len(benchmark.cases))) as bar:
        found = render(benchmark, output, monitor=bar, say=print)
    wrong = [one.case for one in found if one.largest != float("inf") and not one.same]
    if wrong:
        raise UserError(f"the pictures of {', '.join(wrong)} in {output} differ from the reference; results on them are not comparable")
    print(f'next: rhizotwin bench run {name} {output} --method "my_tool {{dataset}} {{output}}" -o results.json')


def run(
    name: Annotated[str, with_metavar("NAME")],
    folder: BenchmarkFolder,
    /,
    *,
    method: str,
    output: OutputFile,
    options: RunOptions = RunOptions(),
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Run a method on each case of a benchmark, score its output, and measure time and memory.

    The method receives a copy of the dataset without ground truth, with cameras for nerfstudio (transforms.json) and
    COLMAP (colmap), binary masks (masks) and undistorted pictures (undistorted). Its output is recognised by file name:
    shape.ply, .stl, .obj or .glb, voxels.nrrd or .npz, points.ply or .xyz, roots.rsml, traits.csv. If a method crashes,
    exceeds the time limit or writes nothing, this is recorded as its result. Results are saved after each case; if
    interrupted, run the same command again to continue.

    Parameters
    ----------
    name : str
        Name of the benchmark.
    folder : Path
        Folder written by 'rhizotwin bench make'.
    method : str
        Command line of the method, in which {dataset} and {output} are replaced by folders; or ours, thesis, hull.
    output : Path
        JSON file of results to write.
    options : RunOptions
        Options for running the method.
    device : str
        Compute device for cameras and masks: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available).
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin bench run quick-1 my_quick --method "python my_method.py {dataset} {output}" -o mine.json
    rhizotwin bench run quick-1 my_quick --method ours --cases print,bean -o ours.json
    """
    from rhizotwin.bench import results, run_method
    from rhizotwin.bench.benchmarks import find
    from rhizotwin.bench.make import check_made

    benchmark = find(name).chosen(options.cases)
    run_method.command_of(method)  # report an invalid command line first
    check_made(benchmark, folder)
    command_steps.start_engine(device, quiet=progress.quiet)
    _run_cases(benchmark, folder, method, output, options, progress)
    print(results.markdown([results.read(output)]))
    print(f"next: rhizotwin bench table {output} -o results.html")


def _run_cases(benchmark: "Benchmark", folder: Path, method: str, output: Path, options: RunOptions, progress: Progress) -> None:
    """Run a method and write the results after each case."""
    from rhizotwin.bench import run_method

    finished = run_method.finished_rows(output, benchmark, method, cameras=options.cameras)
    rows: list[run_method.Row] = []
    with progress.bar(cases=1.0) as bar, bar.stage("cases"), bar.steps("cases", len(benchmark.cases), "case") as step:

        def record(row: run_method.Row) -> None:
            earlier = ", from an earlier run" if row.case in finished else ""
            print(f"{row.case}: {row.state}{f', {row.sentence}' if row.sentence else ''}{earlier}", flush=True)
            rows.append(row)
            stored = run_method.as_json(benchmark, method, rows, name=options.label or method, cameras=options.cameras)
            atomic.write_json(output, stored)
            step()

        run_method.run(
            benchmark, folder, method,
            cameras=options.cameras, timeout_s=options.timeout_s, keep=options.keep, finished=finished, say=record,
        )  # fmt: skip


def score(
    name: Annotated[str, with_metavar("NAME")],
    folder: BenchmarkFolder,
    outputs: Annotated[Path, with_metavar("OUTPUTS")],
    /,
    *,
    output: OutputFile,
    label: Annotated[str, with_metavar("TEXT")],
    cases: Cases = (),
) -> None:
    """Score output that a method wrote on another computer, such as a cluster.

    Parameters
    ----------
    name : str
        Name of the benchmark.
    folder : Path
        Folder written by 'rhizotwin bench make'.
    outputs : Path
        Folder with the output of the method, with one subfolder per case, named after the case.
    output : Path
        JSON file of results to write.
    label : str
        Name of the method in tables.
    cases : tuple of str
        Cases to score; default: all.

    Examples
    --------
    rhizotwin bench score quick-1 my_quick my_outputs --label "my method" -o mine.json
    """
    from rhizotwin.bench import results, run_method
    from rhizotwin.bench.benchmarks import find
    from rhizotwin.bench.make import check_made

    benchmark = find(name).chosen(cases)
    check_made(benchmark, folder)
    if not outputs.is_dir():
        raise UserError(f"the folder {outputs} does not exist; give the folder that contains one subfolder per case")
    rows = run_method.score(benchmark, folder, outputs)
    atomic.write_json(output, run_method.as_json(benchmark, "", rows, name=label, cameras=None))
    print(results.markdown([results.read(output)]))


def table(
    files: Annotated[tuple[Path, ...], with_metavar("RESULTS.json")],
    /,
    *,
    output: OutputFile | None = None,
) -> None:
    """Show the results of several methods side by side.

    Parameters
    ----------
    files : tuple of Path
        Result files, written by 'rhizotwin bench run' or 'rhizotwin bench score'.
    output : Path, optional
        File to write: a page with sortable columns (.html) or a Markdown table (.md); default: print the table.

    Examples
    --------
    rhizotwin bench table mine.json hull.json
    rhizotwin bench table mine.json hull.json -o results.html
    """
    from rhizotwin.bench import results
    from rhizotwin.bench.results_page import page

    several = [results.read(file) for file in files]
    if not several:
        raise UserError("give at least one result file")
    if output is None:
        print(results.markdown(several))
        return
    if output.suffix.lower() not in (".html", ".md"):
        raise UserError(f"{output} must end in .html or .md")
    atomic.write_text(output, page(several) if output.suffix.lower() == ".html" else results.markdown(several) + "\n")
    print(f"wrote {output}")


def gate(
    file: Annotated[Path, with_metavar("RESULTS.json")],
    /,
    *,
    baseline: Annotated[Path, with_metavar("FILE")],
    junit: Annotated[Path | None, with_metavar("FILE")] = None,
) -> int:
    """Compare results with a baseline; the exit code is 1 if a number got worse.

    Parameters
    ----------
    file : Path
        Result file, written by 'rhizotwin bench run'.
    baseline : Path
        Result file of an earlier version of the method.
    junit : Path, optional
        JUnit file to write, with one test case per number.

    Examples
    --------
    rhizotwin bench gate mine.json --baseline baseline.json --junit gate.xml
    """
    from rhizotwin.bench import results

    findings = results.compare(results.read(file), results.read(baseline))
    if junit is not None:
        atomic.write_bytes(junit, results.junit(findings, f"{file.name} against {baseline.name}"))
    worse = [one for one in findings if one.worse]
    for one in worse:
        print(f"{one.case}, {one.quantity}: {one.sentence}")
    print(f"{len(findings)} numbers compared, {len(worse)} worse")
    return 1 if worse else 0
