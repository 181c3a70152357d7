"""Commands that measure the ladder's cases, and judge them by the committed baseline."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from benchmarks import cases, gate, ladder, scatter
from benchmarks.options import Selection, Subset, Words, read_change
from benchmarks.output import about, results_folder, results_table, say
from benchmarks.run import Run
from benchmarks.targets import TARGETS
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.arguments import Device, Flag, OutputFile, option

HERE = Path(__file__).resolve().parent
FROZEN_RUNS = 8
"""Runs with changed pictures of each frozen case."""


@Parameter(name="*", group="Deliberate changes")
@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Options for deliberate changes, which the gate must tolerate or notice."""

    change: Annotated[str, option(read_change, "KIND:SEED")] = "none"
    """rounded:S, pictures as another machine may have rounded them; dithered:S, with noise of half a grey level; \
shuffled:S, in another order; lossy:S, one in twenty mirrored; S: 1, 2, ..."""
    fault: Literal["none", "ghost", "swap", "tips", "length"] = "none"
    """Deliberate fault of the found roots, at which the gate must shut."""


@Parameter(name="*", group="Baseline")
@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Options for the comparison with the baseline."""

    gate: Flag = False
    """Exit with code 1 if a number is worse than the baseline or missing."""
    update_baseline: Flag = False
    """Record this run as the baseline, to be committed. A part of the ladder renews its cases."""


@Parameter(name="*", group="Earlier measurements")
@dataclass(frozen=True, kw_only=True)
class Reuse:
    """Options for the measurements of an earlier run with the same code."""

    kept: Flag = False
    """Only cases that an earlier run with the same code measured; the others are skipped."""
    afresh: Flag = False
    """Repeat measurements of an earlier run with the same code."""


def accuracy(
    *,
    selection: Selection = Selection(),
    deviation: Deviation = Deviation(),
    judgement: Judgement = Judgement(),
    reuse: Reuse = Reuse(),
    output: OutputFile | None = None,
    device: Device = "auto",
) -> int:
    """Measure the accuracy ladder: render (or load from the cache), reconstruct, score; a stopped run is resumed.

    A part of the ladder gives a part of the table. Two runs are compared by `compare`.

    Parameters
    ----------
    output : Path, optional
        Where to write every number as JSON; default: the cache folder.
    device : str
        Where to compute.

    Examples
    --------
    python -m benchmarks accuracy --scenes 'radish_day0*,fallen_plant' --profiles clean,bench -o a.json
    python -m benchmarks compare a.json b.json
    """
    chosen = selection.chosen()
    is_part = selection.nightly or bool(selection.given) or reuse.kept
    if selection.list_:
        say("\n".join(case.name for case in chosen))
        return 0
    if judgement.update_baseline and deviation != Deviation():
        raise UserError("changed pictures or roots cannot become the baseline; omit --change, --fault or --update-baseline.")
    if judgement.update_baseline and selection.quick and is_part:
        raise UserError("a part of the quick set is incomplete, so it cannot become the baseline.")
    from benchmarks import accuracy, table

    if reuse.kept:
        chosen = [case for case in chosen if accuracy.load_record(case, device=device, **vars(deviation))]
    # a missing baseline is reported before an hour of measuring
    baseline = _baseline(chosen, is_quick=selection.quick, is_part=is_part) if judgement.gate and not judgement.update_baseline else None
    run = accuracy.measure(chosen, device=device, say=say, afresh=reuse.afresh, **vars(deviation))
    if selection.quick and not is_part:
        run.metrics = [*accuracy.projection(device), *run.metrics]
    elif not is_part:
        run.metrics += [line.metric() for line in table.lines(run.details.values())]
    _write(run, selection, deviation, output=output, device=device)
    if judgement.update_baseline:
        _record(run, is_quick=selection.quick, device=device)
    elif baseline is not None:
        return _judge(run, baseline, chosen)
    return 1 if run.crashed else 0


def _baseline(chosen: Sequence[cases.Case], *, is_quick: bool, is_part: bool) -> gate.Baseline:
    """Return the baseline of the chosen cases."""
    if is_quick:
        baseline = gate.read_baseline(_quick_path())
        own = {case.name for case in chosen}
        return baseline.without({key.rpartition("/")[0] for key in baseline.values} - own) if is_part else baseline
    from benchmarks import accuracy, table

    known = {record["case"]["name"]: record for record in ladder.read()}
    missing = [case.name for case in chosen if case.name not in known]
    if missing:
        raise UserError(f"{ladder.PATH} does not contain {missing[0]}; measure it with --update-baseline, and commit the file.")
    records = [known[case.name] for case in chosen]
    of_cases = [metric for case in chosen for metric in accuracy.metrics(case, known[case.name])]
    return gate.baseline_of(of_cases + ([] if is_part else [line.metric() for line in table.lines(records)]), path=ladder.PATH)


def _write(run: Run, selection: Selection, deviation: Deviation, *, output: Path | None, device: str) -> None:
    """Print the numbers and write them as JSON; those of the ladder also as a table and a figure."""
    shown = [m for m in run.metrics if selection.quick or m.key in TARGETS or m.key.startswith("ladder/")]
    say("\n" + results_table(shown))
    words = [word.replace(":", "_") for word in vars(deviation).values() if word != "none"]
    path = output or results_folder() / f"{'_'.join(['accuracy', *(['quick'] if selection.quick else []), *words])}.json"
    values = {m.key: {"value": m.value if m.measured else None, "unit": m.unit} for m in run.metrics}
    described = about(_command("accuracy", selection), device)
    stored = {"about": described, "metrics": values, "crashed": run.crashed, "details": run.details}
    atomic.write_json(path, json.loads(json.dumps(stored, default=str)))
    say(f"\nevery number: {path}")
    if selection.quick:
        return
    from benchmarks import figure, table

    records = list(run.details.values())
    text = table.markdown(table.lines(records), records)
    say("\n" + text.partition("\n\n")[0])
    atomic.write_text(path.with_suffix(".md"), text)
    atomic.write_text(path.with_suffix(".csv"), table.comma_separated(records))
    figure.draw(records, path.with_suffix(".png"))
    say(f"\ntable and figure beside it: {path.stem}.md, .csv, .png")


def _record(run: Run, *, is_quick: bool, device: str) -> None:
    """Record a run as the baseline; that of the ladder with the page and the figure of the documentation."""
    if is_quick and run.crashed:
        raise UserError(f"{_quick_path()} is not changed: {next(iter(run.crashed))} crashed.")
    if is_quick:
        gate.write_baseline(_quick_path(), run.metrics, about=about("accuracy --quick", device))
    else:
        from benchmarks import figure

        records = ladder.update(run.details.values())
        write_page(records)
        figure.draw(records, HERE.parent / "docs" / "pictures" / "error_by_age.png")
    say(f"recorded: {_quick_path() if is_quick else ladder.PATH}")


def _judge(run: Run, baseline: gate.Baseline, chosen: Sequence[cases.Case]) -> int:
    """Print the comparison with the baseline, and return the exit code."""
    rounding = scatter.read(_scatter_path())
    findings = gate.compare(run.metrics, baseline, crashed=run.crashed, scatter=rounding)
    say("\n" + gate.table(findings))
    runs = [rounding.runs.get(m.key, 0) for m in scatter.metrics_of_pictures(run.metrics, chosen)]
    unmeasured = sum(count < scatter.LEAST_RUNS for count in runs)
    if unmeasured:
        say(f"the tolerance of {unmeasured} of them is an estimate; `./run bench scatter` measures it for the quick and the nightly set")
    return 0 if gate.all_pass(findings) else 1


def scatter_(
    *,
    subset: Subset = Subset(),
    frozen: Words = None,
    runs: int | None = None,
    change: Literal["rounded", "lossy"] = "rounded",
    device: Device = "auto",
) -> int:
    """Measure the variation of all numbers under rounding of the pictures.

    It is the tolerance of the gate. The verdict of the gate is reported for each run. A stopped run is resumed.

    Parameters
    ----------
    frozen : tuple of str, optional
        Frozen cases under rounding, noise of half a grey level and another order of views.
    runs : int, optional
        Number of runs with changed pictures; default: 20, of frozen cases 8.
    change : str
        lossy: one picture in twenty mirrored; reports how often the gate shuts, without recording.
    device : str
        Where to compute.
    """
    if subset.quick + subset.nightly + (frozen is not None) != 1:
        raise UserError("the scatter is that of one set: give --quick, --nightly or --frozen NAME,...")
    if runs is not None and runs < 1:
        raise UserError(f"--runs {runs}: must be at least 1")
    if frozen is not None:
        from benchmarks import tree_scatter

        stored = tree_scatter.measure(frozen, runs=runs or FROZEN_RUNS, device=device, say=say)
        say("\n" + tree_scatter.table(stored))
        tree_scatter.write(stored)
        write_page(ladder.read())
        say(f"recorded: {tree_scatter.PATH}")
        return 0
    chosen = subset.chosen()
    found = scatter.measure(chosen, runs=runs or scatter.RUNS, change=change, device=device, say=say)
    crashed = {case: why for run in found for case, why in run.crashed.items()}
    if crashed:
        raise UserError(f"{next(iter(crashed))} crashed; the recorded scatter is not changed.")
    values = scatter.values(found)
    say("\n" + scatter.table(values))
    if change == scatter.ROUNDED:
        scatter.write(_scatter_path(), values, about=about(_command("scatter", subset), device))
        say(f"recorded: {_scatter_path()}")
    rounding = scatter.read(_scatter_path())
    for case in chosen:
        try:
            baseline = _baseline([case], is_quick=subset.quick, is_part=True)
        except UserError as error:
            say(str(error))
            continue
        measured = [scatter.metrics_of_pictures(run.metrics, [case]) for run in found]
        is_open = [gate.all_pass(gate.compare(metrics, baseline, scatter=rounding)) for metrics in measured]
        say(f"{case.name}: the gate is open in {sum(is_open)} of {len(is_open)} runs")
    return 0


def write_page(records: Sequence[dict[str, Any]]) -> None:
    """Write the page of the documentation with the committed results of the ladder and the scatter of the tree."""
    from benchmarks import table, tree_scatter

    atomic.write_text(HERE.parent / "docs" / "ladder.md", table.page(records, tree_scatter.read()))


def _command(name: str, subset: Subset) -> str:
    return " ".join([name, *(f"--{one}" for one in ("quick", "nightly") if getattr(subset, one))])


def _quick_path() -> Path:
    return HERE / "baseline_accuracy_quick.json"


def _scatter_path() -> Path:
    return HERE / "scatter_accuracy.json"
