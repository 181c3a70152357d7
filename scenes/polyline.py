"""Lines of points in space: how long they are, how far along each point lies, and what lies between."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def steps_mm(points_mm: Array) -> Array:
    """Return the lengths (N - 1,) of a line's pieces between its points (N, 3)."""
    return np.asarray(np.linalg.norm(np.diff(points_mm, axis=0), axis=1))


def length_mm(points_mm: Array) -> float:
    """Return the length of a line of points (N, 3)."""
    return float(steps_mm(points_mm).sum())


def way_mm(points_mm: Array) -> Array:
    """Return how far along a line each of its points (N, 3) lies: (N,), 0 at the first."""
    return np.concatenate([[0.0], np.cumsum(steps_mm(points_mm))])


def between(points_mm: Array, way: Array, at: Array) -> Array:
    """Return the points (M, 3) at places along a line.

    Parameters
    ----------
    points_mm : (N, 3) float64 array
        The line's points.
    way : (N,) float64 array
        How far along each of them lies, as `way_mm`.
    at : (M,) float64 array
        Places on the same scale; beyond the ends they are the ends.

    Returns
    -------
    (M, 3) array
        Between its neighbours in proportion.
    """
    return np.stack([np.interp(at, way, points_mm[:, axis]) for axis in range(3)], axis=1)


def middles(way: Array, step_mm: float) -> Array:
    """Return the middles (M,) of equal pieces of a line, each about a step long.

    Parameters
    ----------
    way : (N,) float64 array
        How far along each point of the line lies, as `way_mm`.
    step_mm : float
        About how long a piece is.

    Returns
    -------
    (M,) array
        On the same scale.
    """
    pieces = max(1, round(way[-1] / step_mm))
    return np.asarray((np.arange(pieces) + 0.5) * way[-1] / pieces)
