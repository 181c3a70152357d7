"""Memory of the device: halves, parts of an array, and what is given back."""

import os
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from rhizotwin.recon import device

MIB = 2**20


def held_mib() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MIB


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel tells what a process holds on Linux only")
def test_what_is_used_no_more_is_given_back() -> None:
    device.release()
    before = held_mib()
    large = dr.arange(mi.Float, 50 * MIB) + 1.0
    dr.eval(large)
    dr.sync_thread()
    assert held_mib() - before > 190
    del large
    device.release()
    assert held_mib() - before < 30


def test_halves_and_parts_of_arrays() -> None:
    pictures = np.random.default_rng(0).random((3, 4, 5)).astype(np.float32)
    np.testing.assert_allclose(np.array(mi.Float(device.halves(list(pictures)))), pictures.ravel(), atol=2.0**-12)
    parts = device.some_parts(mi.Float(np.arange(12.0, dtype=np.float32)), [2, 0], 4)
    np.testing.assert_array_equal(np.array(parts), [8, 9, 10, 11, 0, 1, 2, 3])
    halves = mi.Float16(np.array([0.0, 2.0**-24, 0.5, -0.0, -1.0], np.float16))
    np.testing.assert_array_equal(np.array(dr.select(device.is_positive(halves), mi.Int32(1), mi.Int32(0))), [0, 1, 1, 0, 0])
