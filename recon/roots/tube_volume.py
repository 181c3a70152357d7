"""One shape from solids and tubes: the tubes' volume painted into the finest nodes of the hull's lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull import spheres
from rhizotwin.recon.hull.boxes import Box
from rhizotwin.recon.hull.leaves import Grid, Leaves, common, united
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


def paint(solids: Leaves, system: RootSystem, hull: Leaves) -> Painted:
    """Paint tubes beside solids.

    Where both are, a node is as full as the fuller of the two; no thick tube reaches out of the hull.
    """
    tubes, grid = system.tubes, solids.grid
    wide = _is_wide(tubes, grid.size_mm) & ~system.solid
    spacing_mm = max(grid.size_mm / _SAMPLES_A_NODE, _FINEST_SPACING_MM)
    thin, flanks = (_leaves(fill(tubes, spacing_mm, left_out=system.solid | wide | gone), grid) for gone in (system.thick, ~system.thick))
    thick = united(solids, common(united(spheres.fill(_strung(tubes, wide), grid), flanks), hull))
    leaves = united(thick, thin)
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
    """Return spheres close together along the segments between wide nodes (N,), as large as fit into their branches."""
    found = [_inscribed(tubes, branch, wide) for branch, nodes in enumerate(tubes.branches) if wide[nodes].any()]
    centre, radius = (np.concatenate(parts) for parts in zip(*found, strict=True)) if found else (np.zeros((0, 3)), np.zeros(0))
    return Spheres(centre, radius)


def _inscribed(tubes: Tubes, branch: int, wide: Mask) -> tuple[Array, Array]:
    """Return centres (M, 3) and radii (M,) of the spheres inside a branch that touch its surface.

    Cross-sections are discs. Where their radius r changes along the way s, the sphere that touches the surface at one
    of them has its centre at s + q and the radius sqrt(r^2 + q^2), q = (r^2)' / 2; as wide as the disc, and on it, a
    sphere would stand out of a branch that grows thinner. None reaches beyond any other disc's rim.
    """
    nodes = tubes.branches[branch]
    way, square = polyline.way_mm(tubes.centre_mm[nodes]), np.square(tubes.radius_mm[nodes])
    if branch > 0:
        square[0] = square[1]  # a branch's first node has its parent's radius
    step, both = np.diff(way), wide[nodes[:-1]] & wide[nodes[1:]]
    count = np.maximum(np.ceil(step / (_APART * np.sqrt(np.minimum(square[:-1], square[1:])))), 1).astype(np.int64)
    segment = np.repeat(np.arange(len(step)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    at = np.append(way[segment] + share * step[segment], way[-1])
    apart, inside = np.append((step / count)[segment], (step / count)[-1]), np.append(both[segment], both[-1])
    disc, shift = (np.interp(at, way, value) for value in (square, 0.5 * np.gradient(square, way)))
    middle = np.clip(at + shift, way[0], way[-1])[inside]
    radius = np.sqrt([(np.square(at - place) + disc).min() for place in middle])
    radius += np.square(apart[inside]) / (_DENT * radius)  # the dents between spheres, on the mean
    return np.stack([np.interp(middle, way, axis) for axis in tubes.centre_mm[nodes].T], axis=1), radius


def _leaves(filled: Filled, grid: Grid) -> Leaves:
    """Gather points that fill tubes in the finest nodes."""
    at = np.floor((filled.point_mm - np.asarray(grid.origin_mm)) / grid.size_mm).astype(np.int64)
    box = Box.around(at)
    keys, inverse = np.unique(box.number(at), return_inverse=True)
    share = np.bincount(inverse, weights=filled.volume_mm3 / grid.size_mm**3, minlength=len(keys)).astype(np.float64)
    return Leaves(grid, box.cell(keys).astype(np.int32), np.ones(len(keys), np.int32), levelled(share).astype(np.float32))
