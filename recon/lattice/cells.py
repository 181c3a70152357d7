"""Sparse sets of cells of a cubic lattice: points near cells, smoothing, shortest paths, and branches of paths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.lattice.compiled import compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Index32 = NDArray[np.int32]
Mask = NDArray[np.bool_]

_IDLE, _QUEUED, _LATER = 0, 1, 2
"""States of a cell in the search for shortest paths: not to be examined, to be examined at the current threshold, or
at a higher one."""


_STEP = np.sqrt(np.arange(4.0))
"""Distance between two cells whose indices differ by one along none, one, two or three axes, in cells."""


class Lattice(NamedTuple):
    """Cells in ascending order of x, y and z, and the range of the cells in each vertical column.

    The bounding rectangle of the columns is enlarged by one empty column on each side.
    """

    low: Index
    """Lowest x and y of the columns, shape (2,)."""
    span: Index
    """Number of columns along x and y, shape (2,)."""
    begin: Index
    """Index of the first cell of each column, followed by the number of cells, shape (span x * span y + 1,)."""
    column: Index32
    """Column of each cell, shape (N,)."""
    height: Index32
    """Vertical index of each cell, shape (N,)."""

    @staticmethod
    def of(index: NDArray[np.integer]) -> Lattice:
        """Create the lattice of distinct cells (N, 3), which must be sorted (`sort`)."""
        low, high = (np.array(end(index[:, :2], axis=0, initial=0), np.int64) for end in (np.min, np.max))
        low, span = low - 1, high - low + 3
        column = (index[:, 0] - low[0]) * span[1] + index[:, 1] - low[1]
        begin = np.searchsorted(column, np.arange(span.prod() + 1))
        return Lattice(low, span, begin, column.astype(np.int32), index[:, 2].astype(np.int32))


def sort(index: NDArray[np.integer]) -> Index:
    """Return the order (N,) in which cells (N, 3) are ascending in x, y and z."""
    low = index.min(axis=0, initial=0).astype(np.int64)
    x, y, z = (index - low).T
    return np.argsort((x * (y.max(initial=0) + 1) + y) * (z.max(initial=0) + 1) + z)


@compiled
def _seek(lattice: Lattice, column: int, height: int) -> tuple[int, int]:
    """Return the first cell of a column that is not below a height, and the cell after the column's last cell."""
    first, end = lattice.begin[column], lattice.begin[column + 1]
    last = end
    while first < last:
        middle = (first + last) // 2
        if lattice.height[middle] < height:
            first = middle + 1
        else:
            last = middle
    return first, end


@compiled
def find_nearest(lattice: Lattice, points: Array, reach: Array) -> tuple[Array, Index]:
    """Find the nearest of the points whose reach contains a cell. Of equally near points, the first one is used.

    Parameters
    ----------
    points : (P, 3) float64 array
        Points in units of cells. The centres of the cells have integer coordinates.
    reach : (P,) float64 array
        Distance below which a cell is in reach of each point, in cells.

    Returns
    -------
    distance : (N,) float64 array
        Distance of the nearest point, in cells. It is infinite for a cell that is in reach of no point.
    point : (N,) int64 array
        Index of this point, or -1.
    """
    square, nearest = np.full(len(lattice.height), np.inf), np.full(len(lattice.height), -1)
    for p in range(len(points)):
        x, y, z = points[p, 0] - lattice.low[0], points[p, 1] - lattice.low[1], points[p, 2]
        for i in range(max(int(np.ceil(x - reach[p])), 0), min(int(x + reach[p]) + 1, lattice.span[0])):
            for j in range(max(int(np.ceil(y - reach[p])), 0), min(int(y + reach[p]) + 1, lattice.span[1])):
                aside = (i - x) ** 2 + (j - y) ** 2
                if aside >= reach[p] ** 2:
                    continue
                rise = np.sqrt(reach[p] ** 2 - aside)
                k, end = _seek(lattice, i * lattice.span[1] + j, int(np.floor(z - rise)))
                while k < end and lattice.height[k] <= z + rise:
                    away = aside + (lattice.height[k] - z) ** 2
                    if away < square[k] and away < reach[p] ** 2:
                        square[k], nearest[k] = away, p
                    k += 1
    return np.sqrt(square), nearest


@compiled
def smooth(lattice: Lattice, values: Array, weights: Array) -> Array:
    """Return the weighted sum (N,) of the values (N,) of each cell and its 26 neighbours.

    Parameters
    ----------
    weights : (4,) float64 array
        Weight of the cell, and of neighbours that share a face, an edge and a corner with it.
    """
    found = np.zeros(len(values))
    for k in range(len(values)):
        for i in range(-1, 2):
            for j in range(-1, 2):
                at, end = _seek(lattice, lattice.column[k] + i * lattice.span[1] + j, lattice.height[k] - 1)
                while at < end and lattice.height[at] <= lattice.height[k] + 1:
                    found[k] += weights[abs(i) + abs(j) + abs(lattice.height[at] - lattice.height[k])] * values[at]
                    at += 1
    return found


class Paths(NamedTuple):
    """Shortest path from the start to each cell."""

    cost: Array
    """Cost of each path, shape (N,). It is infinite for a cell without a path."""
    before: Index32
    """Preceding cell on each path, shape (N,). It is negative at the start and without a path."""
    length: Array
    """Length of each path, shape (N,), in cells."""

    @staticmethod
    def none(count: int) -> Paths:
        """Return the state in which no cell has a path."""
        return Paths(np.full(count, np.inf), np.full(count, -1, np.int32), np.zeros(count))


