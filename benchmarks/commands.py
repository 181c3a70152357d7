"""Commands of the benchmarks beside those of the ladder, each with its report.

A command returns the exit code. Modules are imported by the commands that need them, because the first import of Dr.Jit
selects the LLVM of the process.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from benchmarks.intervals import COUNT
from benchmarks.options import Words
from benchmarks.output import about, results_folder, say
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.steps.arguments import Device, Flag, OutputFile, OutputFolder, with_metavar

HERE = Path(__file__).resolve().parent
Profile = Literal["clean", "bench", "harsh"]
Json = Annotated[Path, with_metavar("FILE.json")]


def _start(device: str) -> None:
    """Start the engine in this process, before any import of Dr.Jit, which loads the first LLVM that it finds."""
    from rhizotwin import engine

    engine.start(device)


def _write(command: str, found: dict[str, Any], *, output: Path | None, device: str) -> Path:
    """Write the numbers of a command as JSON, and return the path."""
    path = output or results_folder() / f"{command}.json"
    atomic.write_json(path, {"about": about(command, device), **found})
    say(f"every number: {path}")
    return path


def speed(
    *,
    against: str | None = None,
    jobs: Words = None,
    repeats: int = 3,
    quick: Flag = False,
    output: OutputFile | None = None,
    device: Device = "auto",
) -> int:
    """Measure processor time and memory of commands, and compare them with another commit.

    Parameters
    ----------
    against : str, optional
        Check out this commit and alternate runs.
    jobs : tuple of str, optional
        Only these jobs (a wrong name lists them).
    repeats : int
        Runs per job, of each commit.
    quick : bool
        The small jobs.
    output : Path, optional
        Where to write every number as JSON.
    device : str
        Where to compute.
    """
    from benchmarks import commit_comparison

    offered = commit_comparison.QUICK if quick else commit_comparison.JOBS
    unknown = [name for name in jobs or () if name not in {job.name for job in offered}]
    if unknown:
        raise UserError(f"--jobs {unknown[0]} is none of {', '.join(job.name for job in offered)}")
    if repeats < 1:
        raise UserError(f"--repeats {repeats}: must be at least 1")
    chosen = [job for job in offered if jobs is None or job.name in jobs]
    ratios = commit_comparison.compare(against, jobs=chosen, repeats=repeats, device=device, say=say)
    say("\n" + commit_comparison.table(ratios))
    if output is not None:
        atomic.write_json(output, {"against": against, "ratios": [asdict(ratio) for ratio in ratios]})
    return 0


def scaling(*, axes: Words = None, quick: Flag = False, output: OutputFile | None = None, device: Device = "auto") -> int:
    """Measure how time and memory grow with views, pixels, length of roots and finer voxels, one at a time.

    Parameters
    ----------
    axes : tuple of str, optional
        Only these axes (a wrong name lists them).
    quick : bool
        Reduced axes.
    output : Path, optional
        Where to write every number as JSON, with a figure beside it.
    device : str
        Where to compute.
    """
    from benchmarks import scaling

    found = scaling.measure(axes, quick=quick, device=device, say=say)
    say("\n" + scaling.table(found))
    if output is not None:
        atomic.write_json(output, {"growths": [asdict(one) for one in found]})
        atomic.write_bytes(output.with_suffix(".png"), scaling.draw(found))
    return 0


def rig(*, quick: Flag = False, output: OutputFile | None = None, device: Device = "auto") -> int:
    """Measure the emulated rig: faults, kinematics, overhead, lens, and a scan with its reconstruction.

    The exit code is 1 if a scan with faults went wrong, a target is missed, or a part crashed.

    Parameters
    ----------
    quick : bool
        Fewer faults and poses, and no reconstruction (three minutes).
    output : Path, optional
        Where to write every number as JSON; default: the cache folder.
    device : str
        Where to compute.
    """
    _start(device)
    from benchmarks import rig
    from benchmarks.output import results_table
    from benchmarks.targets import TARGETS

    run = rig.measure(quick=quick, say=say)
    say("\n" + results_table(run.metrics))
    _write("rig", {"metrics": {m.key: m.value for m in run.metrics}, **run.details, "crashed": run.crashed}, output=output, device=device)
    missed = [m for m in run.metrics if m.key in TARGETS and not TARGETS[m.key].reached(m.value)]
    return 1 if run.crashed or missed else 0


def compare(before: Json, after: Json, /, *, method: Literal["coverage", "thesis"] = "coverage") -> int:
    """Compare two runs of the ladder on the same pictures.

    Parameters
    ----------
    before : Path
        Output of `accuracy -o` before the change.
    after : Path
        Output after the change; cases in only one of them are ignored.
    method : str
        Method whose cases are compared.
    """
    from benchmarks import run_comparison

    say(run_comparison.compare(run_comparison.read_cases(before), run_comparison.read_cases(after), method=method))
    return 0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Scans:
    """Options for the random scans."""

    count: int = COUNT
    """Number of scans."""
    first: int = 0
    """Number of the first scan."""
    processes: int = 1
    """Number of scans at the same time."""
    table: Annotated[Path | None, with_metavar("FILE.csv")] = None
    """Evaluate this table of an earlier run, such as benchmarks/intervals.csv, without new scans."""


def intervals(
    *,
    scans: Scans = Scans(),
    calibrate: Flag = False,
    output: OutputFile | None = None,
    device: Device = "auto",
) -> int:
    """Measure how often the 90 % intervals contain the truth, on small random scans of random subjects.

    The factors that calibrate them are printed. The exit code is 1 if a scan failed. A stopped run is resumed.

    Parameters
    ----------
    calibrate : bool
        Record the factors in recon/uncertainty, and the table beside this command.
    output : Path, optional
        Table of all scans (.csv); a page and a figure are written beside it (.md, .png).
    device : str
        Where to compute.
    """
    from benchmarks import conformal, intervals, intervals_page, intervals_table
    from rhizotwin.recon.settings import TrustSettings
    from rhizotwin.recon.uncertainty import calibration

    if scans.count < 1 or scans.first < 0 or scans.processes < 1:
        raise UserError("--count and --processes must be 1 or more, and --first 0 or more")
    if scans.table is None:
        numbers = range(scans.first, scans.first + scans.count)
        table = intervals_table.table_of(intervals.measure(numbers, processes=scans.processes, device=device, say=say))
    else:
        table = intervals_table.read(scans.table)
    failures = intervals_table.failures(table)
    if failures and len(failures) == len(table):
        say(_failed_scans(failures, len(table)))
        return 1
    factors = conformal.calibrate(table, widest=TrustSettings.widest)
    text = intervals_page.page(table, factors, widest=TrustSettings.widest)
    say("\n" + text)
    path = (output or results_folder() / "intervals.csv").with_suffix(".csv")
    for written in (path, *([HERE / "intervals.csv"] if calibrate else [])):
        atomic.write_text(written, table.to_csv(index=False))
    atomic.write_text(path.with_suffix(".md"), text)
    intervals_page.draw(table, path.with_suffix(".png"), widest=TrustSettings.widest)
    if calibrate:
        source = f"benchmarks/intervals.csv: conformal prediction from {len(table) - len(failures)} random scans"
        atomic.write_json(calibration.TABLE, {"source": source, "confidence": conformal.CONFIDENCE, "factors": factors})
    say(f"every number: {path}")
    if failures:
        say(_failed_scans(failures, len(table)))
    return 1 if failures else 0


def _failed_scans(failures: Sequence[str], scans: int) -> str:
    return f"{len(failures)} of {count(scans, 'random scan')} failed; the first error is: {failures[0]}"


def damages(*, names: Words = None, scene: str = "printed_8ml", output: OutputFile | None = None, device: Device = "auto") -> int:
    """Find out whether a wrong volume is ever trusted: one clean scan with typical errors of laboratories.

    The exit code is 1 if a wrong volume is trusted, or a run crashed.

    Parameters
    ----------
    names : tuple of str, optional
        Only these damages (a wrong name lists them).
    scene : str
        Scene of the quick ladder whose clean scan is used.
    output : Path, optional
        Where to write every number as JSON, and a table beside it (.md); default: the cache folder.
    device : str
        Where to compute.
    """
    _start(device)
    from benchmarks import damages

    records = damages.measure(names, scene=scene, say=say)
    text = damages.table(records)
    say("\n" + text)
    atomic.write_text(_write("damages", {"records": records}, output=output, device=device).with_suffix(".md"), text)
    return 1 if any(damages.fails(record) for record in records) else 0


def thesis(
    *,
    profile: Profile = "clean",
    committed: Flag = False,
    kept: Flag = False,
    output: OutputFile | None = None,
    device: Device = "auto",
) -> int:
    """Write one page that compares the thesis with its re-implemented method and ours.

    It contains table 4.1, figures 3.6 to 3.10, 4.1 and 5.3, and the effect of the thesis's assumptions. A stopped run
    is resumed, and measurements of the ladder are reused.

    Parameters
    ----------
    profile : str
        Disturbance profile of the radishes' pictures.
    committed : bool
        Use the radishes' volumes of the ladder's committed baseline.
    kept : bool
        Use earlier measurements only; missing values are shown as dashes.
    output : Path, optional
        Page (.md); figures are written beside it; default: the cache folder.
    device : str
        Where to compute.
    """
    _start(device)
    from benchmarks import assumptions, thesis_figures, thesis_page

    path = output or results_folder() / "thesis.md"
    if path.suffix.lower() != ".md":
        raise UserError(f"{path}: the page is Markdown; its name must end in .md")
    counted = assumptions.measure(thesis_page.PHANTOM, say=say, only_kept=kept)
    levels = assumptions.levels(thesis_page.PHANTOM, say=say, only_kept=kept)
    measure = partial(thesis_page.measure, device=device, say=say, only_kept=kept)
    found = thesis_page.plants((thesis_page.committed_records if committed else measure)(profile))
    method = {} if kept else thesis_figures.draw(replace(thesis_page.PHANTOM, profile="bench"))
    for file in thesis_page.write(path, found, levels, counted, method):
        say(f"wrote {file}")
    return 0


def growth(
    *,
    profile: Profile = "bench",
    sets: int = 20,
    no_pictures: Flag = False,
    output: OutputFile | None = None,
    device: Device = "auto",
) -> int:
    """Measure growth on reconstructions, and the detection of treatment effects.

    One plant is reconstructed on six days, for the identification and elongation of its roots; finished days are
    reused. Detection of a treatment effect and coverage of dose-response intervals use true lengths with the error of
    a scan.

    Parameters
    ----------
    profile : str
        Disturbance profile of the plant's pictures.
    sets : int
        Number of sets of plants.
    no_pictures : bool
        Only treatments and doses, without rendering and reconstruction.
    output : Path, optional
        Where to write every number as JSON; default: the cache folder.
    device : str
        Where to compute.
    """
    if sets < 1:
        raise UserError(f"--sets {sets}: must be at least 1")
    _start(device)
    from benchmarks import growth

    found: dict[str, Any] = {}
    if not no_pictures:
        found["links"] = growth.measure(profile, say=say).plain()
        say("\n".join(f"{name}: {value}" for name, value in found["links"].items() if name != "rate_errors"))
    for name, effect in (("treated", growth.TREATED), ("equal", 1.0)):
        apart = sum(growth.treatments(sets, effect=effect, say=say))
        found[name] = {"growth": effect, "sets": sets, "told_apart": apart}
        say(f"growth {effect:g}: {apart} of {sets} distinguished")
    slope, ranges = growth.responses(sets, say=say)
    held = sum(low <= slope <= high for low, high in ranges)
    found["dose_response"] = {"slope": slope, "intervals": ranges, "held": held}
    say(f"dose response: the slope {slope:.4f} l/mmol is inside {held} of {sets} intervals")
    _write("growth", found, output=output, device=device)
    return 0


def freeze(*, cases: Words = None, output: OutputFolder | None = None, device: Device = "auto") -> int:
    """Keep twelve cases with pictures, intermediate values and scores in one folder, to compare changed code with.

    A stopped run is resumed.

    Parameters
    ----------
    cases : tuple of str, optional
        Only these cases (a wrong name lists them).
    output : Path, optional
        New folder; default: in the cache folder.
    device : str
        Where to compute.
    """
    _start(device)
    from benchmarks import frozen

    folder = output or results_folder() / "frozen"
    records = frozen.freeze(folder, cases or tuple(frozen.CASES), device=device, say=say)
    say("\n" + frozen.compared_table([{"name": one["name"], "before": one, "after": one} for one in records]))
    say(f"frozen: {folder}; compare a changed reconstruction with `./run bench against {folder}`")
    return 0


def against(
    frozen: Annotated[Path, with_metavar("FROZEN")], /, *, cases: Words = None, output: OutputFile | None = None, device: Device = "auto"
) -> int:
    """Reconstruct frozen pictures with the present code; compare every kind of intermediate values, and the scores.

    The exit code is 1 if a case crashed.

    Parameters
    ----------
    frozen : Path
        Folder written by `freeze`.
    cases : tuple of str, optional
        Only these cases (a wrong name lists them).
    output : Path, optional
        Where to write every number as JSON; default: only the table.
    device : str
        Where to compute.
    """
    from benchmarks import frozen as frozen_cases

    rows = frozen_cases.compare(frozen, cases, device=device, say=say)
    say("\n" + frozen_cases.compared_table(rows))
    if output is not None:
        plain = [{**row, "changes": [asdict(one) for one in row.get("changes", ())]} for row in rows]
        _write("against", {"cases": plain}, output=output, device=device)
    return 1 if any("crashed" in row for row in rows) else 0


def fingerprints(name: Annotated[str, with_metavar("NAME")], folder: Annotated[Path, with_metavar("FOLDER")], /) -> int:
    """Write the fingerprints with which `rhizotwin bench make` compares a rendered benchmark.

    Parameters
    ----------
    name : str
        Name of the benchmark, such as quick-1.
    folder : Path
        Folder in which `rhizotwin bench make` rendered it.
    """
    from rhizotwin.bench import benchmarks, fingerprints

    fingerprints.write(benchmarks.find(name), folder, HERE.parent / "rhizotwin" / "bench" / "data")
    return 0
