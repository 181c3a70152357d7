"""Numbers for Dr.Jit's kernels: how they get there, and what a checker calls them.

Dr.Jit takes an array of NumPy as it lies in memory, and compiles a kernel anew for every combination of inputs that
begin at a multiple of 64 bytes and inputs that do not. Small arrays begin anywhere, so that a kernel of twenty inputs
would be compiled time and again (a second each). These are copied to where they begin at a multiple of 64 bytes.
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

# Mitsuba's types exist only once a variant is chosen, so that a checker knows none of them:
# these names say what is meant.
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
"""Any of them."""

engine.choose_on_first_use()

_ALIGNED = 64
"""Bytes of the widest vector that Dr.Jit loads."""


TO_LAST = 1.01
"""Look-ups stay this far from a picture's width and height: within the last sample, however float32 rounds."""


_BELOW_HALF = 1e-9
"""Below the smallest half, 6e-8, and no half itself."""


def readable(px: Vector2f, width: int, height: int) -> Bool:
    """Tell which pixels a bilinear look-up in a picture can read."""
    return (px.x > 0) & (px.x < width - TO_LAST) & (px.y > 0) & (px.y < height - TO_LAST)


def numbers(values: NDArray[np.generic]) -> Float:
    """Return mi.Float of an array (...), flattened."""
    return mi.Float(_aligned(values, np.dtype(np.float32)))


def halves(pictures: Sequence[NDArray[np.generic]]) -> Kernel:
    """Return mi.Float16 of pictures (H, W), flattened one after the other.

    Halves keep a coverage to 1/4096, a twentieth of what the noise of a picture leaves of it.
    """
    size = pictures[0].size
    placed = room(len(pictures) * size, np.dtype(np.float16))
    for k, picture in enumerate(pictures):
        placed[k * size : (k + 1) * size] = picture.ravel()
    return mi.Float16(placed)


def vectors(values: NDArray[np.generic]) -> Vector3f:
    """Return mi.Vector3f of (N, 3)."""
    return mi.Vector3f(*(numbers(part) for part in values.T))


def points(values: NDArray[np.generic]) -> Point3f:
    """Return mi.Point3f of (N, 3)."""
    return mi.Point3f(*(numbers(part) for part in values.T))


def wholes(values: NDArray[np.generic]) -> UInt32:
    """Return mi.UInt32 of an array (...) of whole numbers, flattened."""
    return mi.UInt32(_aligned(values, np.dtype(np.uint32)))


def _aligned(values: NDArray[np.generic], kind: np.dtype[np.generic]) -> NDArray[np.generic]:
    placed = room(values.size, kind)
    placed[:] = values.ravel()
    return placed


def room(count: int, kind: np.dtype[np.generic]) -> NDArray[np.generic]:
    """Return an array (count,) to be filled, which Dr.Jit then takes as it lies."""
    buffer = np.empty(count * kind.itemsize + _ALIGNED, np.uint8)
    begin = -buffer.ctypes.data % _ALIGNED
    return buffer[begin : begin + count * kind.itemsize].view(kind)


def release() -> None:
    """Give back the memory that is used no more.

    Dr.Jit and the C library (glibc) keep what was freed to use it again, but what follows a stage, a fit or a thinning
    has other sizes. What loops of Dr.Jit refer to is freed by Python's search for cycles only.
    """
    gc.collect()
    dr.flush_malloc_cache()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def some_parts(source: Kernel, which: Sequence[int], size: int) -> Kernel:
    """Return some of the parts, each of ``size`` elements, that lie one after the other in an array."""
    lane, length = dr.arange(mi.UInt32, len(which) * size), dr.opaque(mi.UInt32, size)
    part = lane // length
    found = dr.gather(type(source), source, dr.gather(mi.UInt32, wholes(np.asarray(which)), part) * length + (lane - part * length))
    dr.eval(found)
    return found


def is_positive(half: Kernel) -> Bool:
    """Return which elements (mi.Float16) are above zero.

    They are compared as mi.Float with a number that is no half. Below version 22, LLVM swaps the operands of a masked
    comparison of halves on processors with AVX512-FP16 (llvm-project issue 159723), and it narrows a comparison of
    floats to one of halves where the constant is a half.
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
        Where the picture begins, in elements of ``kind``.
    width : mi.UInt32 or int
        Columns of the picture.
    u, v : mi.Float
        Column and row, between the first and the last.
    kind : type, optional
        What an element is; that of the source where not given. Halves become mi.Float.
    most : float, optional
        What a larger element counts as.
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
