"""Points that fill tubes uniformly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.tubes.branch_graph import Index
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""Golden angle, rad."""
_UPRIGHT = 0.8
"""Threshold for the z component of a unit vector, which corresponds to 37 degrees from the vertical. The perpendicular
vectors are constructed from the z axis for smaller components, and from the x axis for larger ones."""
_LEAST_SAMPLES = 6
"""Minimum number of points in a cross-section."""
_DENSE_MM = 0.15
"""Spacing of the points along all branches that are used to test whether a point lies inside a branch, mm."""
_NEAR = 24
"""Maximum number of neighbouring branch points that are tested per query."""
_AT_ONCE = 100_000
"""Number of points that are queried at once. It limits the memory for distances and neighbours to 40 MB."""
_THICK_MM = 0.5
"""Radius above which the points on branches are stored in a separate k-d tree, mm. There are few such points, so that
the search in the other tree has a small radius."""


@dataclass(frozen=True)
class FillPoints:
    """Points that fill tubes uniformly."""

    point_mm: Array
    """Positions of the points, shape (M, 3), mm."""
    volume_mm3: Array
    """Volume that each point represents, shape (M,), mm3."""
    branch: Index
    """Index of the branch that each point fills, shape (M,)."""
    along_mm: Array
    """Position of each point along its branch, shape (M,), mm. For points in a rounded tip, it is the position of the
    last node."""


def fill(tubes: Tubes, spacing_mm: float, *, excluded: Mask | None = None) -> FillPoints:
    """Fill each tube separately, including overlaps, with points at a spacing of about ``spacing_mm``.

    In each cross-section, they are arranged like the seeds of a sunflower (Vogel 1979, Math. Biosci. 44:179).

    Parameters
    ----------
    excluded : (N,) bool array, optional
        Mask of nodes. Segments between two of these nodes are not filled.
    """
    piece = _pieces(tubes)
    if excluded is not None:
        piece = piece.select(np.flatnonzero(~excluded[piece.nodes].all(axis=1)))
    length = np.linalg.norm(piece.way_mm, axis=1)
    slices = np.maximum(np.ceil(length / spacing_mm), 1).astype(np.int64)
    segment, part = _repeat_indices(slices)
    share = (part + 0.5) / slices[segment]
    # For slices of a cap, use the mean square of the radius, so that the volume is exact.
    square = np.where(piece.is_cap[segment], 1.0 - share**2 - 1.0 / (12.0 * slices[segment] ** 2), 1.0)
    first, last = piece.radii_mm[segment].T
    radius = (first + share * (last - first)) * np.sqrt(square)
    count = np.maximum(np.ceil(np.pi * radius**2 / spacing_mm**2), _LEAST_SAMPLES).astype(np.int64)
    each_mm3 = np.pi * radius**2 * (length / slices)[segment] / count
    reached = piece.along_mm[segment] + np.where(piece.is_cap[segment], 0.0, share * length[segment])
    along, side, up = _frames(piece.way_mm)
    number, place = _repeat_indices(count)
    at, turn = radius[number] * np.sqrt((place + 0.5) / count[number]), _GOLDEN * (place + 0.61 * number)  # slices are rotated
    owner = segment[number]
    point = piece.begin_mm[owner] + share[number, None] * along[owner]
    point += at[:, None] * (np.cos(turn)[:, None] * side[owner] + np.sin(turn)[:, None] * up[owner])
    return FillPoints(point, each_mm3[number], piece.branch[owner], reached[number])


def find_inside(tubes: Tubes, point: Array, branch: Index) -> tuple[Index, Index, Array]:
    """Find which points (M, 3) lie inside a branch other than their own.

    ``branch`` (M,) is the branch of each point.

    Returns
    -------
    point, other : (K,) int64 array
        Index of a point, and index of a branch that contains it.
    along_mm : (K,) float64 array
        Position of the point along the branch that contains it, mm.
    """
    others, found = _Dense.sample(tubes), list[tuple[Index, Index, Array]]()
    for begin in range(0, max(len(point), 1), _AT_ONCE):
        inside, other, along = others.find_containing(point[begin : begin + _AT_ONCE], branch[begin : begin + _AT_ONCE])
        found.append((begin + inside, other, along))
    inside, other, along = (np.concatenate(part) for part in zip(*found, strict=True))
    return inside, other, along


@dataclass(frozen=True)
class _Pieces:
    """Segments of tubes, followed by the rounded tips."""

    nodes: Index
    """Indices of the nodes at both ends, shape (P, 2). For a tip, both are the last node."""
    begin_mm: Array
    """Starting point of each piece, shape (P, 3), mm."""
    way_mm: Array
    """Vector from the beginning to the end of each piece, shape (P, 3), mm. A tip is as long as its radius."""
    radii_mm: Array
    """Radii at both ends, shape (P, 2), mm."""
    branch: Index
    """Index of the branch of each piece, shape (P,)."""
    along_mm: Array
    """Position of each starting point along its branch, shape (P,), mm."""
    is_cap: Mask
    """Whether each piece is a rounded tip, shape (P,)."""

    def select(self, which: Index) -> _Pieces:
        """Return a subset of the pieces, selected by indices."""
        return _Pieces(*(getattr(self, field.name)[which] for field in fields(self)))


