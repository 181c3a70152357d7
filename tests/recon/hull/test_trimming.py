"""Trimming the hull: tubes get their own cross-section back, what is no tube keeps its hull."""

from functools import cache

import numpy as np
import pytest

from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.hull import carve, trimming
from rhizotwin.recon.hull.bodies import fill
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.centre_lines import centre_lines
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves, fill_up, subtract
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.optics import projection, refraction
from tests.recon.hull import blocks, exact_pictures
from tests.recon.hull.exact_pictures import Segment

TRUNK: Segment = ((0.0, 0.0, -20.0), (0.0, 0.0, -80.0), 4.0)
TWIG: Segment = ((3.0, 0.0, -40.0), (27.0, 0.0, -58.0), 1.6)
SPHERE: Segment = ((0.0, 0.0, -34.0), (0.0, 0.0, -34.001), 10.0)
TAIL: Segment = ((0.0, 0.0, -34.0), (20.0, 0.0, -75.425), 2.0)
OTHER: Segment = ((-2.0, 2.0, -36.0), (-20.0, 14.0, -56.0), 1.6)
RODS = (TRUNK, TWIG, OTHER)
HALF_AS_WIDE = Spheres(np.outer(np.arange(-80.0, -20.0, 0.5), [0.0, 0.0, 1.0]), np.full(120, 2.0))
"""Spheres within the trunk."""


@cache
def volume_of_rods() -> float:
    """Volume of the union of the round-ended rods, by counting a grid."""
    grid = 0.4 * np.argwhere(np.ones((145, 75, 180), bool)) + [-25.8, -9.8, -85.8]
    inside = np.zeros(len(grid), bool)
    for a, b, r in RODS:
        start, axis = np.array(a), np.array(b) - np.array(a)
        t = np.clip((grid - start) @ axis / (axis @ axis), 0, 1)
        inside |= np.linalg.norm(grid - start - t[:, None] * axis, axis=1) < r
    return float(inside.sum()) * 0.4**3


@cache
def hull_of(segments: tuple[Segment, ...]) -> tuple[projection.ViewBank, DistanceMaps, Leaves]:
    scene = exact_pictures.ring_of(20)
    optics = refraction.Optics.from_scene(scene)
    views = exact_pictures.views_of(scene)
    maps = [silhouettes.signed_distance(exact_pictures.drawn(view, optics, segments)) for view in views]
    water = Water(optics.inner_radius_mm, -8.0, -100.0)
    bank, device_maps = projection.ViewBank.pack(views, optics), blocks.maps_of(np.stack(maps))
    return bank, device_maps, carve.carve(bank, device_maps, water.grid(0.25), water, min_votes=6).leaves


def trimmed(bank: projection.ViewBank, maps: DistanceMaps, hull: Leaves, lines: np.ndarray | None = None) -> trimming.TrimmedHull:
    """Return the spheres along centre lines, completed from the silhouettes."""
    spheres, doubtful = trimming.grow_spheres(bank, maps, centre_lines(hull) if lines is None else lines)
    shape = fill(spheres.bodies, hull)
    missing = trimming.find_missing(bank, maps, shape, subtract(hull, shape), spheres)[1]
    return trimming.TrimmedHull(fill_up(shape, missing), spheres, doubtful, missing.volume_mm3())


@cache
def trimmed_rods() -> trimming.TrimmedHull:
    return trimmed(*hull_of(RODS))


def test_trimming_gives_tubes_their_volume_back_and_adds_nothing() -> None:
    hull, found, true = hull_of(RODS)[2], trimmed_rods(), volume_of_rods()
    shape, spheres = found.leaves, found.spheres
    assert hull.volume_mm3() > 1.012 * true, "otherwise there is nothing to trim"
    assert shape.volume_mm3() == pytest.approx(true, rel=0.015)  # 1.1 %: the few views of one ring leave webs
    assert found.kept_mm3 < 0.05 * true
    assert abs(shape.volume_mm3() - true) < 0.6 * (hull.volume_mm3() - true)
    on_twig = (spheres.centre_mm[:, 0] > 10) & (spheres.centre_mm[:, 2] > -56)
    assert np.median(spheres.radius_mm[on_twig]) == pytest.approx(1.6, abs=0.06)
    cells, hull_cells = (set(map(tuple, one.split().index.tolist())) for one in (shape, hull))
    assert cells <= hull_cells
    assert len(cells) == (shape.size.astype(int) ** 3).sum()


def test_a_ball_keeps_its_size_where_a_root_hangs_on_it() -> None:
    """Its centre line is the end of the root's, short of its middle: the largest sphere lies beyond."""
    bank, maps, hull = hull_of((SPHERE, TAIL))
    sphere, tail, sunk = 4.0 / 3.0 * np.pi * 10.0**3, np.pi * 2.0**2 * 46.0 + 2.0 / 3.0 * np.pi * 2.0**3, np.pi * 2.0**2 * (10.0 - 0.2)
    assert trimmed(bank, maps, hull).leaves.volume_mm3() == pytest.approx(sphere + tail - sunk, rel=0.015)


def test_the_hull_of_a_twig_is_kept_where_silhouettes_need_it() -> None:
    """Hide the twigs from the skeleton: the pictures still ask for them."""
    bank, maps, hull = hull_of(RODS)
    lines = centre_lines(hull)
    found = trimmed(bank, maps, hull, lines[np.hypot(lines[:, 0], lines[:, 1]) < 2.0])
    assert np.hypot(found.spheres.centre_mm[:, 0], found.spheres.centre_mm[:, 1]).max() < 3.0
    assert found.leaves.volume_mm3() == pytest.approx(volume_of_rods(), rel=0.05)


def test_only_what_the_silhouettes_require_is_added_to_a_shape() -> None:
    """Half of a trunk is missing and comes back; the webs of the hull between complete rods do not."""
    bank, maps, hull = hull_of(RODS)
    complete = trimmed_rods().leaves
    lacking, missing = trimming.find_missing(bank, maps, complete, subtract(hull, complete), HALF_AS_WIDE)
    assert lacking.volume_mm3() > 0.012 * volume_of_rods()
    assert missing.volume_mm3() < 0.002 * volume_of_rods()
    x, y, z = complete.middles_mm.T
    away = (x > 1.0) & (np.hypot(x, y) < 4.5) & (z < -62.0)  # below the twigs
    rest = complete.select(~away)
    lacking, missing = trimming.find_missing(bank, maps, rest, subtract(hull, rest), HALF_AS_WIDE)
    gone = complete.select(away).volume_mm3()
    assert 0.75 * gone < missing.volume_mm3() < 1.02 * gone, "all but a rim of 0.75 px at the outlines"
    assert trimming.find_missing(bank, maps, hull, subtract(hull, hull), HALF_AS_WIDE)[0].volume_mm3() == 0.0
