"""Compiled loops over cells, against short references."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from rhizotwin.recon.lattice import cells
from rhizotwin.recon.lattice.cells import Lattice, Paths


def blobs(seed: int, shape: tuple[int, int, int] = (14, 15, 24)) -> np.ndarray:
    """Return the sorted cells of several connected parts, some of them single cells."""
    smooth = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.3)
    index = np.argwhere(smooth > np.quantile(smooth, 0.75)) - (3, 40, -7)
    return index[cells.sort(index)].astype(np.int32)


def test_cells_are_sorted() -> None:
    index = np.random.default_rng(1).permutation(blobs(1))
    np.testing.assert_array_equal(cells.sort(index), np.lexsort(index.T[::-1]))
    assert len(cells.sort(index[:0])) == 0


@pytest.mark.parametrize("seed", range(3))
def test_shortest_paths_and_their_lengths(seed: int) -> None:
    """The resistance spans four orders of magnitude, as from the axis of a thick root to empty cells."""
    rng, index = np.random.default_rng(seed), blobs(seed)
    resistance = 10.0 ** rng.uniform(-3.0, 1.0, len(index))
    near = cKDTree(index).query_pairs(1.8, output_type="ndarray")
    way = np.linalg.norm(index[near[:, 0]] - index[near[:, 1]], axis=1)
    graph = coo_matrix((0.5 * way * resistance[near].sum(axis=1), near.T), shape=(len(index),) * 2).tocsr()
    starts = rng.choice(len(index), 3, replace=False)
    cost, before, _ = dijkstra(graph, directed=False, indices=starts, min_only=True, return_predecessors=True)
    paths = Paths.none(len(index))
    paths.cost[starts] = 0.0
    cells.extend_paths(Lattice.of(index), resistance, starts, paths)
    assert 0.1 < np.isfinite(cost).mean() < 1.0
    np.testing.assert_allclose(paths.cost, cost, rtol=1e-12)
    np.testing.assert_array_equal(paths.before, np.maximum(before, -1))
    some = before >= 0
    steps = np.linalg.norm(index[some] - index[before[some]], axis=1)
    np.testing.assert_allclose(paths.length[some] - paths.length[before[some]], steps)
    assert (paths.length[starts] == 0.0).all()


@pytest.mark.parametrize("seed", range(3))
def test_nearest_point_in_reach(seed: int) -> None:
    rng, index = np.random.default_rng(seed), blobs(seed)
    points, reach = rng.uniform(index.min(axis=0) - 2.0, index.max(axis=0) + 2.0, (60, 3)), rng.uniform(0.3, 4.0, 60)
    away = np.linalg.norm(index[:, None] - points, axis=2)
    away[away >= reach] = np.inf
    distance, nearest = cells.find_nearest(Lattice.of(index), points, reach)
    np.testing.assert_allclose(distance, away.min(axis=1))
    np.testing.assert_array_equal(nearest, np.where(np.isfinite(away.min(axis=1)), away.argmin(axis=1), -1))


def test_smoothing_weighs_the_cells_around() -> None:
    index = blobs(4)
    values = np.random.default_rng(4).random(len(index))
    volume = np.zeros(np.ptp(index, axis=0) + 1)
    volume[tuple((index - index.min(axis=0)).T)] = values
    for axis in range(3):
        volume = ndimage.convolve1d(volume, np.array([0.3, 1.0, 0.3]) / 1.6, axis=axis, mode="constant")
    weights = 0.3 ** np.arange(4.0) / 1.6**3
    np.testing.assert_allclose(cells.smooth(Lattice.of(index), values, weights), volume[tuple((index - index.min(axis=0)).T)])


def test_branches_end_where_they_meet_the_first_one() -> None:
    """A trunk of 30 cells with a twig of 9, a spur that is too short, and a row beside the trunk that the trunk claims."""
    trunk, twig = [(0, 0, z) for z in range(30)], [(x, 0, 12) for x in range(1, 10)]
    index = np.array(trunk + twig + [(0, 1, z) for z in range(20, 24)] + [(-1, 0, 5), (-2, 0, 5)], np.int32)
    index = index[cells.sort(index)]
    lattice, paths = Lattice.of(index), Paths.none(len(index))
    start = np.flatnonzero((index == 0).all(axis=1))
    paths.cost[start] = 0.0
    cells.extend_paths(lattice, np.where((index[:, 0] == 0) & (index[:, 1] == 0), 0.1, 1.0), start, paths)
    tips = np.argsort(-paths.length, kind="stable")
    flat, ends = cells.extract_branches(lattice, paths, tips, np.full(len(index), 1.5), 3.0)
    first, second = np.split(flat, ends)[:-1]
    assert [tuple(cell) for cell in index[first]] == trunk
    assert [tuple(cell) for cell in index[second]] == [(0, 0, 12), *twig]
