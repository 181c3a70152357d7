"""Thick roots begin as wide as the spheres of their core, and what no root runs through is a solid."""

import numpy as np
import pytest

from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.roots import organs, tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.roots.organs import Core
from tests.recon.strings import line, strung

CELL_MM, PX_A_MM = 0.2, 4.0
RIM_MM = 1.75 / PX_A_MM
"""Of a root beyond its core."""


def core_of(*radii_mm: float) -> Core:
    """Return the core of upright cones of 24 mm, 10 mm apart along x, from such a radius below the tip to it at the top."""
    count = (300, 60, 130)
    x, y, z = (CELL_MM * (np.arange(n) + 0.5) for n in count)
    away = [np.hypot(x[:, None] - 6.0 - 10.0 * k, y[None] - 6.0) for k in range(len(radii_mm))]
    share = np.clip(z / 24.0, 0.0, 1.0) * (z < 24.0)
    inside = np.any([one[..., None] < radius * share for one, radius in zip(away, radii_mm, strict=True)], axis=0)
    index = np.argwhere(inside).astype(np.int32)
    cells = Cells(Grid(np.zeros(3), CELL_MM, 1, count), index, np.zeros(len(index), np.float32))
    return Core(cells, tracing.core_depth(cells, index, reach_mm=0.0))


def test_a_cone_is_as_wide_as_its_core_and_a_lateral_on_it_stays_thin() -> None:
    axis = line((6.0, 6.0, 23.5), (6.0, 6.0, 3.0))
    started, thick = organs.thicken(strung(axis, line((6.0, 6.0, 15.0), (12.0, 6.0, 15.0))), core_of(4.0), PX_A_MM)
    z = started.centre_mm[:, 2]
    own = started.branches[0]
    assert thick[own].all()
    assert not thick[started.own(1)].any()
    expected = 4.0 * z[own] / 24.0 + RIM_MM
    assert np.abs(started.radius_mm[own] - expected)[5:-5].max() < 0.16 * expected.max()
    assert np.all(started.radius_mm[started.own(1)] < 0.5)


def test_an_axis_through_a_bulb_is_as_wide_as_the_bulb() -> None:
    """It began as wide as the widest sphere nearly everywhere; the excess at both ends pushed the axis aside and along."""
    count, semi_mm = (60, 60, 100), np.array([5.0, 5.0, 9.0])
    places = np.argwhere(np.ones(count)).astype(np.int32)
    index = places[np.linalg.norm((CELL_MM * (places + 0.5) - [6.0, 6.0, 10.0]) / semi_mm, axis=1) < 1.0]
    cells = Cells(Grid(np.zeros(3), CELL_MM, 1, count), index, np.zeros(len(index), np.float32))
    bulb = Core(cells, tracing.core_depth(cells, index, reach_mm=0.0))
    started, thick = organs.thicken(strung(line((6.0, 6.0, 18.8), (6.0, 6.0, 0.5))), bulb, PX_A_MM)
    z = started.centre_mm[:, 2] - 10.0
    inner = np.abs(z) < 7.5
    assert thick[inner].all()
    np.testing.assert_allclose(started.radius_mm[inner], 5.0 * np.sqrt(1.0 - (z[inner] / 9.0) ** 2) + RIM_MM, atol=0.4)


def test_parts_without_a_root_are_solids() -> None:
    core = core_of(4.0, 3.0)
    tree, thick = organs.thicken(strung(line((6.0, 6.0, 23.5), (6.0, 6.0, 3.0))), core, PX_A_MM)
    solids = organs.find_solids(core, tree, thick, PX_A_MM)
    assert solids.centre_mm[:, 0].min() > 11.0
    assert len(solids.index) == pytest.approx(np.pi * 3.0**2 * 24.0 / 3.0 / CELL_MM**3, rel=0.05)
    assert organs.find_solid_nodes(strung(line((16.0, 6.0, 23.0), (16.0, 6.0, 10.0))), solids, 0.6).all()
    assert not organs.find_solid_nodes(tree, solids, 0.6).any()
