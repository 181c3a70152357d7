"""Small trees whose roots were joined wrongly, and what they should be."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from rhizotwin.recon.roots.hierarchy import arrange, find_ambiguous_forks
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root, length_mm
from rhizotwin.scenes.thickened_roots import BURIED_MM, trim_buried
from tests.recon.strings import root

SWOLLEN = root([0, 0, 0], [0, 0, -40], diameters=(12, 12))
TAP = root([0, 0, 0], [0, 0, -40], diameters=(1.5, 1.5))
LATERAL = root([0, 0, -15], [15, 0, -25], order=1, parent=0)


def test_a_right_tree_stays_as_it_is():
    branch = root([7.5, 0, -20], [7.5, 8, -24], diameters=(0.2, 0.2), order=2, parent=1)
    kept = arrange([TAP, LATERAL, branch])
    assert [(one.order, one.parent) for one in kept] == [(0, -1), (1, 0), (2, 1)]
    for name in ("points_mm", "diameters_mm"):
        joined, original = (np.concatenate([getattr(one, name) for one in roots]) for roots in (kept, (TAP, LATERAL, branch)))
        np.testing.assert_array_equal(joined, original)


def test_the_thick_line_is_the_taproot():
    """The taproot was traced on into a lateral, whose tip is hidden; its own end was left over, and its tip is seen."""
    aside, rest = root([0, 0, -20], [10, 0, -26]), root([0, 0, -20], [0, 0, -40], diameters=(1.5, 1.5), order=1, parent=0)
    points, diameters = (np.concatenate([getattr(TAP, name)[:41], getattr(aside, name)[1:]]) for name in ("points_mm", "diameters_mm"))
    traced = [Root(points_mm=points, diameters_mm=diameters, order=0, parent=-1, tip_seen=False), rest]
    tap, lateral = arrange(traced)
    assert (tap.tip_seen, lateral.tip_seen) == (True, False)
    assert lateral.points_mm[-1, 0] == pytest.approx(10.0)
    assert tap.points_mm[-1] == pytest.approx([0.0, 0.0, -40.0])
    assert tap.diameters_mm.min() == 1.5
    assert lateral.diameters_mm.max() == 0.3
    assert (lateral.order, lateral.parent) == (1, 0)
    assert length_mm([tap, lateral]) == pytest.approx(length_mm(traced))


@pytest.mark.parametrize(("nodal", "ambiguous"), [(1.8, 1), (0.7, 0)])
def test_at_its_base_a_main_root_is_vertical(nodal: float, ambiguous: int) -> None:
    """A nodal root that leaves the wide stem beside the primary root is thicker, but oblique: the choice may be a tie."""
    stem = root([0, 0, 0], [0, 0, -1], diameters=(5, 5))
    oblique = root([0, 0, -1], [20, 0, -21], diameters=(nodal, nodal), order=1, parent=0)
    primary = root([0, 0, -1], [0, 0, -41], diameters=(1.2, 1.2), order=1, parent=0)
    found = arrange([stem, oblique, primary])
    assert found[0].points_mm[-1] == pytest.approx([0.0, 0.0, -41.0])
    assert len(find_ambiguous_forks(found)) == ambiguous


@pytest.mark.parametrize(("diameter", "ambiguous"), [(0.8, 1), (0.6, 0)])
def test_roots_of_a_crown_may_be_the_main_root(diameter: float, ambiguous: int) -> None:
    """Three roots leave a stem of 4 mm beside the main root of 1 mm: the largest may be the main root, if it is as thick."""
    main = root([0, 0, 0], [0, 0, -40], diameters=(1, 1))
    main = replace(main, diameters_mm=np.where(main.points_mm[:, 2] > -3.0, 4.0, main.diameters_mm))
    beside = [root([0, 0, -2 - k], [20, 5 * k, -20], diameters=(diameter, diameter), order=1, parent=0) for k in range(3)]
    below = root([0, 0, -30], [20, 0, -40], diameters=(diameter, diameter), order=1, parent=0)
    forks = find_ambiguous_forks(arrange([main, *beside, below]))
    assert [fork.length_mm for fork in forks] == pytest.approx([length_mm(beside[2:])] * ambiguous)


def test_a_taproot_that_tapers_ends_at_its_own_tip():
    """Behind the fork it is thicker than the lateral over 5 mm, and thinner over all that is left."""
    tap = root([0, 0, 0], [0, 0, -80], diameters=(1.5, 0.1))
    lateral = root([0, 0, -15], [15, 0, -25], diameters=(0.9, 0.9), order=1, parent=0)
    assert arrange([tap, lateral])[0].points_mm[-1] == pytest.approx([0.0, 0.0, -80.0])


def test_no_root_is_lost_that_leaves_from_the_base_of_a_lateral():
    """The main root goes on in a thick lateral; what hangs on its lateral is nearest to that one's base, which both have in common."""
    main = root([0, 0, 0], [0, 0, -40])
    thick = root([0, 0, -15], [15, 0, -15], diameters=(2.4, 2.4), order=1, parent=0)
    round_it = root([4, 0, -15], [4, 4, -15], [-2.5, 4, -15], [-2.5, -4, -15], order=2, parent=1)
    last = root([-2.5, 0, -15], [-9, 0, -18], order=3, parent=2)
    traced = [main, thick, round_it, last]
    assert sorted(tuple(root.points_mm[-1]) for root in arrange(traced)) == sorted(tuple(root.points_mm[-1]) for root in traced)