def _pieces(tubes: Tubes) -> _Pieces:
    """Divide tubes into segments and rounded tips."""
    nodes, radii = tubes.segments, np.stack(tubes.segment_radii, axis=1)
    branch = np.repeat(np.arange(len(tubes.branches)), [len(nodes) - 1 for nodes in tubes.branches])
    way = tubes.centre_mm[nodes[:, 1]] - tubes.centre_mm[nodes[:, 0]]
    length = np.linalg.norm(way, axis=1)
    end = np.cumsum(length)
    begin = end - length
    begin, end = (value - begin[np.searchsorted(branch, branch)] for value in (begin, end))
    last = np.flatnonzero(tubes.segment_neighbours[:, 1] == nodes[:, 1])
    tip, radius = nodes[last, 1], radii[last, 1]
    return _Pieces(
        nodes=np.concatenate([nodes, np.stack([tip, tip], axis=1)]),
        begin_mm=np.concatenate([tubes.centre_mm[nodes[:, 0]], tubes.centre_mm[tip]]),
        way_mm=np.concatenate([way, way[last] * (radius / np.maximum(length[last], 1e-12))[:, None]]),
        radii_mm=np.concatenate([radii, np.stack([radius, radius], axis=1)]),
        branch=np.concatenate([branch, branch[last]]),
        along_mm=np.concatenate([begin, end[last]]),
        is_cap=np.repeat([False, True], [len(nodes), len(last)]),
    )


def _repeat_indices(count: Index) -> tuple[Index, Index]:
    """Return the item index and the repetition index of a sequence in which item i is repeated ``count[i]`` times."""
    thing = np.repeat(np.arange(len(count)), count)
    return thing, np.arange(len(thing)) - np.repeat(np.cumsum(count) - count, count)


def _frames(along: Array) -> tuple[Array, Array, Array]:
    """Return the given vectors (S, 3), followed by two unit vectors (S, 3) perpendicular to each of them."""
    unit = polyline.unit_vectors(along)
    other = np.where(np.abs(unit[:, 2:]) < _UPRIGHT, np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    side = np.cross(unit, other)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return along, side, np.cross(unit, side)


@dataclass(frozen=True)
class _Dense:
    """Densely spaced points (P, 3) on all branches, used to find points that lie inside the branches."""

    centre_mm: Array
    radius_mm: Array
    """Radius of the branch at each point, shape (P,), mm."""
    branch: Index
    """Index of the branch of each point, shape (P,)."""
    along_mm: Array
    """Position of each point along its branch, shape (P,), mm."""
    mixed: Mask
    """Whether another branch may overlap at each point, shape (P,). Other points need no further test."""

    tree: cKDTree
    parts: tuple[tuple[Index, cKDTree], ...]
    """Point indices and k-d tree of the points on thick branches, then those of the points on thin branches. The
    maximum radius in each tree limits its search."""

    @staticmethod
    def sample(tubes: Tubes) -> _Dense:
        """Place densely spaced points on all branches."""
        centre, radius, owner, along = _on_branches(tubes)
        tree, thick = cKDTree(centre), radius > _THICK_MM
        reach = 2.0 * min(float(np.quantile(radius, 0.99)) + _DENSE_MM, _THICK_MM)
        mixed = np.zeros(len(centre), bool)
        close = tree.query_pairs(reach, output_type="ndarray")
        close = close[owner[close[:, 0]] != owner[close[:, 1]]]
        mixed[close.ravel()] = True
        if thick.any():
            apart = cKDTree(centre[thick]).sparse_distance_matrix(tree, 2.0 * (float(radius.max()) + _DENSE_MM), output_type="ndarray")
            one, other = np.flatnonzero(thick)[apart["i"]], apart["j"]
            touch = (apart["v"] < radius[one] + radius[other] + 2.0 * _DENSE_MM) & (owner[one] != owner[other])
            mixed[one[touch]] = mixed[other[touch]] = True
        parts = tuple((part, cKDTree(centre[part])) for part in (np.flatnonzero(thick), np.flatnonzero(~thick)) if len(part))
        return _Dense(centre, radius, owner, along, mixed, tree, parts)

    def find_containing(self, point: Array, branch: Index) -> tuple[Index, Index, Array]:
        """Find which of the points (M, 3) lie inside a branch other than their own.

        ``branch`` (M,) is the branch of each point. The result is that of `find_inside`.
        """
        pairs = [np.zeros((2, 0), np.int64)]
        unproven = np.flatnonzero(self.mixed[self.tree.query(point, workers=-1)[1]]) if len(point) else np.zeros(0, np.int64)
        for part, tree in self.parts if len(unproven) else ():
            width = self.radius_mm[part]
            numbers = list(range(1, min(_NEAR, tree.n) + 1))
            distance, near = tree.query(point[unproven], k=numbers, distance_upper_bound=width.max(), workers=-1)
            near = np.minimum(near, tree.n - 1)  # points beyond the bound have infinite distance
            row, column = np.nonzero((distance < width[near]) & (self.branch[part][near] != branch[unproven][:, None]))
            pairs.append(np.stack([unproven[row], part[near[row, column]]]))
        inside, node = np.concatenate(pairs, axis=1)
        return inside, self.branch[node], self.along_mm[node]


def _on_branches(tubes: Tubes) -> tuple[Array, Array, Index, Array]:
    """Place densely spaced points on all branches.

    The result is the coordinates (P, 3) of the points, the radii (P,), the branch indices (P,), and the positions along
    the branch (P,).
    """
    centres, radii, owners, ways = list[Array](), list[Array](), list[Index](), list[Array]()
    for k, nodes in enumerate(tubes.branches):
        line, radius = tubes.centre_mm[nodes], tubes.radii(k)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / _DENSE_MM)) + 1)
        centres.append(np.stack([np.interp(at, along, line[:, axis]) for axis in range(3)], axis=1))
        radii.append(np.interp(at, along, radius))
        owners.append(np.full(len(at), k))
        ways.append(at)
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(owners), np.concatenate(ways)
