"""One measured number with what it takes to judge it."""

import math
from dataclasses import dataclass
from typing import Literal

Direction = Literal["up", "down", "zero"]


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number that a benchmark measured."""

    key: str
    """Case and quantity, for example ``printed_8ml/clean/40x800x600/0.27/coverage/volume_error``."""
    value: float
    """Not finite where the measurement failed."""
    unit: str
    """mm, deg, s, MiB, or 1 for fractions and counts."""
    direction: Direction
    """What is better: larger, smaller, or closer to zero."""
    rel_tol: float = 0.0
    """Change for the worse that passes, as a fraction of the baseline's magnitude."""
    abs_tol: float = 0.0
    """Change for the worse that passes, in the unit; added to the relative part."""

    def worse_by(self, baseline: float) -> float:
        """Return how much worse than a baseline this is, in the unit.

        Negative where it is better, NaN where it failed.
        """
        if self.direction == "up":
            return baseline - self.value
        if self.direction == "down":
            return self.value - baseline
        return abs(self.value) - abs(baseline)

    def tolerance(self, baseline: float) -> float:
        """Return the change in the unit that passes as no change."""
        return self.abs_tol + self.rel_tol * abs(baseline)

    @property
    def measured(self) -> bool:
        """Whether there is a finite value."""
        return math.isfinite(self.value)