def test_a_lateral_in_the_basal_zone_is_the_grandparents():
    beside = root([0.8, 0, -15.5], [6, 9, -24], diameters=(0.25, 0.25), order=2, parent=1)
    further = root([0.9, 0.2, -15.7], [3, -9, -24], diameters=(0.2, 0.2), order=3, parent=2)
    assert [(one.order, one.parent) for one in arrange([TAP, LATERAL, beside, further])] == [(0, -1), (1, 0), (1, 0), (1, 0)]


def test_a_line_bent_into_a_lateral_is_left_for_the_axis():
    """As fitted in a print: the line of the main root turns into a lateral of similar width, and its rest begins beside it."""
    main = root([0, 0, 0], [0, 0, -26], [0.8, 1.6, -30], [2.4, 4.8, -33], [8, 24, -54], diameters=(5.0, 3.5))
    rest = root([0.8, 1.6, -30], [0, -0.3, -33], [0, -1, -60], diameters=(4.4, 3.0), order=1, parent=0)
    axis, lateral = arrange([main, rest])
    assert axis.points_mm[-1] == pytest.approx([0.0, -1.0, -60.0])
    assert (lateral.order, lateral.parent) == (1, 0)
    assert lateral.points_mm[-1] == pytest.approx([8.0, 24.0, -54.0])


