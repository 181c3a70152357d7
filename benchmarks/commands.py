"""Commands of the benchmarks that have no gate, each with its report.

A command takes the parsed arguments and returns the exit code. Modules are imported by the commands that need them,
because the first import of Dr.Jit selects the LLVM of the process.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from benchmarks.arguments import FROZEN_RUNS
from benchmarks.output import about, results_folder, say
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count

HERE = Path(__file__).resolve().parent


def thesis(given: argparse.Namespace) -> int:
    """Write the page that compares the thesis with our results."""
    from benchmarks import assumptions, thesis_figures, thesis_page

    path = given.output or results_folder() / "thesis.md"
    if path.suffix.lower() != ".md":
        raise UserError(f"{path}: the page is Markdown; its name must end in .md")
    counted = assumptions.measure(thesis_page.PHANTOM, say=say, only_kept=given.kept)
    levels = assumptions.levels(thesis_page.PHANTOM, say=say, only_kept=given.kept)
    if given.committed:
        records = thesis_page.committed_records(given.profile)
    else:
        records = thesis_page.measure(given.profile, device=given.device, say=say, only_kept=given.kept)
    found = thesis_page.plants(records)
    method = {} if given.kept else thesis_figures.draw(replace(thesis_page.PHANTOM, profile="bench"))
    for file in thesis_page.write(path, found, levels, counted, method):
        say(f"wrote {file}")
    return 0


def intervals(given: argparse.Namespace) -> int:
    """Measure random scans, or read their table; report the coverage, and record the calibration if asked to.

    Return 1 if a scan failed.
    """
    from benchmarks import conformal, intervals, intervals_page, intervals_table
    from rhizotwin.recon.settings import TrustSettings
    from rhizotwin.recon.uncertainty import calibration

    if given.count < 1 or given.first < 0 or given.processes < 1:
        raise UserError("--count and --processes must be 1 or more, and --first 0 or more")
    if given.table is None:
        numbers = range(given.first, given.first + given.count)
        table = intervals_table.table_of(intervals.measure(numbers, processes=given.processes, device=given.device, say=say))
    else:
        table = intervals_table.read(given.table)
    failures = intervals_table.failures(table)
    if failures and len(failures) == len(table):
        say(_failed_scans(failures, len(table)))
        return 1
    factors = conformal.calibrate(table, widest=TrustSettings.widest)
    text = intervals_page.page(table, factors, widest=TrustSettings.widest)
    say("\n" + text)
    output = (given.output or results_folder() / "intervals.csv").with_suffix(".csv")
    for path in (output, *([HERE / "intervals.csv"] if given.calibrate else [])):
        atomic.write_text(path, table.to_csv(index=False))
    atomic.write_text(output.with_suffix(".md"), text)
    intervals_page.draw(table, output.with_suffix(".png"), widest=TrustSettings.widest)
    if given.calibrate:
        source = f"benchmarks/intervals.csv: conformal prediction from {len(table) - len(failures)} random scans"
        atomic.write_json(calibration.TABLE, {"source": source, "confidence": conformal.CONFIDENCE, "factors": factors})
    say(f"every number: {output}")
    if failures:
        say(_failed_scans(failures, len(table)))
    return 1 if failures else 0


def _failed_scans(failures: Sequence[str], scans: int) -> str:
    return f"{len(failures)} of {count(scans, 'random scan')} failed; the first error is: {failures[0]}"


def _write(given: argparse.Namespace, found: dict[str, Any]) -> Path:
    """Write the numbers of a command as JSON, and return the path."""
    output: Path = given.output or results_folder() / f"{given.what}.json"
    atomic.write_json(output, {"about": about(given.what, given.device), **found})
    say(f"every number: {output}")
    return output


def growth(given: argparse.Namespace) -> int:
    """Measure growth on reconstructions, and the detection of treatment effects."""
    from benchmarks import growth

    found: dict[str, Any] = {}
    if not given.no_pictures:
        found["links"] = growth.measure(given.profile, say=say).plain()
        say("\n".join(f"{name}: {value}" for name, value in found["links"].items() if name != "rate_errors"))
    for name, effect in (("treated", growth.TREATED), ("equal", 1.0)):
        apart = growth.treatments(given.sets, effect=effect, say=say)
        found[name] = {"growth": effect, "sets": len(apart), "told_apart": sum(apart)}
    say(
        "\n".join(
            f"growth {found[name]['growth']:g}: {found[name]['told_apart']} of {given.sets} distinguished" for name in ("treated", "equal")
        )
    )
    slope, intervals = growth.responses(given.sets, say=say)
    held = sum(low <= slope <= high for low, high in intervals)
    found["dose_response"] = {"slope": slope, "intervals": intervals, "held": held}
    say(f"dose response: the slope {slope:.4f} l/mmol is inside {held} of {given.sets} intervals")
    _write(given, found)
    return 0


def damages(given: argparse.Namespace) -> int:
    """Run all damages; return 1 if a wrong volume is trusted, or a run crashed."""
    from benchmarks import damages

    records = damages.measure(given.names, scene=given.scene, say=say)
    text = damages.table(records)
    say("\n" + text)
    atomic.write_text(_write(given, {"records": records}).with_suffix(".md"), text)
    return 1 if any(damages.fails(record) for record in records) else 0


def compare(given: argparse.Namespace) -> int:
    """Print the changes between two runs of the ladder on the same pictures."""
    from benchmarks import run_comparison

    say(run_comparison.compare(run_comparison.read_cases(given.before), run_comparison.read_cases(given.after), method=given.method))
    return 0


def scaling(given: argparse.Namespace) -> int:
    """Measure how time and memory grow with the size of a task."""
    from benchmarks import scaling

    found = scaling.measure(given.axes, quick=given.quick, device=given.device, say=say)
    say("\n" + scaling.table(found))
    if given.output is not None:
        atomic.write_json(given.output, {"growths": [asdict(one) for one in found]})
        atomic.write_bytes(given.output.with_suffix(".png"), scaling.draw(found))
    return 0


def fingerprints(given: argparse.Namespace) -> int:
    """Write the fingerprints of a rendered benchmark into the package."""
    from rhizotwin.bench import benchmarks, fingerprints

    fingerprints.write(benchmarks.find(given.name), given.folder, HERE.parent / "rhizotwin" / "bench" / "data")
    return 0


def against(given: argparse.Namespace) -> int:
    """Compare the speed with that of another commit."""
    from benchmarks import commit_comparison

    jobs: tuple[commit_comparison.Job, ...] = commit_comparison.QUICK if given.quick else commit_comparison.JOBS
    if given.jobs is not None:
        unknown = [name for name in given.jobs if name not in {job.name for job in jobs}]
        if unknown:
            raise UserError(f"--jobs {unknown[0]} is none of {', '.join(job.name for job in jobs)}")
        jobs = tuple(job for job in jobs if job.name in given.jobs)
    if given.repeats < 1:
        raise UserError(f"--repeats {given.repeats}: must be at least 1")
    ratios = commit_comparison.compare(given.against, jobs=jobs, repeats=given.repeats, device=given.device, say=say)
    say("\n" + commit_comparison.table(ratios))
    if given.output is not None:
        atomic.write_json(given.output, {"against": given.against, "ratios": [asdict(ratio) for ratio in ratios]})
    return 0


def freeze(given: argparse.Namespace) -> int:
    """Keep pictures and intermediate values of the frozen cases."""
    from benchmarks import frozen

    folder = given.output or results_folder() / "frozen"
    records = frozen.freeze(folder, given.cases or tuple(frozen.CASES), device=given.device, say=say)
    say("\n" + frozen.table(records))
    say(f"frozen: {folder}; compare a changed reconstruction with `./run bench against {folder}`")
    return 0


def against_frozen(given: argparse.Namespace) -> int:
    """Compare the reconstruction with frozen cases; return 1 if a case crashed."""
    from benchmarks import frozen

    rows = frozen.compare(given.frozen, given.cases, device=given.device, say=say)
    say("\n" + frozen.compared_table(rows))
    if given.output is not None:
        _write(given, {"cases": [{**row, "changes": [asdict(one) for one in row.get("changes", ())]} for row in rows]})
    return 1 if any("crashed" in row for row in rows) else 0


def write_ladder_page(records: Sequence[dict[str, Any]]) -> None:
    """Write the page of the documentation with the committed results of the ladder and the scatter of the tree."""
    from benchmarks import table, tree_scatter

    atomic.write_text(HERE.parent / "docs" / "ladder.md", table.page(records, tree_scatter.read()))


def tree_scatter(given: argparse.Namespace) -> int:
    """Measure and record the scatter of frozen trees under changes of the pictures that should not matter."""
    from benchmarks import ladder, tree_scatter

    runs = FROZEN_RUNS if given.runs is None else given.runs
    if runs < 1:
        raise UserError(f"--runs {runs}: must be at least 1")
    stored = tree_scatter.measure(given.frozen, runs=runs, device=given.device, say=say)
    say("\n" + tree_scatter.table(stored))
    tree_scatter.write(stored)
    write_ladder_page(ladder.read())
    say(f"recorded: {tree_scatter.PATH}")
    return 0
