"""Thick roots begin as wide as the spheres of their core, and what no root runs through is a solid."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.optics import cameras, projection
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.roots import organs, search_space, tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.roots.organs import Core
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures
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


def test_a_cone_is_as_wide_as_its_core_and_a_lateral_stays_thin() -> None:
    axis = line((6.0, 6.0, 23.5), (6.0, 6.0, 3.0))
    started, thick = organs.thicken(strung(axis, line((6.0, 6.0, 15.0), (12.0, 6.0, 15.0))), core_of(4.0), PX_A_MM)
    z = started.centre_mm[:, 2]
    own = started.branches[0]
    assert thick[own].all()
    assert not thick[started.own(1)].any()
    expected = 4.0 * z[own] / 24.0 + RIM_MM
    assert np.abs(started.radius_mm[own] - expected)[5:-5].max() < 0.16 * expected.max()
    assert np.all(started.radius_mm[started.own(1)] < 0.5)


def test_parts_without_a_root_are_solids() -> None:
    core = core_of(4.0, 3.0)
    tree, thick = organs.thicken(strung(line((6.0, 6.0, 23.5), (6.0, 6.0, 3.0))), core, PX_A_MM)
    solids = organs.find_solids(core, tree, thick, PX_A_MM)
    assert solids.centre_mm[:, 0].min() > 11.0
    assert len(solids.index) == pytest.approx(np.pi * 3.0**2 * 24.0 / 3.0 / CELL_MM**3, rel=0.05)
    assert organs.find_solid_nodes(strung(line((16.0, 6.0, 23.0), (16.0, 6.0, 10.0))), solids, 0.6).all()
    assert not organs.find_solid_nodes(tree, solids, 0.6).any()


BALL = ((0.0, 0.0, -59.9), (0.0, 0.0, -60.1), 16.0)
"""A very short rod: 16 mm in radius."""


@cache
def scan() -> tuple[Optics, list[View], tuple[Silhouette, ...]]:
    scene = exact_pictures.ring_of(12, (320, 240))
    optics, views = Optics.from_scene(scene), exact_pictures.views_of(scene)
    return optics, views, tuple(exact_pictures.drawn(view, optics, (BALL,)) for view in views)


def core_volume_mm3(silhouettes: list[Silhouette]) -> float:
    optics, views, _ = scan()
    seen = Evidence.from_silhouettes(ViewBank.pack(views, optics), silhouettes)
    water = Water(optics.inner_radius_mm, -8.0, -120.0)
    _, core = search_space.carve_cells(seen, water, projection.px_a_mm(seen.bank, water.centre_mm), monitor=Monitor.of(None))
    return len(core.index) * core.grid.size_mm**3


def spotted(*which: int) -> list[Silhouette]:
    """Return the silhouettes with a bright spot of 4 px where some views see the middle of the ball."""
    optics, views, silhouettes = scan()
    found = list(silhouettes)
    for k in which:
        column, row = np.rint(cameras.project_inner(views[k], optics, np.array([[0.0, 0.0, -60.0]]))[0]).astype(int)
        found[k] = replace(found[k], coverage=found[k].coverage.copy())
        found[k].coverage[row - 1 : row + 3, column - 1 : column + 3] = 0.1
    return found


def test_a_bubble_makes_no_tunnel_but_a_hole_does() -> None:
    """The core of a ball: a bubble before it in one picture makes no tunnel, a hole that all pictures show stays one."""
    whole = core_volume_mm3(spotted())
    assert whole > 0.5 * 4.0 / 3.0 * np.pi * 16.0**3
    assert core_volume_mm3(spotted(3)) == whole
    assert core_volume_mm3(spotted(*range(12))) < 0.995 * whole
