"""Pieces of roots are connected by their tangents."""

from dataclasses import replace

import numpy as np

from rhizotwin.recon.roots import linking
from rhizotwin.recon.tubes import tubes
from tests.recon.lines import line


def _fork(*lines: np.ndarray, starts: tuple[int, ...]) -> tubes.Tubes:
    """Put branches together whose first node is a given node."""
    centre, branches = [lines[0]], [np.arange(len(lines[0]))]
    for points, start in zip(lines[1:], starts, strict=True):
        count = sum(len(part) for part in centre)
        branches.append(np.concatenate([[start], count + np.arange(len(points))]))
        centre.append(points)
    nodes = np.concatenate(centre)
    return tubes.Tubes(nodes, np.full(len(nodes), 0.1), tuple(branches))


def test_a_root_that_was_cut_where_it_touches_another_is_joined():
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -20.0), step=0.5)
    above, below = line((-6.0, 0.2, -6.0), (-0.5, 0.2, -9.6), step=0.5), line((0.3, 0.2, -10.2), (6.0, 0.2, -14.0), step=0.5)
    system = _fork(trunk, above, below, starts=(2, 20))
    linked = linking.link(system)[0]
    assert len(linked.branches) == 2
    assert linked.branches[1][0] == 2
    np.testing.assert_allclose(linked.centre_mm[linked.branches[1][-1]], below[-1])


def test_tips_that_meet_head_to_head_are_joined():
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -20.0), step=0.5)
    left, right = line((0.5, 0.0, -5.0), (6.0, 0.0, -7.0), step=0.5), line((12.0, 0.0, -9.0), (6.3, 0.0, -7.1), step=0.5)
    other = line((0.5, 1.0, -2.0), (13.0, 0.0, -8.0), step=0.5)
    system = _fork(trunk, left, right, other, starts=(10, len(trunk) + len(left) + len(right) + len(other) - 2, 4))
    assert len(linking.link(_parents_first(system))[0].branches) == 3


def test_a_root_whose_way_to_the_top_was_taken_by_another_gets_it_back():
    """Two roots cross: one was traced up to the crossing and on along the other, whose own way ends there."""
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    first, second = line((0.5, 0.0, -5.0), (12.0, 0.0, -17.0), step=0.5), line((0.5, 0.0, -17.0), (12.0, 0.3, -5.0), step=0.5)
    half = len(first) // 2
    swapped = np.concatenate([second[:half], first[half:]])
    system = _fork(trunk, swapped, first[: half - 1], second[half:], starts=(34, 10, len(trunk) + half - 1))
    linked = linking.link(system)[0]
    assert len(linked.branches) == 3
    tips = {(int(branch[0]), round(float(linked.centre_mm[branch[-1]][2]))) for branch in linked.branches[1:]}
    assert tips == {(10, -17), (34, -5)}


def test_a_root_goes_on_in_the_straighter_of_two():
    """The traced trunk bends away into a lateral, and what is left of it hangs there."""
    upper, lower = line((0.0, 0.0, 0.0), (0.0, 0.0, -15.0), step=0.5), line((0.0, 0.0, -15.5), (0.0, 0.0, -30.0), step=0.5)
    side = line((0.5, 0.0, -15.3), (10.0, 0.0, -20.0), step=0.5)
    linked = linking.link(_fork(np.concatenate([upper, side]), lower, starts=(len(upper) - 1,)))[0]
    assert [round(float(linked.centre_mm[branch[-1]][2])) for branch in linked.branches] == [-30, -20]


def test_a_root_that_was_traced_from_its_tip_is_turned_round():
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    higher, lower = line((0.5, 0.0, -5.0), (20.0, 0.0, -20.0), step=0.5), line((19.0, 0.5, -20.0), (0.5, 0.5, -10.0), step=0.5)
    system = _fork(trunk, higher, lower, starts=(10, len(trunk) + len(higher) - 2))
    linked = linking.link(system)[0]
    assert linked.branches[2][0] in (19, 20, 21)
    np.testing.assert_allclose(linked.centre_mm[linked.branches[2][-1]], lower[0])


def test_a_stub_that_ends_where_another_begins_goes_on_in_it():
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    stub, rest = np.array([[0.4, 0.0, -5.3]]), line((0.8, 0.0, -5.6), (12.0, 0.0, -14.0), step=0.5)
    linked = linking.link(_fork(trunk, stub, rest, starts=(10, len(trunk))))[0]
    assert [int(branch[0]) for branch in linked.branches] == [0, 10]
    np.testing.assert_allclose(linked.centre_mm[linked.branches[1][-1]], rest[-1])