@compiled
def extend_paths(lattice: Lattice, resistance: Array, starts: Index, paths: Paths) -> None:
    """Extend paths from the given cells, whose costs are known, to all cells that are connected to them.

    A path runs from cell to cell, each of which has 26 neighbours. The threshold algorithm (Glover, Klingman and
    Phillips 1985, Oper. Res. 33:65) examines the cells whose cost is below a threshold until none of them changes, and
    then raises the threshold. The result is written to ``paths``.

    Parameters
    ----------
    resistance : (N,) float64 array
        Cost per unit of length in each cell.
    starts : (S,) int64 array
        Cells from which the paths are extended.
    """
    cost, before, length = paths
    state = np.zeros(len(cost), np.int8)
    queue, first, count = np.zeros(len(cost), np.int32), 0, 0  # cyclic
    later, waiting = np.zeros(len(cost), np.int32), 0
    for k in starts:
        later[waiting], state[k] = k, _LATER
        waiting += 1
    while waiting > 0:
        threshold, kept = _next_threshold(cost, resistance, state, later[:waiting]), 0
        for k in later[:waiting]:
            if state[k] == _LATER and cost[k] > threshold:
                later[kept] = k
                kept += 1
            elif state[k] == _LATER:
                queue[(first + count) % len(queue)], state[k] = k, _QUEUED
                count += 1
        waiting = kept
        while count > 0:
            k = queue[first]
            first, count, state[k] = (first + 1) % len(queue), count - 1, _IDLE
            for i in range(-1, 2):
                for j in range(-1, 2):
                    at, end = _seek(lattice, lattice.column[k] + i * lattice.span[1] + j, lattice.height[k] - 1)
                    while at < end and lattice.height[at] <= lattice.height[k] + 1:
                        step = _STEP[abs(i) + abs(j) + abs(lattice.height[at] - lattice.height[k])]
                        found = cost[k] + 0.5 * step * (resistance[k] + resistance[at])
                        if found < cost[at]:
                            cost[at], before[at], length[at] = found, k, length[k] + step
                            if found <= threshold and state[at] != _QUEUED:
                                queue[(first + count) % len(queue)], state[at] = at, _QUEUED
                                count += 1
                            elif found > threshold and state[at] == _IDLE:
                                later[waiting], state[at] = at, _LATER
                                waiting += 1
                        at += 1


@compiled
def _next_threshold(cost: Array, resistance: Array, state: NDArray[np.int8], later: Index32) -> float:
    """Return the lowest cost of the cells that wait, increased by the cost of crossing this cell."""
    lowest = -1
    for k in later:
        if state[k] == _LATER and (lowest < 0 or cost[k] < cost[lowest]):
            lowest = k
    return cost[lowest] + resistance[lowest]


@compiled
def extract_branches(lattice: Lattice, paths: Paths, tips: Index, claim: Array, least: float) -> tuple[Index, Index]:
    """Extract branches from the tree of shortest paths.

    Parameters
    ----------
    tips : (T,) int64 array
        Cells that can be tips, in the order in which they are examined.
    claim : (N,) float64 array
        Distance from each cell within which a branch through the cell claims other cells, in cells.
    least : float
        Minimum length of a branch within unclaimed cells, in cells.

    Returns
    -------
    cells : (M,) int64 array
        Cells of all branches, one branch after the other, each from a cell of its parent to its tip.
    ends : (B,) int64 array
        Index of the first cell after each branch.
    """
    taken, unclaimed = np.zeros(len(claim), np.bool_), np.zeros(len(claim), np.bool_)
    for tip in tips:
        unclaimed[tip] = True
    cells, ends = np.zeros(2 * len(claim), np.int64), np.zeros(len(tips), np.int64)
    count = branches = 0
    for tip in tips:
        if not unclaimed[tip]:
            continue
        end, fresh, k = count, 0.0, tip
        cells[end] = k
        while paths.before[k] >= 0 and not taken[k]:
            fresh += paths.length[k] - paths.length[paths.before[k]] if unclaimed[k] else 0.0
            k, end = paths.before[k], end + 1
            cells[end] = k
        if fresh < max(least, claim[tip]):
            _claim(lattice, unclaimed, tip, claim[tip])
            continue
        line = cells[count : end + 1]
        for k in range(len(line) // 2):
            line[k], line[-1 - k] = line[-1 - k], line[k]
        last = line[0]
        for k in line:
            taken[k] = True
            # A few spheres cover the path in taproot and hypocotyl, where they are large.
            if k == line[0] or k == tip or paths.length[k] - paths.length[last] > claim[k] / 3.0:
                _claim(lattice, unclaimed, k, claim[k])
                last = k
        count = end + 1
        ends[branches] = count
        branches += 1
    return cells[:count], ends[:branches]


@compiled
def _claim(lattice: Lattice, unclaimed: Mask, cell: int, reach: float) -> None:
    """Claim the cells within a distance of a cell."""
    wide, x, y = int(reach), lattice.column[cell] // lattice.span[1], lattice.column[cell] % lattice.span[1]
    for i in range(max(x - wide, 0), min(x + wide + 1, lattice.span[0])):
        for j in range(max(y - wide, 0), min(y + wide + 1, lattice.span[1])):
            square = reach**2 - (i - x) ** 2 - (j - y) ** 2
            if square >= 0.0:
                high = int(np.sqrt(square))
                k, end = _seek(lattice, i * lattice.span[1] + j, lattice.height[cell] - high)
                while k < end and lattice.height[k] <= lattice.height[cell] + high:
                    unclaimed[k] = False
                    k += 1
