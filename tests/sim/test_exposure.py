"""The camera's converter and noise."""

import numpy as np
import pytest

from rhizotwin.scenes.model import Camera, Disturbances
from rhizotwin.sim.exposure import expose, mask_picture


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


def test_masks_use_all_of_16_bits() -> None:
    np.testing.assert_array_equal(mask_picture(np.array([[0.0, 0.5, 1.0]])), [[0, 32768, 65535]])
