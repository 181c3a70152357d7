"""What is told from roots: tubes that lie in others, and ends that are none."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.roots import ghosts, node_support, rooting, tips
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.scenes.monitor import Monitor
from tests.recon.strings import TRUNK, TWIG, at_rest, line, pictured, strung


@pytest.mark.parametrize(
    ("branch", "shown", "share", "expected"),
    [(7, 0.05, 0.3, True), (7, 0.5, 0.3, False), (3, 0.05, 0.02, False), (3, 0.05, 0.9, True)],
    ids=["near and hidden", "it shows", "hidden but free, leaves no more than others", "hidden and free, leaves much"],
)
def test_hidden_ends_near_others_are_uncertain(branch: int, shown: float, share: float, expected: bool):
    angle = np.arange(6) * 2.0 * np.pi / 6.0
    laterals = [line((0.0, 0.0, -24.0 - 4.0 * k), (4.0 * np.cos(a), 4.0 * np.sin(a), -27.0 - 4.0 * k)) for k, a in enumerate(angle)]
    beside = line((0.0, 0.0, -44.0), (0.4, 0.0, -46.0))  # its tip is 0.2 mm from the trunk's surface, those of the others far
    system = strung(TRUNK, *laterals, beside)
    own = system.owner == branch
    visible, left = np.where(own, shown, 0.5), np.where(own, share, 0.02)
    judged = ghosts.find_uncertain_ends(system, visible, node_support.Support(1.0 - left, left, left), np.zeros(len(own), bool))
    np.testing.assert_array_equal(judged, own & expected)


@pytest.mark.parametrize(
    ("radius_mm", "end", "roots"),
    [(0.3, 2.0, 2), (1.0, 2.0, 1), (0.4, 0.6, 2), (1.0, 8.0, 2)],
    ids=["a short lateral", "a nodule", "a stub as thick as the root", "a tuber"],
)
def test_a_nodule_is_no_root(radius_mm: float, end: float, roots: int):
    found = strung(TRUNK, line((0.0, 0.0, -30.0), (end, 0.0, -30.5)), radius_mm=0.3)
    found = tubes.with_geometry(found, found.centre_mm, np.where(found.owner == 1, radius_mm, 0.3))
    nodule = ghosts.find_nodules(found)
    np.testing.assert_array_equal(nodule, (found.owner == 1) & (roots == 1))
    system = replace(at_rest(found, px_a_mm=3.2), nodule=nodule)
    assert (len(system.roots()), len(system.nodules())) == (roots, 2 - roots)


def test_a_second_tube_and_a_detour_beside_one_explain_little():
    def hanging(x: float, *on: tuple[float, float, float]) -> np.ndarray:
        return line((0.0, 0.0, -26.0), (x, 0.0, -28.0), (x, 0.0, -48.0), *on)

    seen = pictured(strung(TRUNK, hanging(0.7), line((0.1, 0.0, -48.0), (12.0, 0.0, -52.0)), radius_mm=0.3))
    found = strung(TRUNK, hanging(0.7), hanging(0.1), hanging(-0.1, (12.0, 0.0, -52.0)), radius_mm=0.3)
    beside = found.centre_mm[:, 0] < 0.3
    found = tubes.with_geometry(found, found.centre_mm, np.where((found.owner >= 2) & beside, 0.1, 0.3))
    support = node_support.compute_support(Rendering.draw(seen, found))
    unproven = ghosts.find_unsupported_starts(found, support, np.zeros(len(found.radius_mm), bool))
    np.testing.assert_array_equal(unproven[found.owner < 3], found.owner[found.owner < 3] == 2)
    detour, last = unproven[found.own(3)], found.cut_detours(unproven)
    assert 34 <= detour.sum() <= 48  # 24 mm of it, and what follows until it shows more
    assert not detour[48:].any()
    assert last.owner[last.branches[3][0]] == 1
    assert last.centre_mm[last.branches[3][0], 2] == pytest.approx(-48.0, abs=1.5)


@pytest.mark.parametrize(
    ("radius_mm", "x", "end", "enclosed"),
    [(0.2, 1.4, 1.4, True), (0.9, 1.4, 1.4, False), (0.2, 1.7, 1.7, False), (0.2, 1.4, 9.0, False)],
    ids=["inside a thick root", "not much thinner", "touching it", "it leaves"],
)
def test_a_thin_branch_inside_a_thick_root_is_its_outline(radius_mm: float, x: float, end: float, *, enclosed: bool):
    found = strung(TRUNK, line((0.0, 0.0, -26.0), (x, 0.0, -27.0), (end, 0.0, -46.0)))
    found = tubes.with_geometry(found, found.centre_mm, np.where(found.owner == 0, 1.5, radius_mm))
    np.testing.assert_array_equal(ghosts.find_enclosed(found, 0.1), (found.owner == 1) & enclosed)


@pytest.mark.parametrize(
    ("radius_mm", "corner", "end", "folded_mm"),
    [
        (1.0, (0.5, 0.0, -50.0), (0.5, 0.0, -48.0), 2.0),
        (1.0, (0.0, 0.0, -50.0), (2.2, 0.0, -50.0), 2.2),
        (0.2, (0.5, 0.0, -50.0), (0.5, 0.0, -48.0), 0.0),
        (1.0, (0.0, 0.0, -50.0), (1.2, 0.0, -52.0), 0.0),
        (1.0, (0.0, 0.0, -50.0), (12.0, 0.0, -50.0), 0.0),
    ],
    ids=["turns back", "winds around the end", "too thin to be resolved", "slight bend", "another root"],
)
def test_an_end_that_turns_back_into_its_root_is_folded(
    radius_mm: float, corner: tuple[float, float, float], end: tuple[float, float, float], folded_mm: float
):
    found = strung(line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0), corner, end), radius_mm=radius_mm)
    folded = ghosts.find_folded(found)
    np.testing.assert_array_equal(np.sort(folded), folded)  # the last nodes
    assert folded.sum() * tubes.SPACING_MM == pytest.approx(folded_mm, abs=2.0 * tubes.SPACING_MM)
    assert folded.any() == (folded_mm > 0.0)


@pytest.mark.parametrize(("radius_mm", "away_mm", "is_root"), [(1.0, 0.8, False), (4.0, 20.0, True)], ids=["line", "root of a bulb"])
def test_a_thin_line_that_returns_is_no_root(radius_mm: float, away_mm: float, *, is_root: bool) -> None:
    found = strung(line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0), (away_mm, 0.0, -50.0), (away_mm, 0.0, -25.0)))
    beyond = found.centre_mm[:, 0] > 0.3
    found = tubes.with_geometry(found, found.centre_mm, np.where(beyond, 0.1, radius_mm))
    folded = ghosts.find_folded(found)
    assert folded[found.centre_mm[:, 0] > 0.5 * away_mm].all() != is_root
    assert not folded[found.centre_mm[:, 0] < 0.1].any()


def test_a_root_that_bends_inside_a_bulb_is_not_folded() -> None:
    """At the end of a bulb, its path was thin already, and stayed inside for five of its own diameters: a root of 100 mm was lost."""
    found = strung(line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0), (30.0, 0.0, -50.0)))
    bulb, inside = found.centre_mm[:, 2] > -46.0, found.centre_mm[:, 0] < 0.3
    found = tubes.with_geometry(found, found.centre_mm, np.where(bulb, 7.0, np.where(inside, 0.8, 0.4)))
    assert not ghosts.find_folded(found).any()


@pytest.mark.parametrize(("tail_mm", "base_mm", "ghost"), [(0.02, 1.5, True), (0.1, 1.5, False), (0.02, 0.05, False)])
def test_the_invisible_rest_of_a_thick_root_is_a_ghost(tail_mm: float, base_mm: float, *, ghost: bool):
    """A root that narrows and stays visible, and one that is as thin everywhere, are kept."""
    found = strung(TRUNK)
    tail = found.centre_mm[:, 2] < -40.0
    found = tubes.with_geometry(found, found.centre_mm, np.where(tail, tail_mm, base_mm))
    shown = node_support.Support(*[np.full(len(tail), value) for value in (9.0, 0.0, 9.0)])
    np.testing.assert_array_equal(ghosts.find_ghosts(found, shown, np.zeros(len(tail), bool), 4.0), tail & ghost)


def test_a_branch_that_is_mostly_invisible_is_a_ghost() -> None:
    """Nothing leads to its visible end, such as a spot that no tube explains."""
    found = strung(TRUNK)
    end = found.centre_mm[:, 2] < -46.0
    found = tubes.with_geometry(found, found.centre_mm, np.where(end, 0.3, 0.02))
    shown = node_support.Support(*[np.full(len(end), value) for value in (9.0, 0.0, 9.0)])
    assert ghosts.find_ghosts(found, shown, np.zeros(len(end), bool), 4.0).all()


def test_a_branch_that_no_picture_shows_is_removed_in_the_end() -> None:
    """After the fit, the branch is as thin as tubes can be; without its removal, its length would still count."""
    false = line((0.0, 0.0, -25.0), (-8.0, 4.0, -30.0), (-10.0, 6.0, -45.0))
    true, found = strung(TRUNK, TWIG), strung(TRUNK, TWIG, false)
    tree = at_rest(found, px_a_mm=3.2, seen=pictured(true, noise=0.003))
    system = rooting.finish_tree(tree, monitor=Monitor())
    assert len(system.tubes.branches) == 2
    assert system.tubes.length_mm == pytest.approx(true.length_mm, rel=0.01)
    assert len(system.solid) == len(system.uncertain) == len(system.tubes.radius_mm)
    assert np.median(system.tubes.radius_mm) == pytest.approx(0.2, rel=0.05)


SHORT = line((0.0, 0.0, -20.0), (0.0, 0.0, -40.0))
SIDEWAYS = line((0.0, 0.0, -28.0), (12.0, 3.0, -34.0))
PX_A_MM = 2.6
"""Sideways in the middle of the pictures; up and down the water does not magnify, there it is 1.7."""


def off(found: tubes.Tubes, true: tubes.Tubes) -> np.ndarray:
    """Return how far found tips lie beyond the true ones along the roots."""
    last = [nodes[-1] for nodes in true.branches]
    return np.asarray(((found.centre_mm[last] - true.centre_mm[last]) * true.tangents[last]).sum(axis=1))


def with_tips_moved(true: tubes.Tubes, by_mm: float) -> tubes.Tubes:
    centre = true.centre_mm.copy()
    for nodes in true.ends:
        centre[nodes] = tips._stretch(centre[nodes], by_mm)
    moved = tubes.with_geometry(true, centre, true.radius_mm)
    np.testing.assert_allclose(off(moved, true), by_mm, atol=1e-6)
    return moved


@pytest.mark.parametrize(("radius_mm", "by_mm"), [(0.15, 0.8), (0.4, 0.0), (1.2, -0.8)])
def test_tips_that_are_off_come_back(radius_mm: float, by_mm: float) -> None:
    true = strung(SHORT, SIDEWAYS, radius_mm=radius_mm)
    found = tips.place_tips(pictured(true), with_tips_moved(true, by_mm), PX_A_MM)
    assert np.abs(off(found, true)).max() < (0.29 if by_mm else 1e-3)  # half of a pixel up and down
    bears = true.branches[1][0]
    np.testing.assert_array_equal(found.centre_mm[: bears + 1], true.centre_mm[: bears + 1])  # laterals stay where they leave
