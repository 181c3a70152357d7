"""Run any method on named benchmarks, and compare methods.

A benchmark is a set of simulated scans with perfect ground truth. A method is a command line that reads a dataset and
writes meshes, voxels, points, centre lines or a table of traits.

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
from rhizotwin.arguments import Device, OutputFile, OutputFolder, Progress, between, list_of, named, option
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from rhizotwin.bench.named import Benchmark

TIMEOUT_LIMITS_S = (1.0, 1e6)
Cases: TypeAlias = Annotated[tuple[str, ...], option(list_of(str), "NAME,NAME,...")]
BenchmarkFolder: TypeAlias = Annotated[Path, named("FOLDER")]


def read_timeout_s(text: str) -> float:
    """Read a time limit."""
    return between(text, TIMEOUT_LIMITS_S, "s")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How a method is run."""

    label: Annotated[str | None, named("TEXT")] = None
    """The method's name in tables; default: its command line."""
    cases: Cases = ()
    """Only these cases; default: all."""
    cameras: Literal["estimated", "true"] = "estimated"
    """estimated: as the markers give them; true: as the pictures were rendered."""
    timeout_s: Annotated[float, option(read_timeout_s, "S")] = 3600.0
    """Seconds after which a case is stopped."""
    keep: Annotated[Path | None, named("FOLDER")] = None
    """Folder for what the method writes, a folder a case; default: it is removed."""


def list_() -> None:
    """List the benchmarks and their cases.

    Examples
    --------
    rhizotwin bench list
    """
    from rhizotwin.bench.named import BENCHMARKS

    for benchmark in BENCHMARKS.values():
        print(f"{benchmark.name}: {benchmark.description}")
        for case in benchmark.cases:
            pictures = f"{case.views * case.rings} pictures of {case.image_wh[0]}x{case.image_wh[1]}"
            print(f"  {case.name:<16}{case.scene}, {case.profile}, {pictures}, seed {case.seed}")


