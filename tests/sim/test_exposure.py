"""The camera's converter and noise."""

import numpy as np
import pytest
from scipy import special, stats

from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera
from rhizotwin.sim.exposure import expose, photons


def test_a_perfect_camera_only_rounds_and_clips() -> None:
    light = np.array([[0.0, 0.5, 1.0, 1.7, -0.1]], dtype=np.float32)
    stored = expose(light, Camera(bits=12), Disturbances(), rng=np.random.default_rng(0))
    assert stored.dtype == np.uint16
    np.testing.assert_array_equal(stored >> 4, [[0, 2048, 4095, 4095, 0]])
    np.testing.assert_array_equal(stored & 15, 0)
    np.testing.assert_array_equal(expose(light, Camera(bits=8), Disturbances(), rng=np.random.default_rng(0)), [[0, 128, 255, 255, 0]])


@pytest.mark.parametrize("level", [0.1, 0.6])
def test_noise_is_that_of_counted_photons(level: float) -> None:
    light = np.full((200, 200), level, dtype=np.float32)
    noisy = expose(light, Camera(bits=16), Disturbances(full_well_e=5000.0, read_noise_e=4.0), rng=np.random.default_rng(1)) / 65535.0
    assert noisy.mean() == pytest.approx(level, rel=2e-3)
    assert noisy.std() * 5000.0 == pytest.approx(np.sqrt(level * 5000.0 + 16.0), rel=0.03)


@pytest.mark.parametrize("mean", [0.0, 0.3, 24.0, 25.0, 8000.0])
def test_photons_are_poisson_quantiles(mean: float) -> None:
    chance = np.linspace(-5.0, 5.0, 2001)
    found = photons(np.full(len(chance), mean), chance)
    exact = stats.poisson.ppf(special.ndtr(chance), mean)
    assert np.abs(found - exact).max() <= (1.0 if mean >= 25.0 else 0.0)
    weight = np.exp(-0.5 * chance**2)
    assert weight @ (found != exact) < 0.01 * weight.sum()


def test_a_pixel_that_differs_in_its_last_bit_leaves_the_noise_of_all_others() -> None:
    light = np.full((100, 100), 0.3, dtype=np.float32)
    pictures = []
    for last in (0.3, 0.3 * (1.0 + 1e-6)):
        light[::7, ::5] = last
        pictures.append(expose(light, Camera(bits=12), Disturbances(full_well_e=8000.0), rng=np.random.default_rng(2)).astype(int) >> 4)
    changed = pictures[0] != pictures[1]
    assert changed.sum() <= 3
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
