"""Octree carving with refraction (T3.4.4), implemented as Dr.Jit kernels.

The water is divided into nodes. A node is *empty* if its footprint lies entirely outside the silhouette in at least one
view that shows the whole node. A node is *full* if its footprint lies inside the silhouette in all views that show it.
Any other node is divided into eight, down to the finest size. A view neither carves a node nor counts as a vote if it
does not show the node, shows it twice, or has unusable pixels there. Nodes with too few votes are *blind*: they are not
part of the shape, and their total volume is reported.

A node is represented by its integer position on the lattice of its level. Neighbours, parents and children follow from
arithmetic, so that no tree is stored: arrays of positions replace the dictionary of leaves in the thesis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon import passes
from rhizotwin.recon.device import Bool, Int32, Kernel, Point3f
from rhizotwin.recon.hull import marks
from rhizotwin.recon.hull.distance_maps import DistanceMaps, least_votes
from rhizotwin.recon.hull.leaves import Grid, Hull, Index, Leaves
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.scenes.memory import MIB, total_mib

_BLIND_MM = 2.5
"""Edge length above which a node that too few views show is still divided, mm, since parts of it may be visible."""
BY_PARENT_MM = 1.0
"""Maximum edge length of nodes that are not projected individually, mm. Instead, the centre of their parent is
projected, and they are located with the Jacobian of this projection (`marks.mark_nodes`)."""
_GOLDEN = (5.0**0.5 - 1.0) / 2.0
"""Inverse of the golden ratio. Views at multiples of this fraction of a turn are evenly distributed for any number of
views."""
_HALF_DIAGONAL = 0.71
"""Half the diagonal of a square with an edge length of 1, sqrt(2) / 2, rounded up."""
_CHUNK = 1 << 21
"""Maximum number of nodes processed by one kernel launch. This takes 0.3 GB (`_BYTES_A_NODE`)."""
_BYTES_A_NODE = 150
"""Measured peak memory per node of the finest level, bytes.

