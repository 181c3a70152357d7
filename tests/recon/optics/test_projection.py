"""The Dr.Jit kernel against the float64 reference, and its closed form against brute-force ray tracing: vector Snell at each wall."""

from dataclasses import replace
from functools import cache

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.projection import all_images, images_swept, points_on_rays
from rhizotwin.recon.optics import cameras, projection, refraction, start_tables
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Canister, Scene, Water

LENS = Camera(distortion=(-0.05, 0.02, 0.001, -0.002, 0.001))


@cache
def bank_and_view(n_wall: float = 1.49, n_water: float = 1.333, *, sways: bool = False):
    """Return two views, the second of which is turned, shifted and may sway, that second view, and its optics."""
    level = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=2.0)
    aside = frames.from_rotvec(np.array([0.01, 0.02, -0.01]), np.array([1.0, 2.0, 3.0])) @ level @ frames.rotation_z(0.7)
    view = cameras.View(camera=LENS, cam_from_canister=aside, sway=(0.004, -0.003, 2e-4) if sways else cameras.STILL)
    optics = refraction.Optics.from_scene(Scene(camera=LENS, canister=Canister(n_wall=n_wall), water=Water(n_water=n_water)))
    return projection.ViewBank.pack([cameras.View(camera=LENS, cam_from_canister=level), view], optics), view, optics


def test_points_beyond_the_fold_of_a_lens_are_not_seen() -> None:
    """Beyond the fold, the distortion would project points 350 px below the picture into it."""
    lens = Camera(distortion=(-0.5, 0.0, 0.0, 0.0, 0.0))
    optics = refraction.Optics.from_scene(Scene(camera=lens, canister=Canister(height_mm=300.0)))
    bent = cameras.View(camera=lens, cam_from_canister=frames.level_camera(distance_mm=150.0, height_mm=-30.0, tilt_deg=0.0))
    points = random_points(optics, 2000) * [0.5, 0.5, 2.4]
    found, straight = (in_kernel(projection.ViewBank.pack([view] * 2, optics), points) for view in (bent, replace(bent, camera=Camera())))
    beyond = (((straight["px"].T - lens.principal_px) / lens.focal_px) ** 2).sum(axis=1) > 1.0 / 1.5  # 3 |k1| r^2 = 1
    assert (straight["visible"] & beyond).sum() > 200
    np.testing.assert_array_equal(found["visible"], straight["visible"] & ~beyond)
    px, count = all_images(bent, optics, points[beyond])
    assert np.isnan(px).all()
    assert (count == 0).all()


def test_what_sways_is_seen_where_it_is() -> None:
    bank, view, optics = bank_and_view(sways=True)
    points = random_points(optics, 1000) * [0.8, 0.8, 1.0]
    found = in_kernel(bank, points)
    seen = found["visible"]
    still = all_images(replace(view, sway=cameras.STILL), optics, cameras.apply_sway(view, optics, points))[0][:, 0]
    np.testing.assert_allclose(all_images(view, optics, points)[0][seen, 0], still[seen])
    assert np.abs(found["px"].T[seen] - still[seen]).max() < 1e-3
    deep = optics.water_z_mm - points[:, 2]
    np.testing.assert_allclose(cameras.apply_sway(view, optics, points)[:, 0], points[:, 0] + deep * (0.004 - 2e-4 * points[:, 1]))


def in_kernel(bank: projection.ViewBank, points: np.ndarray) -> dict[str, np.ndarray]:
    p = projection.project(
        bank, dr.full(mi.UInt32, 1, len(points)), mi.Point3f(points.T.astype(np.float32)), dr.full(mi.Bool, True, len(points))
    )
    found = {name: getattr(p, name) for name in ("px", "visible", "clear_mm", "du", "dv")}
    dr.eval(found)  # in one kernel
    return {name: np.array(part) for name, part in found.items()}


def random_points(optics: refraction.Optics, count: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    angle, radius = rng.uniform(-np.pi, np.pi, count), (optics.inner_radius_mm - 0.01) * np.sqrt(rng.uniform(0, 1, count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-115, -10, count)], axis=1)


