"""Conversion of NumPy arrays to Dr.Jit arrays, and names of Mitsuba's types for static type checkers.

Dr.Jit uses NumPy arrays without copying them. It compiles a separate kernel for every combination of inputs that are
aligned to 64 bytes and inputs that are not. Small NumPy arrays have arbitrary alignment, so a kernel with twenty inputs
would be compiled many times, at one second each. This module therefore copies arrays to aligned memory.

A number from Python is a literal of the kernel, so that another value requires another kernel. Numbers that depend on
the scan, such as the size of the pictures, are therefore passed as inputs (`drjit.opaque`).
"""

import ctypes
import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from rhizotwin import engine

# Mitsuba's types exist only after a variant is set, so static checkers do not know them. These names document the
# intended types.
Float: TypeAlias = Any
"""Array of type mi.Float."""
UInt32: TypeAlias = Any
"""Array of type mi.UInt32."""
Int32: TypeAlias = Any
"""Array of type mi.Int32."""
Bool: TypeAlias = Any
"""Array of type mi.Bool."""
Vector2f: TypeAlias = Any
"""Array of type mi.Vector2f."""
Vector2u: TypeAlias = Any
"""Array of type mi.Vector2u."""
Vector3f: TypeAlias = Any
"""Array of type mi.Vector3f."""
Point3f: TypeAlias = Any
"""Array of type mi.Point3f."""
Kernel: TypeAlias = Any
"""Any of the Dr.Jit array types above."""

engine.choose_on_first_use()

_ALIGNED = 64
"""Memory alignment of the widest vector that Dr.Jit loads, bytes."""


TO_LAST = 1.01
"""Minimum difference between the width or height of a picture and an interpolated position, px. With this difference,
the interpolation uses only samples of the picture, even after float32 rounding."""


_BELOW_HALF = 1e-9
"""Threshold above which a half-precision number counts as positive. The threshold is less than the smallest positive
half-precision number, 6e-8, and cannot itself be represented in half precision."""


def readable(px: Vector2f, width: UInt32, height: UInt32) -> Bool:
    """Return whether each position lies within a picture, so that it can be interpolated bilinearly.

    The result is mi.Bool, with one element per position.
    """
    return (px.x > 0) & (px.x < mi.Float(width) - TO_LAST) & (px.y > 0) & (px.y < mi.Float(height) - TO_LAST)


def numbers(values: NDArray[np.generic]) -> Float:
    """Convert an array (...) to a flat mi.Float."""
    return mi.Float(_align(values, np.dtype(np.float32)))


def halves(pictures: Sequence[NDArray[np.generic]]) -> Kernel:
    """Convert pictures (H, W) to one flat mi.Float16, concatenated in the given order.

    Half precision resolves coverage to 1/4096, which is a twentieth of a picture's noise.
    """
    size = pictures[0].size
    placed = aligned_empty(len(pictures) * size, np.dtype(np.float16))
    for k, picture in enumerate(pictures):
        placed[k * size : (k + 1) * size] = picture.ravel()
    return mi.Float16(placed)


def vectors(values: NDArray[np.generic]) -> Vector3f:
    """Convert an array (N, 3) to mi.Vector3f."""
    return mi.Vector3f(*(numbers(part) for part in values.T))


def points(values: NDArray[np.generic]) -> Point3f:
    """Convert an array (N, 3) to mi.Point3f."""
    return mi.Point3f(*(numbers(part) for part in values.T))


def wholes(values: NDArray[np.generic]) -> UInt32:
    """Convert an array (...) of non-negative integers to a flat mi.UInt32."""
    return mi.UInt32(_align(values, np.dtype(np.uint32)))


def _align(values: NDArray[np.generic], kind: np.dtype[np.generic]) -> NDArray[np.generic]:
    placed = aligned_empty(values.size, kind)
    placed[:] = values.ravel()
    return placed


def aligned_empty(count: int, kind: np.dtype[np.generic]) -> NDArray[np.generic]:
    """Allocate an uninitialised array (count,) in aligned memory, which Dr.Jit uses without copying."""
    buffer = np.empty(count * kind.itemsize + _ALIGNED, np.uint8)
    begin = -buffer.ctypes.data % _ALIGNED
    return buffer[begin : begin + count * kind.itemsize].view(kind)


@contextmanager
def tuned_process() -> Iterator[None]:
    """Run a computation with one BLAS thread, and exclude objects that exist before it from garbage collection.

    The matrices are small, so that a second BLAS thread spends its time waiting. Most objects belong to imported
    libraries: without them, a collection (`release`) takes 1 instead of 40 ms.
    """
    gc.freeze()
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        gc.unfreeze()


def release() -> None:
    """Release cached memory to the operating system.

    Dr.Jit and the C library (glibc) cache freed memory for reuse, but later stages need blocks of other sizes. Arrays
    that are referenced by Dr.Jit loops are only freed by Python's cyclic garbage collector, so it is run first.
    """
    gc.collect()
    dr.flush_malloc_cache()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def select_parts(source: Kernel, which: Sequence[int], size: int) -> Kernel:
    """Concatenate selected parts of a flat array that consists of consecutive parts with ``size`` elements each."""
    lane, length = dr.arange(mi.UInt32, len(which) * size), dr.opaque(mi.UInt32, size)
    part = lane // length
    found = dr.gather(type(source), source, dr.gather(mi.UInt32, wholes(np.asarray(which)), part) * length + (lane - part * length))
    dr.eval(found)
    return found


def is_positive(half: Kernel) -> Bool:
    """Return whether each element of a half-precision array (mi.Float16) is positive, as mi.Bool.

    The elements are converted to mi.Float and compared with a number that half precision cannot represent. Before
    version 22, LLVM swaps the operands of a masked comparison of halves on processors with AVX512-FP16 (llvm-project
    issue 159723). It also converts a comparison of floats to one of halves if the constant is a half.
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
    """Interpolate bilinearly in one of several concatenated pictures.

    Parameters
    ----------
    source : mi.Float or mi.Float16
        Concatenated pictures, flattened row by row.
    base : mi.UInt32
        Index of the picture's first element in ``source``, counted in elements of ``kind``.
    width : mi.UInt32 or int
        Number of columns of the picture.
    u, v : mi.Float
        Column and row of the positions, px; both must lie between the first and the last sample.
    kind : type, optional
        Type of an element; by default, the type of ``source``. Half-precision elements are converted to mi.Float.
    most : float, optional
        Upper bound to which elements are clipped before interpolation; by default, they are not clipped.
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
