"""Cells, their neighbours and their faces."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.hull import leaves
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.leaves import Grid, Leaves


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


GRID = Grid(np.zeros(3), 1.0, 2, (2, 2, 2))


def cut(seed: int) -> Leaves:
    """Return random leaves: some nodes of 4 whole, others cut into 2 and 1, the finest partly full, some missing."""
    rng, index, size = np.random.default_rng(seed), list[NDArray[np.int64]](), list[int]()
    waiting = [(np.array(at) * 4, 4) for at in np.ndindex(2, 2, 2)]
    while waiting:
        low, edge = waiting.pop()
        chance = rng.random()
        if edge > 1 and chance < 0.5:
            waiting += [(low + np.array(step) * edge // 2, edge // 2) for step in np.ndindex(2, 2, 2)]
        elif chance < 0.8:
            index.append(low)
            size.append(edge)
    full = np.where(np.array(size) > 1, 1.0, rng.random(len(size))).astype(np.float32)
    return Leaves(GRID, np.array(index, np.int32), np.array(size, np.int32), full)


def dense(some: Leaves) -> NDArray[np.float32]:
    """Return how full each finest node (8, 8, 8) is."""
    whole = np.zeros((8, 8, 8), np.float32)
    for (x, y, z), edge, full in zip(some.index, some.size, some.occupancy, strict=True):
        assert not whole[x : x + edge, y : y + edge, z : z + edge].any()
        whole[x : x + edge, y : y + edge, z : z + edge] = full
    return whole


@pytest.mark.parametrize("seed", range(2))
def test_leaves_are_combined_as_their_nodes_are(seed: int) -> None:
    a, b = cut(2 * seed), cut(2 * seed + 1)
    np.testing.assert_array_equal(dense(leaves.unite(a, b)), np.maximum(dense(a), dense(b)))
    np.testing.assert_array_equal(dense(leaves.intersect(a, b)), np.minimum(dense(a), dense(b)))
    np.testing.assert_array_equal(dense(leaves.subtract(a, b)), np.maximum(dense(a) - dense(b), 0.0))
    np.testing.assert_array_equal(a.occupancy_at(np.argwhere(np.ones((8, 8, 8), bool)).astype(np.int32)), dense(a).ravel())
    nothing = a.select(slice(0))
    np.testing.assert_array_equal(dense(leaves.subtract(a, nothing)), dense(a))
    assert len(leaves.subtract(nothing, a).size) == 0
