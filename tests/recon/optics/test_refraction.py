"""The closed form against brute-force ray tracing: vector Snell at each wall."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.projection import images_swept, points_on_rays
from rhizotwin.recon.optics import cameras, refraction
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Canister, Scene, Water


def a_view(scene: Scene, *, azimuth_deg: float, tilt_deg: float, height_mm: float) -> cameras.View:
    level = frames.level_camera(distance_mm=400.0, height_mm=height_mm, tilt_deg=tilt_deg)
    aside = frames.from_rotvec(np.array([0.01, -0.02, 0.03]), np.array([2.0, -1.0, 3.0]))
    return cameras.View(camera=scene.camera, cam_from_canister=aside @ level @ frames.rotation_z(np.deg2rad(azimuth_deg)))


LENS = Camera(distortion=(-0.05, 0.02, 0.001, -0.002, 0.001))


@settings(max_examples=8, deadline=None)
@given(
    azimuth_deg=st.floats(-180, 180),
    tilt_deg=st.floats(-10, 35),
    n_water=st.sampled_from([1.0, 1.333, 1.36]),
    n_wall=st.sampled_from([1.0, 1.49]),
    seed=st.integers(0, 2**31),
)
def test_points_on_traced_rays_project_back_to_their_pixel(azimuth_deg, tilt_deg, n_water, n_wall, seed) -> None:
    scene = Scene(camera=LENS, canister=Canister(n_wall=n_wall), water=Water(n_water=n_water))
    optics = refraction.Optics.from_scene(scene)
    view = a_view(scene, azimuth_deg=azimuth_deg, tilt_deg=tilt_deg, height_mm=-42.0 + 8.0 * tilt_deg)
    px, points = points_on_rays(view, optics, np.random.default_rng(seed), 150)
    found, count = cameras.project(view, optics, points)
    error = np.linalg.norm(found - px[:, None], axis=-1)
    assert (count >= 1).all()
    assert (np.where(np.isnan(error), np.inf, error).min(axis=1) < 1e-6).all()


def test_seen_or_blind_agrees_with_a_dense_sweep_of_traced_rays() -> None:
    """Count the images of points by sweeping traced rays over the canister's width at each point's own height."""
    scene = Scene()
    optics = refraction.Optics.from_scene(scene)
    view = a_view(scene, azimuth_deg=20.0, tilt_deg=0.0, height_mm=-60.0)
    rng = np.random.default_rng(3)
    angle, radius = rng.uniform(-np.pi, np.pi, 300), optics.inner_radius_mm * np.sqrt(rng.uniform(0.3, 0.999, 300))
    z = float(view.centre_mm[2])
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(300, z)], axis=1)
    _, count = cameras.project(view, optics, points)
    swept = images_swept(view, optics, points)
    assert set(np.unique(swept)) == {0, 1, 2}
    np.testing.assert_array_equal(count, swept)


def test_with_indices_of_one_projection_is_the_pinhole() -> None:
    scene = Scene(camera=LENS, canister=Canister(n_wall=1.0), water=Water(n_water=1.0))
    view = a_view(scene, azimuth_deg=77.0, tilt_deg=5.0, height_mm=-30.0)
    rng = np.random.default_rng(0)
    points = rng.uniform([-40, -40, -110], [40, 40, -20], (200, 3))
    found, count = cameras.project(view, refraction.Optics.from_scene(scene), points)
    rotation = cv2.Rodrigues(view.cam_from_canister[:3, :3])[0]
    lens = cameras.matrix(scene.camera), np.array(LENS.distortion)
    expected = cv2.projectPoints(points, rotation, view.cam_from_canister[:3, 3], *lens)[0].reshape(-1, 2)
    assert (count == 1).all()
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-7)
