"""One number for each cell of a box, so that cells are compared, joined and looked up as numbers are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Whole = NDArray[np.integer]


@dataclass(frozen=True)
class Box:
    """A box of cells."""

    low: NDArray[np.int64]
    """(3,) its first cell."""
    span: NDArray[np.int64]
    """(3,) cells along x, y, z."""

    @staticmethod
    def around(index: Whole) -> Box:
        """Return the least box that holds cells (N, 3); one cell where there are none."""
        if not len(index):
            return Box(np.zeros(3, np.int64), np.ones(3, np.int64))
        low = index.min(axis=0).astype(np.int64)
        return Box(low, index.max(axis=0).astype(np.int64) - low + 1)

    @property
    def step(self) -> NDArray[np.int64]:
        """By how much (3,) a cell's number grows along x, y, z."""
        return np.array([self.span[1] * self.span[2], self.span[2], 1], np.int64)

    def number(self, index: Whole) -> NDArray[np.int64]:
        """Return the numbers (N,) of cells (N, 3)."""
        return np.asarray((index.astype(np.int64) - self.low) @ self.step)

    def cell(self, number: Whole) -> NDArray[np.int64]:
        """Return the cells (N, 3) of numbers (N,)."""
        x, rest = np.divmod(number, self.step[0])
        y, z = np.divmod(rest, self.step[1])
        return np.stack([x, y, z], axis=1) + self.low


@dataclass(frozen=True)
class Scattered:
    """Cells that are found by where they lie: memory goes with their count, not with the box about them."""

    box: Box
    """About the cells, with a layer of empty ones."""
    number: NDArray[np.int64]
    """(N,) of the cells in the box, rising."""
    order: NDArray[np.int64]
    """(N,) which of the cells each is."""

    @staticmethod
    def of(index: Whole) -> Scattered:
        """Sort cells (N, 3), none of them twice."""
        least = Box.around(index)
        box = Box(least.low - 1, least.span + 2)
        number = box.number(index)
        order = np.argsort(number)
        return Scattered(box, number[order], order)

    def holds(self, index: Whole) -> NDArray[np.bool_]:
        """Tell which cells (M, 3) are among them."""
        inside = np.asarray(((index >= self.box.low) & (index < self.box.low + self.box.span)).all(axis=1))
        inside[inside] = self.lists(self.box.number(index[inside]))
        return inside

    def lists(self, number: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which numbers (M,) in the box are those of cells."""
        return np.asarray(self.number[self._place(number)] == number) if len(self.number) else np.zeros(len(number), bool)

    def neighbours(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
        """Yield each of 13 steps (3,) to a neighbour, with the cells (M,) that have one there, and these (M,).

        The 13 opposite steps lead back.
        """
        for step in (np.array(s) - 1 for s in np.ndindex(3, 3, 3) if s > (1, 1, 1)):
            wanted = self.number + int(step @ self.box.step)
            place = self._place(wanted)
            some = np.flatnonzero(self.number[place] == wanted) if len(wanted) else place
            yield step, self.order[some], self.order[place[some]]

    def _place(self, number: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.minimum(np.searchsorted(self.number, number), len(self.number) - 1)
