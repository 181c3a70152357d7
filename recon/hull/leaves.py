"""Octree leaves: the lattice of the finest nodes, occupied leaves of several sizes, and the visual hull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.boxes import Box, CellSet

Array = NDArray[np.float64]
Index = NDArray[np.int32]

_COARSEST_MM = 4.6
"""Maximum edge length of the coarsest nodes, mm. The canister is 33 such nodes wide."""


@dataclass(frozen=True)
class Grid:
    """Cubic lattice of the finest octree nodes.

    Node (i, j, k) extends from ``origin_mm + size_mm * [i, j, k]`` to ``origin_mm + size_mm * [i + 1, j + 1, k + 1]``.
    """

    origin_mm: Array
    size_mm: float
    levels: int
    """Number of times that the coarsest nodes are halved to obtain the finest nodes."""
    coarse_shape: tuple[int, int, int]

    @staticmethod
    def over(low_mm: Array, high_mm: Array, size_mm: float) -> Grid:
        """Return a lattice that covers the box between two corners (3,).

        The planes x = 0 and y = 0 are faces of nodes.
        """
        levels = max(0, int(np.floor(np.log2(_COARSEST_MM / size_mm))))
        coarse = size_mm * 2**levels
        first = np.floor(np.asarray(low_mm) / coarse)
        shape = np.maximum(np.ceil(np.asarray(high_mm) / coarse) - first, 1).astype(int)
        return Grid(first * coarse, size_mm, levels, (int(shape[0]), int(shape[1]), int(shape[2])))

    def refine(self, halvings: int) -> Grid:
        """Return the lattice whose finest nodes are halved several times. A negative number doubles them."""
        return replace(self, size_mm=self.size_mm / 2.0**halvings, levels=self.levels + halvings)

    def edge_mm(self, level: int) -> float:
        """Return the edge length of the nodes of a level, mm. Level 0 is the coarsest."""
        return self.size_mm * 2.0 ** (self.levels - level)


@dataclass(frozen=True)
class Leaves:
    """Occupied, non-overlapping octree leaves of different sizes."""

    grid: Grid
    index: Index
    """Lowest corner of each leaf, shape (N, 3), in units of the finest nodes."""
    size: Index
    """Edge length of each leaf, shape (N,), in units of the finest nodes. It is a power of two."""
    occupancy: NDArray[np.float32]
    """Fraction of each leaf that lies inside the shape, shape (N,)."""

    @staticmethod
    def whole(grid: Grid) -> Leaves:
        """Return all of a lattice, in its coarsest nodes."""
        index = np.argwhere(np.ones(grid.coarse_shape, bool)).astype(np.int32) * 2**grid.levels
        return Leaves(grid, index, np.full(len(index), 2**grid.levels, np.int32), np.ones(len(index), np.float32))

    @property
    def middles_mm(self) -> Array:
        """Centres of the leaves, shape (N, 3), canister frame, mm."""
        return np.asarray(self.grid.origin_mm) + (self.index + 0.5 * self.size[:, None]) * self.grid.size_mm

    @property
    def filled_volume(self) -> Array:
        """Occupied volume of each leaf, shape (N,), in volumes of a finest node."""
        return np.asarray(self.occupancy.astype(np.float64) * self.size.astype(np.float64) ** 3)

    def select(self, chosen: NDArray[np.generic] | slice) -> Leaves:
        """Return the leaves selected by a mask (N,), indices (M,) or a slice."""
        return Leaves(self.grid, self.index[chosen], self.size[chosen], self.occupancy[chosen])

    def split(self) -> Leaves:
        """Divide the leaves into finest nodes."""
        index, occupancy = [self.index[:0]], [self.occupancy[:0]]
        for edge in np.unique(self.size):
            some, offset = self.select(self.size == edge), np.array(list(np.ndindex(edge, edge, edge)), np.int32)
            index.append((some.index[:, None] + offset).reshape(-1, 3))
            occupancy.append(np.repeat(some.occupancy, len(offset)))
        nodes = np.concatenate(index)
        return Leaves(self.grid, nodes, np.ones(len(nodes), np.int32), np.concatenate(occupancy))

    def merge(self, halvings: int) -> Leaves:
        """Merge leaves into nodes of at least the size of finest nodes of a coarser lattice.

        The finest nodes of the lattice of the result are those of this lattice, doubled ``halvings`` times.
        """
        units = 2**halvings
        large, small = self.select(self.size >= units), self.select(self.size < units)
        parent = (small.index // units).astype(np.int64)
        share = small.occupancy * (small.size / units).astype(np.float32) ** 3
        box = Box.around(parent)
        unique, inverse = np.unique(box.number(parent), return_inverse=True)
        filled = np.bincount(inverse, weights=share, minlength=len(unique)).astype(np.float32)
        index = np.concatenate([large.index // units, box.cell(unique).astype(np.int32)])
        size = np.concatenate([large.size // units, np.ones(len(unique), np.int32)])
        return Leaves(self.grid.refine(-halvings), index, size, np.concatenate([large.occupancy, np.minimum(filled, 1.0)]))

    def near(self, points_mm: Array, margin_mm: float) -> Leaves:
        """Return the leaves within a distance of ``margin_mm`` of any point (M, 3)."""
        near = np.zeros(len(self.size), bool)
        if len(points_mm):
            reach_mm = margin_mm + 0.5 * self.grid.size_mm * (self.size - 1)
            tree = cKDTree(points_mm)
            for edge in np.unique(self.size):  # a bound is needed, since distant queries are the slowest
                some = np.flatnonzero(self.size == edge)
                most_mm = float(reach_mm[some[0]])
                near[some] = tree.query(self.middles_mm[some], distance_upper_bound=most_mm, workers=-1)[0] < most_mm
        return self.select(near)

    def occupancy_at(self, index: Index) -> NDArray[np.float32]:
        """Return the occupancy (M,) at finest nodes (M, 3), which is that of the leaf that contains them, or 0."""
        found = np.zeros(len(index), np.float32)
        for edge in np.unique(self.size):
            some = self.select(self.size == edge)
            place = CellSet.from_cells(some.index // edge).find(index // edge)
            found[place >= 0] = some.occupancy[place[place >= 0]]
        return found

    def volume_mm3(self, occupancy: NDArray[np.float32] | None = None) -> float:
        """Return the occupied volume of all leaves, mm3, optionally with other occupancies (N,) than those stored."""
        cubes = (self.size.astype(np.float64) * self.grid.size_mm) ** 3
        return float(cubes @ (self.occupancy if occupancy is None else occupancy).astype(np.float64))


def unite(first: Leaves, second: Leaves) -> Leaves:
    """Return the union of two sets of leaves on the same lattice.

    Leaves inside a larger leaf are removed. Of two identical leaves, the one with the higher occupancy is kept.
    """
    both = concatenate([first.select(~_find_within(first, second)), second.select(~_find_within(second, first))])
    _, place, which = np.unique(Box.around(both.index).number(both.index), return_index=True, return_inverse=True)
    fuller = np.zeros(len(place), np.float32)
    np.maximum.at(fuller, which, both.occupancy)
    return replace(both.select(place), occupancy=fuller)


def fill_up(leaves: Leaves, more: Leaves) -> Leaves:
    """Return leaves with the occupancies of finest nodes added to them."""
    return unite(leaves, replace(more, occupancy=more.occupancy + leaves.occupancy_at(more.index)))


def subtract(first: Leaves, second: Leaves) -> Leaves:
    """Return the difference of two sets of leaves on the same lattice.

    Leaves of the first set are divided until none contains a smaller leaf of the second set. Their occupancy is the
    difference of the occupancies, if it is positive.
    """
    done, carried, edge = list[Leaves](), first.select(slice(0)), int(first.size.max(initial=1))
    while edge:
        here = concatenate([carried, first.select(first.size == edge)])
        smaller = second.index[second.size < edge] // edge
        _, place = np.unique(Box.around(smaller).number(smaller), return_index=True)
        cut = CellSet.from_cells(smaller[place]).contains(here.index // edge)
        whole = here.select(~cut)
        rest = whole.occupancy - second.select(second.size >= edge).occupancy_at(whole.index)
        done.append(replace(whole, occupancy=rest).select(rest > 0.0))
        carried, edge = halve(here.select(cut)), edge // 2
    return concatenate(done)


def concatenate(parts: Sequence[Leaves]) -> Leaves:
    """Return all leaves of one or more sets that do not overlap."""
    return Leaves(parts[0].grid, *(np.concatenate([getattr(part, name) for part in parts]) for name in ("index", "size", "occupancy")))


def _find_within(leaves: Leaves, others: Leaves) -> NDArray[np.bool_]:
    """Return the mask (N,) of leaves that lie inside a larger leaf of another set."""
    within = np.zeros(len(leaves.size), bool)
    for edge in np.unique(others.size):
        smaller = np.flatnonzero(leaves.size < edge)
        larger = CellSet.from_cells(others.index[others.size == edge] // edge)
        within[smaller] |= larger.contains(leaves.index[smaller] // edge)
    return within


@dataclass(frozen=True)
class Hull:
    """Visual hull carved from the silhouettes."""

    leaves: Leaves
    outer: NDArray[np.float32]
    """Occupied fraction of each leaf if all outlines are moved out by their uncertainty, shape (N,)."""
    moved_in_mm3: float
    """Volume of the hull if all outlines are moved in by their uncertainty, mm3."""
    blind_mm3: float
    """Volume of the water that too few views show, mm3."""

    @property
    def widest(self) -> Leaves:
        """Return the hull that results if all outlines are moved out by their uncertainty."""
        return Leaves(self.leaves.grid, self.leaves.index, self.leaves.size, self.outer)

    @property
    def moved_out_mm3(self) -> float:
        """Return the volume of the hull if all outlines are moved out by their uncertainty, mm3."""
        return self.leaves.volume_mm3(self.outer)


def halve(leaves: Leaves) -> Leaves:
    """Divide leaves into their eight halves."""
    edge, corners = leaves.size // 2, np.array(list(np.ndindex(2, 2, 2)), np.int32)
    index = (leaves.index[:, None] + edge[:, None, None] * corners).reshape(-1, 3)
    return Leaves(leaves.grid, index, np.repeat(edge, 8), np.repeat(leaves.occupancy, 8))