def test_a_root_that_was_traced_from_a_crossing_both_ways_is_one():
    """A root crosses another, on which both its halves were hung: the half that leaves against growth is its base."""
    trunk, low = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5), line((0.5, 0.3, -20.0), (6.0, 0.3, -21.5), (7.5, 5.0, -23.0), step=0.5)
    crossed = line((0.5, 0.0, -2.0), (14.0, 0.0, -33.0), step=0.5)
    base, rest = line((9.2, 0.3, -22.9), (6.2, 0.3, -21.7), step=0.5), line((10.2, 0.3, -23.3), (16.0, 0.3, -25.6), step=0.5)
    at = len(trunk) + len(low) + int(np.argmin(np.linalg.norm(crossed - [9.7, 0.0, -23.1], axis=1)))
    linked = linking.link(_fork(trunk, low, crossed, base, rest, starts=(40, 4, at, at)))[0]
    assert len(linked.branches) == 4
    whole = next(nodes for nodes in linked.branches if np.allclose(linked.centre_mm[nodes[-1]], rest[-1]))
    assert whole[0] < len(trunk) + len(low)
    assert (np.linalg.norm(linked.centre_mm[whole] - base[2], axis=1) < 1e-6).any()


def test_a_second_path_along_the_same_root_is_dropped():
    """A root is found in two pieces that overlap by 2 mm; a lateral of the second path hangs on the first then."""
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    first, second = line((0.5, 0.0, -5.0), (10.0, 0.0, -11.0), step=0.5), line((8.5, 0.3, -10.0), (18.0, 0.3, -16.0), step=0.5)
    twig = line((9.2, 0.8, -10.5), (9.2, 6.0, -12.0), step=0.5)
    apart = len(trunk) + len(first)
    linked = linking.link(_fork(trunk, first, second, twig, starts=(10, 30, apart + 2)))[0]
    assert len(linked.branches) == 3
    np.testing.assert_allclose(linked.centre_mm[linked.branches[1][-1]], second[-1])
    assert linked.branches[2][0] in linked.branches[1]
    assert len(linked.centre_mm) < apart + len(second) + len(twig)
    np.testing.assert_array_equal(np.unique(np.concatenate(linked.branches)), np.arange(len(linked.centre_mm)))


def test_no_root_ends_where_a_lateral_leaves_it():
    trunk, stub = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5), line((0.5, 0.0, -5.0), (4.0, 0.0, -7.0), step=0.5)
    bent, straight = line((4.0, 0.5, -6.8), (4.0, 8.0, -6.8), step=0.5), line((4.2, 0.5, -7.2), (9.0, 5.0, -9.0), step=0.5)
    last = len(trunk) + len(stub) - 2
    joined = tubes.without_stubs(_fork(trunk, stub, bent, straight, starts=(10, last, last)))
    assert [len(nodes) for nodes in joined.branches[:2]] == [len(trunk), len(stub) + len(straight)]
    np.testing.assert_allclose(joined.centre_mm[joined.branches[1][-1]], straight[-1])
    assert joined.branches[2][0] in joined.branches[1]
    far = _fork(trunk, stub, bent, starts=(10, last - 2))  # what goes on for more than a node's distance is a tip
    assert len(tubes.without_stubs(far).branches) == 3


def _parents_first(system: tubes.Tubes) -> tubes.Tubes:
    return tubes.Tubes(system.centre_mm, system.radius_mm, tuple(system.branches[k] for k in (0, 1, 3, 2)))


def test_tips_that_pass_beside_each_other_stay():
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -20.0), step=0.5)
    left, right = line((0.5, 0.0, -5.0), (6.0, 0.0, -7.0), step=0.5), line((0.5, 0.6, -6.0), (6.0, 0.6, -7.0), step=0.5)
    assert len(linking.link(_fork(trunk, left, right, starts=(10, 12)))[0].branches) == 3


