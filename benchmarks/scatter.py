"""Scatter of every number under rounding, from runs of the ladder with simulated rounding of other machines.

A number counts as changed if it exceeds `FACTOR` times the range of these runs, and the smallest relevant change.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks import accuracy
from benchmarks.cases import Case
from benchmarks.metric import Metric
from benchmarks.output import stored_json
from benchmarks.run import Run, Say
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

SCHEMA_VERSION = 1
RUNS = 20
ROUNDED = "rounded"
"""Change of the pictures that simulates another machine."""
LEAST_RUNS = 5
"""Minimum number of runs for a range: that of two is almost zero once in twenty times."""
FACTOR = 2.0
"""Factor of the range. Twenty normal numbers have a range of 3.7 standard deviations; two of them differ by twice this
once in seven million times. Ranges of fewer runs are enlarged in the proportion of normal numbers."""
DIGITS = 6
"""Significant digits of the numbers in a baseline."""


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Ranges of numbers over runs that differ by rounding only."""

    path: Path
    ranges: Mapping[str, float]
    """Maximum minus minimum, by key of the metric."""
    runs: Mapping[str, int]
    """Number of runs, by key of the metric."""

    def tolerance(self, key: str, baseline: float, estimate: float) -> float:
        """Return the tolerance of a number relative to its baseline.

        Parameters
        ----------
        key : str
            Key of the metric.
        baseline : float
            Value in the baseline, in the metric's unit.
        estimate : float
            Tolerance if no scatter was measured.

        Returns
        -------
        float
            Tolerance in the metric's unit.
        """
        if key not in self.ranges:
            return estimate
        held = 0.0 if baseline == 0.0 else 0.5 * 10.0 ** (math.floor(math.log10(abs(baseline))) + 1 - DIGITS)
        grown = max(normal_range(RUNS) / normal_range(self.runs[key]), 1.0)
        return max(FACTOR * self.ranges[key] * grown + 2.0 * held, estimate)


def normal_range(count: int) -> float:
    """Return the mean range of a number of normal values, in standard deviations (Tippett 1925, Biometrika 17:364)."""
    x = np.linspace(-8.0, 8.0, 1601)
    below = norm.cdf(x)
    return float(np.trapezoid(1.0 - (1.0 - below) ** count - below**count, x))


def measure(cases: Sequence[Case], *, runs: int, change: str = ROUNDED, device: str, say: Say) -> list[Run]:
    """Run cases on pictures with different random changes.

    Parameters
    ----------
    cases : sequence of Case
        Cases to run.
    runs : int
        Number of runs; the seeds are 1 to this.
    change : str
        Name of the change (`benchmarks.perturb`); the run's number is its seed.
    device : str
        Computing device.
    say : Say
        Receives the progress.

    Returns
    -------
    list of Run
        One run per seed, with the metrics that depend on pictures.
    """
    found = []
    for seed in range(1, runs + 1):
        say(f"run {seed} of {runs}")
        run = accuracy.measure(cases, device=device, say=say, change=f"{change}:{seed}")
        found.append(replace(run, metrics=metrics_of_pictures(run.metrics, cases)))
    return found


def values(runs: Sequence[Run]) -> dict[str, list[float]]:
    """Return the values of several runs by key of the metric."""
    found: dict[str, list[float]] = {}
    for metric in (metric for run in runs for metric in run.metrics):
        found.setdefault(metric.key, []).append(metric.value)
    return found


def metrics_of_pictures(metrics: Sequence[Metric], cases: Sequence[Case]) -> list[Metric]:
    """Return the metrics that depend on pictures, the only ones affected by simulated rounding."""
    names = {case.name for case in cases}
    return [metric for metric in metrics if metric.key.rpartition("/")[0] in names]


def table(values: Mapping[str, Sequence[float]]) -> str:
    """Return the ranges as text."""
    width = max(map(len, values), default=0)
    lines = [f"{'metric':<{width}}  {'mean':>12} {'range':>10} {'deviation':>10}"]
    for key, some in values.items():
        mean = math.fsum(some) / len(some)
        deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in some) / max(1, len(some) - 1))
        lines.append(f"{key:<{width}}  {mean:>12.5g} {max(some) - min(some):>10.2g} {deviation:>10.2g}")
    return "\n".join(lines)


def write(path: Path, values: Mapping[str, Sequence[float]], *, about: Mapping[str, Any]) -> None:
    """Record the scatter of numbers; others in the file are kept.

    Parameters
    ----------
    path : Path
        Path of the JSON file.
    values : dict of sequence of float
        Values of each metric in all runs, by key.
    about : dict of Any
        Description of the runs.

    Raises
    ------
    UserError
        If a number was not measured in every run, or the file is damaged.
    """
    runs = max(map(len, values.values()), default=0)
    lacking = [key for key, some in values.items() if len(some) < runs or not all(map(math.isfinite, some))]
    if lacking or runs < LEAST_RUNS:
        what = lacking[0] if lacking else "every metric"
        raise UserError(f"{path} is not changed: {what} was not measured in every run, or in fewer than {LEAST_RUNS} runs.")
    before = read(path)
    found = {key: {"range": before.ranges[key], "runs": before.runs[key]} for key in before.ranges}
    found |= {key: {"range": float(f"{max(some) - min(some):.3g}"), "runs": runs} for key, some in values.items()}
    atomic.write_json(path, {"schema_version": SCHEMA_VERSION, "about": dict(about), "metrics": dict(sorted(found.items()))})


def read(path: Path) -> Scatter:
    """Read a committed scatter, empty if there is none; raise UserError if it is damaged."""
    if not path.is_file():
        return Scatter(path=path, ranges={}, runs={})
    with stored_json(path, SCHEMA_VERSION, "make it with `./run bench scatter --quick`") as stored:
        ranges = {str(key): float(entry["range"]) for key, entry in stored["metrics"].items()}
        runs = {str(key): int(entry["runs"]) for key, entry in stored["metrics"].items()}
        if not all(math.isfinite(value) and value >= 0.0 for value in ranges.values()):
            raise ValueError("a range is negative or not a number")
    return Scatter(path=path, ranges=ranges, runs=runs)
