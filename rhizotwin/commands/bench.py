"""Run reconstruction methods on standard benchmarks and compare them.

A benchmark is a set of simulated scans, called cases, whose true roots are known exactly. A method is any program that
reads a dataset and writes a mesh, voxels, points, centre lines of the roots or a table of traits.

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

from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count, was
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import Computing, OutputFile, OutputFolder, Progress, list_of, option, read_number, with_metavar

if TYPE_CHECKING:
    from rhizotwin.bench.benchmarks import Benchmark

TIMEOUT_LIMITS_S = (1.0, 1e6)
Cases: TypeAlias = Annotated[tuple[str, ...], option(list_of(str), "NAME,NAME,...")]
BenchmarkFolder: TypeAlias = Annotated[Path, with_metavar("FOLDER")]


def read_timeout_s(text: str) -> float:
    """Convert text to a timeout in seconds."""
    return read_number(text, TIMEOUT_LIMITS_S, "s")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options for running a method."""

    label: Annotated[str | None, with_metavar("TEXT")] = None
    """Name of the method in tables; default: the command line of the method."""
    cases: Cases = ()
    """Names of the cases to run, separated by commas; default: all cases."""
    cameras: Literal["estimated", "true"] = "estimated"
    """Cameras in the method's input: estimated (from the markers in the pictures) or true (as rendered)."""
    timeout_s: Annotated[float, option(read_timeout_s, "S")] = 3600.0
    """Timeout per case in seconds, after which the method is stopped."""
    keep: Annotated[Path | None, with_metavar("FOLDER")] = None
    """Folder in which the output of the method is kept, with one subfolder per case; default: the output is deleted."""


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
    computing: Computing = Computing(),
) -> None:
    """Render a benchmark and verify its pictures.

    A dataset (folder of pictures) is rendered for each case. The pictures are compared with stored reference values, so
    that results from different computers are comparable. After an interruption, run the same command again to continue.

    Parameters
    ----------
    name : str
        Name of the benchmark, listed by 'rhizotwin bench list'.
    output : Path
        Folder for the datasets.
    cases : tuple of str
        Names of the cases to render, separated by commas; default: all cases.
    computing : Computing
        Device of the computation, and progress output.

    Examples
    --------
    rhizotwin bench make quick-1 -o my_quick
    rhizotwin bench make roots-1 -o my_roots --cases bean,maize
    """
    from rhizotwin.bench.benchmarks import find
    from rhizotwin.bench.make import make as render

    benchmark = find(name).chosen(cases)
    command_steps.start_engine(computing.device, quiet=computing.quiet)
    with computing.bar(render=float(len(benchmark.cases))) as bar:
        found = render(benchmark, output, monitor=bar, say=print)
    wrong = [one.case for one in found if one.has_reference and not one.same]
    if wrong:
        raise UserError(
            f"the pictures of {', '.join(wrong)} in {output} differ from the reference, so results on them cannot be compared with others"
        )
    print(f'next: rhizotwin bench run {name} {output} --method "my_tool {{dataset}} {{output}}" -o results.json')


def run(
    name: Annotated[str, with_metavar("NAME")],
    folder: BenchmarkFolder,
    /,
    *,
    method: Annotated[str, with_metavar("METHOD")],
    output: OutputFile,
    options: RunOptions = RunOptions(),
    computing: Computing = Computing(),
) -> None:
    """Run a method on each case of a benchmark, score its output, and measure time and memory.

    The method receives a copy of the dataset without the true roots, together with cameras for nerfstudio
    (transforms.json) and COLMAP (colmap), silhouettes (masks) and pictures without lens distortion (undistorted). Its
    output is recognised by file names: shape.ply, .stl, .obj or .glb, voxels.nrrd or .npz, points.ply or .xyz,
    roots.rsml, and traits.csv. If a method crashes, exceeds the timeout or writes no output, this is recorded as its
    result. Results are saved after each case, in a file RESULTS.json.part if RESULTS.json contains other results; after
    an interruption, run the same command again to continue.

    Parameters
    ----------
    name : str
        Name of the benchmark.
    folder : Path
        Folder written by 'rhizotwin bench make'.
    method : str
        Command line of the method, in which {dataset} and {output} are replaced by folders; or a method of this
        program: ours, thesis, regularised or hull (see 'rhizotwin reconstruct').
    output : Path
        JSON file to which the results are written.
    options : RunOptions
        Options for running the method.
    computing : Computing
        Device on which cameras and silhouettes are computed, and progress output.

    Examples
    --------
    rhizotwin bench run quick-1 my_quick --method "python my_method.py {dataset} {output}" -o mine.json
    rhizotwin bench run quick-1 my_quick --method ours --cases print,bean -o ours.json
    """
    from rhizotwin.bench import results, run_method
    from rhizotwin.bench.benchmarks import find
    from rhizotwin.bench.make import check_made

    benchmark = find(name).chosen(options.cases)
    run_method.command_of(method, cameras=options.cameras)  # report an invalid command line first
    check_made(benchmark, folder)
    command_steps.start_engine(computing.device, quiet=computing.quiet)
    _run_cases(benchmark, folder, method, output, options, computing)
    print(results.markdown([results.read(output)]))
    print(f"next: rhizotwin bench table {output} -o results.html")


