"""One solid from taproot, hypocotyl and tubes.

The tubes' volume painted into the finest nodes of the trimmed hull's lattice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull.boxes import Box, Scattered
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.parsimony import Trimmed
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.filling import Filled, fill, levelled

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAMPLES_A_NODE = 1.8
"""Points along a node's edge: every node in a tube gets some."""
_FINEST_SPACING_MM = 0.05
"""Of the points, for memory."""
_SLACK_PX = 0.05
"""Uncertainty of a tube's radius that the volume's bounds allow for."""


@dataclass(frozen=True)
class United:
    """Taproot, hypocotyl and tubes as one solid."""

    leaves: Leaves
    """On the lattice of the trimmed hull."""
    thick: Trimmed
    """Taproot, hypocotyl and solids alone."""
    thinner_mm3: float
    """What the tubes lose where all radii are smaller by `_SLACK_PX`."""
    thicker_mm3: float
    """What they gain where all are larger."""


def unite(trimmed: Trimmed, system: RootSystem) -> United:
    """Unite taproot, hypocotyl and solids, the part of a trimmed hull within a margin of core points, with tubes.

    Where both are, a node is as full as the fuller of the two.
    """
    size_mm, tubes = trimmed.leaves.grid.size_mm, system.tubes
    spacing_mm = max(size_mm / _SAMPLES_A_NODE, _FINEST_SPACING_MM)
    filled = fill(tubes, spacing_mm, left_out=system.buried)
    thick = trimmed.near(system.core_mm, system.margin_mm)
    slack_mm = _SLACK_PX / system.px_a_mm
    free = np.where(system.buried, 0.0, tubes.radius_mm)
    length = np.linalg.norm(np.diff(tubes.centre_mm[tubes.segments], axis=1)[:, 0], axis=1)
    radius = free[tubes.segments[:, 1]]
    thinner = float(np.pi * length @ (radius**2 - np.maximum(radius - slack_mm, 0.0) ** 2))
    thicker = float(np.pi * length @ ((radius + slack_mm) ** 2 - radius**2))
    return United(_painted(thick.leaves, filled), thick, thinner, thicker)


def _painted(thick: Leaves, filled: Filled) -> Leaves:
    """Add filled tubes to leaves; leaves larger than a node are full already."""
    large = thick.size > 1
    fine = thick.index[~large].astype(np.int64)
    at = np.floor((filled.point_mm - np.asarray(thick.grid.origin_mm)) / thick.grid.size_mm).astype(np.int64)
    small = np.concatenate([at, fine])
    box = Box.around(small)
    keys, inverse = np.unique(box.number(small), return_inverse=True)
    tube = np.bincount(inverse[: len(at)], weights=filled.volume_mm3 / thick.grid.size_mm**3, minlength=len(keys)).astype(np.float64)
    organ = np.zeros(len(keys))
    organ[inverse[len(at) :]] = thick.occupancy[~large]
    occupancy = np.maximum(levelled(tube), organ)
    index, new = box.cell(keys), occupancy > 0
    for edge in np.unique(thick.size[large]):
        new &= ~Scattered.of(thick.index[thick.size == edge] // edge).holds(index // edge)
    return Leaves(
        thick.grid,
        np.concatenate([thick.index[large], index[new].astype(np.int32)]),
        np.concatenate([thick.size[large], np.ones(int(new.sum()), np.int32)]),
        np.concatenate([thick.occupancy[large], occupancy[new].astype(np.float32)]),
    )
