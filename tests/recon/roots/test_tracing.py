"""Density, tracing, and what tubes leave unexplained."""

import numpy as np
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.roots import residue, tracing
from rhizotwin.recon.roots.density import Cells, estimate
from rhizotwin.recon.scoring import score_roots
from rhizotwin.recon.tubes import tube_picture, tubes
from rhizotwin.scenes.rsml import Root
from tests.recon.strings import TRUNK, TWIG, cameras, pictured, strung


def nothing(grid: Grid) -> Cells:
    return Cells(grid, np.zeros((0, 3), np.int32), np.zeros(0, np.float32))


def test_density_and_tracing_find_thin_roots():
    """Two roots, less than a pixel wide, from their coverage alone."""
    true = strung(TRUNK, TWIG, radius_mm=0.2)
    seen = pictured(true)
    grid = Grid(np.array([-4.0, -4.0, -54.0]), 0.4, 2, (10, 5, 24))
    index = np.stack(np.meshgrid(np.arange(36), np.arange(20), np.arange(10, 90), indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    cells, _ = estimate(seen, Cells(grid, index, np.zeros(len(index), np.float32)), nothing(grid))
    assert len(cells.index) < 0.3 * len(index)
    paths = tracing.trace(cells, np.full(len(cells.index), -1.0))
    found = [Root(points_mm=path.points_mm, diameters_mm=np.ones(len(path.points_mm)), order=0, parent=-1) for path in paths]
    truth = [Root(points_mm=path, diameters_mm=np.ones(len(path)), order=0, parent=-1) for path in (TRUNK, TWIG)]
    score = score_roots.compare_roots(found, truth)
    assert min(score.recall, score.precision) > 0.95
    assert (score.tip_recall, score.tips) == (1.0, 2)


def test_a_plants_top_is_its_stem_though_a_lateral_reaches_higher():
    """The stem ends 1.5 mm below a lateral's tip; one that reaches 0.5 mm higher changes nothing, nor does one that no stem belongs to."""
    height = np.arange(-30.0, -10.0, 0.25)
    plant = np.arange(len(height))
    for rise_mm, top_mm in ((1.5, -11.75), (0.5, -10.25), (8.0, -10.25)):
        deep = np.where(height <= -10.25 - rise_mm, 0.3, -1.0)
        highest = tracing._top(plant, height, deep)
        assert height[highest].max() == top_mm
        assert height[highest].min() == top_mm - 0.75


def test_core_depth_is_signed():
    grid = Grid(np.zeros(3), 0.5, 0, (20, 20, 20))
    core = np.stack(np.meshgrid(*[np.arange(5, 10)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    cells = Cells(grid, np.array([[7, 7, 7], [5, 7, 7], [4, 7, 7], [19, 19, 19]], np.int32), np.zeros(4, np.float32))
    np.testing.assert_allclose(tracing.core_depth(cells, core, reach_mm=1.2), [1.5, 0.5, -0.5, -1.2])


def test_what_tubes_leave_unexplained_is_hung_on_them():
    true = strung(TRUNK, TWIG, radius_mm=0.2)
    seen = pictured(true)
    found = tubes.Tubes(true.centre_mm[true.branches[0]], true.radius_mm[true.branches[0]], (true.branches[0],))
    grid = Grid(np.array([-4.0, -4.0, -54.0]), 0.4, 2, (10, 5, 24))
    at = np.stack(np.meshgrid(np.arange(36), np.arange(20), np.arange(10, 90), indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    index = at[cKDTree(np.concatenate([TRUNK, TWIG])).query(grid.origin_mm + (at + 0.5) * 0.4)[0] < 0.5]
    depth = tube_picture.optical_depth(seen, found, seen.project(found.centre_mm), 0.0)
    none = np.zeros(len(found.radius_mm), bool)
    grown = residue.grow(seen, found, none, Cells(grid, index, np.zeros(len(index), np.float32)), depth, 4.0)
    assert len(grown.branches) == 2
    assert np.linalg.norm(grown.centre_mm[grown.branches[1][-1]] - TWIG[-1]) < 0.8
    assert grown.branches[1][0] in found.branches[0]


def test_nothing_seen_gives_no_density():
    bank, (width, height) = cameras()
    blank = Silhouette(np.zeros((height, width), np.float32), np.ones((height, width), bool))
    seen = Evidence.of(bank, [blank] * bank.count)
    grid = Grid(np.array([-4.0, -4.0, -54.0]), 0.4, 2, (10, 5, 24))
    cells = Cells(grid, np.array([[10, 10, 50]], np.int32), np.zeros(1, np.float32))
    shadow = estimate(seen, cells, nothing(grid))[0].shadow_mm2
    assert not len(shadow) or shadow.max() < 1e-2
