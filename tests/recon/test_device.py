"""Arrays on the device: halves and parts."""

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.recon import device


def test_halves_and_parts_of_arrays() -> None:
    pictures = np.random.default_rng(0).random((3, 4, 5)).astype(np.float32)
    np.testing.assert_allclose(np.array(mi.Float(device.halves(list(pictures)))), pictures.ravel(), atol=2.0**-12)
    parts = device.select_parts(mi.Float(np.arange(12.0, dtype=np.float32)), [2, 0], 4)
    np.testing.assert_array_equal(np.array(parts), [8, 9, 10, 11, 0, 1, 2, 3])
    halves = mi.Float16(np.array([0.0, 2.0**-24, 0.5, -0.0, -1.0], np.float16))
    np.testing.assert_array_equal(np.array(dr.select(device.is_positive(halves), mi.Int32(1), mi.Int32(0))), [0, 1, 1, 0, 0])
