"""Given cameras: what they see of silhouettes that were made in air, where neither rim nor floor hides anything."""

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.cameras import cam_pixels, project, project_inner
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures


@pytest.mark.parametrize("rho_mm", [0.5, 40.0, 90.0])
def test_a_camera_straight_above_silhouettes_in_air_sees_all_of_them(tmp_path: Path, rho_mm: float) -> None:
    scene = replace(Scene(), canister=replace(Scene().canister, n_wall=1.0), water=replace(Scene().water, n_water=1.0))
    down = np.array([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -rho_mm], [0.0, 0.0, -1.0, 350.0], [0.0, 0.0, 0.0, 1.0]])
    poses = [down @ frames.rotation_z(turn) for turn in (0.0, 1.0, 2.0)]
    listed = tuple(Frame(file="", sha256="", cam_from_canister=exact_pictures.rows(pose)) for pose in poses)
    dataset = Dataset(folder=tmp_path, scene=scene, frames=listed, masks=True)
    cameras = find_cameras(Pictures(dataset=dataset, frames=listed, images=()), monitor=Monitor())
    points = np.random.default_rng(0).uniform([-45.0, -45.0, -110.0], [45.0, 45.0, -20.0], (500, 3)).astype(np.float32).astype(float)
    expected = cam_pixels(scene.camera, frames.apply(poses[1], points))
    np.testing.assert_allclose(project_inner(cameras.views[1], cameras.optics, points), expected, atol=1e-9)
    px, count = project(cameras.views[1], cameras.optics, points)
    np.testing.assert_allclose(px[:, 0], expected, atol=1e-9)
    assert (count == 1).all()
    bank, views = ViewBank.pack(cameras.views, cameras.optics), mi.UInt32(np.ones(500))
    found = projection.project(bank, views, mi.Point3f(points.T.astype(np.float32)), mi.Bool([True] * 500))
    assert np.array(found.visible).all()
    np.testing.assert_allclose(np.array(found.px).T, expected, atol=1e-3)
    for axis, step in enumerate(1e-3 * np.eye(3)):
        slope = (cam_pixels(scene.camera, frames.apply(poses[1], points + step)) - expected) / 1e-3
        np.testing.assert_allclose(np.stack([found.du[axis], found.dv[axis]], axis=1), slope, atol=2e-3)


@pytest.mark.parametrize(("n_water", "masks", "top_seen"), [(1.0, True, True), (1.0, False, False), (1.333, True, False)])
def test_silhouettes_made_in_air_show_what_lies_under_the_rim(tmp_path: Path, n_water: float, masks: bool, top_seen: bool) -> None:
    scene = Scene()
    scene = replace(scene, plan=CapturePlan(rings=(Ring(views=5, height_mm=150.0, tilt_deg=25.0),)))
    scene = replace(scene, canister=replace(scene.canister, n_wall=n_water), water=replace(scene.water, n_water=n_water))
    poses = [view.cam_from_canister for view in exact_pictures.views_of(scene)]
    listed = tuple(Frame(file="", sha256="", cam_from_canister=exact_pictures.rows(pose)) for pose in poses)
    dataset = Dataset(folder=tmp_path, scene=scene, frames=listed, masks=masks)
    cameras = find_cameras(Pictures(dataset=dataset, frames=listed, images=()), monitor=Monitor())
    top = np.array([0.0, 0.0, scene.net_pot.grid_z_mm - 1.0])
    found = projection.project(
        ViewBank.pack(cameras.views, cameras.optics), mi.UInt32(np.arange(5)), mi.Point3f(*map(mi.Float, top)), mi.Bool([True] * 5)
    )
    assert np.array(found.visible).tolist() == [top_seen] * 5
    if n_water == 1.0 and top_seen:
        focal, middle = np.array(scene.camera.focal_px), np.array(scene.camera.principal_px)
        for k, pose in enumerate(poses):
            at = frames.apply(pose, top[None])[0]
            expected = middle + focal * at[:2] / at[2]
            assert np.allclose([found.px.x[k], found.px.y[k]], expected, atol=1e-3)
