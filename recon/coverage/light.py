"""Light parameters that all roots of a scan share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIGHT = ("log mu", "blur variance", "hairs", "index")
"""Names of the light parameters as they are fitted: logarithm of the attenuation, variance of the blur of the pictures
(px2), strength of the root hairs, and relative excess of the roots' refractive index over that of water."""


@dataclass(frozen=True)
class Light:
    """Appearance of roots in front of the backlight; by default, that of opaque roots in sharp pictures."""

    mu_per_mm: float = np.inf
    """Attenuation of the roots, 1/mm. It is infinite for opaque roots."""
    blur_px: float = 0.0
    """Standard deviation of the pictures' blur, px, in addition to the blur by the square pixel."""
    hairs: float = 0.0
    """Strength of the root hairs, as a multiple of `translucent_tube.HAIRS`."""
    index: float = 1.0
    """Refractive index of the roots relative to water; used only for translucent roots."""

    @staticmethod
    def from_vector(vector: Array) -> Light:
        """Return the light with given parameters (L,), in the order of `LIGHT`."""
        log_mu, variance, hairs, excess = vector.tolist()
        return Light(float(np.exp(log_mu)), float(np.sqrt(max(variance, 0.0))), hairs, 1.0 + excess)

    @property
    def vector(self) -> Array:
        """Return the parameters (L,), in the order of `LIGHT`."""
        return np.array([np.log(self.mu_per_mm), self.blur_px**2, self.hairs, self.index - 1.0])

    @property
    def is_opaque(self) -> bool:
        """Return whether the roots are opaque."""
        return self.mu_per_mm == np.inf