@pytest.mark.parametrize(("n_wall", "n_water"), [(1.49, 1.333), (1.0, 1.0), (1.49, 1.36)])
def test_kernel_agrees_with_the_reference(n_wall: float, n_water: float) -> None:
    bank, view, optics = bank_and_view(n_wall, n_water)
    points = random_points(optics, 2000)
    expected, count = all_images(view, optics, points)
    found = in_kernel(bank, points)
    seen = found["visible"]
    assert (count[seen] == 1).all(), "the kernel uses a view only where the point has exactly one image"
    assert np.abs(found["px"].T[seen] - expected[seen, 0]).max() < 1e-3
    lost = (count == 1) & ~seen
    assert lost.mean() < 0.03, "only a thin rim of the blind zone is given away"
    if n_water > 1.0:
        assert np.hypot(*points[lost, :2].T).min() > 54.0


@pytest.mark.parametrize("sways", [False, True])
def test_gradients_agree_with_finite_differences(sways: bool) -> None:
    bank, view, optics = bank_and_view(sways=sways)
    points = random_points(optics, 150)
    found = in_kernel(bank, points)
    step = 1e-3
    for axis in range(3):
        shift = np.eye(3)[axis] * step
        up, down = (cameras.project_inner(view, optics, points + s * shift) for s in (1, -1))
        good = found["visible"] & np.isfinite(up - down).all(axis=1)
        slope = (up[good] - down[good]) / (2 * step)
        np.testing.assert_allclose(np.stack([found["du"][axis], found["dv"][axis]], axis=1)[good], slope, atol=3e-3)


def test_clear_distance_reaches_no_blind_point() -> None:
    bank, view, optics = bank_and_view()
    points, rng = random_points(optics, 400), np.random.default_rng(2)
    clear = in_kernel(bank, points)["clear_mm"]
    angle, away = rng.uniform(-np.pi, np.pi, len(points)), (clear - start_tables.CELL_MM) * rng.uniform(0, 1, len(points))
    near = points + np.stack([away * np.cos(angle), away * np.sin(angle), np.zeros(len(points))], axis=1)
    inside = (np.hypot(near[:, 0], near[:, 1]) < optics.inner_radius_mm) & (clear > 2 * start_tables.CELL_MM)
    assert (all_images(view, optics, near[inside])[1] == 1).all()


def a_view(scene: Scene, *, azimuth_deg: float, tilt_deg: float, height_mm: float) -> cameras.View:
    level = frames.level_camera(distance_mm=400.0, height_mm=height_mm, tilt_deg=tilt_deg)
    aside = frames.from_rotvec(np.array([0.01, -0.02, 0.03]), np.array([2.0, -1.0, 3.0]))
    return cameras.View(camera=scene.camera, cam_from_canister=aside @ level @ frames.rotation_z(np.deg2rad(azimuth_deg)))


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
    found, count = all_images(view, optics, points)
    error = np.linalg.norm(found - px[:, None], axis=-1)
    assert (count >= 1).all()
    # Near a caustic, where two images merge, the pixel changes as the square root of the distance by which a ray misses.
    assert (np.where(np.isnan(error), np.inf, error).min(axis=1) < np.where(count > 1, 1e-3, 1e-6)).all()


def test_seen_or_blind_agrees_with_a_dense_sweep_of_traced_rays() -> None:
    """Count the images of points by sweeping traced rays over the canister's width at each point's own height."""
    scene = Scene()
    optics = refraction.Optics.from_scene(scene)
    view = a_view(scene, azimuth_deg=20.0, tilt_deg=0.0, height_mm=-60.0)
    rng = np.random.default_rng(3)
    angle, radius = rng.uniform(-np.pi, np.pi, 300), optics.inner_radius_mm * np.sqrt(rng.uniform(0.3, 0.999, 300))
    z = float(view.centre_mm[2])
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(300, z)], axis=1)
    _, count = all_images(view, optics, points)
    swept = images_swept(view, optics, points)
    assert set(np.unique(swept)) == {0, 1, 2}
    np.testing.assert_array_equal(count, swept)


def test_with_indices_of_one_projection_is_the_pinhole() -> None:
    scene = Scene(camera=LENS, canister=Canister(n_wall=1.0), water=Water(n_water=1.0))
    view = a_view(scene, azimuth_deg=77.0, tilt_deg=5.0, height_mm=-30.0)
    rng = np.random.default_rng(0)
    points = rng.uniform([-40, -40, -110], [40, 40, -20], (200, 3))
    found, count = all_images(view, refraction.Optics.from_scene(scene), points)
    rotation = cv2.Rodrigues(view.cam_from_canister[:3, :3])[0]
    lens = cameras.matrix(scene.camera), np.array(LENS.distortion)
    expected = cv2.projectPoints(points, rotation, view.cam_from_canister[:3, 3], *lens)[0].reshape(-1, 2)
    assert (count == 1).all()
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-7)
