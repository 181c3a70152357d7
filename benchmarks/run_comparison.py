"""Paired comparison of two runs of the ladder on the same pictures, which separates effects from chance."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.output import value_at
from rhizotwin.scenes.errors import UserError

Record = Mapping[str, Any]
Key = tuple[Any, ...]
"""Description of a case, without its name."""

CONFIDENCE = 0.95
SHOWN = 12
"""Number of listed cases with the largest improvement of volume, and with the largest deterioration."""
NO_CHANGE = 1e-9


@dataclass(frozen=True)
class Compared:
    """A number in both runs."""

    name: str
    path: str
    scale: float
    unit: str
    smaller_is_better: bool = True

    def of(self, record: Record) -> float | None:
        """Return the number in a record, without its sign if a decrease is an improvement; None if it is missing."""
        value = value_at(record, self.path)
        return abs(value) if value is not None and self.smaller_is_better else value


COMPARED = (
    Compared("volume error (size)", "score.volume_error", 100.0, "%"),
    Compared("length error (size)", "score.roots.length_error", 100.0, "%"),
    Compared("centre-line recall", "score.roots.recall", 100.0, "%", smaller_is_better=False),
    Compared("centre-line precision", "score.roots.precision", 100.0, "%", smaller_is_better=False),
    Compared("tip recall", "score.roots.tip_recall", 100.0, "%", smaller_is_better=False),
    Compared("tip precision", "score.roots.tip_precision", 100.0, "%", smaller_is_better=False),
    Compared("interval holds", "score.interval_holds_truth", 100.0, "%", smaller_is_better=False),
    Compared("time", "wall_s", 1.0, "s"),
    Compared("processor time", "cpu_s", 1.0, "s"),
    Compared("memory", "peak_memory_mib", 1.0 / 1024.0, "GiB"),
)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of one number over all pairs: B minus A, in its unit."""

    name: str
    unit: str
    pairs: int
    """Number of cases with the number in both runs."""
    before: float
    """Mean of A over the pairs; NaN without pairs."""
    after: float
    """Mean of B over the pairs; NaN without pairs."""
    mean: float
    """Mean difference of the pairs; NaN without pairs."""
    low: float
    """Lower limit of the 95 % confidence interval of the mean difference (Student's t over the pairs); NaN with fewer
    than two pairs."""
    high: float
    """Upper limit of this interval; NaN with fewer than two pairs."""
    better: int
    """Number of cases that improved, including those with the number in B only."""
    worse: int
    """Number of cases that deteriorated, including those with the number in A only."""
    p_sign: float
    """Two-sided exact sign test over the cases that differ: the probability of a split at least this uneven without an
    effect."""


