"""Parameters that all nodes share, with their prior and limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Parameter:
    """Declaration of a parameter."""

    name: str
    step: float
    """Step of the difference quotient from which its derivatives are computed, in the unit of the parameter."""
    low: float = -np.inf
    high: float = np.inf
    largest: float = np.inf
    """Largest change per iteration."""


@dataclass(frozen=True)
class Parameters:
    """Values of K parameters, with their normal prior distribution."""

    declared: tuple[Parameter, ...]
    value: Array
    """Current values, shape (K,)."""
    mean: Array
    """Mean of the prior, shape (K,)."""
    precision: Array
    """Precision matrix of the prior, shape (K, K). It is 0 where nothing is known."""
    free: Mask
    """Mask of the parameters that are fitted, shape (K,)."""

    @property
    def limits(self) -> Array:
        """Return the lower bound, the upper bound and the largest step of every parameter, shape (3, K)."""
        return np.array([(part.low, part.high, part.largest) for part in self.declared]).reshape(-1, 3).T

    def unconstrained(self, free: Mask) -> Parameters:
        """Return the same values without prior and limits. The parameters in a mask (K,) are free."""
        declared = tuple(Parameter(part.name, part.step) for part in self.declared)
        return replace(self, declared=declared, precision=np.zeros_like(self.precision), free=free)
