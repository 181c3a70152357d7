"""Comparison of a run with the committed baseline. Missing, crashed, non-finite and unknown numbers fail."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from benchmarks.metric import Metric
from benchmarks.output import stored_json
from benchmarks.scatter import Scatter
from benchmarks.targets import TARGETS
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

SCHEMA_VERSION = 1

Verdict = Literal["same", "better", "WORSE", "MISSING", "NOT A NUMBER", "UNKNOWN", "MISSED", "CRASHED"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Verdict on one metric, or on one crashed case."""

    key: str
    verdict: Verdict
    baseline: float | None
    value: float | None
    unit: str
    note: str = ""

    @property
    def passes(self) -> bool:
        """Whether the gate accepts this."""
        return self.verdict in ("same", "better")


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """Committed numbers of an earlier run."""

    path: Path
    values: Mapping[str, float]
    units: Mapping[str, str]

    def without(self, cases: Collection[str]) -> "Baseline":
        """Remove the numbers of cases, by name."""
        kept = {key: value for key, value in self.values.items() if key.rpartition("/")[0] not in cases}
        return replace(self, values=kept)


def compare(
    metrics: Sequence[Metric],
    baseline: Baseline,
    *,
    crashed: Mapping[str, str] | None = None,
    scatter: Scatter | None = None,
) -> list[Finding]:
    """Judge every metric of a run, every metric of the baseline that is missing in the run, and every crashed case.

    Parameters
    ----------
    metrics : sequence of Metric
        Metrics of the run.
    baseline : Baseline
        Baseline of the comparison.
    crashed : mapping of str or None
        Errors by case; each is a failure, regardless of the baseline.
    scatter : Scatter or None
        Variation of numbers under rounding, which is the tolerance of the numbers that it contains.

    Returns
    -------
    list of Finding
        One verdict per metric or case.
    """
    findings = [
        Finding(key=case, verdict="CRASHED", baseline=None, value=None, unit="", note=why.strip().splitlines()[-1] if why.strip() else "")
        for case, why in (crashed or {}).items()
    ]
    seen: set[str] = set()
    for metric in metrics:
        findings.append(_judge(metric, baseline, scatter, repeated=metric.key in seen))
        seen.add(metric.key)
    findings += [
        Finding(key=key, verdict="MISSING", baseline=before, value=None, unit=baseline.units[key], note="not measured")
        for key, before in baseline.values.items()
        if key not in seen
    ]
    if not findings:
        findings.append(Finding(key="(all)", verdict="MISSING", baseline=None, value=None, unit="", note="the run measured nothing"))
    return findings


def _judge(metric: Metric, baseline: Baseline, scatter: Scatter | None, *, repeated: bool) -> Finding:
    before = baseline.values.get(metric.key)
    verdict: Verdict
    note = ""
    if not metric.measured:
        verdict = "NOT A NUMBER"
    elif repeated:
        verdict, note = "UNKNOWN", "measured twice under one key"
    elif before is None:
        verdict, note = "UNKNOWN", f"not in {baseline.path.name}; --update-baseline records it"
    elif not math.isfinite(before) or baseline.units[metric.key] != metric.unit:
        verdict, note = "UNKNOWN", f"{baseline.path.name} holds {before} in {baseline.units[metric.key]}"
    elif metric.key in TARGETS and not TARGETS[metric.key].reached(metric.value):
        verdict, note = "MISSED", f"required: {TARGETS[metric.key].text}"
    else:
        worse, tolerance = metric.worse_by(before), metric.tolerance(before)
        if scatter is not None:
            tolerance = scatter.tolerance(metric.key, before, tolerance)
        verdict = "WORSE" if worse > tolerance else "better" if worse < -tolerance else "same"
        note = f"by {worse:.4g}, tolerance {tolerance:.4g}" if verdict == "WORSE" else ""
    return Finding(key=metric.key, verdict=verdict, baseline=before, value=metric.value, unit=metric.unit, note=note)


def all_pass(findings: Sequence[Finding]) -> bool:
    """Return whether a run passes."""
    return bool(findings) and all(finding.passes for finding in findings)


def table(findings: Sequence[Finding]) -> str:
    """Return the findings as text: failures, then improvements, then a count."""
    shown = sorted((f for f in findings if f.verdict != "same"), key=lambda f: (f.passes, f.key))
    width = max((len(f.key) for f in shown), default=0)
    lines = []
    for f in shown:
        change = f"{_number(f.baseline):>10} -> {_number(f.value):>10} {f.unit:<4}"
        lines.append(f"{f.verdict:<12}  {f.key:<{width}}  {change} {f.note}".rstrip())
    failed = sum(not f.passes for f in findings)
    better = sum(f.verdict == "better" for f in findings)
    verdict = "the gate is shut" if failed or not findings else "the gate is open"
    same = len(findings) - failed - better
    return "\n".join([*lines, f"{len(findings)} numbers: {failed} failed, {better} better, {same} as before: {verdict}"])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def baseline_of(metrics: Iterable[Metric], *, path: Path) -> Baseline:
    """Return a baseline of measured numbers.

    Parameters
    ----------
    metrics : iterable of Metric
        Numbers; those that are not finite are left out, so that they are reported as unknown.
    path : Path
        File of which they are made, which messages name.
    """
    measured = [metric for metric in metrics if metric.measured]
    return Baseline(path=path, values={m.key: m.value for m in measured}, units={m.key: m.unit for m in measured})


def read_baseline(path: Path) -> Baseline:
    """Read a committed baseline; raise UserError if it is missing or damaged."""
    if not path.is_file():
        raise UserError(f"{path} does not exist; run once with --update-baseline and commit it.")
    with stored_json(path, SCHEMA_VERSION, "run with --update-baseline") as stored:
        values = {str(key): float(entry["value"]) for key, entry in stored["metrics"].items()}
        units = {str(key): str(entry["unit"]) for key, entry in stored["metrics"].items()}
    return Baseline(path=path, values=values, units=units)


def write_baseline(path: Path, metrics: Sequence[Metric], *, about: Mapping[str, Any]) -> None:
    """Record a run as the new baseline.

    Parameters
    ----------
    path : Path
        Path of the file.
    metrics : sequence of Metric
        Metrics of the run.
    about : dict of Any
        Description of the run: versions, device, commit.

    Raises
    ------
    UserError
        If a metric is not finite, as such a run must not become the baseline.
    """
    failed = [metric.key for metric in metrics if not metric.measured]
    if failed or not metrics:
        raise UserError(f"{path} is not changed: {failed[0] if failed else 'every metric'} was not measured.")
    stored = {
        "schema_version": SCHEMA_VERSION,
        "about": dict(about),
        "metrics": {m.key: {"value": float(f"{m.value:.6g}"), "unit": m.unit} for m in sorted(metrics, key=lambda m: m.key)},
    }
    atomic.write_json(path, stored)
