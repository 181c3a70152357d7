"""Command line of the benchmarks."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import cases, commands, gate, scatter
from benchmarks.arguments import parser
from benchmarks.output import about, results_folder, results_table, say
from benchmarks.run import Run
from benchmarks.targets import TARGETS
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

HERE = Path(__file__).resolve().parent

_IN_PROCESS = ("thesis", "batch", "growth", "damages", "adopt", "rig")
"""Commands that compute in this process; the others run workers."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks; return the exit code."""
    given = parser().parse_args(arguments)
    try:
        if given.what in _IN_PROCESS:  # before any import of Dr.Jit, which loads the first LLVM that it finds
            from rhizotwin import engine

            engine.start(getattr(given, "device", "cpu"))
        if given.what == "speed" and given.against is not None:
            return commands.against(given)
        if given.what == "speed" and given.scaling:
            return commands.scaling(given)
        return _COMMANDS.get(given.what, _run)(given)
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


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
        scatter.write(_scatter_path(), values, about=_about(given))
        say(f"recorded: {_scatter_path()}")
    rounding, everything = scatter.read(_scatter_path()), {key.rpartition("/")[0] for key in baseline.values}
    for case in chosen:
        one, measured = baseline.without(everything - {case.name}), [scatter.metrics_of_pictures(run.metrics, [case]) for run in runs]
        is_open = [gate.all_pass(gate.compare(metrics, one, scatter=rounding)) for metrics in measured]
        say(f"{case.name}: the gate is open in {sum(is_open)} of {len(is_open)} runs")
    return 0


def _about(given: argparse.Namespace) -> dict[str, Any]:
    """Return the description of a run that may be restricted to the quick set."""
    return about(f"{given.what}{' --quick' if given.quick else ''}", given.device)


def _scatter_path() -> Path:
    return HERE / "scatter_accuracy_quick.json"


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

    described = _about(given)
    change = getattr(given, "change", "none")
    suffix = "" if change == "none" else "_" + change.replace(":", "_")
    output = given.output or results_folder() / f"{baseline_path.stem.removeprefix('baseline_')}{suffix}.json"
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


_COMMANDS = {
    "adopt": commands.adopt,
    "batch": commands.batch,
    "compare": commands.compare,
    "damages": commands.damages,
    "fingerprints": commands.fingerprints,
    "growth": commands.growth,
    "intervals": commands.intervals,
    "scatter": _scatter,
    "thesis": commands.thesis,
    "view": commands.view,
}
"""Commands other than those that `_run` compares with a baseline: accuracy, speed and rig."""


if __name__ == "__main__":
    sys.exit(main())
