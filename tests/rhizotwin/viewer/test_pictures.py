"""Points, roots and outlines that are drawn over the pictures."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.projection import all_images
from rhizotwin.drawing import through_water
from rhizotwin.drawing.through_water import Pictures
from rhizotwin.recon.calibration.cameras import BareUncertainty, Camera, Cameras
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.calibration_summary import summarize_cameras
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.stored.result_files import read_summary
from rhizotwin.viewer.shown import Shown
from tests.rhizotwin import plant as plants


def test_pixels_are_those_of_the_reference(plant: plants.Plant):
    found = Pictures.of(load_dataset(plant.dataset), {"views": [], "rig": {}} | read_summary(plant.result))
    points = np.concatenate([root.points_mm for root in plant.roots])[::7]
    reference, count = zip(*(all_images(found.views[place], found.optics, points) for place in (0, 3)), strict=True)
    assert (np.array(count) == 1).all()
    assert np.array([found.pixels(place, points) for place in (0, 3)]) == pytest.approx(np.array(reference)[:, :, 0], abs=1e-6)


def test_stored_cameras_project_like_the_calibrated_cameras(plant: plants.Plant):
    """The scale of the scene is 0.22 mm per pixel, that of the pictures 0.11; the roots sway by 0.3 mm at their tips."""
    dataset = load_dataset(plant.dataset)
    given = replace(dataset.scene.camera, kind="telecentric", mm_per_px=0.22)
    scene = replace(dataset.scene, camera=given)
    lens = replace(given, mm_per_px=0.11)
    pose = lens.pinhole_pose(frames.level_camera(distance_mm=400.0, height_mm=-60.0, tilt_deg=0.0))
    one = Camera(file=dataset.frames[0].file, ring=0, used=True, cam_from_canister=pose, sway=(0.0, 0.003, 0.0))
    bare = BareUncertainty(scale=1e-3, azimuth_rad=1e-3, lift_mm=0.1, mm_per_px=0.11)
    made = Cameras(lens=lens.as_pinhole(), optics=Optics.from_scene(scene), all=(one,), order=(0,), bare=bare)
    rig = summarize_cameras(made)
    stored = {"file": one.file, "used": True, "cam_from_canister": pose.tolist(), "sway": list(one.sway)}
    found = Pictures.of(replace(dataset, scene=scene), {"views": [stored], "rig": rig})
    points = np.array([[0.0, 2.0, -80.0], [3.0, -4.0, -120.0]])
    assert found.pixels(0, points) == pytest.approx(cameras.project_inner(made.views[0], made.optics, points), abs=1e-9)
    del rig["mm_per_px"], stored["sway"]  # as in results of earlier versions
    assert Pictures.of(replace(dataset, scene=scene), {"views": [stored], "rig": rig}).views[0].camera == given.as_pinhole()


def test_outlines_lie_on_the_roots_and_are_those_of_the_union(shown: Shown):
    pictures, lines = shown.pictures, shown.session.state.lines
    plain = pictures.draw_outline(0, None, {}).astype(int)  # eight times as large as the picture
    marked = (pictures.draw_outline(0, shown.surface(), lines) != plain).any(axis=2)
    assert 50 < marked.sum() < 0.02 * marked.size
    roots = cv2.dilate((plain[..., 0] < 250).astype(np.uint8), np.ones((17, 17), np.uint8)) > 0  # within a pixel of the picture
    assert roots[marked].mean() > 0.98
    outline = (pictures.draw_outline(0, None, lines) != plain).any(axis=2)
    mask = through_water.fill(pictures._tubes(0, lines, plain.shape[1] // 200, thickest_mm=np.inf), plain.shape[:2])
    inside = cv2.erode(mask, np.ones((5, 5), np.uint8)) > 0
    assert inside.sum() > 1000
    assert not outline[inside].any()  # no edge of one tube inside another
    selected = pictures.draw_outline(0, shown.surface(), lines, selected=[1]).astype(int)
    assert ((selected[..., 1] > 180) & (selected[..., 2] < 60)).sum() > 50  # yellow


def test_filled_polygons_are_their_union():
    triangles = np.random.default_rng(0).uniform(-5.0, 45.0, (30, 3, 2))
    triangles[3, 1, 0] = np.nan
    y, x = np.mgrid[:40, :37].astype(float)
    inside = np.zeros(x.shape, bool)
    for corners in np.delete(triangles, 3, axis=0):
        ahead = np.roll(corners, -1, axis=0) - corners
        side = [u * (y - b) - v * (x - a) for (a, b), (u, v) in zip(corners, ahead, strict=True)]
        inside |= (np.array(side) > 0.0).all(axis=0) | (np.array(side) < 0.0).all(axis=0)
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(through_water.fill([triangles[:20], triangles[20:]], x.shape) > 0, inside)
