"""Sets of lattice cells. Each cell is encoded as an integer for fast comparison, look-up and connectivity analysis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Whole = NDArray[np.integer]


@dataclass(frozen=True)
class Box:
    """Axis-aligned box of cells on an integer lattice."""

    low: NDArray[np.int64]
    """Lowest cell index along x, y and z, shape (3,)."""
    span: NDArray[np.int64]
    """Number of cells along x, y and z, shape (3,)."""

    @staticmethod
    def around(index: Whole) -> Box:
        """Return the smallest box that contains the cells (N, 3), or a box of a single cell if N is 0."""
        if not len(index):
            return Box(np.zeros(3, np.int64), np.ones(3, np.int64))
        low, high = (np.array([end(axis) for axis in index.T], np.int64) for end in (np.min, np.max))
        return Box(low, high - low + 1)

    @property
    def step(self) -> NDArray[np.int64]:
        """Increment of the cell number from a cell to its neighbour along x, y and z, shape (3,)."""
        return np.array([self.span[1] * self.span[2], self.span[2], 1], np.int64)

    def number(self, index: Whole) -> NDArray[np.int64]:
        """Encode cell indices (N, 3) as cell numbers (N,)."""
        x, y, z = index.T  # an integer matrix product takes five times as long
        return np.asarray(x * self.step[0] + y * self.step[1] + (z - self.low @ self.step))

    def cell(self, number: Whole) -> NDArray[np.int64]:
        """Decode cell numbers (N,) to cell indices (N, 3)."""
        x, rest = np.divmod(number, self.step[0])
        y, z = np.divmod(rest, self.step[1])
        return np.stack([x, y, z], axis=1) + self.low


@dataclass(frozen=True)
class CellSet:
    """Sparse set of cells with fast look-up by position.

    The memory required is proportional to the number of cells.
    """

    box: Box
    """Bounding box of the cells, enlarged by one layer of empty cells on each side."""
    number: NDArray[np.int64]
    """Numbers of the cells within `box`, shape (N,), in ascending order."""
    order: NDArray[np.int64]
    """Position of each sorted cell in the original array of cells, shape (N,)."""

    @staticmethod
    def from_cells(index: Whole) -> CellSet:
        """Create a set from distinct cell indices (N, 3)."""
        least = Box.around(index)
        box = Box(least.low - 1, least.span + 2)
        number = box.number(index)
        order = np.argsort(number)
        return CellSet(box, number[order], order)

    def contains(self, index: Whole) -> NDArray[np.bool_]:
        """Return the mask (M,) of cells (M, 3) that are in the set."""
        inside = np.ones(len(index), bool)
        for axis, low, span in zip(index.T, self.box.low, self.box.span, strict=True):
            inside &= (axis >= low) & (axis < low + span)
        inside[inside] = self.contains_numbers(self.box.number(index[inside]))
        return inside

    def find(self, index: Whole) -> NDArray[np.int64]:
        """Return the position (M,) of each cell (M, 3) in the original array of cells, or -1 if the set lacks it."""
        found, inside = np.full(len(index), -1), self.contains(index)
        found[inside] = self.order[self._place(self.box.number(index[inside]))]
        return found

    def contains_numbers(self, number: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return the mask (M,) of cell numbers (M,) that are in the set. All cells must lie in `box`."""
        return np.asarray(self.number[self._place(number)] == number) if len(self.number) else np.zeros(len(number), bool)

    def neighbours(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
        """Yield pairs of neighbouring cells for 13 of the 26 neighbour directions.

        For each direction, the offset (3,), the indices (M,) of the first cells and the indices (M,) of the second
        cells are yielded. The other 13 directions are the reverse of these.
        """
        place = np.arange(len(self.number))
        for step in (np.array(s) - 1 for s in np.ndindex(3, 3, 3) if s > (1, 1, 1)):
            wanted = self.number + int(step @ self.box.step)
            # This step is one cell further along z than the previous step: same index in `number`, or the next.
            onward = np.minimum(place + (self.number[place] == wanted - 1), len(self.number) - 1)
            place = self._place(wanted) if step[2] < 0 else onward
            some = np.flatnonzero(self.number[place] == wanted)
            yield step, self.order[some], self.order[place[some]]

    def components(self) -> NDArray[np.int64]:
        """Label the connected components of the set. Return the label (N,) of each cell.

        Each cell is connected with its 26 neighbours. Consecutive cells along z are first merged into rows. Two rows
        are connected if the first cell of either has a neighbour in the other row.
        """
        first = np.append(True, np.diff(self.number) > 1)[: len(self.number)]
        row, begin = np.cumsum(first) - 1, self.number[first]
        here, there = list[NDArray[np.int64]](), list[NDArray[np.int64]]()
        for step in (np.array(s) - 1 for s in np.ndindex(3, 3, 3) if s[:2] != (1, 1)):
            wanted = begin + int(step @ self.box.step)
            place = self._place(wanted)
            some = np.flatnonzero(self.number[place] == wanted)
            here.append(some)
            there.append(row[place[some]])
        ends = np.concatenate(here), np.concatenate(there)
        joined = coo_matrix((np.ones(len(ends[0]), bool), ends), shape=(len(begin),) * 2)
        found = np.empty(len(self.number), np.int64)
        found[self.order] = connected_components(joined, directed=False)[1][row]
        return found

    def faces(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the indices (M,) of cells on the surface, and the empty cells (K, 3) next to them.

        A cell is on the surface if at least one of the six cells that share a face with it is empty.
        """
        beside = [self.number + step for step in (*self.box.step, *-self.box.step)]
        empty = [~self.contains_numbers(number) for number in beside]
        beyond = np.unique(np.concatenate([number[some] for number, some in zip(beside, empty, strict=True)]))
        return self.order[np.any(empty, axis=0)], self.box.cell(beyond)

    def _place(self, number: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.minimum(np.searchsorted(self.number, number), len(self.number) - 1)
