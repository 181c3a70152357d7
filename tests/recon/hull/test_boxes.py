"""Cells, their neighbours and their faces."""

import numpy as np

from rhizotwin.recon.hull.boxes import CellSet


def test_scattered_cells_know_their_neighbours() -> None:
    rng = np.random.default_rng(1)
    index = rng.permutation(np.unique(rng.integers(-5, 4, (300, 3)), axis=0)).astype(np.int32)
    cells = CellSet.from_cells(index)
    away = index[:, None] - index
    joined = np.zeros((len(index), len(index)), int)
    for step, here, there in cells.neighbours():
        np.testing.assert_array_equal(index[there] - index[here], np.broadcast_to(step, (len(here), 3)))
        joined[here, there] += 1
        joined[there, here] += 1
    np.testing.assert_array_equal(joined, (np.abs(away).max(axis=2) == 1).astype(int))
    together = joined + np.eye(len(index), dtype=int) > 0
    for _ in range(9):
        together = together @ together
    part = cells.components()
    np.testing.assert_array_equal(part[:, None] == part, together)
    asked = np.stack(np.meshgrid(*[np.arange(-9, 9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    np.testing.assert_array_equal(cells.contains(asked), (asked[:, None] == index).all(axis=2).any(axis=1))


def test_faces_lie_between_cells_and_empty_ones() -> None:
    index = np.argwhere(np.random.default_rng(2).random((6, 7, 8)) < 0.9)
    full = np.zeros((8, 9, 10), bool)
    full[tuple((index + 1).T)] = True
    around = np.stack([np.roll(full, shift, axis) for axis in range(3) for shift in (-1, 1)])
    rim, beyond = CellSet.from_cells(index).faces()
    np.testing.assert_array_equal(np.sort(rim), np.flatnonzero(~around.all(axis=0)[tuple((index + 1).T)]))
    np.testing.assert_array_equal(beyond, np.argwhere(~full & around.any(axis=0)) - 1)
