"""Command line of the benchmarks."""

import argparse
import json
import platform
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks import cases, gate, scatter
from benchmarks.arguments import parser
from benchmarks.metric import Metric
from benchmarks.run import Run
from benchmarks.targets import TARGETS
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count

HERE = Path(__file__).resolve().parent


def say(text: str) -> None:
    """Write a line of progress."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def about(given: argparse.Namespace) -> dict[str, Any]:
    """Return the versions, device and command of the measurements."""
    from rhizotwin import sources

    packages = ("mitsuba", "drjit", "numpy", "scipy", "opencv-python-headless", "scikit-image", "trimesh", "manifold3d")
    versions = {}
    for package in packages:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "command": f"{given.what}{' --quick' if given.quick else ''}",
        "device": given.device,
        "reconstruction": sources.digest(("rhizotwin.recon.reconstruct",))[:12],
        "python": platform.python_version(),
        **versions,
    }


def results_table(metrics: Sequence[Metric]) -> str:
    """Return the numbers as text, with their targets."""
    width = max((len(metric.key) for metric in metrics), default=0)
    lines = [f"{'metric':<{width}}  {'value':>12} unit  target"]
    for metric in metrics:
        target = ""
        if metric.key in TARGETS:
            wanted = TARGETS[metric.key]
            target = f"{wanted.text}: {'reached' if wanted.reached(metric.value) else 'NOT REACHED'}"
        lines.append(f"{metric.key:<{width}}  {metric.value:>12.5g} {metric.unit:<4}  {target}".rstrip())
    return "\n".join(lines)


_HERE = ("thesis", "batch", "growth", "damages", "adopt", "rig")
"""Commands that compute in this process; the others run workers."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks; return the exit code."""
    given = parser().parse_args(arguments)
    try:
        if given.what in _HERE:  # before any import of Dr.Jit, which loads the first LLVM that it finds
            from rhizotwin import engine

            engine.start(getattr(given, "device", "cpu"))
        if given.what == "compare":
            return _compare(given)
        if given.what == "scatter":
            return _scatter(given)
        if given.what == "speed" and given.against is not None:
            return _against(given)
        if given.what == "speed" and given.scaling:
            return _scaling(given)
        if given.what == "thesis":
            return _thesis(given)
        if given.what == "intervals":
            return _intervals(given)
        if given.what == "view":
            return _view(given)
        if given.what == "damages":
            return _damages(given)
        if given.what == "batch":
            return _batch(given)
        if given.what == "growth":
            return _growth(given)
        if given.what == "fingerprints":
            return _fingerprints(given)
        return _adopt(given) if given.what == "adopt" else _run(given)
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


def _thesis(given: argparse.Namespace) -> int:
    """Write the page that compares the thesis with our results."""
    from benchmarks import assumptions, thesis_figures, thesis_page

    path = given.output or _results() / "thesis.md"
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


def _intervals(given: argparse.Namespace) -> int:
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
    factors = conformal.calibrate(table)
    text = intervals_page.page(table, factors, widest=TrustSettings.widest)
    say("\n" + text)
    output = (given.output or _results() / "intervals.csv").with_suffix(".csv")
    for path in (output, *([HERE / "intervals.csv"] if given.calibrate else [])):
        atomic.write_text(path, table.to_csv(index=False))
    atomic.write_text(output.with_suffix(".md"), text)
    intervals_page.draw(table, output.with_suffix(".png"))
    if given.calibrate:
        source = f"benchmarks/intervals.csv: conformal prediction from {len(table) - len(failures)} random scans"
        atomic.write_json(calibration.TABLE, {"source": source, "confidence": conformal.CONFIDENCE, "factors": factors})
    say(f"every number: {output}")
    if failures:
        say(_failed_scans(failures, len(table)))
    return 1 if failures else 0


def _failed_scans(failures: Sequence[str], scans: int) -> str:
    return f"{len(failures)} of {count(scans, 'random scan')} failed; the first error is: {failures[0]}"


def _batch(given: argparse.Namespace) -> int:
    """Run a batch with a killed worker and a damaged scan; return 1 if a result is missing, or computed twice."""
    from benchmarks import batch_run

    with tempfile.TemporaryDirectory(prefix="rhizotwin-many-") as folder:
        night = batch_run.measure(Path(folder), say=say)
    say("\n".join(batch_run.lines(night, given.job_s)))
    output = given.output or _results() / "batch.json"
    atomic.write_json(output, {"about": about(argparse.Namespace(what="batch", quick=False, device="cpu")), **batch_run.plain(night)})
    say(f"every number: {output}")
    whole = night.results == batch_run.COUNT - 1 and len(night.sentences) == 1 and not night.twice and night.killed
    return 0 if whole else 1


