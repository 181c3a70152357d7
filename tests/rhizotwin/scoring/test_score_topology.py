"""Measures of the tree on trees made by hand: a main root of 100 mm with three laterals of 30 mm, and one of second order."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from rhizotwin.scoring.score_topology import compare_topology
from tests.roots import straight

lateral = partial(straight, count=121, order=1, parent=0)
MAIN = straight((0, 0, -20), (0, 0, -120), 1.2, count=121)
LATERALS = [lateral((0, 0, z), (30, 0, z)) for z in (-40, -60, -80)]
FINE = straight((15, 0, -60), (15, 20, -60), 0.2, count=121, parent=2, order=2)
TRUE = [MAIN, *LATERALS, FINE]
LENGTH_MM = 100.0 + 3 * 30.0 + 20.0


def moved(root, shift):
    return replace(root, points_mm=root.points_mm + np.asarray(shift, float))


def part(root, first, last, **changes):
    return replace(root, points_mm=root.points_mm[first:last], diameters_mm=root.diameters_mm[first:last], **changes)


def test_an_equal_tree_agrees_in_every_measure():
    score = compare_topology([moved(root, (0, 0, 0.1)) for root in TRUE], TRUE)
    assert (score.matched, score.parents, score.orders, score.order_length, score.main_length) == (1.0, 1.0, 1.0, 1.0, 1.0)
    assert (score.branch_points, score.branch_points_true, score.branch_recall, score.branch_precision) == (4, 4, 1.0, 1.0)
    assert score.identity == pytest.approx(1.0)
    assert (score.ghosts_mm, score.missing_mm, score.doubled_mm) == (0.0, 0.0, 0.0)


def test_a_ghost_counts_by_its_diameter_and_a_copy_as_doubled():
    ghost, copy = lateral((40, 0, -20), (40, 0, -60), 0.3), moved(MAIN, (0.3, 0, 0))
    score = compare_topology([*TRUE, ghost, replace(copy, parent=0, order=1)], TRUE)
    assert score.ghosts_mm == pytest.approx(40.0)
    assert score.ghosts_by_diameter_mm == pytest.approx((0.0, 40.0, 0.0, 0.0, 0.0))
    assert score.doubled_mm == pytest.approx(100.0)
    assert score.missing_mm == 0.0
    assert score.identity == pytest.approx(2 * LENGTH_MM / (2 * LENGTH_MM + 140.0))
    assert score.branch_precision == pytest.approx(4 / 6)
    # beyond 0.5 mm, but inside the true root
    thick = straight((0, 0, -20), (0, 0, -120), 6.0, count=121)
    assert compare_topology([moved(thick, (2, 0, 0))], [thick]).ghosts_mm == 0.0


def test_missing_length_counts_by_its_true_diameter():
    score = compare_topology(TRUE[:-1], TRUE)
    assert score.missing_mm == pytest.approx(20.0, abs=0.6)  # its start lies on the lateral
    assert score.missing_by_diameter_mm[1:] == (0.0, 0.0, 0.0, 0.0)
    assert (score.branch_recall, score.branch_precision) == (0.75, 1.0)


def test_exchanged_continuations_reduce_the_identity_only():
    """Two laterals cross at their middles, and continue as the other one."""
    crossing = [lateral((0, 0, -40), (30, 0, -60)), lateral((0, 0, -60), (30, 0, -40))]
    one, other = crossing
    swapped = [
        replace(one, points_mm=np.concatenate([one.points_mm[:61], other.points_mm[61:]])),
        replace(other, points_mm=np.concatenate([other.points_mm[:61], one.points_mm[61:]])),
    ]
    score = compare_topology([MAIN, *swapped], [MAIN, *crossing])
    assert (score.order_length, score.main_length, score.branch_recall, score.missing_mm) == (1.0, 1.0, 1.0, 0.0)
    both = 2 * float(np.hypot(30.0, 20.0))
    assert score.identity == pytest.approx((100.0 + both / 2) / (100.0 + both), abs=0.01)


def test_a_main_root_that_turns_off_is_wrong_in_its_order():
    """The found main root continues as the last lateral, and the lower part of the true one is a lateral of it."""
    turned = replace(MAIN, points_mm=np.concatenate([MAIN.points_mm[:73], LATERALS[2].points_mm]), diameters_mm=np.full(194, 1.0))
    rest = part(MAIN, 73, 121, parent=0, order=1)
    score = compare_topology([turned, LATERALS[0], LATERALS[1], FINE, rest], TRUE)
    assert score.main_length == pytest.approx(0.6, abs=0.02)
    assert score.order_length == pytest.approx(1.0 - (40.0 + 30.0) / LENGTH_MM, abs=0.02)
    assert score.missing_mm == 0.0


def test_branch_points_match_nearby_on_the_right_parent():
    found = [
        MAIN,
        moved(LATERALS[0], (0, 0, -0.9)),
        moved(LATERALS[1], (0, 0, -1.2)),
        replace(LATERALS[2], parent=1),
        replace(FINE, parent=2),
    ]
    score = compare_topology(found, TRUE)
    # the second lateral is too low, the third one is attached to the first one
    assert (score.branch_points, score.branch_points_true) == (4, 4)
    assert score.branch_recall == score.branch_precision == 0.25


def test_trees_without_branch_points_have_none_to_miss():
    score = compare_topology([MAIN], [MAIN])
    assert (score.branch_points, score.branch_recall, score.branch_precision) == (0, 1.0, 1.0)
    apart = compare_topology([moved(MAIN, (50, 0, 0))], TRUE)
    assert (apart.identity, apart.order_length, apart.main_length, apart.branch_recall) == (0.0, 0.0, 0.0, 0.0)
    assert apart.ghosts_mm == pytest.approx(100.0)
    assert apart.missing_mm == pytest.approx(LENGTH_MM)
