"""Paired comparison of two runs of the ladder on the same pictures, which separates effects from chance."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from rhizotwin.scenes.errors import UserError

Record = Mapping[str, Any]

CONFIDENCE = 0.95
SHOWN = 12
"""Number of listed cases with the largest improvement of volume, and with the largest deterioration."""
NO_CHANGE = 1e-9


@dataclass(frozen=True)
class _Compared:
    """A number in both runs."""

    name: str
    of: Callable[[Record], float | None]
    scale: float
    unit: str
    smaller_is_better: bool = True


def _number(*path: str, size: bool = False) -> Callable[[Record], float | None]:
    def found(record: Record) -> float | None:
        value: Any = record
        for name in path:
            value = None if value is None else value.get(name)
        return None if value is None else abs(float(value)) if size else float(value)

    return found


COMPARED = (
    _Compared("volume error (size)", _number("score", "volume_error", size=True), 100.0, "%"),
    _Compared("length error (size)", _number("score", "roots", "length_error", size=True), 100.0, "%"),
    _Compared("centre-line recall", _number("score", "roots", "recall"), 100.0, "%", smaller_is_better=False),
    _Compared("centre-line precision", _number("score", "roots", "precision"), 100.0, "%", smaller_is_better=False),
    _Compared("tip recall", _number("score", "roots", "tip_recall"), 100.0, "%", smaller_is_better=False),
    _Compared("tip precision", _number("score", "roots", "tip_precision"), 100.0, "%", smaller_is_better=False),
    _Compared("interval holds", _number("score", "interval_holds_truth"), 100.0, "%", smaller_is_better=False),
    _Compared("time", _number("wall_s"), 1.0, "s"),
    _Compared("processor time", _number("cpu_s"), 1.0, "s"),
    _Compared("memory", _number("peak_memory_mib"), 1.0 / 1024.0, "GiB"),
)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of one number over all pairs: B minus A, in its unit."""

    name: str
    unit: str
    pairs: int
    before: float
    """Mean of A."""
    after: float
    mean: float
    low: float
    """Limit of the 95 % confidence interval of the mean difference (Student's t over the pairs); NaN for a single pair.
    """
    high: float
    better: int
    worse: int
    p_sign: float
    """Two-sided exact sign test over the pairs that differ: the probability of a split at least this uneven without an
    effect."""


def difference(before: Sequence[float], after: Sequence[float], *, name: str, unit: str, smaller_is_better: bool) -> Difference:
    """Compare two equally long, non-empty series of paired numbers.

    Parameters
    ----------
    before, after : (N,) float
        Values of the same cases in both runs, in the same order.
    name, unit : str
        Name and unit of the number.
    smaller_is_better : bool
        Whether a decrease is an improvement.

    Returns
    -------
    Difference
        Mean difference with its interval, numbers of improvements and deteriorations, and probability of the sign test.
    """
    a, b = np.asarray(before, np.float64), np.asarray(after, np.float64)
    change = b - a
    low = high = math.nan
    if len(change) > 1:
        reach = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, len(change) - 1)) * float(change.std(ddof=1)) / math.sqrt(len(change))
        low, high = float(change.mean()) - reach, float(change.mean()) + reach
    gain = -change if smaller_is_better else change
    better, worse = int((gain > NO_CHANGE).sum()), int((gain < -NO_CHANGE).sum())
    p = float(stats.binomtest(better, better + worse).pvalue) if better + worse else 1.0
    return Difference(
        name=name,
        unit=unit,
        pairs=len(change),
        before=float(a.mean()),
        after=float(b.mean()),
        mean=float(change.mean()),
        low=low,
        high=high,
        better=better,
        worse=worse,
        p_sign=p,
    )


def read_records(path: Path) -> dict[tuple[Any, ...], Record]:
    """Read the scored cases of a run's JSON, by their descriptions.

    Raises
    ------
    UserError
        If the file is not a run of the ladder.
    """
    try:
        details = json.loads(path.read_text(encoding="utf-8"))["details"]
        records = [record for record in details.values() if "case" in record]
        found = {_what(record): record for record in records}
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}); use the JSON written by `python -m benchmarks accuracy -o`") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise UserError(f"{path} is not the JSON of a run of `python -m benchmarks accuracy`") from None
    if not found:
        raise UserError(f"{path} contains no scored case")
    return found