def _growth(given: argparse.Namespace) -> int:
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
    output = given.output or _results() / "growth.json"
    atomic.write_json(output, {"about": about(argparse.Namespace(what="growth", quick=False, device=given.device)), **found})
    say(f"every number: {output}")
    return 0


def _damages(given: argparse.Namespace) -> int:
    """Run all damages; return 1 if a wrong volume is trusted, or a run crashed."""
    from benchmarks import damages

    records = damages.measure(given.names, scene=given.scene, say=say)
    say("\n" + damages.table(records))
    output = given.output or _results() / "damages.json"
    atomic.write_json(output, {"about": about(argparse.Namespace(what="damages", quick=False, device=given.device)), "records": records})
    atomic.write_text(output.with_suffix(".md"), damages.table(records))
    say(f"every number: {output}")
    return 1 if any(damages.fails(record) for record in records) else 0


def _compare(given: argparse.Namespace) -> int:
    from benchmarks import run_comparison

    say(run_comparison.compare(run_comparison.read_cases(given.before), run_comparison.read_cases(given.after), method=given.method))
    return 0


def _scatter(given: argparse.Namespace) -> int:
    """Measure and record the scatter, and report the gate's verdict on each run."""
    selection = {name: getattr(given, name) for name in ("scenes", "profiles", "methods") if getattr(given, name) is not None}
    chosen = cases.quick(**selection)
    baseline = gate.read_baseline(HERE / "baseline_accuracy_quick.json")
    runs = scatter.measure(chosen, runs=given.runs, change=given.change, device=given.device, say=say)
    crashed = {case: why for run in runs for case, why in run.crashed.items()}
    if crashed:
        raise UserError(f"{next(iter(crashed))} crashed; the recorded scatter is not changed.")
    values = scatter.values(runs)
    say("\n" + scatter.table(values))
    if given.change == scatter.ROUNDED:
        scatter.write(_scatter_path(), values, about=about(given))
        say(f"recorded: {_scatter_path()}")
    rounding, everything = scatter.read(_scatter_path()), {key.rpartition("/")[0] for key in baseline.values}
    for case in chosen:
        one, measured = baseline.without(everything - {case.name}), [scatter.metrics_of_pictures(run.metrics, [case]) for run in runs]
        is_open = [gate.all_pass(gate.compare(metrics, one, scatter=rounding)) for metrics in measured]
        say(f"{case.name}: the gate is open in {sum(is_open)} of {len(is_open)} runs")
    return 0


def _scaling(given: argparse.Namespace) -> int:
    from benchmarks import scaling

    found = scaling.measure(given.axes, quick=given.quick, device=given.device, say=say)
    say("\n" + scaling.table(found))
    if given.output is not None:
        atomic.write_json(given.output, scaling.as_json(found))
        atomic.write_bytes(given.output.with_suffix(".png"), scaling.draw(found))
    return 0


def _view(given: argparse.Namespace) -> int:
    """Measure the viewer; return 1 if that failed."""
    from benchmarks import viewer

    if given.repeats < 1:
        raise UserError(f"--repeats {given.repeats}: must be at least 1")
    run = viewer.measure(given.results, given.dataset, clean=given.clean, repeats=given.repeats, say=say)
    say("\n" + results_table(run.metrics))
    if given.output is not None:
        atomic.write_json(given.output, {metric.key: {"value": metric.value, "unit": metric.unit} for metric in run.metrics})
    return 1 if run.crashed else 0


def _fingerprints(given: argparse.Namespace) -> int:
    """Write the fingerprints of a rendered benchmark into the package."""
    from rhizotwin.bench import benchmarks, fingerprints

    fingerprints.write(benchmarks.find(given.name), given.folder, HERE.parent / "rhizotwin" / "bench" / "data")
    return 0


def _scatter_path() -> Path:
    return HERE / "scatter_accuracy_quick.json"


def _against(given: argparse.Namespace) -> int:
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
        atomic.write_json(given.output, commit_comparison.as_json(given.against, ratios))
    return 0


def _adopt(given: argparse.Namespace) -> int:
    """Adopt each folder; those that do not match are reported, and the rest continue."""
    from benchmarks.adopt import adopt

    refused = 0
    for number, folder in enumerate(given.folders, start=1):
        try:
            say(f"[{number}/{len(given.folders)}] {folder} -> {adopt(folder)}")
        except UserError as error:
            refused += 1
            say(f"[{number}/{len(given.folders)}] REFUSED: {error}")
    return 1 if refused else 0


