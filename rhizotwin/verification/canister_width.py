"""Width of the canister in the pictures, relative to the rendered canister.

The walls' edges are seen through air, so that their distance in the pictures depends only on the size of the canister
and the distance of the camera, which the marker strip determines. A strip or a canister of another size than stated
shows here, and hardly in the roots, which scale with the cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from rhizotwin.recon.coverage.silhouettes import Image
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.settings import TrustSettings

Array = NDArray[np.float64]

_BLOCK_ROWS = 8
"""Number of rows that are averaged. Over this height, the edge of a canister tilted by a degree moves by 0.14 px."""
_REACH = 0.06
"""Maximum shift of an edge that is searched, as a fraction of the canister's width in the picture."""
_WINDOW = 0.04
"""Half-width of the compared part of a row, around the rendered edge, as a fraction of the canister's width."""
_SMOOTH_PX = 0.7
"""Standard deviation of the Gaussian that is applied to the rows before differences are computed, px."""
_LEAST_CORRELATION = 0.8
"""Minimum correlation of the light's gradient in the picture with the rendered one. Where an edge is hidden by roots or
dirt, or has too little contrast, it is lower."""
_LEAST_BLOCKS = 4
"""Minimum number of measured blocks of rows from which the width is determined."""


@dataclass(frozen=True)
class CanisterWidth:
    """Width of the canister in the pictures, relative to the rendered width."""

    error: float
    """Relative difference between the measured and the rendered width."""
    sigma: float
    """Standard deviation of ``error``."""

    @property
    def is_wrong(self) -> bool:
        """Return whether the width differs by more than the bad limit of the radius in the reconstruction's checks."""
        return abs(self.error) - 3.0 * self.sigma > TrustSettings().radius_share[1]


def measure_edges(light: Image, rendered: Image, coverage: Image) -> Array:
    """Return the relative differences (B,) of the canister's width in blocks of rows of a picture.

    Parameters
    ----------
    light, rendered : (H, W) float32 array
        Light of the picture, and rendered light of the empty canister.
    coverage : (H, W) float32 array
        Rendered coverage of the pixels by the canister's outer wall.
    """
    found = []
    width = coverage.shape[1]
    for top in range(0, len(coverage) - _BLOCK_ROWS + 1, _BLOCK_ROWS):
        rows = slice(top, top + _BLOCK_ROWS)
        inside = np.flatnonzero(coverage[rows].mean(axis=0) > 0.5)
        if not len(inside) or inside[0] == 0 or inside[-1] == width - 1 or coverage[rows].max(axis=1).min() < 1.0:
            continue
        own, other = (np.diff(gaussian_filter1d(image[rows].mean(axis=0, dtype=np.float64), _SMOOTH_PX)) for image in (rendered, light))
        across = float(inside[-1] - inside[0])
        left, right = (_shift(own, other, edge, across) for edge in (inside[0], inside[-1]))
        if left is not None and right is not None:
            found.append((right - left) / across)
    return np.array(found)


def _shift(own: Array, other: Array, edge: int, across: float) -> float | None:
    """Return the shift, px, at which a picture's gradients correlate best with the rendered ones around an edge."""
    half, reach = max(4, round(_WINDOW * across)), max(2, round(_REACH * across))
    low = edge - half
    high = edge + half
    if low - reach < 0 or high + reach >= len(other):
        return None
    pattern = own[low:high] - own[low:high].mean()
    scores = []
    for shift in range(-reach, reach + 1):
        part = other[low + shift : high + shift] - other[low + shift : high + shift].mean()
        scores.append(float(pattern @ part) / max(float(np.linalg.norm(pattern) * np.linalg.norm(part)), 1e-12))
    best = int(np.argmax(scores))
    if scores[best] < _LEAST_CORRELATION or best in (0, 2 * reach):
        return None
    before, here, after = scores[best - 1 : best + 2]
    return best - reach + 0.5 * (before - after) / (before - 2.0 * here + after)


def combine(blocks: Sequence[Array]) -> CanisterWidth | None:
    """Combine the blocks (B,) of each picture. The blocks of a picture share its camera, so that pictures are averaged.

    The result is None if too few edges were measured.
    """
    values = np.concatenate(blocks) if blocks else np.zeros(0)
    if len(values) < _LEAST_BLOCKS:
        return None
    pictures = np.array([np.median(block) for block in blocks if len(block)])
    noise = MAD * float(np.median(np.abs(values - np.median(values)))) / np.sqrt(len(values))
    spread = float(pictures.std(ddof=1)) / np.sqrt(len(pictures)) if len(pictures) > 1 else 0.0
    return CanisterWidth(error=float(np.median(pictures)), sigma=float(np.hypot(noise, spread)))
