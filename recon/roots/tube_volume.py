"""Leaves that tubes fill, on the grid of the finest octree nodes of the visual hull."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull import bodies
from rhizotwin.recon.hull.bodies import Bodies
from rhizotwin.recon.hull.leaves import Grid, Hull, Leaves, unite
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WIDE_NODES = 4.0
"""Radius above which nodes resolve a tube, in node edges, so that its surface is that of its nodes."""
_LEAST_NODES = 3.0
"""Minimum radius of a tube in nodes of the lattice on which it is filled. The volume of a tube with this radius and a
length of 24 nodes has a standard deviation of 0.5 %, which depends on its position and direction. With 2 nodes, two
tubes that overlap by a third of their width lose 2 %."""
_SLACK_PX = 0.05
"""Change of the tube radii from which the bounds of the volume are computed, px."""


def find_thin(system: RootSystem, edge_mm: float) -> Mask:
    """Return the mask (N,) of the nodes of tubes outside solids that leaves with a given edge do not resolve."""
    return np.asarray((system.tubes.radius_mm <= _WIDE_NODES * edge_mm) & ~system.thick & ~system.solid)


def fill_tubes(system: RootSystem, hull: Hull) -> tuple[Leaves, Leaves]:
    """Return the leaves of wide tubes, clipped to the hull, and those of all others.

    A wide root may extend above its first node. This round top is only known from the outlines.
    """
    tubes, grid = system.tubes, hull.leaves.grid
    filled, thin = ~system.solid[tubes.segments].all(axis=1), find_thin(system, grid.size_mm)[tubes.segments[:, 1]]
    wide, first = filled & ~thin, tubes.branches[0][:1]
    top_mm, radius_mm = (values[first[: int(wide[0])]] for values in (tubes.centre_mm, tubes.radius_mm))
    top = bodies.fill(Bodies.spheres(top_mm, radius_mm), hull.leaves.near(top_mm, float(radius_mm.sum()) + grid.size_mm))
    shape = bodies.fill(_find_bodies(tubes, wide, grid.size_mm), hull.widest)
    return unite(shape, top), paint(tubes, filled & thin, grid)


def paint(tubes: Tubes, some: Mask, grid: Grid) -> Leaves:
    """Return the leaves of some segments, given by a mask (S,). Thin branches are filled on a finer lattice."""
    wanted = [np.log2(_LEAST_NODES * grid.size_mm / np.median(tubes.radii(k))) for k in range(len(tubes.branches))]
    halvings = np.repeat(np.ceil(np.maximum(wanted, 0.0)).astype(int), [len(nodes) - 1 for nodes in tubes.branches])
    leaves = Leaves.whole(grid).select(slice(0))
    for number in np.unique(halvings[some]).tolist():
        finer = grid.refine(number)
        fine = bodies.fill(_find_bodies(tubes, some & (halvings == number), finer.size_mm), Leaves.whole(finer))
        leaves = unite(leaves, fine.merge(number))
    return leaves


def slack_mm3(system: RootSystem) -> tuple[float, float]:
    """Return the decrease and the increase of the volume of tubes if their radii are changed by `_SLACK_PX`, mm3."""
    tubes, slack_mm = system.tubes, _SLACK_PX / system.px_a_mm
    length = np.linalg.norm(np.diff(tubes.centre_mm[tubes.segments], axis=1)[:, 0], axis=1)
    radius = np.where(system.solid, 0.0, tubes.radius_mm)[tubes.segments[:, 1]]
    thinner = float(np.pi * length @ (radius**2 - np.maximum(radius - slack_mm, 0.0) ** 2))
    return thinner, float(np.pi * length @ ((radius + slack_mm) ** 2 - radius**2))


def _find_bodies(tubes: Tubes, some: Mask, edge_mm: float) -> Bodies:
    """Return the frustums and round tips of some segments, given by a mask (S,), to fill nodes with a given edge."""
    a, b, before, after = (tubes.centre_mm[node] for node in (*tubes.segments.T, *tubes.segment_neighbours.T))
    way, beside = polyline.unit_vectors(b - a), polyline.unit_vectors(np.stack([a - before, after - b], axis=1))
    joined = np.einsum("sek,sk->se", beside, way) > 0.0
    normals = polyline.unit_vectors(np.where(joined[..., None], beside, 0.0) + way[:, None])
    radii = _painted(np.stack(tubes.segment_radii, axis=1), edge_mm)
    inner, ball = np.concatenate([_inscribe(tubes, k) for k in range(len(tubes.branches))], axis=1)
    frustums = Bodies(np.stack([a, b], axis=1)[some], radii[some], normals[some], inner[some])
    tip = some & (tubes.segment_neighbours[:, 1] == tubes.segments[:, 1])
    return bodies.join([frustums, Bodies.spheres(b[tip], _painted(ball[tip], edge_mm))])


def _painted(radius_mm: Array, edge_mm: float) -> Array:
    """Return the radii with which cylinders fill nodes with a given edge with their true volume.

    The occupancy is a linear function of the depth. Its integral over a section is `pi (radius^2 + edge^2 / 12)`.
    """
    return np.asarray(np.sqrt(np.maximum(radius_mm**2 - edge_mm**2 / 12.0, 0.0)))


def _inscribe(tubes: Tubes, branch: int) -> Array:
    """Return the radii (2, S) of balls inside a branch, around the middles and ends of its segments.

    A cross-section of a branch is a disc. No ball extends beyond the rim of a disc, or above the flat base.
    """
    way = polyline.arc_length_mm(tubes.centre_mm[tubes.branches[branch]])
    at = np.concatenate([0.5 * (way[1:] + way[:-1]), way])
    radius = np.hypot(at[:, None] - at, np.interp(at, way, tubes.radii(branch))).min(axis=1)
    return np.stack([np.minimum(radius, at)[: len(way) - 1], radius[len(way) :]])