From this value, the number of nodes that fit in memory is computed before each level, since Dr.Jit aborts the process
if memory is exhausted."""


@dataclass(frozen=True)
class Water:
    """Cylinder of water that may contain roots."""

    radius_mm: float
    top_mm: float
    bottom_mm: float

    @property
    def centre_mm(self) -> NDArray[np.float64]:
        """Return the centre (3,) of the water, canister frame."""
        return np.array([0.0, 0.0, 0.5 * (self.top_mm + self.bottom_mm)])

    def grid(self, size_mm: float) -> Grid:
        """Return the lattice that covers the water with finest nodes of edge length ``size_mm``."""
        return Grid.over(
            np.array([-self.radius_mm, -self.radius_mm, self.bottom_mm]), np.array([self.radius_mm, self.radius_mm, self.top_mm]), size_mm
        )


def spread(count: int) -> list[int]:
    """Return the indices of views, ordered so that successive views have very different directions.

    The indices are sorted by the fractional part of their product with the inverse of the golden ratio. With this
    order, most nodes are carved early.
    """
    return [int(k) for k in np.argsort((np.arange(count) * _GOLDEN) % 1.0, kind="stable")]


def carve(
    bank: ViewBank,
    maps: DistanceMaps,
    grid: Grid,
    water: Water,
    *,
    min_votes: int | None = None,
    slack_px: float = 0.3,  # same default as in `HullSettings`
    progress: Callable[[], object] | None = None,
) -> Hull:
    """Carve the visual hull of the silhouettes out of the water.

    Parameters
    ----------
    water : Water
        Volume to be carved. Nodes outside are removed.
    min_votes : int, optional
        Minimum number of views that must show a node for it to be part of the shape. The default is
        `distance_maps.least_votes`.
    slack_px : float
        Uncertainty of the outlines, px. `Hull.moved_in_mm3` and ``moved_out_mm3`` are the volumes for outlines moved by
        this distance.
    progress : callable, optional
        Function called after each level of the octree.
    """
    passes.add("carvings")
    i, j, k = (a.ravel() for a in np.meshgrid(*(np.arange(n, dtype=np.int32) for n in grid.coarse_shape), indexing="ij"))
    votes = least_votes(bank.count) if min_votes is None else min_votes
    carving, nodes = _Carving(bank, maps, grid, water, votes, slack_px), [mi.Int32(i), mi.Int32(j), mi.Int32(k)]
    done = [_Classified(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros((3, 0), np.float32), 0.0, None)]
    for level in range(grid.levels + 1):
        by_parent = level > 0 and grid.edge_mm(level) <= BY_PARENT_MM
        if level > 0 and not by_parent:
            nodes = _split(nodes)
        chunk, kept = _CHUNK // 8 if by_parent else _CHUNK, list[list[Int32]]()
        for begin in range(0, dr.width(nodes[0]), chunk):
            lane = dr.arange(mi.UInt32, begin, min(begin + chunk, dr.width(nodes[0])))
            part = [dr.gather(mi.Int32, a, lane) for a in nodes]
            decided = carving.classify(part, level, by_parent=by_parent)
            if decided is not None:
                done.append(decided)
                kept += [] if decided.split is None or not dr.width(decided.split[0]) else [decided.split]
        nodes = kept[0] if len(kept) == 1 else [dr.concat([part[axis] for part in kept]) if kept else mi.Int32() for axis in range(3)]
        if progress:
            progress()
        if dr.width(nodes[0]) == 0:
            break
        _check_memory(8 * dr.width(nodes[0]))
    best, low, high = np.concatenate([part.occupancy for part in done], axis=1)
    leaves = Leaves(grid, np.concatenate([part.index for part in done]), np.concatenate([part.size for part in done]), best)
    return Hull(leaves, high, leaves.volume_mm3(low), sum(part.blind_mm3 for part in done))


@dataclass(frozen=True)
class _Classified:
    """Classification of octree nodes of equal size."""

    index: Index
    """Lowest corner of each node that is part of the shape, shape (N, 3), in units of the finest nodes."""
    size: Index
    """Edge length of each node, shape (N,), in units of the finest nodes."""
    occupancy: NDArray[np.float32]
    """Occupied fraction of each node, shape (3, N). The three rows are the best estimate, the fraction with the
    outlines shifted inwards, and the fraction with the outlines shifted outwards."""
    blind_mm3: float
    """Total volume of the nodes that too few views show, mm3."""
    split: list[Int32] | None
    """Nodes that must be divided further, or None on the finest level."""


@dataclass(frozen=True)
class _Carving:
    """Inputs and parameters of octree carving."""

    bank: ViewBank
    maps: DistanceMaps
    grid: Grid
    water: Water
    min_votes: int
    slack_px: float

    def classify(self, part: list[Int32], level: int, *, by_parent: bool) -> _Classified | None:
        """Classify the nodes of one level, or return None if all of them lie outside the water.

        Parameters
        ----------
        part : list of mi.Int32
            Nodes to classify, or their parents if ``by_parent`` is true.
        """
        grid, slack_px, water = self.grid, self.slack_px, self.water
        units, edge_mm = 2 ** (grid.levels - level), grid.edge_mm(level)
        half_mm, least = dr.opaque(mi.Float, 0.5 * edge_mm), dr.opaque(mi.UInt32, self.min_votes)
        if not by_parent:
            part = _compress(part, self._inside(_centres(grid, part, edge_mm), edge_mm))
            if dr.width(part[0]) == 0:
                return None
        about = _centres(grid, part, 2.0 * edge_mm if by_parent else edge_mm)
        parts = marks.corners(half_mm) if by_parent else [mi.Vector3f(dr.opaque(mi.Float, 0.0))]
        marked = marks.mark_nodes(self.bank, self.maps, about, parts, half_mm, dr.opaque(mi.Float, slack_px))
        part = _split(part) if by_parent else part
        point = _centres(grid, part, edge_mm)
        empty, partial, votes, depth, scale = marked.empty, marked.partial, marked.votes, marked.depth, marked.scale
        if by_parent:
            empty |= ~self._inside(point, edge_mm)
        blind = ~empty & (votes < least) & (edge_mm <= max(_BLIND_MM, 1.01 * grid.size_mm))  # 1.01: rounding
        if level < grid.levels:
            blind &= ~marks.find_partly_visible(self.bank, self.maps, point, half_mm, blind, self.min_votes)
        full = ~empty & ~blind & ~partial & (votes >= least)
        split = ~empty & ~blind & ~full
        in_radius = dr.square(point.x) + dr.square(point.y) < water.radius_mm**2
        chosen, measured = full, None
        if units == 1:
            # occupancy of the finest nodes that no view classifies
            moves = (0.0, -slack_px / scale, slack_px / scale)
            measured = [dr.select(full, 1.0, dr.clip(0.5 + (depth + move) / dr.opaque(mi.Float, grid.size_mm), 0.0, 1.0)) for move in moves]
            chosen = full | (split & in_radius & (measured[2] > 0))
            dr.eval(blind, chosen, measured)
        else:
            dr.eval(blind, chosen, split)
        blind &= in_radius & (point.z < water.top_mm) & (point.z > water.bottom_mm)
        index = np.stack([np.array(a) for a in _compress(part, chosen)], axis=1).astype(np.int32)
        occupancy = np.ones((3, len(index)), np.float32)
        if measured is not None:
            occupancy = np.stack([np.array(a) for a in _compress(measured, chosen)]).astype(np.float32)
        return _Classified(
            index=index * units,
            size=np.full(len(index), units, np.int32),
            occupancy=occupancy,
            blind_mm3=float(dr.count(blind)[0]) * edge_mm**3,
            split=_compress(part, split) if measured is None else None,
        )

    def _inside(self, point: Point3f, edge_mm: float) -> Bool:
        """Return the mask of nodes that lie at least partly in the water."""
        water = self.water
        inside = dr.square(point.x) + dr.square(point.y) < dr.opaque(mi.Float, (water.radius_mm + _HALF_DIAGONAL * edge_mm) ** 2)
        return (
            inside
            & (point.z < dr.opaque(mi.Float, water.top_mm + 0.5 * edge_mm))
            & (point.z > dr.opaque(mi.Float, water.bottom_mm - 0.5 * edge_mm))
        )


def _centres(grid: Grid, nodes: list[Int32], edge_mm: float) -> Point3f:
    """Return the centres of nodes of equal size, canister frame, mm."""
    edge = dr.opaque(mi.Float, edge_mm)
    return mi.Point3f(*((mi.Float(nodes[a]) + 0.5) * edge + dr.opaque(mi.Float, float(grid.origin_mm[a])) for a in range(3)))


def _compress(arrays: list[Kernel], mask: Bool) -> list[Kernel]:
    """Select the same entries, given by a mask, from each of several arrays."""
    chosen = dr.compress(mask)
    return [dr.gather(type(a), a, chosen) for a in arrays]


def _check_memory(count: int) -> None:
    """Raise a MemoryError if ``count`` nodes do not fit in memory."""
    fitting = int(total_mib() * MIB) // _BYTES_A_NODE
    if count > fitting:
        raise MemoryError(f"carving requires {count} octree nodes, but only {fitting} fit in memory")


def _split(nodes: list[Int32]) -> list[Int32]:
    """Return the eight children of each node. Siblings are consecutive."""
    lane = dr.arange(mi.UInt32, 8 * dr.width(nodes[0]))
    parent, child = lane >> 3, lane & 7
    bits = [(child >> 2) & 1, (child >> 1) & 1, child & 1]
    found = [2 * dr.gather(mi.Int32, nodes[a], parent) + mi.Int32(bits[a]) for a in range(3)]
    dr.eval(found)
    return found