def _chosen(given: argparse.Namespace) -> tuple[list[cases.Case], bool]:
    """Return the selected cases, and whether they are a part that can neither be gated nor become the baseline."""
    selection = {name: getattr(given, name) for name in ("scenes", "profiles", "seeds", "methods") if getattr(given, name) is not None}
    if given.quick and "seeds" in selection:
        raise UserError("the quick set has no seeds; omit --seeds or --quick.")
    return (cases.quick(**selection) if given.quick else cases.ladder(**selection)), bool(selection)


def _run(given: argparse.Namespace) -> int:
    chosen: list[cases.Case] = []
    if given.what == "accuracy":
        chosen, is_part = _chosen(given)
        if given.list:
            say("\n".join(case.name for case in chosen))
            return 0
        if given.change != "none" and given.update_baseline:
            raise UserError("changed pictures cannot become the baseline; omit --change or --update-baseline.")
        if is_part and (given.update_baseline or (given.gate and not given.quick)):
            what = "cannot become the baseline" if given.update_baseline else "can only be gated with --quick"
            raise UserError(f"a part of the ladder is incomplete, so it {what}.")
    baseline_path = HERE / f"baseline_{given.what}{'_quick' if given.quick else ''}.json"
    # a missing baseline is reported before an hour of measuring
    baseline = gate.read_baseline(baseline_path) if given.gate and not given.update_baseline else None
    is_scattered = given.what == "accuracy" and given.quick and baseline is not None
    rounding = scatter.read(_scatter_path()) if is_scattered else None
    run = _measure(given, chosen)
    is_long = given.what == "accuracy" and not given.quick
    shown = [metric for metric in run.metrics if not is_long or metric.key in TARGETS or metric.key.startswith(("ladder/", "projection/"))]
    say("\n" + results_table(shown))

    described = about(given)
    change = getattr(given, "change", "none")
    suffix = "" if change == "none" else "_" + change.replace(":", "_")
    output = given.output or _results() / f"{baseline_path.stem.removeprefix('baseline_')}{suffix}.json"
    values = {m.key: {"value": m.value if m.measured else None, "unit": m.unit} for m in run.metrics}
    stored = json.loads(json.dumps({"about": described, "metrics": values, "crashed": run.crashed, "details": run.details}, default=str))
    atomic.write_json(output, stored)
    say(f"\nevery number: {output}")
    if is_long:
        _write_ladder(run, output)

    if given.update_baseline:
        if run.crashed:
            raise UserError(f"{baseline_path} is not changed: {next(iter(run.crashed))} crashed.")
        gate.write_baseline(baseline_path, run.metrics, about=described)
        say(f"recorded: {baseline_path}")
        return 0
    if baseline is not None:
        if rounding is not None:
            baseline = baseline.without({case.name for case in cases.quick()} - {case.name for case in chosen})
        findings = gate.compare(run.metrics, baseline, crashed=run.crashed, scatter=rounding)
        say("\n" + gate.table(findings))
        runs = None if rounding is None else [rounding.runs.get(m.key, 0) for m in scatter.metrics_of_pictures(run.metrics, chosen)]
        unmeasured = sum(count < scatter.RUNS for count in runs or ())
        if unmeasured:
            say(f"the tolerance of {unmeasured} of them is an estimate; `python -m benchmarks scatter --quick` measures it")
        return 0 if gate.all_pass(findings) else 1
    return 1 if run.crashed else 0


def _results() -> Path:
    from benchmarks import cache

    return cache.folder() / "results"


def _measure(given: argparse.Namespace, chosen: Sequence[cases.Case]) -> Run:
    if given.what == "accuracy":
        from benchmarks import accuracy, table

        run = accuracy.measure(chosen, device=given.device, say=say, afresh=given.afresh, change=given.change)
        if not given.quick:
            run.metrics += [line.metric() for line in table.lines(run.details.values())]
        return run
    if given.what == "speed":
        from benchmarks import speed

        return speed.measure(quick=given.quick, device=given.device, say=say)
    from benchmarks import rig

    return rig.measure(quick=given.quick, say=say)


def _write_ladder(run: Run, output: Path) -> None:
    """Write the ladder's table and figure beside the numbers, and print the groups."""
    from benchmarks import figure, table

    records = list(run.details.values())
    text = table.markdown(table.lines(records), records)
    say("\n" + text.partition("\n\n")[0])
    written = [output.with_suffix(".md"), output.with_suffix(".csv")]
    atomic.write_text(written[0], text)
    atomic.write_text(written[1], table.comma_separated(records))
    if figure.draw(records, output.with_suffix(".png")):
        written.append(output.with_suffix(".png"))
    say("\ntable and figure: " + ", ".join(str(path) for path in written))


if __name__ == "__main__":
    sys.exit(main())
