"""Numbers for Dr.Jit's kernels.

Dr.Jit takes an array of NumPy as it lies in memory, and compiles a kernel anew for every combination of inputs that begin at a multiple of
64 bytes and inputs that do not. Small arrays begin anywhere, so that a kernel of twenty inputs would be compiled time and again (a second
each). These are copied to where they begin at a multiple of 64 bytes.
"""

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

_ALIGNED = 64
"""Bytes of the widest vector that Dr.Jit loads."""


def numbers(values: NDArray[Any]) -> Any:
    """Return mi.Float of an array, flattened."""
    return mi.Float(_aligned(values, np.dtype(np.float32)))


def vectors(values: NDArray[Any]) -> Any:
    """Return mi.Vector3f of (N, 3)."""
    return mi.Vector3f(*(numbers(part) for part in values.T))


def wholes(values: NDArray[Any]) -> Any:
    """Return mi.UInt32 of an array of whole numbers, flattened."""
    return mi.UInt32(_aligned(values, np.dtype(np.uint32)))


def _aligned(values: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    buffer = np.empty(values.size * kind.itemsize + _ALIGNED, np.uint8)
    begin = -buffer.ctypes.data % _ALIGNED
    placed = buffer[begin : begin + values.size * kind.itemsize].view(kind)
    placed[:] = values.ravel()
    return placed
