"""Tubes: strings of nodes, their volume, the pictures they cast, and how a fit finds them again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from recon.coverage.evidence import Evidence
from recon.coverage.silhouettes import Silhouette
from recon.hull.carve import Grid
from recon.roots import residue, rooting, tracing
from recon.roots.density import Cells, estimate
from recon.scoring import score_roots
from recon.tubes import tube_fit, tube_picture, tubes
from recon.tubes.tube_law import TubeLaw
from recon.uncertainty import tube_doubt
from scenes.rsml import Root
from tests.recon.lines import line
from tests.recon.strings import TRUNK, TWIG, cameras, pictured, strung


def nothing(grid: Grid) -> Cells:
    return Cells(grid, np.zeros((0, 3), np.int32), np.zeros(0, np.float32))


def test_a_straight_string_keeps_length_and_ends():
    system = strung(TRUNK, TWIG)
    assert system.length_mm == pytest.approx(30.0 + 15.0, abs=0.3)
    np.testing.assert_allclose(system.centre_mm[system.branches[0][[0, -1]]], TRUNK[[0, -1]], atol=1e-9)
    assert system.owner[system.branches[1][0]] == 0


def test_cutting_keeps_what_bears_a_branch():
    system = strung(TRUNK, TWIG)
    gone = np.ones(len(system.radius_mm), bool)
    gone[system.branches[1][5]] = False
    cut = system.keep(system.staying(gone))
    assert [len(branch) for branch in cut.branches] == [np.flatnonzero(system.branches[0] == system.branches[1][0])[0] + 1, 6]
    np.testing.assert_allclose(cut.centre_mm[cut.branches[1]], system.centre_mm[system.branches[1][:6]])


def test_the_first_branch_keeps_a_segment_where_only_its_first_node_bears_a_branch():
    system = tubes.Tubes(
        np.array([[0.0, 0.0, -10.0 - 0.6 * k] for k in range(5)] + [[0.6 * k, 0.0, -10.0] for k in range(1, 5)]),
        np.full(9, 0.2),
        (np.arange(5), np.array([0, 5, 6, 7, 8])),
    )
    cut = system.keep(system.staying(system.owner == 0))
    assert [len(branch) for branch in cut.branches] == [2, 5]


def test_a_lateral_is_drawn_as_thick_as_it_is_from_its_parents_axis_on():
    """Its first segment reaches from the axis of a thick parent to beyond the skin: no cone of the parent's width."""
    thick = strung(TRUNK, radius_mm=0.7)
    at = int(np.argmin(np.abs(thick.centre_mm[:, 2] + 30.0)))
    way = thick.centre_mm[at] + np.array([[1.4, 0.0, 0.0], [2.0, 0.0, 0.0], [2.6, 0.0, 0.0], [3.2, 0.0, 0.0]])
    count = len(thick.centre_mm)
    both = tubes.Tubes(
        np.concatenate([thick.centre_mm, way]),
        np.concatenate([thick.radius_mm, np.full(4, 0.15)]),
        (*thick.branches, np.array([at, count, count + 1, count + 2, count + 3])),
    )
    alone = tubes.Tubes(np.concatenate([thick.centre_mm[at : at + 1], way]), np.full(5, 0.15), (np.arange(5),))
    begin, end = both.segment_radii
    np.testing.assert_array_equal(begin[-4:], 0.15)
    np.testing.assert_array_equal(end, both.radius_mm[both.segments[:, 1]])
    parent, lateral, drawn = (np.array(pictured(system).coverage) for system in (thick, alone, both))
    np.testing.assert_allclose(drawn, 1.0 - (1.0 - parent) * (1.0 - lateral), atol=1e-3)


def test_coverage_of_a_thin_tube_is_its_projected_area():
    system = strung(TRUNK, radius_mm=0.1)
    seen = pictured(system)
    at = seen.project(system.centre_mm)
    way = np.linalg.norm(np.diff(at.px, axis=1), axis=-1)
    width = 0.2 * np.linalg.norm(at.du, axis=-1)  # the trunk hangs upright
    area = (way * 0.5 * (width[:, 1:] + width[:, :-1]) * (at.seen[:, 1:] & at.seen[:, :-1])).sum()
    assert np.array(seen.coverage).sum() == pytest.approx(area, rel=0.02)


