"""Find the voxel centres that lie inside a closed triangle mesh.

Vertical rays through the columns of the grid are intersected with the mesh, and their entries and exits are counted.

A voxel ``i`` (three integers) covers ``origin_mm + voxel_mm * [i, i + 1]``. Each triangle is assigned to the columns
(x, y) whose centre lies in the triangle's projection. The crossings of a column are sorted by height. Each crossing
changes the winding number by the sign of the triangle's normal, and a voxel centre is inside if the winding number is
not zero. Columns that pass exactly through an edge or a vertex are assigned to a single triangle by symbolic
perturbation (Edelsbrunner and Muecke 1990), so that each crossing is counted exactly once.

Time and memory are proportional to the number of crossings and the number of queried voxels, not to the size of the
grid.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SAMPLES = 2
"""Number of points along the edge of a voxel at which a fraction is sampled."""
PAIRS_AT_ONCE = 3_000_000
"""Maximum number of triangle-column pairs in memory at once. A pair needs about 100 bytes."""

NUDGES_VOXEL = ((0.0, 0.0), (1.1e-7, 1.7e-7), (-2.3e-7, 1.3e-7), (3.1e-6, -2.9e-6))
"""Offsets (x, y) of a column, in voxels. If rounding errors cause unequal numbers of entries and exits in a column, the
column is shifted by the next offset and intersected again."""


@dataclass(frozen=True)
class Crossings:
    """Sorted crossings of a closed surface with the grid columns ``x_range[0] <= i_x < x_range[1]``."""

    low: Ints
    """Index (3,) of the lowest voxel of the surface's bounding box."""
    shape: Ints
    """Size (3,) of the bounding box in voxels. It is one larger along z, so that the first voxel centre above the
    topmost crossing has an index."""
    x_range: tuple[int, int]
    """Range of column indices along x (first, last + 1)."""
    keys: Ints
    """Flat indices (M,) of the first voxel centre above each crossing, in ascending order."""
    inside: NDArray[np.bool_]
    """Whether the voxel centres between each crossing and the next one lie inside the surface (M,)."""
    below: Ints
    """Number of voxel centres inside the surface whose flat index is smaller than the index in ``keys`` (M,)."""

    @property
    def count(self) -> int:
        """Number of voxel centres inside the surface."""
        return int(self.below[-1]) if len(self.below) else 0

    def _flat(self, x: Ints, y: Ints, z: Ints) -> Ints:
        return (x * self.shape[1] + y) * self.shape[2] + z

    def count_below(self, flat: Ints) -> Ints:
        """Count the voxel centres inside the surface whose flat index is smaller than ``flat`` (N,)."""
        if not len(self.keys):
            return np.zeros(len(flat), np.int64)
        at = np.searchsorted(self.keys, flat, side="right") - 1
        found = self.below[at] + np.where(self.inside[at], flat - self.keys[at], 0)
        return np.where(at < 0, 0, found)

    def count_in_columns(self, indices_xy: Ints, z_low: Ints, z_high: Ints) -> Ints:
        """Count the voxel centres inside the surface in parts of columns.

        A part consists of the voxels ``z_low <= i_z < z_high`` (N,) in a column (N, 2).
        """
        x, y = indices_xy[:, 0] - self.low[0], indices_xy[:, 1] - self.low[1]
        known = (x >= 0) & (x < self.shape[0]) & (y >= 0) & (y < self.shape[1])
        known &= (indices_xy[:, 0] >= self.x_range[0]) & (indices_xy[:, 0] < self.x_range[1])
        start = np.clip(z_low - self.low[2], 0, self.shape[2] - 1)
        stop = np.clip(z_high - self.low[2], 0, self.shape[2] - 1)
        x, y = np.where(known, x, 0), np.where(known, y, 0)
        return np.where(known, self.count_below(self._flat(x, y, stop)) - self.count_below(self._flat(x, y, start)), 0)


