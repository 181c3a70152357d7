"""What is told from roots: tubes that lie in others, and ends that are none."""

import numpy as np
import pytest

from rhizotwin.recon.roots import ghosts, node_support
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tube_picture import Rendering
from tests.recon.strings import TRUNK, line, pictured, strung


def test_an_end_is_uncertain_where_little_shows_much_is_left_and_another_root_is_near():
    angle = np.arange(6) * 2.0 * np.pi / 6.0
    laterals = [line((0.0, 0.0, -24.0 - 4.0 * k), (4.0 * np.cos(a), 4.0 * np.sin(a), -27.0 - 4.0 * k)) for k, a in enumerate(angle)]
    beside = line((0.0, 0.0, -44.0), (0.4, 0.0, -46.0))  # its tip is 0.2 mm from the trunk's surface, those of the others far
    system, near = strung(TRUNK, *laterals, beside), 7
    for branch, shown, share, expected in (
        (near, 0.05, 0.3, True),
        (near, 0.5, 0.3, False),  # it shows
        (near, 0.25, 0.02, False),  # it leaves little
        (3, 0.05, 0.02, False),  # hidden, but it stands free of all others and leaves no more than they do
        (3, 0.05, 0.9, True),
    ):
        own = system.owner == branch
        visible, left = np.where(own, shown, 0.5), np.where(own, share, 0.02)
        judged = ghosts.find_uncertain_ends(system, visible, node_support.Support(1.0 - left, left, left), np.zeros(len(own), bool))
        np.testing.assert_array_equal(judged, own & expected)


def test_a_second_tube_of_a_root_and_a_detour_beside_one_explain_little():
    def hanging(x: float, *on: tuple[float, float, float]) -> np.ndarray:
        return line((0.0, 0.0, -26.0), (x, 0.0, -28.0), (x, 0.0, -48.0), *on)

    seen = pictured(strung(TRUNK, hanging(0.7), line((0.1, 0.0, -48.0), (12.0, 0.0, -52.0)), radius_mm=0.3))
    found = strung(TRUNK, hanging(0.7), hanging(0.1), hanging(-0.1, (12.0, 0.0, -52.0)), radius_mm=0.3)
    beside = found.centre_mm[:, 0] < 0.3
    found = tubes.with_geometry(found, found.centre_mm, np.where((found.owner >= 2) & beside, 0.1, 0.3))
    unproven = ghosts.find_unsupported_starts(
        found, node_support.compute_support(Rendering.draw(seen, found)), np.zeros(len(found.radius_mm), bool)
    )
    np.testing.assert_array_equal(unproven[found.owner < 3], found.owner[found.owner < 3] == 2)
    detour, last = unproven[found.own(3)], found.cut_detours(unproven)
    assert 34 <= detour.sum() <= 48  # 24 mm of it, and what follows until it shows more
    assert not detour[48:].any()
    assert last.owner[last.branches[3][0]] == 1
    assert last.centre_mm[last.branches[3][0], 2] == pytest.approx(-48.0, abs=1.5)
