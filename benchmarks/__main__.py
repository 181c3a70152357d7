"""Command line of the benchmarks."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import cases, commands, gate, ladder, reconstructions, scatter, tree_faults
from benchmarks.arguments import parser
from benchmarks.output import about, results_folder, results_table, say
from benchmarks.run import Run
from benchmarks.targets import TARGETS
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

HERE = Path(__file__).resolve().parent

_IN_PROCESS = ("thesis", "growth", "damages", "rig", "freeze")
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
    if given.frozen is not None:
        return commands.tree_scatter(given)
    selection = {name: getattr(given, name) for name in ("scenes", "profiles", "methods") if getattr(given, name) is not None}
    if given.nightly and selection:
        raise UserError("--nightly is a set of its own; omit the selection.")
    chosen = cases.nightly() if given.nightly else cases.quick(**selection)
    path = ladder.PATH if given.nightly else HERE / "baseline_accuracy_quick.json"
    runs = scatter.measure(chosen, runs=given.runs or scatter.RUNS, change=given.change, device=given.device, say=say)
    crashed = {case: why for run in runs for case, why in run.crashed.items()}
    if crashed:
        raise UserError(f"{next(iter(crashed))} crashed; the recorded scatter is not changed.")
    values = scatter.values(runs)
    say("\n" + scatter.table(values))
    if given.change == scatter.ROUNDED:
        scatter.write(_scatter_path(), values, about=_about(given))
        say(f"recorded: {_scatter_path()}")
    rounding = scatter.read(_scatter_path())
    for case in chosen:
        try:
            baseline = _baseline(path, [case], is_ladder=given.nightly, is_part=True)
        except UserError as error:
            say(str(error))
            continue
        measured = [scatter.metrics_of_pictures(run.metrics, [case]) for run in runs]
        is_open = [gate.all_pass(gate.compare(metrics, baseline, scatter=rounding)) for metrics in measured]
        say(f"{case.name}: the gate is open in {sum(is_open)} of {len(is_open)} runs")
    return 0


def _about(given: argparse.Namespace) -> dict[str, Any]:
    """Return the description of a run that may be restricted to a set."""
    sets = [f" --{name}" for name in ("quick", "nightly") if getattr(given, name, False)]
    return about(given.what + "".join(sets), given.device)


def _scatter_path() -> Path:
    return HERE / "scatter_accuracy.json"


def _chosen(given: argparse.Namespace) -> tuple[list[cases.Case], bool]:
    """Return the selected cases, and whether they are a part of the set."""
    selection = {
        name: getattr(given, name) for name in ("scenes", "profiles", "rings", "seeds", "methods") if getattr(given, name) is not None
    }
    if given.nightly and (given.quick or selection):
        raise UserError("--nightly is a set of its own; omit --quick, and the selection.")
    if given.nightly:
        return cases.nightly(), True
    unknown = [name for name in ("rings", "seeds") if given.quick and name in selection]
    if unknown:
        raise UserError(f"the quick set has no {unknown[0]}; omit --{unknown[0]} or --quick.")
    return (cases.quick(**selection) if given.quick else cases.ladder(**selection)), bool(selection)


def _check(given: argparse.Namespace, *, is_part: bool) -> None:
    """Raise UserError if the run cannot become the baseline."""
    if (given.change, given.fault) != (reconstructions.UNCHANGED, tree_faults.NONE) and given.update_baseline:
        raise UserError("changed pictures or roots cannot become the baseline; omit --change, --fault or --update-baseline.")
    if (is_part or given.kept) and given.quick and given.update_baseline:
        raise UserError("a part of the quick set is incomplete, so it cannot become the baseline.")


def _run(given: argparse.Namespace) -> int:
    chosen: list[cases.Case] = []
    is_part = False
    if given.what == "accuracy":
        chosen, is_part = _chosen(given)
        if given.list:
            say("\n".join(case.name for case in chosen))
            return 0
        _check(given, is_part=is_part)
        if given.kept:
            from benchmarks import accuracy

            is_part = True
            chosen = [case for case in chosen if accuracy.load_record(case, device=given.device, change=given.change, fault=given.fault)]
    is_ladder = given.what == "accuracy" and not given.quick
    baseline_path = ladder.PATH if is_ladder else HERE / f"baseline_{given.what}{'_quick' if given.quick else ''}.json"
    # a missing baseline is reported before an hour of measuring
    baseline = _baseline(baseline_path, chosen, is_ladder=is_ladder, is_part=is_part) if given.gate and not given.update_baseline else None
    rounding = scatter.read(_scatter_path()) if given.what == "accuracy" and baseline is not None else None
    run = _measure(given, chosen, is_part=is_part)
    shown = [
        metric for metric in run.metrics if not is_ladder or metric.key in TARGETS or metric.key.startswith(("ladder/", "projection/"))
    ]
    say("\n" + results_table(shown))

    described = _about(given)
    words = [word.replace(":", "_") for word in (getattr(given, "change", "none"), getattr(given, "fault", "none")) if word != "none"]
    name = "_".join([given.what, *(["quick"] if given.quick else []), *words])
    output = given.output or results_folder() / f"{name}.json"
    values = {m.key: {"value": m.value if m.measured else None, "unit": m.unit} for m in run.metrics}
    stored = json.loads(json.dumps({"about": described, "metrics": values, "crashed": run.crashed, "details": run.details}, default=str))
    atomic.write_json(output, stored)
    say(f"\nevery number: {output}")
    if is_ladder:
        _write_ladder(run, output)

    if given.update_baseline:
        if is_ladder:
            _update_ladder(run)
        elif run.crashed:
            raise UserError(f"{baseline_path} is not changed: {next(iter(run.crashed))} crashed.")
        else:
            gate.write_baseline(baseline_path, run.metrics, about=described)
        say(f"recorded: {baseline_path}")
        return 1 if run.crashed else 0
    if baseline is not None:
        findings = gate.compare(run.metrics, baseline, crashed=run.crashed, scatter=rounding)
        say("\n" + gate.table(findings))
        runs = None if rounding is None else [rounding.runs.get(m.key, 0) for m in scatter.metrics_of_pictures(run.metrics, chosen)]
        unmeasured = sum(count < scatter.LEAST_RUNS for count in runs or ())
        if unmeasured:
            say(
                f"the tolerance of {unmeasured} of them is an estimate; `./run bench scatter` measures it for the quick and the nightly set"
            )
        return 0 if gate.all_pass(findings) else 1
    return 1 if run.crashed else 0


def _baseline(path: Path, chosen: Sequence[cases.Case], *, is_ladder: bool, is_part: bool) -> gate.Baseline:
    """Return the baseline of the chosen cases."""
    if is_ladder:
        from benchmarks import accuracy, table

        known = {record["case"]["name"]: record for record in ladder.read()}
        missing = [case.name for case in chosen if case.name not in known]
        if missing:
            raise UserError(f"{path} does not contain {missing[0]}; measure it with --update-baseline, and commit the file.")
        records = [known[case.name] for case in chosen]
        of_cases = [metric for case in chosen for metric in accuracy.metrics(case, known[case.name])]
        return gate.baseline_of(of_cases + ([] if is_part else [line.metric() for line in table.lines(records)]), path=path)
    baseline = gate.read_baseline(path)
    if not is_part:
        return baseline
    own = {case.name for case in chosen}
    return baseline.without({key.rpartition("/")[0] for key in baseline.values} - own)


def _measure(given: argparse.Namespace, chosen: Sequence[cases.Case], *, is_part: bool) -> Run:
    if given.what == "accuracy":
        from benchmarks import accuracy, table

        # numbers of the projection depend on no picture: they are measured with the quick set
        run = accuracy.measure(
            chosen,
            device=given.device,
            say=say,
            afresh=given.afresh,
            change=given.change,
            fault=given.fault,
            projection=given.quick and not is_part,
        )
        if not given.quick and not is_part:
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


def _update_ladder(run: Run) -> None:
    """Record the measured cases of the ladder, and write the page and the figure of the documentation."""
    from benchmarks import figure

    records = ladder.update(run.details.values())
    commands.write_ladder_page(records)
    figure.draw(records, HERE.parent / "docs" / "pictures" / "error_by_age.png")


_COMMANDS = {
    "against": commands.against_frozen,
    "compare": commands.compare,
    "damages": commands.damages,
    "fingerprints": commands.fingerprints,
    "freeze": commands.freeze,
    "growth": commands.growth,
    "intervals": commands.intervals,
    "scatter": _scatter,
    "thesis": commands.thesis,
}
"""Commands other than those that `_run` compares with a baseline: accuracy, speed and rig."""


if __name__ == "__main__":
    sys.exit(main())
