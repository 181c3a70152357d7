"""Convex obstacles of the arm, and distances between the arm's links and obstacles.

The signed distance to a convex body is a convex function of position, so that its minimum along a straight link can be
found by golden-section search.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rhizotwin.scenes.frames import Array

_SEARCH_STEPS = 32  # accuracy 2e-7 of the link's length
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


class Solid(Protocol):
    """Convex body in the rig frame."""

    @property
    def name(self) -> str:
        """Name of the body in messages."""

    def distance_mm(self, points_mm: Array) -> Array:
        """Return the signed distance (...,) of points (..., 3) in the rig frame.

        It is negative inside the body.
        """


@dataclass(frozen=True)
class Cylinder:
    """Upright cylinder about the table's axis."""

    name: str
    radius_mm: float
    low_mm: float
    high_mm: float

    def distance_mm(self, points_mm: Array) -> Array:
        """Return the signed distance (...,) of points (..., 3) in the rig frame.

        It is negative inside the cylinder.
        """
        z = points_mm[..., 2]
        beside = np.hypot(points_mm[..., 0], points_mm[..., 1]) - self.radius_mm
        return _intersection_distance(np.stack([beside, np.maximum(self.low_mm - z, z - self.high_mm)], axis=-1))


@dataclass(frozen=True)
class Box:
    """Box with edges parallel to the axes of the rig frame."""

    name: str
    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    def distance_mm(self, points_mm: Array) -> Array:
        """Return the signed distance (...,) of points (..., 3) in the rig frame.

        It is negative inside the box.
        """
        return _intersection_distance(np.maximum(np.array(self.low_mm) - points_mm, points_mm - np.array(self.high_mm)))


@dataclass(frozen=True)
class Floor:
    """Half-space below a horizontal plane."""

    name: str
    z_mm: float

    def distance_mm(self, points_mm: Array) -> Array:
        """Return the signed distance (...,) of points (..., 3) in the rig frame.

        It is negative below the plane.
        """
        return points_mm[..., 2] - self.z_mm


def minimum_distance(solid: Solid, begin: Array, end: Array) -> Array:
    """Return the minimum signed distance (...,) between line segments and a convex solid.

    It is found by golden-section search.

    Parameters
    ----------
    solid : Solid
        Convex body.
    begin, end : (..., 3) array
        Ends of the segments, mm.

    Returns
    -------
    (...) array
        Distances in mm, negative inside.
    """
    low, high = np.zeros(begin.shape[:-1]), np.ones(begin.shape[:-1])

    def at(t: Array) -> Array:
        return solid.distance_mm(begin + t[..., None] * (end - begin))

    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    of_left, of_right = at(left), at(right)
    for _ in range(_SEARCH_STEPS):
        keep_left = of_left < of_right
        low, high = np.where(keep_left, low, left), np.where(keep_left, right, high)
        probe = np.where(keep_left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        of_probe = at(probe)
        left, right = np.where(keep_left, probe, right), np.where(keep_left, left, probe)
        of_left, of_right = np.where(keep_left, of_probe, of_right), np.where(keep_left, of_left, of_probe)
    return np.minimum(np.minimum(of_left, of_right), np.minimum(solid.distance_mm(begin), solid.distance_mm(end)))


def point_to_segment(point: Array, begin: Array, end: Array) -> Array:
    """Return the distance (...,) between points (..., 3) and line segments.

    Parameters
    ----------
    point : (..., 3) array
        Points, mm.
    begin, end : (..., 3) array
        Ends of the segments, mm.

    Returns
    -------
    (...) array
        Distances in mm.
    """
    along = end - begin
    length2 = np.maximum(np.sum(along**2, axis=-1), 1e-12)
    t = np.clip(np.sum((point - begin) * along, axis=-1) / length2, 0.0, 1.0)
    return np.linalg.norm(point - begin - t[..., None] * along, axis=-1)


def _intersection_distance(outside_mm: Array) -> Array:
    """Return the signed distance (...,) to a convex body that is the intersection of perpendicular slabs.

    A slab is the region between two parallel planes. The input contains the signed distances (..., k) to the individual
    slabs.
    """
    return np.linalg.norm(np.maximum(outside_mm, 0.0), axis=-1) + np.minimum(outside_mm.max(axis=-1), 0.0)
