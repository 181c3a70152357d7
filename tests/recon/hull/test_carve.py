"""Carving a sphere from exact silhouettes drawn with the reference projection."""

from functools import cache

import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.hull import carve, distance_maps, surface
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Hull
from rhizotwin.recon.optics import projection, refraction
from tests.recon.hull import exact_pictures

RADIUS_MM = 8.0
BALL_MM3 = 4.0 / 3.0 * np.pi * RADIUS_MM**3
MIDDLE_MM = (0.0, 0.0, -50.0)


@cache
def seen_ball(centre_mm: tuple[float, float, float]) -> tuple[projection.ViewBank, DistanceMaps]:
    scene = exact_pictures.ring_of(24, (240, 180))
    optics = refraction.Optics.from_scene(scene)
    views = exact_pictures.views_of(scene)
    sphere = (centre_mm, (centre_mm[0], centre_mm[1], centre_mm[2] - 1e-3), RADIUS_MM)
    maps = [silhouettes.signed_distance(exact_pictures.drawn(view, optics, (sphere,))) for view in views]
    return projection.ViewBank.pack(views, optics), DistanceMaps.from_arrays(np.stack(maps))


@cache
def carved(centre_mm: tuple[float, float, float], *, ignore_blindness: bool = False) -> Hull:
    bank, maps = seen_ball(centre_mm)
    r = bank.optics.inner_radius_mm
    grid = Grid.over(np.array([-r, -r, -110.0]), np.array([r, r, -8.0]), 0.4)
    return carve.carve(bank, maps, grid, Water(r, -8.0, -110.0), min_votes=5, ignore_blindness=ignore_blindness)


@pytest.mark.parametrize("centre_mm", [MIDDLE_MM, (40.0, 5.0, -50.0)])
def test_volume_of_a_ball(centre_mm: tuple[float, float, float]) -> None:
    hull = carved(centre_mm)
    leaves = hull.leaves
    assert leaves.volume_mm3() == pytest.approx(BALL_MM3, rel=0.025)
    assert hull.moved_in_mm3 < BALL_MM3 < hull.moved_out_mm3
    weight = leaves.occupancy * leaves.size.astype(float) ** 3
    np.testing.assert_allclose(np.average(leaves.middles_mm, axis=0, weights=weight), centre_mm, atol=0.12)


def test_a_ball_at_the_wall_survives_blind_directions() -> None:
    """Beyond R_o / n_w from the axis some views are blind; carving there, as the thesis does, loses the sphere."""
    centre_mm = (64.0, 0.0, -50.0)
    assert carved(centre_mm).leaves.volume_mm3() == pytest.approx(BALL_MM3, rel=0.15)
    assert carved(centre_mm, ignore_blindness=True).leaves.volume_mm3() < 0.6 * BALL_MM3


def test_a_ball_reaches_as_high_as_enough_views_see() -> None:
    """The pictures say nothing above some row; large nodes that the edge of the blind zone cuts are not blind as a whole."""
    bank, maps = seen_ball(MIDDLE_MM)
    row = float(np.array(distance_maps.project_and_read(bank, maps, mi.UInt32(0), mi.Point3f(0.0, 0.0, -47.3), mi.Bool(True))[0].px.y)[0])
    values = np.array(maps.values).reshape(bank.count, 360, 480)
    values[:, : int(2 * row)] = np.inf
    half = DistanceMaps.from_arrays(values)
    grid = Grid.over(np.array([-12.0, -12.0, -62.0]), np.array([12.0, 12.0, -38.0]), 0.4)
    leaves = carve.carve(bank, half, grid, Water(73.0, -38.0, -62.0), min_votes=5).leaves
    z = np.arange(-50.0, -40.0, 0.05)
    point = mi.Point3f(0.2, 0.2, mi.Float(z))
    told = [distance_maps.project_and_read(bank, half, mi.UInt32(view), point, mi.Bool(True))[2] for view in range(bank.count)]
    votes = np.sum([np.array(one, int) for one in told], axis=0)
    on_axis = np.floor((0.2 - leaves.grid.origin_mm[:2]) / 0.4)
    column = (leaves.index[:, :2] <= on_axis).all(axis=1) & (leaves.index[:, :2] + leaves.size[:, None] > on_axis).all(axis=1)
    top = leaves.grid.origin_mm[2] + 0.4 * (leaves.index[:, 2] + leaves.size)[column].max()
    assert top == pytest.approx(z[votes >= 5].max(), abs=0.41)


def test_surface_is_closed_and_holds_the_volume() -> None:
    leaves = carved(MIDDLE_MM).leaves
    grid = leaves.grid
    mesh = surface.surface(leaves.index, leaves.size, leaves.occupancy, origin_mm=np.asarray(grid.origin_mm), voxel_mm=grid.size_mm)
    assert mesh.is_watertight
    assert abs(mesh.volume) == pytest.approx(leaves.volume_mm3(), rel=0.01)
    np.testing.assert_allclose(mesh.bounds[1] - mesh.bounds[0], 2 * RADIUS_MM, atol=0.35)