def _torn(gap_mm: float, aside_mm: float, frayed_mm: float) -> tubes.Tubes:
    """Return a lateral that ends beside what goes on along its tangent, which hangs on another; its last nodes bend away."""
    trunk, other = line((0.0, 0.0, 0.0), (0.0, 0.0, -20.0), step=0.5), line((0.0, 0.5, -9.0), (9.0, 9.0, -9.0), step=0.5)
    upper = line((0.5, 0.0, -5.0), (5.0, 0.0, -5.0), (5.0 + 0.7 * frayed_mm, 0.0, -5.0 + 0.7 * frayed_mm), step=0.5)
    rest = line((5.0 + gap_mm, aside_mm, -5.0), (14.0, aside_mm, -5.0), step=0.5)
    return _fork(trunk, upper, other, rest, starts=(8, 18, len(trunk) + len(upper) + 4))


def test_a_frayed_end_is_joined_without_what_is_frayed():
    system = _torn(gap_mm=1.0, aside_mm=0.0, frayed_mm=1.4)
    linked, kept = linking.link(system)
    assert len(linked.branches) == 3
    assert 2 <= (~kept).sum() <= 3
    joined = next(nodes for nodes in linked.branches if np.allclose(linked.centre_mm[nodes[-1]], (14.0, 0.0, -5.0)))
    assert linked.centre_mm[joined][1:, 2].max() < -4.5
    assert np.abs(np.diff(linked.centre_mm[joined][1:, 2])).max() < 0.3


def test_an_end_that_is_likely_none_is_joined_at_a_higher_price():
    system = _torn(gap_mm=2.0, aside_mm=0.6, frayed_mm=0.0)
    assert len(linking.link(system)[0].branches) == 4
    uncertain = system.owner == 1
    linked, kept = linking.link(system, uncertain)
    assert len(linked.branches) == 3
    assert kept.all()
    assert len(linking.link(_torn(gap_mm=2.0, aside_mm=1.5, frayed_mm=0.0), uncertain)[0].branches) == 4


def test_a_tip_takes_over_what_follows_of_a_branch_that_bends_into_its_course():
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    bent = line((0.5, 0.0, -10.0), (6.0, 0.0, -10.0), (6.0, 0.0, -20.0), step=0.5)
    upper = line((0.5, 2.0, -2.0), (6.0, 2.0, -4.0), (6.0, 0.2, -9.5), step=0.5)
    linked = linking.link(_fork(trunk, bent, upper, starts=(20, 4)))[0]
    ends = {tuple(np.round(linked.centre_mm[branch[-1]], 1)): branch for branch in linked.branches}
    assert len(ends) == 3
    assert int(ends[6.0, 0.0, -20.0][0]) == 4


def test_where_two_roots_cross_each_goes_on_in_its_own_course():
    """One was traced on into the other's way, whose tip ends before the crossing; what the first should go on in hangs elsewhere."""
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    aslant = np.array([np.cos(0.55), 0.0, -np.sin(0.55)])
    crossing = np.array([5.0, 0.0, -10.0])
    swapped = line((0.5, 0.0, -10.0), tuple(crossing), tuple(crossing + 8.0 * aslant), step=0.5)
    second = line(tuple(crossing - 5.5 * aslant + [0.0, 0.2, 0.0]), tuple(crossing - 1.6 * aslant + [0.0, 0.2, 0.0]), step=0.5)
    onward = line((5.6, 0.0, -10.0), (14.0, 0.0, -10.0), step=0.5)
    linked = linking.link(_fork(trunk, swapped, second, onward, starts=(20, 14, 50)))[0]
    begins = {tuple(np.round(linked.centre_mm[branch[-1]], 1)): int(branch[0]) for branch in linked.branches[1:]}
    assert begins == {(14.0, 0.0, -10.0): 20, tuple(np.round(swapped[-1], 1)): 14}


def test_nothing_is_hung_on_itself():
    """A lateral comes round to its parent's tip head to head: were it the one to go on, nothing would hold either of them."""
    trunk = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5)
    lateral = line((5.0, 0.4, -10.5), (5.0, 0.4, -16.0), (20.0, 0.4, -16.0), (20.0, 0.1, -10.0), (14.5, 0.0, -10.0), step=0.5)
    parent = line((0.5, 0.0, -10.0), (14.0, 0.0, -10.0), step=0.5)
    system = _fork(trunk, lateral, parent, starts=(len(trunk) + len(lateral) + 8, 20))
    linked, kept = linking.link(replace(system, branches=tuple(system.branches[k] for k in (0, 2, 1))))
    assert kept.all()
    assert len(linked.branches) == 2
