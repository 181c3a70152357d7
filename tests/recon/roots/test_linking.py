"""Pieces of roots are connected by their tangents."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.roots import linking
from rhizotwin.recon.tubes import tubes
from tests.recon.strings import line

Point = tuple[float, float, float]


def piece(*corners: Point) -> np.ndarray:
    return line(*corners, step=0.5)


TRUNK = piece((0.0, 0.0, 0.0), (0.0, 0.0, -30.0))


def fork(*lines: np.ndarray, starts: tuple[int, ...]) -> tubes.Tubes:
    """Put branches together whose first node is a given node."""
    centre, branches = [lines[0]], [np.arange(len(lines[0]))]
    for points, start in zip(lines[1:], starts, strict=True):
        branches.append(np.concatenate([[start], sum(map(len, centre)) + np.arange(len(points))]))
        centre.append(points)
    nodes = np.concatenate(centre)
    return tubes.Tubes(nodes, np.full(len(nodes), 0.1), tuple(branches))


def ends(system: tubes.Tubes) -> dict[Point, int]:
    """Return the first node of every branch but the trunk, by where its tip is."""
    return {tuple(np.round(system.centre_mm[branch[-1]], 1).tolist()): int(branch[0]) for branch in system.branches[1:]}


FIRST, SECOND = piece((0.5, 0.0, -5.0), (12.0, 0.0, -17.0)), piece((0.5, 0.0, -17.0), (12.0, 0.3, -5.0))
HALF = len(FIRST) // 2
STUB, REST = np.array([[0.4, 0.0, -5.3]]), piece((0.8, 0.0, -5.6), (12.0, 0.0, -14.0))
BENT = piece((0.5, 0.0, -10.0), (6.0, 0.0, -10.0), (6.0, 0.0, -20.0))
INTO_IT = piece((0.5, 2.0, -2.0), (6.0, 2.0, -4.0), (6.0, 0.2, -9.5))
CUT = piece((-6.0, 0.2, -6.0), (-0.5, 0.2, -9.6)), piece((0.3, 0.2, -10.2), (6.0, 0.2, -14.0))
BESIDE = piece((0.5, 0.0, -5.0), (6.0, 0.0, -7.0)), piece((0.5, 0.6, -6.0), (6.0, 0.6, -7.0))
LEFT, OTHER = piece((0.5, 0.0, -5.0), (6.0, 0.0, -7.0)), piece((0.5, 1.0, -2.0), (13.0, 0.0, -8.0))
RIGHT = piece((12.0, 0.0, -9.0), (6.3, 0.0, -7.1))
SWAPPED = np.concatenate([SECOND[:HALF], FIRST[HALF:]]), FIRST[: HALF - 1], SECOND[HALF:]


@pytest.mark.parametrize(
    ("lines", "starts", "expected"),
    [
        (CUT, (2, 20), {(6.0, 0.2, -14.0): 2}),
        (SWAPPED, (34, 10, len(TRUNK) + HALF - 1), {(12.0, 0.0, -17.0): 10, (12.0, 0.3, -5.0): 34}),
        ((STUB, REST), (10, len(TRUNK)), {(12.0, 0.0, -14.0): 10}),
        (BESIDE, (10, 12), {(6.0, 0.0, -7.0): 10, (6.0, 0.6, -7.0): 12}),
        ((LEFT, OTHER, RIGHT), (10, 4, len(TRUNK) + len(LEFT) + len(OTHER) - 2), {(12.0, 0.0, -9.0): 10, (13.0, 0.0, -8.0): 4}),
        ((BENT, INTO_IT), (20, 4), {(6.0, 0.0, -20.0): 4, (6.0, 0.0, -10.0): 20}),
    ],
    ids=[
        "cut where it touches another",
        "two that cross",
        "a stub",
        "tips side by side",
        "head to head",
        "one that bends into another",
    ],
)
def test_each_root_is_one_branch_from_where_it_leaves(lines, starts, expected) -> None:
    assert ends(linking.link(fork(TRUNK, *lines, starts=starts))[0]) == expected


def test_a_root_goes_on_in_the_straighter_of_two() -> None:
    """The traced trunk bends away into a lateral, and what is left of it hangs there."""
    side = piece((0.5, 0.0, -15.3), (10.0, 0.0, -20.0))
    linked = linking.link(fork(np.concatenate([TRUNK[:31], side]), TRUNK[31:], starts=(30,)))[0]
    assert [round(float(linked.centre_mm[branch[-1]][2])) for branch in linked.branches] == [-30, -20]


def test_a_second_path_along_the_same_root_is_dropped() -> None:
    """A root is found in two pieces that overlap by 2 mm; a lateral of the second path hangs on the first then."""
    first, second = piece((0.5, 0.0, -5.0), (10.0, 0.0, -11.0)), piece((8.5, 0.3, -10.0), (18.0, 0.3, -16.0))
    twig = piece((9.2, 0.8, -10.5), (9.2, 6.0, -12.0))
    apart = len(TRUNK) + len(first)
    linked = linking.link(fork(TRUNK, first, second, twig, starts=(10, 30, apart + 2)))[0]
    assert set(ends(linked)) == {(18.0, 0.3, -16.0), (9.2, 6.0, -12.0)}
    assert linked.branches[2][0] in linked.branches[1]
    assert len(linked.centre_mm) < apart + len(second) + len(twig)


def test_frayed_ends_and_those_that_are_likely_none_are_joined_at_a_price() -> None:
    def torn(gap_mm: float, aside_mm: float, frayed_mm: float) -> tubes.Tubes:
        """Return a lateral that ends beside what goes on along its tangent, which hangs on another; its last nodes bend away."""
        upper = piece((0.5, 0.0, -5.0), (5.0, 0.0, -5.0), (5.0 + 0.7 * frayed_mm, 0.0, -5.0 + 0.7 * frayed_mm))
        rest, other = piece((5.0 + gap_mm, aside_mm, -5.0), (14.0, aside_mm, -5.0)), piece((0.0, 0.5, -9.0), (9.0, 9.0, -9.0))
        return fork(TRUNK[:41], upper, other, rest, starts=(8, 18, 41 + len(upper) + 4))

    linked, kept = linking.link(torn(1.0, 0.0, 1.4))
    assert len(linked.branches) == 3
    assert 2 <= (~kept).sum() <= 3
    system = torn(2.0, 0.6, 0.0)
    uncertain = system.owner == 1
    assert len(linking.link(system)[0].branches) == 4
    assert len(linking.link(system, uncertain)[0].branches) == 3
    assert len(linking.link(torn(2.0, 1.5, 0.0), uncertain)[0].branches) == 4


def test_nothing_is_hung_on_itself() -> None:
    """A lateral comes round to its parent's tip head to head: were it the one to go on, nothing would hold either of them."""
    lateral = piece((5.0, 0.4, -10.5), (5.0, 0.4, -16.0), (20.0, 0.4, -16.0), (20.0, 0.1, -10.0), (14.5, 0.0, -10.0))
    parent = piece((0.5, 0.0, -10.0), (14.0, 0.0, -10.0))
    system = fork(TRUNK, lateral, parent, starts=(len(TRUNK) + len(lateral) + 8, 20))
    linked, kept = linking.link(replace(system, branches=tuple(system.branches[k] for k in (0, 2, 1))))
    assert kept.all()
    assert len(linked.branches) == 2