def make(
    name: Annotated[str, named("NAME")],
    /,
    *,
    output: OutputFolder,
    cases: Cases = (),
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Render a benchmark, and check that its pictures are those of every other machine.

    A dataset is made for each case. Stopped half-way, the same command goes on where it stopped.

    Parameters
    ----------
    name : str
        Of the benchmark; 'rhizotwin bench list' lists them.
    output : Path
        Folder of the datasets.
    cases : tuple of str
        Only these cases; default: all.
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin bench make quick-1 -o my_quick
    rhizotwin bench make roots-1 -o my_roots --cases bean,maize
    """
    from rhizotwin.bench.make import make as render
    from rhizotwin.bench.named import find

    benchmark = find(name).chosen(cases)
    command_steps.start_engine(device, quiet=progress.quiet)
    with progress.bar(render=float(len(benchmark.cases))) as bar:
        found = render(benchmark, output, monitor=bar, say=print)
    wrong = [one.case for one in found if one.largest != float("inf") and not one.same]
    if wrong:
        raise UserError(f"{', '.join(wrong)} of {output} is not what other machines render; results on it cannot be compared with theirs")
    print(f'next: rhizotwin bench run {name} {output} --method "my_tool {{dataset}} {{output}}" -o results.json')


def run(
    name: Annotated[str, named("NAME")],
    folder: BenchmarkFolder,
    /,
    *,
    method: str,
    output: OutputFile,
    options: RunOptions = RunOptions(),
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Run a method on each case of a benchmark, score what it writes, and measure time and memory.

    The method sees a folder without truth that holds the dataset, cameras for nerfstudio (transforms.json) and COLMAP
    (colmap), binary masks (masks) and undistorted pictures (undistorted). What it writes is scored by the names of its
    files: shape.ply, .stl, .obj or .glb, voxels.nrrd or .npz, points.ply or .xyz, roots.rsml, traits.csv. A method that
    crashes, hangs or writes nothing is a row that says so. Results are written after each case. Stopped half-way, the
    same command goes on with the case at which it stopped.

    Parameters
    ----------
    name : str
        Of the benchmark.
    folder : Path
        Where 'rhizotwin bench make' put it.
    method : str
        Command line in which {dataset} and {output} stand for folders; or ours, thesis, hull.
    output : Path
        JSON file of the results.
    options : RunOptions
        How it is run.
    device : str
        What computes cameras and masks: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin bench run quick-1 my_quick --method "python my_method.py {dataset} {output}" -o mine.json
    rhizotwin bench run quick-1 my_quick --method ours --cases print,bean -o ours.json
    """
    from rhizotwin.bench import results, run_method
    from rhizotwin.bench.make import check_made
    from rhizotwin.bench.named import find

    benchmark = find(name).chosen(options.cases)
    run_method.command_of(method)  # a mistake is said before the work
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

        def tell(row: run_method.Row) -> None:
            taken = ", from an earlier run" if row.case in finished else ""
            print(f"{row.case}: {row.state}{f', {row.sentence}' if row.sentence else ''}{taken}", flush=True)
            rows.append(row)
            stored = run_method.as_json(benchmark, method, rows, name=options.label or method, cameras=options.cameras)
            atomic.write_json(output, stored)
            step()

        run_method.run(
            benchmark, folder, method,
            cameras=options.cameras, timeout_s=options.timeout_s, keep=options.keep, finished=finished, say=tell,
        )  # fmt: skip


def score(
    name: Annotated[str, named("NAME")],
    folder: BenchmarkFolder,
    outputs: Annotated[Path, named("OUTPUTS")],
    /,
    *,
    output: OutputFile,
    label: Annotated[str, named("TEXT")],
    cases: Cases = (),
) -> None:
    """Score what a method wrote elsewhere, such as on a cluster.

    Parameters
    ----------
    name : str
        Of the benchmark.
    folder : Path
        Where 'rhizotwin bench make' put it.
    outputs : Path
        A folder for each case, named by it, with the method's files.
    output : Path
        JSON file of the results.
    label : str
        The method's name in tables.
    cases : tuple of str
        Only these cases; default: all.

    Examples
    --------
    rhizotwin bench score quick-1 my_quick my_outputs --label "my method" -o mine.json
    """
    from rhizotwin.bench import results, run_method
    from rhizotwin.bench.make import check_made
    from rhizotwin.bench.named import find

    benchmark = find(name).chosen(cases)
    check_made(benchmark, folder)
    if not outputs.is_dir():
        raise UserError(f"{outputs} does not exist; give the folder that holds a folder for each case")
    rows = run_method.score(benchmark, folder, outputs)
    atomic.write_json(output, run_method.as_json(benchmark, "", rows, name=label, cameras=None))
    print(results.markdown([results.read(output)]))


def table(
    files: Annotated[tuple[Path, ...], named("RESULTS.json")],
    /,
    *,
    output: OutputFile | None = None,
) -> None:
    """Lay results of several methods side by side.

    Parameters
    ----------
    files : tuple of Path
        What 'rhizotwin bench run' or 'score' wrote, here or elsewhere.
    output : Path, optional
        A page (.html) whose columns can be sorted, or a table in Markdown (.md); default: print it.

    Examples
    --------
    rhizotwin bench table mine.json hull.json
    rhizotwin bench table mine.json hull.json -o results.html
    """
    from rhizotwin.bench import results
    from rhizotwin.bench.results_page import page

    several = [results.read(file) for file in files]
    if not several:
        raise UserError("give at least one file of results")
    if output is None:
        print(results.markdown(several))
        return
    if output.suffix.lower() not in (".html", ".md"):
        raise UserError(f"{output}: give a name that ends in .html or .md")
    atomic.write_text(output, page(several) if output.suffix.lower() == ".html" else results.markdown(several) + "\n")
    print(f"wrote {output}")


def gate(
    file: Annotated[Path, named("RESULTS.json")],
    /,
    *,
    baseline: Annotated[Path, named("FILE")],
    junit: Annotated[Path | None, named("FILE")] = None,
) -> int:
    """Compare results with a baseline; the exit code is 1 where a number got worse.

    Parameters
    ----------
    file : Path
        What 'rhizotwin bench run' wrote.
    baseline : Path
        The same of an earlier version, kept beside the method's code.
    junit : Path, optional
        Write a JUnit file, a test for each number.

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
