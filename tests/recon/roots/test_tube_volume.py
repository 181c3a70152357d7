"""The volume of tubes, against closed forms, and beside solids."""

import numpy as np
import pytest

from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.roots import tube_volume
from rhizotwin.recon.tubes import filling, tubes
from tests.recon.strings import at_rest, line, strung


def half_ball(radius_mm: float) -> float:
    """Return the volume of a round tip, mm3."""
    return 2.0 / 3.0 * np.pi * radius_mm**3


def test_filled_volume_is_that_of_the_frustum():
    path = line((0.0, 0.0, -20.0), (6.0, 3.0, -40.0))
    system = tubes.string([path], [np.linspace(0.4, 0.1, len(path))])
    length = float(np.linalg.norm(path[-1] - path[0]))
    filled = filling.fill(system, 0.05)
    expected = np.pi * length / 3.0 * (0.16 + 0.04 + 0.01) + half_ball(0.1)
    assert filled.volume_mm3.sum() == pytest.approx(expected, rel=2e-3)


def test_tubes_are_painted_beside_solids():
    grid = Grid(np.array([-8.0, -8.0, -48.0]), 0.125, 3, (20, 20, 40))
    index = np.array([[64, 64, 200]], np.int32)
    solid = Leaves(grid, index, np.array([8], np.int32), np.ones(1, np.float32))
    path, wide = line((-4.0, 0.0, -40.0), (-4.0, 0.0, -20.0)), line((4.0, 4.0, -20.0), (4.0, 4.0, -40.0))
    thin = tube_volume.paint(solid, at_rest(strung(path), px_a_mm=4.0, blur_px=0.3))
    assert thin.thick.volume_mm3() == pytest.approx(1.0)
    assert thin.leaves.volume_mm3() == pytest.approx(1.0 + np.pi * 0.04 * 20.0 + half_ball(0.2), rel=0.01)
    thick = tube_volume.paint(solid, at_rest(strung(wide, radius_mm=1.0), px_a_mm=4.0, blur_px=0.3))
    assert thick.thick.volume_mm3() == pytest.approx(thick.leaves.volume_mm3())
    assert thick.leaves.volume_mm3() == pytest.approx(1.0 + np.pi * 20.0 + half_ball(1.0), rel=0.01)


@pytest.mark.parametrize(("radius_mm", "apart_mm"), [(0.3, 0.4), (0.75, 1.05), (0.75, 1.6)])
def test_tubes_side_by_side_count_their_overlap_once(radius_mm: float, apart_mm: float) -> None:
    """Two upright tubes share a lens (of two circles), and their tips one of two balls, however thick they are."""
    a, b = (line((x, 0.0, -20.0), (x, 0.0, -40.0)) for x in (0.0, apart_mm))
    system = strung(a, b, radius_mm=radius_mm)
    straight = tubes.Tubes(system.centre_mm, system.radius_mm, (system.branches[0], system.branches[1][1:]))
    length = [np.ptp(system.centre_mm[nodes, 2]) for nodes in straight.branches]
    half = min(apart_mm / 2.0 / radius_mm, 1.0)
    lens = 2.0 * radius_mm**2 * (np.arccos(half) - half * np.sqrt(1.0 - half**2))
    expected = np.pi * radius_mm**2 * sum(length) - lens * min(length) + 2.0 * half_ball(radius_mm)
    if half < 1.0:  # of two balls, half
        expected -= np.pi / 24.0 * (4.0 * radius_mm + apart_mm) * (2.0 * radius_mm - apart_mm) ** 2
    assert filling.fill(straight, 0.05).volume_mm3.sum() == pytest.approx(expected, rel=0.015)
