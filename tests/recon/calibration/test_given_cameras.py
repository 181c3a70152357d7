"""Given cameras: what they see of silhouettes that were made in air, where neither rim nor floor hides anything."""

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull import exact_pictures


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