def difference(before: Sequence[float], after: Sequence[float], compared: Compared, *, gained: int = 0, lost: int = 0) -> Difference:
    """Compare two equally long series of paired numbers.

    Parameters
    ----------
    before, after : (N,) float
        Values of the same cases in both runs, in the same order.
    compared : Compared
        Number that is compared.
    gained, lost : int
        Number of cases with the number in B only, and in A only.

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
    gain = -change if compared.smaller_is_better else change
    better, worse = gained + int((gain > NO_CHANGE).sum()), lost + int((gain < -NO_CHANGE).sum())
    p = float(stats.binomtest(better, better + worse).pvalue) if better + worse else 1.0
    return Difference(
        name=compared.name,
        unit=compared.unit,
        pairs=len(change),
        before=float(a.mean()) if len(a) else math.nan,
        after=float(b.mean()) if len(b) else math.nan,
        mean=float(change.mean()) if len(change) else math.nan,
        low=low,
        high=high,
        better=better,
        worse=worse,
        p_sign=p,
    )


@dataclass(frozen=True)
class Cases:
    """Cases of a run."""

    scored: Mapping[Key, Record]
    """Scored cases by their descriptions."""
    failed: frozenset[str] = frozenset()
    """Names of the failed cases."""


def read_cases(path: Path) -> Cases:
    """Read the cases of a run's JSON.

    Raises
    ------
    UserError
        If the file is not a run of the ladder.
    """
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        records = [record for record in stored["details"].values() if "case" in record]
        found = Cases({_what(record): record for record in records}, frozenset(stored.get("crashed", ())))
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}); use the JSON written by `python -m benchmarks accuracy -o`") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise UserError(f"{path} is not the JSON of a run of `python -m benchmarks accuracy`") from None
    if not found.scored and not found.failed:
        raise UserError(f"{path} contains no case")
    return found


def _what(record: Record) -> tuple[Any, ...]:
    case = record["case"]
    return case["scene"], case["profile"], case["seed"], case["rings"], case["views"], *case["image_wh"], case["voxel_mm"], case["method"]


def compare(a: Cases, b: Cases, *, method: str) -> str:
    """Return the changes from run A to run B, for the common cases of one method, as text.

    Parameters
    ----------
    a, b : Cases
        Cases of both runs. A case that failed in one of them counts as worse there in all numbers.
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
    lost, gained = _scored_once(a, b, method), _scored_once(b, a, method)
    pairs = {what: (record, b.scored[what]) for what, record in a.scored.items() if what in b.scored and what[-1] == method}
    both = len(pairs)
    pairs |= {what: (a.scored[what], {}) for what in lost} | {what: ({}, b.scored[what]) for what in gained}
    if not pairs:
        raise UserError(f"the runs have no case of the method {method} in common")
    only = [sum(what[-1] == method and what not in pairs for what in run.scored) for run in (a, b)]
    lines = [f"{both} cases in both, {only[0]} only in A, {only[1]} only in B (ignored)"]
    for name, failed in (("B", [a.scored[what] for what in lost]), ("A", [b.scored[what] for what in gained])):
        lines += [f"failed in {name}: {', '.join(record['case']['name'] for record in failed)}"] if failed else []
    lines += ["", f"{'':<22}{'A':>9}{'B':>9}{'B - A':>9}  {'95 % interval':<20}{'pairs':>7}{'better':>7}{'worse':>7}  sign test"]
    lines += _rows(COMPARED, list(pairs.values()))
    profiles = list(dict.fromkeys(what[1] for what in pairs))
    for profile in profiles if len(profiles) > 1 else []:
        lines += ["", f"{profile} only:", *_rows(COMPARED[:2], [pair for what, pair in pairs.items() if what[1] == profile])]
    return "\n".join([*lines, *_largest_changes(list(pairs.values()))])


def _scored_once(run: Cases, other: Cases, method: str) -> list[Key]:
    """Return the cases of a method that are scored in one run, and failed in the other."""
    return [what for what, record in run.scored.items() if what[-1] == method and record["case"]["name"] in other.failed]


def _rows(several: Sequence[Compared], pairs: Sequence[tuple[Record, Record]]) -> list[str]:
    return [_row(found) for compared in several if (found := _over_pairs(compared, pairs)) is not None]


def _over_pairs(compared: Compared, pairs: Sequence[tuple[Record, Record]]) -> Difference | None:
    values = [(compared.of(first), compared.of(second)) for first, second in pairs]
    both = [(compared.scale * x, compared.scale * y) for x, y in values if x is not None and y is not None]
    lost, gained = (sum(pair[k] is not None and pair[1 - k] is None for pair in values) for k in (0, 1))
    if not both and not lost and not gained:
        return None
    return difference([x for x, _ in both], [y for _, y in both], compared, gained=gained, lost=lost)


def _row(found: Difference) -> str:
    interval = "-" if math.isnan(found.low) else f"{found.low:+.2f} to {found.high:+.2f} {found.unit}"
    numbers = f"{found.before:>9.2f}{found.after:>9.2f}{found.mean:>+9.2f}"
    return f"{found.name:<22}{numbers}  {interval:<20}{found.pairs:>7}{found.better:>7}{found.worse:>7}  p = {found.p_sign:.3f}"


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
