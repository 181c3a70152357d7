"""Combination of solids and tubes into a single shape, on the grid of the finest octree nodes of the visual hull."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull import frustums
from rhizotwin.recon.hull.boxes import Box
from rhizotwin.recon.hull.frustums import Frustums
from rhizotwin.recon.hull.leaves import Grid, Leaves, intersect, unite
from rhizotwin.recon.hull.spheres import Spheres, concatenate
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.filling import FillPoints, fill, limit_occupancy
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAMPLES_A_NODE = 1.8
"""Number of fill points per edge of a node, so that every node inside a tube contains some points."""
_FINEST_SPACING_MM = 0.05
"""Minimum spacing of points that fill a tube, mm, to limit memory."""
_WIDE_NODES = 4.0
"""Radius above which a tube is filled with frustums and spheres instead of points, in node edges. Spheres are converted
to large leaves, which require less memory than points."""
_APART = 0.25
"""Spacing of the spheres in a wide tube, as a fraction of their radius."""
_SLACK_PX = 0.05
"""Change of the tube radii from which the bounds of the volume are computed, px."""


@dataclass(frozen=True)
class CombinedShape:
    """Solids and tubes, combined into a single shape."""

    leaves: Leaves
    thick: Leaves
    """Leaves of the solids and of the thick roots, without those of thin roots."""
    thin: Mask
    """Mask (N,) of the nodes of thin roots."""
    thinner_mm3: float
    """Decrease of the volume of the tubes if their radii are reduced by `_SLACK_PX`, mm3."""
    thicker_mm3: float
    """Increase of the volume of the tubes if their radii are enlarged by `_SLACK_PX`, mm3."""


def combine(solids: Leaves, system: RootSystem, hull: Leaves) -> CombinedShape:
    """Combine solids and tubes into a single shape.

    Where they overlap, the larger occupancy of a node is used. Thick tubes are clipped to the hull.
    """
    tubes, grid = system.tubes, solids.grid
    wide = np.asarray(tubes.radius_mm > _WIDE_NODES * grid.size_mm) & ~system.solid
    spacing_mm = max(grid.size_mm / _SAMPLES_A_NODE, _FINEST_SPACING_MM)
    filled = system.solid | wide
    thin, flanks = (_leaves(fill(tubes, spacing_mm, excluded=filled | other), grid) for other in (system.thick, ~system.thick))
    inner = frustums.fill(_find_frustums(tubes, wide), *_inscribe_spheres(tubes, wide), grid)
    thick = unite(solids, intersect(unite(inner, flanks), hull))
    leaves = unite(thick, thin)
    slack_mm = _SLACK_PX / system.px_a_mm
    free = np.where(system.solid, 0.0, tubes.radius_mm)
    length = np.linalg.norm(np.diff(tubes.centre_mm[tubes.segments], axis=1)[:, 0], axis=1)
    radius = free[tubes.segments[:, 1]]
    thinner = float(np.pi * length @ (radius**2 - np.maximum(radius - slack_mm, 0.0) ** 2))
    thicker = float(np.pi * length @ ((radius + slack_mm) ** 2 - radius**2))
    return CombinedShape(leaves, thick, ~(filled | system.thick), thinner, thicker)


def _find_frustums(tubes: Tubes, wide: Mask) -> Frustums:
    """Return the segments of tubes whose nodes are both marked in the mask ``wide`` (N,) as frustums."""
    a, b, before, after = (tubes.centre_mm[node] for node in (*tubes.segments.T, *tubes.segment_neighbours.T))
    way, beside = polyline.unit_vectors(b - a), polyline.unit_vectors(np.stack([a - before, after - b], axis=1))
    joined = np.einsum("sek,sk->se", beside, way) > 0.0
    normals = polyline.unit_vectors(np.where(joined[..., None], beside, 0.0) + way[:, None])
    some = wide[tubes.segments].all(axis=1)
    return Frustums(np.stack([a, b], axis=1)[some], np.stack(tubes.segment_radii, axis=1)[some], normals[some])


def _inscribe_spheres(tubes: Tubes, wide: Mask) -> tuple[Spheres, Spheres]:
    """Return the spheres at the tips of wide branches, and the spheres inside all wide parts of branches.

    The mask ``wide`` (N,) marks wide nodes. The flat upper end of the first branch contains no spheres.
    """
    first, round_ = tubes.branches[0], wide.copy()
    round_[first[polyline.arc_length_mm(tubes.centre_mm[first]) < tubes.radius_mm[first]]] = False
    found = [(branch[-2:], _inscribe(tubes, k, round_)) for k, branch in enumerate(tubes.branches) if round_[branch].any()]
    tips = [spheres.select(slice(-1, None)) for end, spheres in found if round_[end].all()]
    return concatenate(tips), concatenate([spheres for _, spheres in found])


def _inscribe(tubes: Tubes, branch: int, wide: Mask) -> Spheres:
    """Return the spheres that touch the surface of a branch from inside.

    The cross-section of a branch at position s along its axis is a disc with the radius r. The sphere that touches the
    surface at a disc has its centre at s + q and the radius sqrt(r^2 + q^2), with q = (r^2)' / 2. A sphere with the
    centre and the radius of the disc would protrude from a tapering branch. No sphere extends beyond the rim of another
    disc.
    """
    nodes = tubes.branches[branch]
    way, square = polyline.arc_length_mm(tubes.centre_mm[nodes]), np.square(tubes.radii(branch))
    step, both = np.diff(way), wide[nodes[:-1]] & wide[nodes[1:]]
    count = np.maximum(np.ceil(step / (_APART * np.sqrt(np.minimum(square[:-1], square[1:])))), 1).astype(np.int64)
    segment = np.repeat(np.arange(len(step)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    at = np.append(way[segment] + share * step[segment], way[-1])
    inside = np.append(both[segment], both[-1])
    disc, shift = (np.interp(at, way, value) for value in (square, 0.5 * np.gradient(square, way)))
    middle = np.clip(at + shift, way[0], way[-1])[inside]
    radius = np.sqrt([(np.square(at - place) + disc).min() for place in middle])
    return Spheres(polyline.interpolate(tubes.centre_mm[nodes], way, middle), radius)


def _leaves(filled: FillPoints, grid: Grid) -> Leaves:
    """Convert points that fill tubes to leaves of the finest size."""
    at = np.floor((filled.point_mm - np.asarray(grid.origin_mm)) / grid.size_mm).astype(np.int64)
    box = Box.around(at)
    keys, first, inverse = np.unique(box.number(at), return_index=True, return_inverse=True)
    share = np.bincount(inverse, weights=filled.volume_mm3 / grid.size_mm**3, minlength=len(keys)).astype(np.float64)
    occupancy = limit_occupancy(share, filled.branch[first]).astype(np.float32)
    return Leaves(grid, box.cell(keys).astype(np.int32), np.ones(len(keys), np.int32), occupancy)
