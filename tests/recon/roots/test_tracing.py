"""Shadows of cells, density, tracing, and what tubes leave unexplained."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.roots import residual_search, tracing
from rhizotwin.recon.roots.density import Cells, estimate
from rhizotwin.recon.roots.footprints import Footprints
from rhizotwin.recon.tubes import tube_picture
from rhizotwin.scenes.rsml import Root
from rhizotwin.scoring import score_roots
from tests.recon.hull.exact_pictures import ring_of
from tests.recon.strings import TRUNK, TWIG, blank_of, nothing, pictured, strung

GRID = Grid(np.array([-4.0, -4.0, -54.0]), 0.4, 2, (10, 5, 24))
INDEX = (np.argwhere(np.ones((36, 20, 80), bool)) + np.array([0, 0, 10])).astype(np.int32)
NOTHING = Cells(GRID, np.zeros((0, 3), np.int32), np.zeros(0, np.float32))


def cells(index: np.ndarray) -> Cells:
    return Cells(GRID, index, np.zeros(len(index), np.float32))


def compared(found: Cells, *true: np.ndarray) -> score_roots.RootScore:
    """Return the score of what is traced in a density, against true centre lines."""
    paths = [path.points_mm for path in tracing.trace(found, np.full(len(found.index), -1.0))]
    lines = ([Root(points_mm=points, diameters_mm=np.ones(len(points)), order=0, parent=-1) for points in roots] for roots in (paths, true))
    return score_roots.compare_roots(*lines)


def test_density_and_tracing_find_thin_roots():
    """Two roots, less than a pixel wide, from their coverage alone."""
    found, _ = estimate(pictured(strung(TRUNK, TWIG)), cells(INDEX), NOTHING)
    assert len(found.index) < 0.3 * len(INDEX)
    score = compared(found, TRUNK, TWIG)
    assert min(score.recall, score.precision) > 0.95
    assert (score.tip_recall, score.tips) == (1.0, 2)


def test_roots_that_meet_behind_the_net_pot_are_traced():
    beside, far = np.add(TRUNK[:200], (2.4, 0.0, -0.4)), np.add(TRUNK[:200], (8.8, 0.0, 0.0))
    index = np.unique(np.floor((np.concatenate([TRUNK, beside, far]) - GRID.origin_mm) / 0.4).astype(np.int32), axis=0)
    found = Cells(GRID, index, np.full(len(index), 0.2, np.float32))
    assert len(tracing.trace(found, np.full(len(index), -1.0))) == 2  # not the one that is far from it
    score = compared(found, TRUNK, beside)
    assert min(score.recall, score.precision) > 0.9
    artificial, *others = tracing.trace(replace(found, tops_mm=((0.0, 0.0, 10.0),)), np.full(len(index), -1.0))
    assert (artificial.points_mm[:, 2] == 10.0).all()
    assert len(others) == 3
    assert sum(bool(line.points_mm[0, 2] == 10.0) for line in others) == 2  # the trunk and the root far from it


@pytest.mark.parametrize(("views", "found"), [(12, True), (5, False)])
def test_what_most_views_show_unexplained_is_hung_on_tubes(views: int, found: bool):
    """Five of twelve views show a ghost, with the mean coverage of a root that is half as wide."""
    true, bare = strung(TRUNK, TWIG, radius_mm=0.3), strung(TRUNK, radius_mm=0.3)
    shown = [*pictured(true).silhouettes[:views], *pictured(bare).silhouettes[views:]]
    seen = Evidence.from_silhouettes(nothing().bank, shown, nothing().window)
    near = cKDTree(np.concatenate([TRUNK, TWIG])).query(GRID.origin_mm + (INDEX + 0.5) * 0.4)[0] < 0.5
    passing = tube_picture.transmittance(seen, bare, seen.project(bare.centre_mm))
    grown = residual_search.add_missing_roots(seen, bare, np.zeros(len(bare.radius_mm), bool), cells(INDEX[near]), passing, 4.0)
    assert (len(grown.branches) > 1) == found
    if found:
        assert np.linalg.norm(grown.centre_mm[grown.branches[1][-1]] - TWIG[-1]) < 0.8
        assert grown.branches[1][0] in bare.branches[0]


VIEWS, WIDTH, HEIGHT = 5, 200, 150


def test_shadows_fall_where_the_cells_are() -> None:
    """The second picture says nothing in its left half."""
    empty, told = blank_of(ring_of(VIEWS, (WIDTH, HEIGHT))), np.ones((VIEWS, HEIGHT, WIDTH), bool)
    told[1, :, : WIDTH // 2] = False
    seen = Evidence.from_silhouettes(empty.bank, [Silhouette(np.zeros((HEIGHT, WIDTH), np.float32), part) for part in told])
    rng = np.random.default_rng(6)
    points_mm, amount = rng.uniform((-8.0, -8.0, -50.0), (8.0, 8.0, -30.0), (300, 3)), rng.random(300)
    at, view = seen.project(points_mm), np.arange(VIEWS)[:, None]
    nearest, low = np.floor(at.px + 0.5).astype(int), np.floor(at.px).astype(int)
    shown = at.visible & told[view, nearest[..., 1], nearest[..., 0]]
    area, f = np.where(shown, np.linalg.norm(np.cross(at.du, at.dv), axis=-1), 0.0), at.px - low
    expected = np.zeros((VIEWS, HEIGHT, WIDTH))
    for i, j in np.ndindex(2, 2):
        share = np.abs(1 - i - f[..., 0]) * np.abs(1 - j - f[..., 1])
        np.add.at(expected, (view, low[..., 1] + j, low[..., 0] + i), share * area * amount)
    footprints, views = Footprints.project(seen, points_mm), range(1, 4)
    found = footprints.shadows(views, amount.astype(np.float32))
    np.testing.assert_allclose(found, expected[views.start : views.stop], atol=0.02 * expected.max())


def test_values_are_averaged_over_the_views_that_show_a_cell() -> None:
    """The product of all values is too small for a number."""
    views, rng = 90, np.random.default_rng(8)
    empty, told = blank_of(ring_of(views, (60, 50))), rng.random((views, 50, 60)) < 0.8
    seen = Evidence.from_silhouettes(empty.bank, [Silhouette(np.zeros((50, 60), np.float32), part) for part in told])
    points_mm = rng.uniform((-8.0, -8.0, -50.0), (8.0, 8.0, -30.0), (200, 3))
    pictures = np.exp(rng.uniform(-14.5, -12.0, told.shape)).astype(np.float32)
    at, view = seen.project(points_mm), np.arange(views)[:, None]
    nearest, low = np.floor(at.px + 0.5).astype(int), np.floor(at.px).astype(int)
    shown, f, value = at.visible & told[view, nearest[..., 1], nearest[..., 0]], at.px - low, np.zeros(at.shape)
    for i, j in np.ndindex(2, 2):
        value += np.abs(1 - i - f[..., 0]) * np.abs(1 - j - f[..., 1]) * pictures[view, low[..., 1] + j, low[..., 0] + i]
    logs = np.where(shown, np.log(np.clip(value, 1e-6, 4e-6)), 0.0)
    parts = [(range(80), pictures[:80]), (range(80, views), pictures[80:])]
    found = Footprints.project(seen, points_mm).mean_log(parts, 1e-6, 4e-6)
    np.testing.assert_allclose(found, logs.sum(axis=0) / np.maximum(shown.sum(axis=0), 1), atol=2e-3)
