"""Conversion of numbers for Dr.Jit kernels, and type names for static checkers.

Dr.Jit uses NumPy arrays in place, and compiles a kernel for every combination of inputs that are aligned to 64 bytes
and inputs that are not. Small arrays have arbitrary alignment, so that a kernel with twenty inputs would be compiled
many times (a second each). Arrays are therefore copied to aligned memory.
"""

import ctypes
import gc
from collections.abc import Sequence
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin import engine

# Mitsuba's types exist only once a variant is set, so that a static checker does not know them; these names document
# the intended types.
Float: TypeAlias = Any
"""mi.Float"""
UInt32: TypeAlias = Any
"""mi.UInt32"""
Int32: TypeAlias = Any
"""mi.Int32"""
Bool: TypeAlias = Any
"""mi.Bool"""
Vector2f: TypeAlias = Any
"""mi.Vector2f"""
Vector2u: TypeAlias = Any
"""mi.Vector2u"""
Vector3f: TypeAlias = Any
"""mi.Vector3f"""
Point3f: TypeAlias = Any
"""mi.Point3f"""
Kernel: TypeAlias = Any
"""Any of the above."""

engine.choose_on_first_use()

_ALIGNED = 64
"""Alignment in bytes of the widest vector that Dr.Jit loads."""


TO_LAST = 1.01
"""Minimum distance of look-ups from a picture's width and height: within the last sample, with a margin for float32
rounding."""


_BELOW_HALF = 1e-9
"""Threshold below the smallest positive half, 6e-8, and not representable as a half."""


def readable(px: Vector2f, width: int, height: int) -> Bool:
    """Return which pixels can be read with bilinear interpolation in a picture."""
    return (px.x > 0) & (px.x < width - TO_LAST) & (px.y > 0) & (px.y < height - TO_LAST)


def numbers(values: NDArray[np.generic]) -> Float:
    """Return an array (...) as mi.Float, flattened."""
    return mi.Float(_align(values, np.dtype(np.float32)))


def halves(pictures: Sequence[NDArray[np.generic]]) -> Kernel:
    """Return pictures (H, W) as mi.Float16, flattened and concatenated.

    Half precision stores a coverage to 1/4096, a twentieth of the noise of a picture.
    """
    size = pictures[0].size
    placed = aligned_empty(len(pictures) * size, np.dtype(np.float16))
    for k, picture in enumerate(pictures):
        placed[k * size : (k + 1) * size] = picture.ravel()
    return mi.Float16(placed)


def vectors(values: NDArray[np.generic]) -> Vector3f:
    """Return (N, 3) as mi.Vector3f."""
    return mi.Vector3f(*(numbers(part) for part in values.T))


def points(values: NDArray[np.generic]) -> Point3f:
    """Return (N, 3) as mi.Point3f."""
    return mi.Point3f(*(numbers(part) for part in values.T))


def wholes(values: NDArray[np.generic]) -> UInt32:
    """Return an array (...) of integers as mi.UInt32, flattened."""
    return mi.UInt32(_align(values, np.dtype(np.uint32)))


def _align(values: NDArray[np.generic], kind: np.dtype[np.generic]) -> NDArray[np.generic]:
    placed = aligned_empty(values.size, kind)
    placed[:] = values.ravel()
    return placed


def aligned_empty(count: int, kind: np.dtype[np.generic]) -> NDArray[np.generic]:
    """Return an aligned array (count,) to be filled, which Dr.Jit uses in place."""
    buffer = np.empty(count * kind.itemsize + _ALIGNED, np.uint8)
    begin = -buffer.ctypes.data % _ALIGNED
    return buffer[begin : begin + count * kind.itemsize].view(kind)


def release() -> None:
    """Release unused memory.

    Dr.Jit and the C library (glibc) cache freed memory for reuse, but later stages need other sizes. Memory referenced
    by loops of Dr.Jit is only freed by Python's cyclic garbage collector.
    """
    gc.collect()
    dr.flush_malloc_cache()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def select_parts(source: Kernel, which: Sequence[int], size: int) -> Kernel:
    """Return some of the consecutive parts, of ``size`` elements each, of an array."""
    lane, length = dr.arange(mi.UInt32, len(which) * size), dr.opaque(mi.UInt32, size)
    part = lane // length
    found = dr.gather(type(source), source, dr.gather(mi.UInt32, wholes(np.asarray(which)), part) * length + (lane - part * length))
    dr.eval(found)
    return found


def is_positive(half: Kernel) -> Bool:
    """Return which elements (mi.Float16) are positive.

    They are converted to mi.Float and compared with a number that is not a half. Below version 22, LLVM swaps the
    operands of a masked comparison of halves on processors with AVX512-FP16 (llvm-project issue 159723), and it narrows
    a comparison of floats to one of halves if the constant is a half.
    """
    return mi.Float(half) > _BELOW_HALF


def bilinear(
    source: Kernel,
    base: UInt32,
    width: UInt32 | int,
    u: Float,
    v: Float,
    active: Bool = True,
    kind: type | None = None,
    most: float | None = None,
) -> Kernel:
    """Interpolate bilinearly in a picture.

    Parameters
    ----------
    source : mi.Float or mi.Float16
        Pictures, flattened.
    base : mi.UInt32
        Offset of the picture, in elements of ``kind``.
    width : mi.UInt32 or int
        Number of columns of the picture.
    u, v : mi.Float
        Column and row, between the first and the last.
    kind : type, optional
        Type of an element; by default that of the source. Halves are converted to mi.Float.
    most : float, optional
        Upper bound of an element.
    """
    kind = kind or type(source)
    column, row = mi.UInt32(u), mi.UInt32(v)
    fu, fv = u - mi.Float(column), v - mi.Float(row)
    at = base + row * width + column
    c00, c01, c10, c11 = (dr.gather(kind, source, at + step, active) for step in (0, 1, width, width + 1))
    if kind is mi.Float16:
        c00, c01, c10, c11 = (mi.Float(corner) for corner in (c00, c01, c10, c11))
    if most is not None:
        c00, c01, c10, c11 = (dr.minimum(corner, most) for corner in (c00, c01, c10, c11))
    return (1 - fv) * ((1 - fu) * c00 + fu * c01) + fv * ((1 - fu) * c10 + fu * c11)
