"""The volume of tubes, against closed forms, and their union with thick organs."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.hull.parsimony import Trimmed
from rhizotwin.recon.hull.spheres import Spheres
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


def test_uniting_keeps_thick_organs_and_adds_tubes():
    grid = Grid(np.array([-8.0, -8.0, -48.0]), 0.125, 3, (20, 20, 40))
    index = np.array([[64, 64, 200]], np.int32)
    solid = Leaves(grid, index, np.array([8], np.int32), np.ones(1, np.float32))
    trimmed = Trimmed(solid, Spheres(np.zeros((0, 3)), np.zeros(0)), Spheres(np.zeros((0, 3)), np.zeros(0)), np.zeros(1, np.float32))
    core = grid.origin_mm + (index + 4) * 0.125
    path = line((-4.0, 0.0, -40.0), (-4.0, 0.0, -20.0))
    system = strung(path)
    found = at_rest(system, px_a_mm=4.0, core_mm=core, blur_px=0.3)
    united = tube_volume.unite(trimmed, found)
    assert united.thick.leaves.volume_mm3() == pytest.approx(1.0)
    assert united.leaves.volume_mm3() == pytest.approx(1.0 + np.pi * 0.04 * 20.0 + half_ball(0.2), rel=0.01)
    far = replace(found, core_mm=core + 5.0)
    assert tube_volume.unite(trimmed, far).thick.leaves.volume_mm3() == 0.0


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
