"""The core of a thick solid: a bubble before it in one picture makes no tunnel, a hole that all pictures show stays one."""

from dataclasses import replace
from functools import cache

import numpy as np

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.optics import cameras, projection
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.roots import search_space
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures

BALL = ((0.0, 0.0, -59.9), (0.0, 0.0, -60.1), 16.0)
"""A very short rod: 16 mm in radius."""


@cache
def scan() -> tuple[Optics, list[View], tuple[Silhouette, ...]]:
    scene = Scene(camera=Camera().resized((320, 240)), plan=CapturePlan(rings=(Ring(views=12),)))
    optics, views = Optics.from_scene(scene), exact_pictures.views_of(scene)
    return optics, views, tuple(exact_pictures.drawn(view, optics, (BALL,)) for view in views)


def core_volume_mm3(silhouettes: list[Silhouette]) -> float:
    optics, views, _ = scan()
    seen = Evidence.from_silhouettes(ViewBank.pack(views, optics), silhouettes)
    water = Water(optics.inner_radius_mm, -8.0, -120.0)
    _, core = search_space.carve_cells(seen, water, projection.px_a_mm(seen.bank, water.centre_mm), monitor=Monitor.of(None))
    return len(core.index) * core.grid.size_mm**3


def spotted(point_mm: tuple[float, float, float], which: list[int]) -> list[Silhouette]:
    """Return the silhouettes with a bright spot of 4 px where some views see a point."""
    optics, views, silhouettes = scan()
    found = list(silhouettes)
    for k in which:
        column, row = np.rint(cameras.project_inner(views[k], optics, np.array([point_mm]))[0]).astype(int)
        coverage = silhouettes[k].coverage.copy()
        coverage[row - 1 : row + 3, column - 1 : column + 3] = 0.1
        found[k] = replace(silhouettes[k], coverage=coverage)
    return found


def test_a_bubble_before_a_ball_makes_no_tunnel_but_a_hole_through_it_does() -> None:
    whole = core_volume_mm3(list(scan()[2]))
    assert whole > 0.5 * 4.0 / 3.0 * np.pi * 16.0**3
    assert core_volume_mm3(spotted((0.0, 0.0, -60.0), [3])) == whole
    assert core_volume_mm3(spotted((0.0, 0.0, -60.0), list(range(12)))) < 0.995 * whole