def _run_cases(benchmark: "Benchmark", folder: Path, method: str, output: Path, options: RunOptions, progress: Progress) -> None:
    """Run a method on all cases, and write the results after each case.

    Other results in the file, such as those of a complete run, are replaced when this run is complete.
    """
    from rhizotwin.bench import run_method

    part = output.with_name(f"{output.name}.part")
    begun = part if part.is_file() else output
    finished = run_method.finished_rows(begun, benchmark, method, cameras=options.cameras)
    written = part if output.is_file() and (begun == part or finished is None) else output
    rows = dict(finished or {})
    with progress.bar(cases=1.0) as bar, bar.stage("cases"), bar.steps("cases", len(benchmark.cases), "case") as step:

        def record(row: run_method.Row) -> None:
            earlier = " (from an earlier run)" if row.case in (finished or {}) else ""
            print(f"{row.case}: {row.state}{f', {row.sentence}' if row.sentence else ''}{earlier}", flush=True)
            rows[row.case] = row
            known = [rows[case.name] for case in benchmark.cases if case.name in rows]
            stored = run_method.as_json(benchmark, method, known, name=options.label or method, cameras=options.cameras)
            atomic.write_json(written, stored)
            step()

        conditions = run_method.Conditions(cameras=options.cameras, timeout_s=options.timeout_s, keep=options.keep)
        run_method.run(benchmark, folder, method, conditions=conditions, finished=finished, say=record)
    if written == part:
        part.replace(output)
    part.unlink(missing_ok=True)


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
    """Score output that a method has written on another computer, such as a cluster.

    Parameters
    ----------
    name : str
        Name of the benchmark.
    folder : Path
        Folder written by 'rhizotwin bench make'.
    outputs : Path
        Folder with the output of the method, with one subfolder per case, named after the case.
    output : Path
        JSON file to which the results are written.
    label : str
        Name of the method in tables.
    cases : tuple of str
        Names of the cases to score, separated by commas; default: all cases.

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
    """Show the results of several methods in one table.

    Parameters
    ----------
    files : tuple of Path
        Files of results, written by 'rhizotwin bench run' or 'rhizotwin bench score'.
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
        raise UserError("the table needs at least one file of results, written by 'rhizotwin bench run' or 'rhizotwin bench score'")
    if output is None:
        print(results.markdown(several))
        return
    if output.suffix.lower() not in (".html", ".md"):
        raise UserError(f"the suffix of {output} must be .html or .md")
    atomic.write_text(output, page(several) if output.suffix.lower() == ".html" else results.markdown(several) + "\n")
    print(f"wrote {output}")


def gate(
    file: Annotated[Path, with_metavar("RESULTS.json")],
    /,
    *,
    baseline: Annotated[Path, with_metavar("BASELINE")],
    junit: Annotated[Path | None, with_metavar("FILE")] = None,
) -> int:
    """Compare results with a baseline; the exit code is 1 if a value is worse.

    Parameters
    ----------
    file : Path
        File of results, written by 'rhizotwin bench run'.
    baseline : Path
        File of results from an earlier version of the method.
    junit : Path, optional
        JUnit file to write, with one test case per compared value.

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
    print(f"{count(len(findings), 'value')} {was(len(findings))} compared; worse: {len(worse)}")
    return 1 if worse else 0
