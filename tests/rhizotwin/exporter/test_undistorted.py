"""Undistorted pictures: exact where they say so, and where no refraction is, everywhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.exporter.exports import MOST_POINTS, write_colmap
from rhizotwin.exporter.undistorted import VirtualCamera, best_distance_mm
from rhizotwin.importer.colmap_model import read_colmap
from rhizotwin.recon.optics.cameras import View, project_inner
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Scene

SCENE = Scene(camera=Camera().resized((400, 300)))
HEIGHTS_MM = (-140.0, -12.0)


def view(height_mm: float = -60.0, tilt_deg: float = 1.0) -> View:
    level = frames.level_camera(distance_mm=400.0, height_mm=height_mm, tilt_deg=tilt_deg)
    return View(camera=SCENE.camera, cam_from_canister=level @ frames.rotation_z(np.deg2rad(-40.0)), cam_from_tank=None)


def test_without_refraction_the_pinhole_is_the_camera() -> None:
    air = replace(SCENE, canister=replace(SCENE.canister, n_wall=1.0), water=replace(SCENE.water, n_water=1.0))
    distance_mm, left_px = best_distance_mm(view(), Optics.from_scene(air), HEIGHTS_MM)
    assert distance_mm == pytest.approx(float(np.hypot(*view().centre_mm[:2])), abs=1.0)
    assert left_px < 0.01


def test_points_of_the_plane_show_where_the_pinhole_sees_them() -> None:
    """Dots are drawn where refraction shows points of the plane, and looked for in the undistorted picture."""
    seen, optics = view(), Optics.from_scene(SCENE)
    distance_mm, left_px = best_distance_mm(seen, optics, HEIGHTS_MM)
    camera = VirtualCamera(seen, optics, distance_mm, HEIGHTS_MM)
    right = np.array([-np.sin(camera._azimuth_rad), np.cos(camera._azimuth_rad), 0.0])
    points = np.array([aside * right + [0.0, 0.0, z] for aside in (-45.0, -15.0, 20.0, 50.0) for z in (-30.0, -60.0, -95.0)])
    real = project_inner(seen, optics, points)
    rows, columns = np.mgrid[0:300, 0:400]
    picture = np.zeros((300, 400))
    for u, v in real:
        picture += np.exp(-0.5 * ((columns - u) ** 2 + (rows - v) ** 2) / 1.2**2)
    undistorted = camera.undistort((60000.0 * picture).astype(np.uint16)).astype(float)
    expected = camera.pixels(points)
    np.testing.assert_allclose(camera.shown(points), expected, atol=1e-3)
    assert (expected > 10.0).all()
    assert (expected < np.array([390.0, 290.0])).all()  # whatever the real picture shows
    for u, v in expected:
        near = undistorted[round(v) - 7 : round(v) + 8, round(u) - 7 : round(u) + 8]
        j, i = np.mgrid[0:15, 0:15]
        at = np.array([(i * near).sum(), (j * near).sum()]) / near.sum() + [round(u) - 7, round(v) - 7]
        np.testing.assert_allclose(at, [u, v], atol=0.1)
    assert 0.1 < left_px < 3.0  # the wall's astigmatism is not nothing
    assert not undistorted[:3].any()  # above the water there is no image


MODELS = {"PINHOLE": (0.0, 0.0, 0.0, 0.0, 0.0), "OPENCV": (-0.1, 0.0, 0.001, 0.0, 0.0), "FULL_OPENCV": (-0.1, 0.05, 0.0, 0.0, 0.01)}


@pytest.mark.parametrize("model", MODELS)
def test_colmap_gets_the_simplest_lens_and_points(model: str, tmp_path: Path) -> None:
    """Splatting reads PINHOLE with points only, and nerfstudio's reader of COLMAP models every lens but FULL_OPENCV."""
    camera, points_mm = replace(SCENE.camera, distortion=MODELS[model]), np.arange(6.0 * MOST_POINTS).reshape(-1, 3)
    write_colmap(tmp_path / "colmap", camera, [("a.png", view().cam_from_canister)], points_mm=points_mm)
    assert (tmp_path / "colmap" / "cameras.txt").read_text().splitlines()[1].split()[1] == model
    rows = np.loadtxt(tmp_path / "colmap" / "points3D.txt", skiprows=1, max_rows=2)
    np.testing.assert_allclose(rows[:, :8], [[1, 0, 1, 2, 128, 128, 128, 0], [2, 9, 10, 11, 128, 128, 128, 0]])
    back = read_colmap(tmp_path / "colmap", SCENE.camera)
    assert back.camera == camera
    np.testing.assert_allclose(back.pictures["a.png"].cam_from_canister, view().cam_from_canister, atol=1e-12)