def _concatenated_ranges(lengths: Ints) -> Ints:
    """Return the integers 0, 1, .., n - 1 for each n in ``lengths``, concatenated."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - lengths, lengths)


def _edge_side(p_xy: Floats, a_xy: Floats, b_xy: Floats) -> NDArray[np.int8]:
    """Return +1 if the point p lies on the left of the edge from a to b, and -1 if it lies on the right.

    A point on the edge is treated as if it were moved by (eps, eps^2). The edge is evaluated from its lexicographically
    smaller end, so that both adjacent triangles have exactly opposite results.
    """
    swap = (b_xy[:, 0] < a_xy[:, 0]) | ((b_xy[:, 0] == a_xy[:, 0]) & (b_xy[:, 1] < a_xy[:, 1]))
    first = np.where(swap[:, None], b_xy, a_xy)
    dx, dy = (np.where(swap[:, None], a_xy, b_xy) - first).T
    value = dx * (p_xy[:, 1] - first[:, 1]) - dy * (p_xy[:, 0] - first[:, 0])
    tie = np.where(dy != 0.0, -dy, dx)
    side = np.sign(np.where(value != 0.0, value, tie)).astype(np.int8)
    return np.where(swap, -side, side).astype(np.int8)


def _chunks(cost: Ints) -> Iterator[slice]:
    """Yield consecutive slices of items, each with a total cost of about `PAIRS_AT_ONCE` or less.

    An item with a higher cost has a slice to itself.
    """
    block = (np.cumsum(cost) - 1) // PAIRS_AT_ONCE
    edges = np.concatenate([[0], np.flatnonzero(np.diff(block)) + 1, [len(cost)]])
    for start, stop in pairwise(edges):
        yield slice(int(start), int(stop))


def _find_crossings(
    corners: Floats, low: Ints, shape: Ints, x_range: tuple[int, int], nudge: tuple[float, float]
) -> tuple[Ints, Ints, Ints]:
    """Return the column (M,), the height index (M,) and the sign (M,) of every crossing.

    The corners (F, 3, 3) of the triangles are in units of voxels. Voxel centres have integer coordinates.
    """
    x_low, y_low = (np.ceil(corners[:, :, i].min(axis=1) - nudge[i]).astype(np.int64) for i in (0, 1))
    x_high, y_high = (np.floor(corners[:, :, i].max(axis=1) - nudge[i]).astype(np.int64) + 1 for i in (0, 1))
    x_low, x_high = np.maximum(x_low, x_range[0]), np.minimum(x_high, x_range[1])
    wide, deep = np.maximum(x_high - x_low, 0), np.maximum(y_high - y_low, 0)
    columns: list[Ints] = [np.zeros(0, np.int64)]
    heights: list[Ints] = [np.zeros(0, np.int64)]
    signs: list[Ints] = [np.zeros(0, np.int64)]
    for part in _chunks(wide * deep):
        pairs = wide[part] * deep[part]
        triangle = np.repeat(np.arange(part.start, part.stop), pairs)
        step_x, step_y = np.divmod(_concatenated_ranges(pairs), np.maximum(deep[triangle], 1))
        i_x, i_y = x_low[triangle] + step_x, y_low[triangle] + step_y
        p = np.stack([i_x + nudge[0], i_y + nudge[1]], axis=1)
        a, b, c = (corners[triangle, k] for k in range(3))
        side = _edge_side(p, a[:, :2], b[:, :2])
        hit = (side != 0) & (side == _edge_side(p, b[:, :2], c[:, :2])) & (side == _edge_side(p, c[:, :2], a[:, :2]))
        p, a, b, c, side = p[hit], a[hit], b[hit], c[hit], side[hit]
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = a[:, 2] - (normal[:, 0] * (p[:, 0] - a[:, 0]) + normal[:, 1] * (p[:, 1] - a[:, 1])) / normal[:, 2]
        z_low, z_high = (extreme(np.stack([a[:, 2], b[:, 2], c[:, 2]]), axis=0) for extreme in (np.min, np.max))
        z = np.clip(np.where(np.isfinite(z), z, z_low), z_low, z_high)
        columns.append((i_x[hit] - low[0]) * shape[1] + i_y[hit] - low[1])
        heights.append(np.clip(np.ceil(z).astype(np.int64) - low[2], 0, shape[2] - 1))
        signs.append(side.astype(np.int64))
    return np.concatenate(columns), np.concatenate(heights), np.concatenate(signs)


def _are_balanced(columns: Ints, signs: Ints, size: int) -> NDArray[np.bool_]:
    """Return for each column whether it has as many entries as exits."""
    return np.bincount(columns, weights=signs, minlength=size) == 0.0


def cross_columns(
    vertices_mm: Floats, faces: NDArray[np.integer], *, origin_mm: Floats, voxel_mm: float, x_range: tuple[int, int] | None = None
) -> Crossings:
    """Intersect the columns of a grid with a closed mesh.

    Parameters
    ----------
    vertices_mm, faces : float64 array, integer array
        Vertices (V, 3), mm, and faces (F, 3) of a closed, consistently oriented mesh. Vertices need not be shared.
    origin_mm, voxel_mm : float64 array, float
        Origin (3,), mm, and voxel edge, mm, of the grid. Voxel i covers ``origin_mm + voxel_mm * [i, i + 1]``.
    x_range : tuple of int or None
        Range of the columns, ``x_range[0] <= i_x < x_range[1]``. None: all columns of the mesh.

    Raises
    ------
    ValueError
        If the mesh is not closed.
    """
    if not len(faces):
        raise ValueError(f"{faces.shape=} but a closed mesh must have at least four faces")
    points = (np.asarray(vertices_mm, np.float64) - np.asarray(origin_mm, np.float64)) / voxel_mm - 0.5
    low = np.floor(points.min(axis=0)).astype(np.int64) - 1
    shape = np.ceil(points.max(axis=0)).astype(np.int64) + 2 - low
    reach = (int(low[0]), int(low[0] + shape[0]))
    x_range = reach if x_range is None else (max(reach[0], x_range[0]), min(reach[1], x_range[1]))
    corners = points[faces]
    near = (corners[:, :, 0].max(axis=1) >= x_range[0] - 1) & (corners[:, :, 0].min(axis=1) <= x_range[1])
    corners = corners[near]
    size = int(shape[0] * shape[1])

    columns, heights, signs = _find_crossings(corners, low, shape, x_range, NUDGES_VOXEL[0])
    balanced = _are_balanced(columns, signs, size)
    for nudge in NUDGES_VOXEL[1:]:
        if balanced.all():
            break
        bad = ~balanced
        keep = balanced[columns]
        again = _near_columns(corners, bad, low, shape)
        more = _find_crossings(corners[again], low, shape, x_range, nudge)
        wanted = bad[more[0]]
        columns, heights, signs = (
            np.concatenate([old[keep], new[wanted]]) for old, new in zip((columns, heights, signs), more, strict=True)
        )
        balanced = _are_balanced(columns, signs, size)
    if not balanced.all():
        raise ValueError(
            f"the mesh is not closed: {int((~balanced).sum())} of {size} vertical test lines enter and leave the mesh unequally often"
        )

    keys = columns * shape[2] + heights
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    inside = np.cumsum(signs[order]) != 0
    # crossings with equal keys enclose empty intervals, so that only the state after the last crossing matters
    below = np.concatenate([[0], np.cumsum(np.where(inside[:-1], np.diff(keys), 0))]) if len(keys) else keys
    return Crossings(low=low, shape=shape, x_range=x_range, keys=keys, inside=inside, below=below)


def _near_columns(corners: Floats, bad: NDArray[np.bool_], low: Ints, shape: Ints) -> NDArray[np.bool_]:
    """Return which triangles (F,) may cross an unbalanced column. They are selected by their bounding boxes."""
    table = np.zeros((int(shape[0]) + 1, int(shape[1]) + 1), np.int64)
    table[1:, 1:] = bad.reshape(int(shape[0]), int(shape[1])).cumsum(axis=0).cumsum(axis=1)
    x0, y0 = (np.clip(np.floor(corners[:, :, i].min(axis=1)).astype(np.int64) - 1 - low[i], 0, shape[i]) for i in (0, 1))
    x1, y1 = (np.clip(np.ceil(corners[:, :, i].max(axis=1)).astype(np.int64) + 2 - low[i], 0, shape[i]) for i in (0, 1))
    return (table[x1, y1] - table[x0, y1] - table[x1, y0] + table[x0, y0]) > 0


def _split_columns(vertices_mm: Floats, faces: NDArray[np.integer], origin_mm: Floats, voxel_mm: float) -> list[tuple[int, int]]:
    """Return consecutive ranges of i_x that cover the mesh, with about `PAIRS_AT_ONCE` triangle-column pairs each."""
    points = (vertices_mm - origin_mm) / voxel_mm
    spans = np.ptp(points[faces][:, :, :2], axis=1)
    parts = max(1, int(np.ceil(((spans[:, 0] + 1.0) * (spans[:, 1] + 1.0)).sum() / PAIRS_AT_ONCE)))
    low = int(np.floor(points[:, 0].min())) - 1
    high = int(np.ceil(points[:, 0].max())) + 2
    edges = np.unique(np.linspace(low, high, parts + 1).round().astype(int))
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def count_inside(vertices_mm: Floats, faces: NDArray[np.integer], *, origin_mm: Floats, voxel_mm: float) -> int:
    """Count the voxel centres of an unbounded grid inside a closed mesh.

    Parameters
    ----------
    vertices_mm, faces : (V, 3), (F, 3) array
        Vertices, mm, and faces of a closed mesh.
    origin_mm : (3,) array
        Lowest corner of voxel (0, 0, 0), mm.
    voxel_mm : float
        Edge of a voxel, mm.

    Returns
    -------
    int
        Number of voxel centres.
    """
    slabs = _split_columns(vertices_mm, faces, origin_mm, voxel_mm)
    return sum(cross_columns(vertices_mm, faces, origin_mm=origin_mm, voxel_mm=voxel_mm, x_range=slab).count for slab in slabs)


def count_in_boxes(
    vertices_mm: Floats,
    faces: NDArray[np.integer],
    low: NDArray[np.integer],
    size: NDArray[np.integer],
    *,
    origin_mm: Floats,
    voxel_mm: float,
) -> Ints:
    """Count the voxel centres inside a closed mesh for each of several cubic boxes of voxels.

    Parameters
    ----------
    low, size : (N, 3) and (N,) integer array
        Lowest voxel and edge, in voxels, of each box, in any order.

    Returns
    -------
    numpy.ndarray
        Number of voxel centres in each box (N,), at most ``size``^3.
    """
    found = np.zeros(len(low), np.int64)
    if not len(low):
        return found
    order = np.argsort(low[:, 0], kind="stable")
    i_x = np.asarray(low)[order, 0].astype(np.int64)
    largest = int(size.max())
    for slab in _split_columns(vertices_mm, faces, origin_mm, voxel_mm):
        start, stop = (int(at) for at in np.searchsorted(i_x, [slab[0] - largest + 1, slab[1]]))
        if start == stop:
            continue
        crossings = cross_columns(vertices_mm, faces, origin_mm=origin_mm, voxel_mm=voxel_mm, x_range=slab)
        for at in range(start, stop, PAIRS_AT_ONCE):
            part = order[at : min(at + PAIRS_AT_ONCE, stop)]
            for edge in np.unique(size[part]):
                boxes = part[size[part] == edge]
                corner = np.asarray(low)[boxes].astype(np.int64)
                for shift in np.ndindex(int(edge), int(edge)):
                    found[boxes] += crossings.count_in_columns(corner[:, :2] + shift, corner[:, 2], corner[:, 2] + edge)
    return found


def fraction(
    vertices_mm: Floats,
    faces: NDArray[np.integer],
    low: NDArray[np.integer],
    size: NDArray[np.integer],
    *,
    origin_mm: Floats,
    voxel_mm: float,
) -> NDArray[np.float32]:
    """Compute the fraction of each cubic box of voxels that lies inside a closed mesh.

    The fraction is sampled at `SAMPLES`^3 points per voxel.

    Parameters
    ----------
    vertices_mm, faces : (V, 3), (F, 3) array
        Vertices, mm, and faces of a closed mesh.
    low, size : (N, 3), (N,) int array
        Lowest voxel and edge, in voxels, of each box.
    origin_mm : (3,) array
        Lowest corner of voxel (0, 0, 0), mm.
    voxel_mm : float
        Edge of a voxel, mm.

    Returns
    -------
    numpy.ndarray
        Fraction of each box (N,), 0 to 1.
    """
    fine = np.asarray(size).astype(np.int64) * SAMPLES
    corner = np.asarray(low).astype(np.int64) * SAMPLES
    count = count_in_boxes(vertices_mm, faces, corner, fine, origin_mm=origin_mm, voxel_mm=voxel_mm / SAMPLES)
    return (count / fine.astype(np.float64) ** 3).astype(np.float32)