def _what(record: Record) -> tuple[Any, ...]:
    case = record["case"]
    return case["scene"], case["profile"], case["seed"], case["rings"], case["views"], *case["image_wh"], case["voxel_mm"], case["method"]


def compare(a: Mapping[tuple[Any, ...], Record], b: Mapping[tuple[Any, ...], Record], *, method: str) -> str:
    """Return the changes from run A to run B, for the common cases of one method, as text.

    Parameters
    ----------
    a, b : mapping of tuple to dict
        Records of both runs by their descriptions.
    method : str
        Method whose cases are compared.

    Returns
    -------
    str
        One line per number.

    Raises
    ------
    UserError
        If they have no case in common.
    """
    shared = [what for what in a if what in b and what[-1] == method]
    if not shared:
        raise UserError(f"the runs have no case of the method {method} in common")
    pairs = [(a[what], b[what]) for what in shared]
    only = [sum(what[-1] == method and what not in other for what in run) for run, other in ((a, b), (b, a))]
    lines = [f"{len(shared)} cases in both, {only[0]} only in A, {only[1]} only in B (ignored)", ""]
    lines.append(f"{'':<22}{'A':>9}{'B':>9}{'B - A':>9}  {'95 % interval':<20}{'better':>7}{'worse':>7}  sign test")
    lines += [_row(found) for compared in COMPARED if (found := _over_pairs(compared, pairs)) is not None]
    profiles = list(dict.fromkeys(what[1] for what in shared))
    for profile in profiles if len(profiles) > 1 else []:
        inside = [pair for pair, what in zip(pairs, shared, strict=True) if what[1] == profile]
        lines += ["", f"{profile} only:"]
        lines += [_row(found) for compared in COMPARED[:2] if (found := _over_pairs(compared, inside)) is not None]
    return "\n".join([*lines, *_largest_changes(pairs)])


def _over_pairs(compared: _Compared, pairs: Sequence[tuple[Record, Record]]) -> Difference | None:
    both = [(x, y) for first, second in pairs if (x := compared.of(first)) is not None and (y := compared.of(second)) is not None]
    if not both:
        return None
    before, after = ([compared.scale * pair[k] for pair in both] for k in (0, 1))
    return difference(before, after, name=compared.name, unit=compared.unit, smaller_is_better=compared.smaller_is_better)


def _row(found: Difference) -> str:
    interval = "-" if math.isnan(found.low) else f"{found.low:+.2f} to {found.high:+.2f} {found.unit}"
    numbers = f"{found.before:>9.2f}{found.after:>9.2f}{found.mean:>+9.2f}"
    return f"{found.name:<22}{numbers}  {interval:<20}{found.better:>7}{found.worse:>7}  p = {found.p_sign:.3f}"


def _largest_changes(pairs: Sequence[tuple[Record, Record]]) -> list[str]:
    """Return the cases with the largest changes of the volume error in both directions."""
    volume = COMPARED[0]
    changes = []
    for first, second in pairs:
        before, after = volume.of(first), volume.of(second)
        if before is not None and after is not None:
            changes.append((100.0 * (after - before), first, second))
    changes.sort(key=lambda change: -change[0])
    worse = [change for change in changes if change[0] > NO_CHANGE][:SHOWN]
    better = [change for change in reversed(changes) if change[0] < -NO_CHANGE][:SHOWN]
    lines = []
    for title, found in (("worse", worse), ("better", better)):
        lines += ["", f"volume {title} (most first): {'none' if not found else ''}".rstrip()]
        for change, first, second in found:
            signed = [100.0 * float(record["score"]["volume_error"]) for record in (first, second)]
            lines.append(f"  {first['case']['name']}: {signed[0]:+.2f} % -> {signed[1]:+.2f} % ({change:+.2f} in size)")
    return lines
