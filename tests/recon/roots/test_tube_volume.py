"""The volume of tubes, against closed forms, and beside solids."""

from collections.abc import Callable

import numpy as np
import pytest

from rhizotwin.recon.hull.leaves import Grid, Hull, Leaves, unite
from rhizotwin.recon.roots import tube_volume
from rhizotwin.recon.tubes import tubes
from tests.recon.strings import at_rest, line, strung


def half_ball(radius_mm: float) -> float:
    """Return the volume of a round tip, mm3."""
    return 2.0 / 3.0 * np.pi * radius_mm**3


GRID = Grid(np.array([-8.0, -8.0, -48.0]), 0.125, 3, (20, 20, 40))


def hull_of(leaves: Leaves) -> Hull:
    return Hull(leaves, leaves.occupancy, leaves.volume_mm3(), 0.0)


def painted(system: tubes.Tubes, grid: Grid = GRID) -> Leaves:
    """Paint tubes without solids into a hull that is all of a grid."""
    return unite(*tube_volume.fill_tubes(at_rest(system, px_a_mm=4.0), hull_of(Leaves.whole(grid))))


def test_painted_volume_is_that_of_the_frustum():
    path = line((0.0, 0.0, -20.0), (6.0, 3.0, -40.0))
    system = tubes.place_nodes([path], [np.linspace(0.4, 0.1, len(path))])
    length = float(np.linalg.norm(path[-1] - path[0]))
    expected = np.pi * length / 3.0 * (0.16 + 0.04 + 0.01) + half_ball(0.1)
    assert painted(system).volume_mm3() == pytest.approx(expected, rel=5e-3)


def test_wide_tubes_are_clipped_to_the_hull():
    thin, wide = line((-4.0, 0.0, -40.0), (-4.0, 0.0, -20.0)), line((4.0, 4.0, -20.0), (4.0, 4.0, -40.0))
    upper = Leaves.whole(GRID)
    upper = upper.select(upper.middles_mm[:, 2] > -30.0)
    found = tube_volume.fill_tubes(at_rest(strung(thin), px_a_mm=4.0), hull_of(upper))
    assert [one.volume_mm3() for one in found] == pytest.approx([0.0, np.pi * 0.04 * 20.0 + half_ball(0.2)], rel=0.015)
    found = tube_volume.fill_tubes(at_rest(strung(wide, radius_mm=1.0), px_a_mm=4.0), hull_of(upper))
    assert [one.volume_mm3() for one in found] == pytest.approx([np.pi * 10.0 + half_ball(1.0), 0.0], rel=0.01)


def test_a_thin_tube_keeps_its_volume_beside_a_wide_one():
    thin, wide = line((-4.0, 0.0, -40.0), (-4.0, 0.0, -20.0)), line((4.0, 0.0, -20.0), (4.0, 0.0, -40.0))
    system = tubes.place_nodes([wide, thin], [np.full(len(wide), 0.4), np.full(len(thin), 0.05)])
    leaves = painted(system)
    x, _, z = leaves.middles_mm.T
    middle = [leaves.select(side & (z > -38.0) & (z < -22.0)).volume_mm3() for side in (x < 0.0, x > 0.0)]
    assert middle == pytest.approx([np.pi * 0.05**2 * 16.0, np.pi * 0.4**2 * 16.0], rel=0.015)  # of tubes along the lattice


RADII: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "blunt": lambda below_mm: np.where(np.abs(below_mm) < 4.0, 6.0, 1.0),
    "wide": lambda below_mm: np.where(np.abs(below_mm) < 4.0, 8.0, 1.0),
    "ball": lambda below_mm: np.sqrt(np.maximum(36.0 - below_mm**2, 0.64)),
    "taper": lambda below_mm: np.interp(below_mm, [-8.0, 12.0], [4.0, 0.2]),
}


@pytest.mark.parametrize(("kind", "bend_mm"), [("blunt", 0), ("wide", 2), ("ball", 0), ("taper", 2)])
def test_a_thick_root_has_the_volume_of_its_frustums(kind: str, bend_mm: float) -> None:
    """Discs of a bent tube overlap inside the bend as much as they part outside (Pappus). Top and tip are round."""
    grid = Grid(np.array([-12.0, -12.0, -48.0]), 0.125, 3, (24, 24, 36))
    path = line((0.0, 0.0, -18.0), (0.0, 0.0, -44.0))
    path[:, 0] += bend_mm * (1.0 - ((path[:, 2] + 31.0) / 13.0) ** 2)
    system = tubes.place_nodes([path], [RADII[kind](-30.0 - path[:, 2])])
    step, found = np.linalg.norm(np.diff(system.centre_mm[system.branches[0]], axis=0), axis=1), system.radii(0)
    a, b = found[:-1], found[1:]
    frustums = np.pi / 3.0 * float(step @ (a**2 + a * b + b**2)) + half_ball(found[0]) + half_ball(found[-1])
    assert painted(system, grid).volume_mm3() == pytest.approx(frustums, rel=0.002)


@pytest.mark.parametrize(("radius_mm", "apart_mm"), [(0.3, 0.4), (0.75, 1.6)])
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
    assert painted(straight).volume_mm3() == pytest.approx(expected, rel=0.015)
