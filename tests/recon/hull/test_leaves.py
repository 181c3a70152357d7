"""Leaves of several sizes, against whole arrays."""

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull import leaves
from rhizotwin.recon.hull.leaves import Grid, Leaves

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


def test_leaves_are_united_and_intersected_as_their_nodes_are() -> None:
    for seed in range(5):
        a, b = cut(2 * seed), cut(2 * seed + 1)
        np.testing.assert_array_equal(dense(leaves.unite(a, b)), np.maximum(dense(a), dense(b)))
        np.testing.assert_array_equal(dense(leaves.intersect(a, b)), np.minimum(dense(a), dense(b)))


def test_the_difference_of_leaves_is_that_of_their_nodes() -> None:
    for seed in range(5):
        a, b = cut(2 * seed), cut(2 * seed + 1)
        np.testing.assert_array_equal(dense(leaves.subtract(a, b)), np.maximum(dense(a) - dense(b), 0.0))
        nodes = np.argwhere(np.ones((8, 8, 8), bool)).astype(np.int32)
        np.testing.assert_array_equal(a.occupancy_at(nodes), dense(a).ravel())
    nothing = cut(0).select(slice(0))
    np.testing.assert_array_equal(dense(leaves.subtract(cut(0), nothing)), dense(cut(0)))
    assert len(leaves.subtract(nothing, cut(0)).size) == 0
