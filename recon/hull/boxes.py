"""One number for each cell of a box, so that cells are compared, joined and looked up as numbers are."""

from __future__ import annotations

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
