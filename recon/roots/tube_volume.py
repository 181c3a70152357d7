"""One shape from solids and tubes: the tubes' volume painted into the finest nodes of the hull's lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull import spheres
from rhizotwin.recon.hull.boxes import Box
from rhizotwin.recon.hull.leaves import Grid, Leaves, united
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.filling import Filled, fill, levelled
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAMPLES_A_NODE = 1.8
"""Points along a node's edge: every node in a tube gets some."""
_FINEST_SPACING_MM = 0.05
"""Of the points, for memory."""
_WIDE_NODES = 4.0
"""Tubes of so many nodes' radius are painted as spheres, which large leaves fill; points would fill memory."""
_APART = 0.25
"""Distance of these spheres, in their radii: dents of a 128th of one, of which the mean is made up for."""
_DENT = 24.0
"""Between spheres of radius r that stand s apart their union is s^2 / (24 r) too thin, on the mean."""
_SLACK_PX = 0.05
"""Uncertainty of a tube's radius that the volume's bounds allow for."""


@dataclass(frozen=True)
class Painted:
    """Solids and tubes as one shape."""

    leaves: Leaves
    thick: Leaves
    """Solids and thick roots alone."""
    thinner_mm3: float
    """What the tubes lose where all radii are smaller by `_SLACK_PX`."""
    thicker_mm3: float
    """What they gain where all are larger."""


def paint(solids: Leaves, system: RootSystem) -> Painted:
    """Paint tubes beside solids.

    Where both are, a node is as full as the fuller of the two.
    """
    tubes, grid = system.tubes, solids.grid
    wide = _is_wide(tubes, grid.size_mm) & ~system.solid
    spacing_mm = max(grid.size_mm / _SAMPLES_A_NODE, _FINEST_SPACING_MM)
    others = united(solids, spheres.fill(_strung(tubes, wide), grid))
    leaves, thick = (
        united(others, _leaves(fill(tubes, spacing_mm, left_out=system.solid | wide | gone), grid))
        for gone in (np.zeros(len(wide), bool), ~system.thick)
    )
    slack_mm = _SLACK_PX / system.px_a_mm
    free = np.where(system.solid, 0.0, tubes.radius_mm)
    length = np.linalg.norm(np.diff(tubes.centre_mm[tubes.segments], axis=1)[:, 0], axis=1)
    radius = free[tubes.segments[:, 1]]
    thinner = float(np.pi * length @ (radius**2 - np.maximum(radius - slack_mm, 0.0) ** 2))
    thicker = float(np.pi * length @ ((radius + slack_mm) ** 2 - radius**2))
    return Painted(leaves, thick, thinner, thicker)


def _is_wide(tubes: Tubes, node_mm: float) -> Mask:
    """Tell the nodes (N,) that are painted as spheres: wide ones, but for the flat end of the first branch."""
    wide = np.asarray(tubes.radius_mm > _WIDE_NODES * node_mm)
    first = tubes.branches[0]
    wide[first[polyline.way_mm(tubes.centre_mm[first]) < tubes.radius_mm[first]]] = False
    return wide


def _strung(tubes: Tubes, wide: Mask) -> Spheres:
    """Return spheres close together along the segments between wide nodes (N,)."""
    ends, radii = tubes.segments, np.stack(tubes.segment_radii, axis=1)
    both = wide[ends].all(axis=1)
    (a, b), (first, last) = ends[both].T, radii[both].T
    step = np.linalg.norm(tubes.centre_mm[b] - tubes.centre_mm[a], axis=1)
    count = np.maximum(np.ceil(step / (_APART * np.minimum(first, last))), 1).astype(np.int64)
    segment = np.repeat(np.arange(len(a)), count + 1)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)) / count[segment]
    radius = first[segment] + share * (last - first)[segment]
    # the dents between spheres, on the mean
    radius += np.square(step / count)[segment] / (_DENT * radius)
    centre = tubes.centre_mm[a][segment] + share[:, None] * (tubes.centre_mm[b] - tubes.centre_mm[a])[segment]
    return Spheres(centre, radius)


def _leaves(filled: Filled, grid: Grid) -> Leaves:
    """Gather points that fill tubes in the finest nodes."""
    at = np.floor((filled.point_mm - np.asarray(grid.origin_mm)) / grid.size_mm).astype(np.int64)
    box = Box.around(at)
    keys, inverse = np.unique(box.number(at), return_inverse=True)
    share = np.bincount(inverse, weights=filled.volume_mm3 / grid.size_mm**3, minlength=len(keys)).astype(np.float64)
    return Leaves(grid, box.cell(keys).astype(np.int32), np.ones(len(keys), np.int32), levelled(share).astype(np.float32))
