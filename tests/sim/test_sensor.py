"""The camera: rays inside Mitsuba against OpenCV's formulas, converter and noise."""

from dataclasses import replace
from typing import Any

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special, stats

from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera
from rhizotwin.sim import sensor
from rhizotwin.sim.exposure import expose, photons

STRONG = (-0.25, 0.08, 0.003, -0.002, 0.02)


def rays(camera: Camera, pixels: NDArray[Any], lens: tuple[float, float] = (0.5, 0.5), **options: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Origins and directions (N, 3) of the rays through OpenCV pixel coordinates (N, 2), camera frame."""
    eye = mi.load_dict(sensor.sensor_dict(camera, **options))
    on_film = (pixels + 0.5) / np.array(camera.image_wh)
    ray, _ = eye.sample_ray(0.0, 0.0, mi.Point2f(on_film[:, 0], on_film[:, 1]), mi.Point2f(*lens))
    return np.array(ray.o + dr.zeros(mi.Float, len(pixels))).T, np.array(ray.d).T


def test_rays_run_through_what_opencv_projects_to_their_pixel() -> None:
    camera = replace(Camera(), focal_px=(900.0, 905.0), principal_px=(410.0, 290.0))
    pixels = np.random.default_rng(0).uniform((-0.5, -0.5), (799.5, 599.5), (200, 2))
    _, directions = rays(camera, pixels, distortion=STRONG)
    matrix = np.array([[900.0, 0.0, 410.0], [0.0, 905.0, 290.0], [0.0, 0.0, 1.0]])
    back, _ = cv2.projectPoints(directions.astype(np.float64), np.zeros(3), np.zeros(3), matrix, np.array(STRONG))
    np.testing.assert_allclose(back.reshape(-1, 2), pixels, atol=1e-3)


@pytest.mark.parametrize("lens", [(0.0, 0.5), (0.9, 0.1)])
def test_a_thin_lens_gathers_its_rays_in_the_plane_of_focus(lens: tuple[float, float]) -> None:
    pixels = np.array([[100.0, 50.0], [700.0, 500.0]])
    pinhole, straight = rays(Camera(), pixels, distortion=STRONG)
    origin, bent = rays(Camera(), pixels, lens, distortion=STRONG, aperture_mm=4.0, focus_mm=350.0)
    assert np.all(np.linalg.norm(origin - pinhole, axis=1) > 0.5)
    assert np.all(np.linalg.norm(origin - pinhole, axis=1) <= 2.0 + 1e-5)
    np.testing.assert_allclose(origin + bent * (350.0 / bent[:, 2:]), straight * (350.0 / straight[:, 2:]), atol=1e-3)


def test_a_perfect_camera_only_rounds_and_clips() -> None:
    light = np.array([[0.0, 0.5, 1.0, 1.7, -0.1]], dtype=np.float32)
    stored = expose(light, Camera(bits=12), Disturbances(), rng=np.random.default_rng(0))
    assert stored.dtype == np.uint16
    np.testing.assert_array_equal(stored >> 4, [[0, 2048, 4095, 4095, 0]])
    np.testing.assert_array_equal(stored & 15, 0)
    np.testing.assert_array_equal(expose(light, Camera(bits=8), Disturbances(), rng=np.random.default_rng(0)), [[0, 128, 255, 255, 0]])


def test_noise_is_that_of_counted_photons() -> None:
    level = 0.1
    light = np.full((200, 200), level, dtype=np.float32)
    noisy = expose(light, Camera(bits=16), Disturbances(full_well_e=5000.0, read_noise_e=4.0), rng=np.random.default_rng(1)) / 65535.0
    assert noisy.mean() == pytest.approx(level, rel=2e-3)
    assert noisy.std() * 5000.0 == pytest.approx(np.sqrt(level * 5000.0 + 16.0), rel=0.03)


@pytest.mark.parametrize("mean", [0.3, 24.0, 25.0, 8000.0])
def test_photons_are_poisson_quantiles(mean: float) -> None:
    chance = np.linspace(-5.0, 5.0, 2001)
    found = photons(np.full(len(chance), mean), chance)
    exact = stats.poisson.ppf(special.ndtr(chance), mean)
    assert np.abs(found - exact).max() <= (1.0 if mean >= 25.0 else 0.0)
    weight = np.exp(-0.5 * chance**2)
    assert weight @ (found != exact) < 0.01 * weight.sum()


def test_a_last_bit_that_differs_leaves_the_noise_of_others() -> None:
    light = np.full((100, 100), 0.3, dtype=np.float32)
    pictures = []
    for last in (0.3, 0.3 * (1.0 + 1e-6)):
        light[::7, ::5] = last
        pictures.append(expose(light, Camera(bits=12), Disturbances(full_well_e=8000.0), rng=np.random.default_rng(2)).astype(int) >> 4)
    changed = pictures[0] != pictures[1]
    assert changed.sum() <= 3
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