@pytest.mark.parametrize(
    ("turn_mm", "diameter", "before", "orders"),
    [(3.0, 0.3, 1.25, [0, 1, 1]), (3.0, 0.12, 1.25, [0, 1, 2]), (14.0, 0.3, 1.0, [0, 1, 2]), (3.0, 0.2, 1.0, [0, 1, 2])],
)
def test_two_roots_that_ran_along_each_other_are_siblings(turn_mm: float, diameter: float, before: float, orders: list[int]):
    """A lateral is thinner than its parent, leaves at a large angle, or the parent is as thick before as beyond it."""
    other = root([7.5, 0, -20], [16.5, turn_mm, -26], order=2, parent=1, diameters=(diameter, diameter))
    thicker = np.where(np.arange(len(LATERAL.points_mm)) < len(LATERAL.points_mm) // 2, before, 1.0)
    parent = replace(LATERAL, diameters_mm=LATERAL.diameters_mm * thicker)
    assert [one.order for one in arrange([TAP, parent, other])] == orders


def test_a_bulb_ends_where_only_thin_roots_go_on():
    thin = root([0, 0, -20], [9, 0, -40], diameters=(0.7, 0.7))
    points, diameters = (np.concatenate([getattr(SWOLLEN, name)[:41], getattr(thin, name)[1:]]) for name in ("points_mm", "diameters_mm"))
    second = root([0, 0, -20], [-9, 0, -40], diameters=(0.8, 0.8), order=1, parent=0)
    bulb, *roots = arrange([Root(points_mm=points, diameters_mm=diameters, order=0, parent=-1), second])
    assert bulb.points_mm[-1] == pytest.approx([0.0, 0.0, -20.0])
    assert [one.order for one in roots] == [1, 1]


LEVEL = root([0, 0, -20], [30, 0, -20], diameters=(0.6, 0.6), order=1, parent=0)


def test_a_lateral_of_a_storage_root_begins_near_its_skin() -> None:
    second = root([1.5, 0, -20], [1.5, 30, -20], diameters=(0.5, 0.5), order=1, parent=1)
    _, found, of_lateral = trim_buried([SWOLLEN, LEVEL, second])
    assert found.points_mm[0] == pytest.approx([6.0 - BURIED_MM, 0.0, -20.0], abs=0.05)
    assert found.points_mm[-1] == pytest.approx([30.0, 0.0, -20.0])
    assert polyline.length_mm(found.points_mm) == pytest.approx(25.0, abs=0.05)
    assert len(found.diameters_mm) == len(found.points_mm)
    assert np.hypot(*of_lateral.points_mm[0, :2]) == pytest.approx(6.0 - BURIED_MM, abs=0.05), "laterals of laterals too"
    assert of_lateral.parent == 1


@pytest.mark.parametrize(
    ("parent", "lateral"),
    [
        (root([0, 0, 0], [0, 0, -40], diameters=(1.9, 1.9)), LEVEL),
        (SWOLLEN, root([0, 0, -20], [30, 0, -20], diameters=(4, 4), order=1, parent=0)),
        (SWOLLEN, root([0, 0, -20], [3, 0, -20], diameters=(0.6, 0.6), order=1, parent=0)),
    ],
    ids=["a thin parent", "a thick lateral", "a root that never comes out"],
)
def test_where_nothing_has_swollen_laterals_begin_on_the_axis(parent: Root, lateral: Root) -> None:
    assert trim_buried([parent, lateral]) == (parent, lateral)


@pytest.mark.parametrize(
    ("first", "end", "tips"), [(40, 40, [True]), (15, 25, [False, True]), (15, 40, [False])], ids=["no solid", "through a solid", "into it"]
)
def test_a_root_that_enters_a_solid_has_no_tip_there(first: int, end: int, tips: list[bool]) -> None:
    nodes = np.arange(40)
    solid = (nodes >= first) & (nodes < end)
    tubes = Tubes(np.outer(-10.0 - 0.6 * nodes, [0.0, 0.0, 1.0]), np.full(40, 0.4), (nodes,))
    tree = SimpleNamespace(tubes=tubes, solid=solid, uncertain=np.zeros(40, bool), nodule=np.zeros(40, bool))
    found = [root.tip_seen for root in RootSystem.roots(cast(RootSystem, tree))]
    assert json.dumps(found) == json.dumps(tips)  # NumPy's values cannot be written as JSON


def test_a_fork_of_equal_branches_is_ambiguous():
    """Both branches leave the stem at 25 degrees with its diameter: the shorter one is 12 mm long and bears one of 4 mm."""
    stem = root([0, 0, 0], [0, 0, -20])
    tangent = np.tan(np.deg2rad(25.0))
    branches = [root([0, 0, -20], [sign * way * tangent, 0, -20 - way], order=1, parent=0) for sign, way in ((1, 30.0), (-1, 11.0))]
    x, y, z = branches[1].points_mm[-1]
    twig = root([x, y, z], [x, y + 4.0, z], diameters=(0.2, 0.2), order=2, parent=2)
    (fork,) = find_ambiguous_forks(arrange([stem, *branches, twig]))
    assert fork.point_mm == pytest.approx([0.0, 0.0, -20.0])
    assert fork.length_mm == pytest.approx(11.0 / np.cos(np.deg2rad(25.0)) + 4.0)
    assert find_ambiguous_forks(arrange([TAP, LATERAL])) == []