def test_fit_finds_moved_and_swollen_tubes_again():
    true = strung(TRUNK, TWIG, radius_mm=0.25)
    seen = pictured(true)
    rng = np.random.default_rng(3)
    wave = 0.15 * np.sin(np.arange(len(true.radius_mm)) / 4.0)[:, None] * rng.normal(size=3)
    start = tubes.moved(true, true.centre_mm + wave, np.full(len(true.radius_mm), 0.15))
    fitted, pull = tube_fit.fit(seen, start, np.zeros(len(true.radius_mm), bool), blur_px=0.0, steps=15)
    inner = slice(3, -3)
    for branch in true.branches:
        off = fitted.centre_mm[branch][inner] - true.centre_mm[branch][inner]
        along = true.tangents[branch][inner]
        across = np.linalg.norm(off - (off * along).sum(1, keepdims=True) * along, axis=1)
        assert np.median(across) < 0.03
    assert np.median(fitted.radius_mm) == pytest.approx(0.25, rel=0.03)
    assert np.median(pull.visible) > 0.8


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


def test_radii_of_tubes_that_share_pixels_do_not_swing():
    """Two roots that run through each other, begun too thin: whole steps swung by an eighth of their area."""
    true = strung(*(line((x, y, -20.0), (-x, -y, -40.0)) for x, y in ((0.2, 0.3), (0.3, -0.3))), radius_mm=0.25)
    seen, fixed = pictured(true), np.zeros(len(true.radius_mm), bool)
    found, areas = tubes.moved(true, true.centre_mm, 0.85 * true.radius_mm), []
    for _ in range(9):
        found, _ = tube_fit.fit(seen, found, fixed, blur_px=0.0, steps=1)
        areas.append(np.square(found.radius_mm / 0.25).mean())
    assert np.abs(np.diff(areas[4:])).max() < 0.03
    assert abs(np.mean(areas[-2:]) - 1.0) < 0.03


def test_a_branch_is_strung_to_the_nearest_that_came_before_it():
    """Seventeen later branches begin nearer to the point than the trunk does; only the trunk came before."""
    start = np.array([2.0, 0.0, -30.0])
    later = [np.stack([start, start + np.array([3.0 * np.cos(a), 3.0 * np.sin(a), -1.0])]) for a in np.linspace(0.0, 3.0, 17)]
    system = strung(TRUNK, line(tuple(start), (5.0, 0.0, -33.0)), *[np.concatenate([part[:1], part]) for part in later])
    nearest = np.argsort(np.linalg.norm(system.centre_mm - start, axis=1))
    assert (system.owner[nearest[:17]] > 0).all()
    first = system.branches[1][0]
    assert system.owner[first] == 0
    np.testing.assert_allclose(system.centre_mm[first], (0.0, 0.0, -30.0), atol=0.31)


def test_touching_roots_share_their_width_evenly():
    """Two roots side by side, one begun too fat and the other too thin by turns, come out as thick as they are."""
    true = strung(TRUNK, TRUNK + np.array([0.5, 0.0, 0.0]), radius_mm=0.25)
    seen, fixed = pictured(true), np.zeros(len(true.radius_mm), bool)
    wave = 0.08 * np.sin(np.arange(len(true.radius_mm)) / 3.0)
    wave[true.owner == 1] *= -1.0
    fitted, _ = tube_fit.fit(seen, tubes.moved(true, true.centre_mm, true.radius_mm + wave), fixed, blur_px=0.0, steps=8)
    below = true.centre_mm[:, 2] < TRUNK[0, 2] - 2.0  # the other's way to the trunk covers the trunk's first nodes twice
    assert np.abs(fitted.radius_mm[below] / 0.25 - 1.0).max() < 0.05


def test_what_a_tube_covers_in_vain_counts_in_full_and_what_it_lacks_little():
    """Two roots of other widths than their tubes: too wide is wrong for certain, what is not covered may be another root."""
    narrow, wide = strung(TRUNK, radius_mm=0.3), strung(TRUNK, radius_mm=0.6)

    def pulled(true: tubes.Tubes, drawn: tubes.Tubes) -> np.ndarray:
        seen = pictured(true)
        at = seen.project(drawn.centre_mm)
        depth = tube_picture.optical_depth(seen, drawn, at, 0.0)
        return tube_picture.pull(seen, drawn, at, depth, tube_picture.unexplained(seen, depth), 0.0).gradient[5:-5, 3]

    inward, outward = pulled(narrow, wide), pulled(wide, narrow)
    assert inward.max() < 0.0 < outward.min()
    assert -inward.mean() > 4.0 * outward.mean()


