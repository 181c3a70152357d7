"""Small trees whose roots were joined wrongly, and what they should be."""

import numpy as np
import pytest

from rhizotwin.recon.roots.hierarchy import arrange
from rhizotwin.scenes.rsml import Root, length_mm
from tests.recon.strings import root

TAP = root([0, 0, 0], [0, 0, -40], diameters=(1.5, 1.5))
LATERAL = root([0, 0, -15], [15, 0, -25], order=1, parent=0)


def test_a_right_tree_stays_as_it_is():
    branch = root([7.5, 0, -20], [7.5, 8, -24], diameters=(0.2, 0.2), order=2, parent=1)
    kept = arrange([TAP, LATERAL, branch])
    assert [(one.order, one.parent) for one in kept] == [(0, -1), (1, 0), (2, 1)]
    for one, original in zip(kept, (TAP, LATERAL, branch), strict=True):
        np.testing.assert_array_equal(one.points_mm, original.points_mm)
        np.testing.assert_array_equal(one.diameters_mm, original.diameters_mm)


def bent_aside(*, tip_seen: bool = True) -> list[Root]:
    """Return a taproot that was traced on into a lateral, and what is left of it."""
    aside = root([0, 0, -20], [10, 0, -26])
    wrong = Root(
        points_mm=np.concatenate([TAP.points_mm[:41], aside.points_mm[1:]]),
        diameters_mm=np.concatenate([TAP.diameters_mm[:41], aside.diameters_mm[1:]]),
        order=0,
        parent=-1,
        tip_seen=tip_seen,
    )
    return [wrong, root([0, 0, -20], [0, 0, -40], diameters=(1.5, 1.5), order=1, parent=0)]


def test_the_thick_line_is_the_taproot():
    traced = bent_aside()
    tap, lateral = arrange(traced)
    assert tap.points_mm[-1] == pytest.approx([0.0, 0.0, -40.0])
    assert tap.diameters_mm.min() == 1.5
    assert lateral.diameters_mm.max() == 0.3
    assert (lateral.order, lateral.parent) == (1, 0)
    assert length_mm([tap, lateral]) == pytest.approx(length_mm(traced))


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


def test_a_tip_is_seen_where_its_line_ends_though_the_line_began_as_another():
    found = arrange(bent_aside(tip_seen=False))
    assert [(root.tip_seen, round(float(root.points_mm[-1, 0]))) for root in found] == [(True, 0), (False, 10)]
