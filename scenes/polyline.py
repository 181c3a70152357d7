"""Polylines in space: lengths, directions, arc lengths and interpolation."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def steps_mm(points_mm: Array) -> Array:
    """Return the lengths (N - 1,) of the segments between successive points (N, 3)."""
    return np.asarray(np.linalg.norm(np.diff(points_mm, axis=0), axis=1))


def unit_vectors(vectors: Array) -> Array:
    """Return vectors (..., 3) divided by their lengths. Zero vectors remain zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def length_mm(points_mm: Array) -> float:
    """Return the length of a polyline with points (N, 3)."""
    return float(steps_mm(points_mm).sum())


def arc_length_mm(points_mm: Array) -> Array:
    """Return the arc length (N,) at each point (N, 3) of a polyline, beginning with 0."""
    return np.concatenate([[0.0], np.cumsum(steps_mm(points_mm))])


def interpolate(points_mm: Array, way: Array, at: Array) -> Array:
    """Interpolate points (M, 3) of a polyline at the given arc lengths.

    Parameters
    ----------
    points_mm : (N, 3) float64 array
        Points of the polyline.
    way : (N,) float64 array
        Arc length at each point, as returned by `arc_length_mm`.
    at : (M,) float64 array
        Arc lengths of the interpolated points. Values beyond the ends are clipped.

    Returns
    -------
    (M, 3) array
        Linearly interpolated points.
    """
    return np.stack([np.interp(at, way, points_mm[:, axis]) for axis in range(3)], axis=1)


def middles(way: Array, step_mm: float) -> Array:
    """Divide a polyline into pieces of equal length, and return the arc lengths (M,) of their midpoints.

    Parameters
    ----------
    way : (N,) float64 array
        Arc length at each point, as returned by `arc_length_mm`.
    step_mm : float
        Approximate length of a piece.

    Returns
    -------
    (M,) array
        Arc lengths of the midpoints.
    """
    pieces = max(1, round(way[-1] / step_mm))
    return np.asarray((np.arange(pieces) + 0.5) * way[-1] / pieces)