def test_score_of_equal_and_of_shifted_roots():
    root = Root(points_mm=TRUNK, diameters_mm=np.full(len(TRUNK), 0.4), order=0, parent=-1)
    same = score_roots.compare_roots([root], [root])
    assert (same.length_error, same.recall, same.precision, same.tip_recall) == (0.0, 1.0, 1.0, 1.0)
    half = Root(points_mm=TRUNK[:151] + np.array([0.1, 0.0, 0.0]), diameters_mm=np.full(151, 0.5), order=0, parent=-1)
    score = score_roots.compare_roots([half], [root])
    assert score.length_error == pytest.approx(-0.5, abs=0.01)
    assert score.recall == pytest.approx(0.5, abs=0.03)
    assert score.precision == 1.0
    assert score.radius_error_median == pytest.approx(0.25)
    assert score.tip_recall == 0.0
    unseen = score_roots.compare_roots([root, replace(half, tip_seen=False)], [root])
    assert (unseen.tips, unseen.tip_precision) == (1, 1.0)
    assert unseen.length_error == pytest.approx(0.5, abs=0.01)
    none = score_roots.compare_roots([replace(root, tip_seen=False)], [root])
    assert (none.tips, none.tip_precision, none.tip_recall) == (0, 0.0, 0.0)


def test_nothing_seen_gives_no_density():
    bank, (width, height) = cameras()
    blank = Silhouette(np.zeros((height, width), np.float32), np.ones((height, width), bool))
    seen = Evidence.of(bank, [blank] * bank.count)
    grid = Grid(np.array([-4.0, -4.0, -54.0]), 0.4, 2, (10, 5, 24))
    cells = Cells(grid, np.array([[10, 10, 50]], np.int32), np.zeros(1, np.float32))
    shadow = estimate(seen, cells, nothing(grid))[0].shadow_mm2
    assert not len(shadow) or shadow.max() < 1e-2


def _system(found: tubes.Tubes, px_a_mm: float) -> rooting.RootSystem:
    no_nodes = np.zeros(len(found.radius_mm), bool)
    return rooting.RootSystem(found, no_nodes, np.zeros((0, 3)), 0.6, px_a_mm, TubeLaw.opaque(0.0), pictured(found), no_nodes)


def test_doubt_about_true_tubes_is_small_and_a_missing_twig_is_missed() -> None:
    true = strung(TRUNK, TWIG, radius_mm=0.25)
    seen = pictured(true)
    px_a_mm = float(np.median(np.linalg.norm(seen.project(true.centre_mm).du, axis=-1)))
    volume = np.pi * 0.25**2 * true.length_mm
    whole = {term.name: term for term in tube_doubt.doubt(seen, _system(true, px_a_mm)).terms}
    assert max(max(term.less_mm3, term.more_mm3) for term in whole.values()) < 0.05 * volume
    assert whole["missing roots"].more_mm3 < 0.002 * volume
    trunk = strung(TRUNK, radius_mm=0.25)
    lacking = tube_doubt.doubt(seen, _system(trunk, px_a_mm))
    missing = next(term for term in lacking.terms if term.name == "missing roots")
    twig = np.pi * 0.25**2 * 15.0
    assert 0.6 * twig < missing.more_mm3 < 1.4 * twig
    assert missing.less_mm3 == 0.0
    assert 0.2 < lacking.unexplained < 0.4  # a third of the length, aslant and partly beside the trunk


def test_swollen_tubes_are_pulled_back() -> None:
    true = strung(TRUNK, radius_mm=0.25)
    seen = pictured(true)
    swollen = tubes.moved(true, true.centre_mm, 1.1 * true.radius_mm)
    terms = {term.name: term for term in tube_doubt.doubt(seen, _system(swollen, 4.0)).terms}
    volume = np.pi * 0.275**2 * true.length_mm
    assert 0.1 * volume < terms["radii, pull"].less_mm3 < 0.3 * volume
    assert terms["radii, pull"].more_mm3 == 0.0
    assert terms["area"].less_mm3 > 0.1 * volume


def test_two_touching_roots_taken_for_one_look_flat() -> None:
    """Drawn as one round root of the same mean width, they have 1.34 times their volume, of which the term allows for most."""
    beside = TRUNK + np.array([1.2, 0.0, 0.0])
    seen = pictured(strung(TRUNK, beside, radius_mm=0.6))
    px_a_mm = float(np.median(np.linalg.norm(seen.project(TRUNK[::50]).du, axis=-1)))
    one = strung(0.5 * (TRUNK + beside), radius_mm=0.6 * (1.0 + 2.0 / np.pi))
    volume = float(np.pi * one.radius_mm[0] ** 2 * one.length_mm)
    flat = {term.name: term for term in tube_doubt.doubt(seen, _system(one, px_a_mm)).terms}["flat roots"]
    assert 0.15 * volume < flat.less_mm3 < 0.27 * volume
    assert flat.more_mm3 == 0.0
    single = strung(TRUNK, radius_mm=0.3)
    assert {term.name: term for term in tube_doubt.doubt(pictured(single), _system(single, px_a_mm)).terms}["flat roots"].less_mm3 == 0.0
