"""One measured number with the data to judge it."""

import math
from dataclasses import dataclass
from typing import Literal

Direction = Literal["up", "down", "zero"]


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number measured by a benchmark."""

    key: str
    """Case and quantity, for example ``printed_8ml/clean/40x800x600/0.27/coverage/volume_error``."""
    value: float
    """Measured value; not finite if the measurement failed."""
    unit: str
    """mm, deg, s, MiB, or 1 for fractions and counts."""
    direction: Direction
    """Direction of improvement: larger, smaller, or closer to zero."""
    rel_tol: float = 0.0
    """Accepted deterioration, as a fraction of the baseline's magnitude."""
    abs_tol: float = 0.0
    """Accepted deterioration in the unit, in addition to the relative part."""

    def worse_by(self, baseline: float) -> float:
        """Return the deterioration relative to a baseline, in the unit.

        It is negative for an improvement, and NaN for a failed measurement.
        """
        if self.direction == "up":
            return baseline - self.value
        if self.direction == "down":
            return self.value - baseline
        return abs(self.value) - abs(baseline)

    def tolerance(self, baseline: float) -> float:
        """Return the accepted deterioration in the unit."""
        return self.abs_tol + self.rel_tol * abs(baseline)

    @property
    def measured(self) -> bool:
        """Whether the value is finite."""
        return math.isfinite(self.value)
