"""Display settings of a result: layers, colours, click mode and clipping box."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

LAYERS = ("surface", "centre lines", "tubes", "voxels", "canister", "cameras", "truth", "scale bar")
"""Layers of the 3D view that can be displayed."""
CLICKS = ("select a root", "select a voxel", "measure a distance", "cut the root here", "end the root here", "set the base of the plant")
"""Click modes of the 3D view."""
TRUTH = ("overlaid", "beside", "as colours of distance")
"""Display modes of the true shape."""
FAR_MM = 1e9
"""Coordinate of a limit of the clipping box that clips nothing, mm."""


@dataclass
class Look:
    """Display settings of a result."""

    layers: set[str] = field(default_factory=lambda: {"surface", "canister", "scale bar"})
    """Displayed layers. Cameras are not displayed by default, because their pictures would delay every frame."""
    colour: str = "order"
    """Property of the roots that determines their colour, one of `root_colours.CHOICES`."""
    truth: str = TRUTH[0]
    """Display mode of the true shape, one of `TRUTH`."""
    low_mm: Triple = (-FAR_MM, -FAR_MM, -FAR_MM)
    """Lowest corner of the clipping box, mm, canister frame."""
    high_mm: Triple = (FAR_MM, FAR_MM, FAR_MM)
    """Highest corner of the clipping box, mm, canister frame."""
    click: str = CLICKS[0]
    """Effect of a click into the 3D view, one of `CLICKS`."""

    @property
    def is_unclipped(self) -> bool:
        """Return whether the clipping box has no limits."""
        return max(self.low_mm) <= -FAR_MM and min(self.high_mm) >= FAR_MM

    def inside(self, points_mm: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3) lie inside the clipping box."""
        return np.asarray(((points_mm >= self.low_mm) & (points_mm <= self.high_mm)).all(axis=1))
