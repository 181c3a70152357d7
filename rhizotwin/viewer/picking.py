"""What a click or a rectangle on the screen means: the root or voxel it meets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_REACH = 0.006
"""A click this near to a root, over its distance from the eye, means it (4 pixels of a 900 pixel window)."""


@dataclass(frozen=True)
class Strung:
    """The nodes of all roots in a row."""

    point_mm: Array
    """(N, 3)"""
    radius_mm: Array
    root: Index

    @classmethod
    def of(cls, lines: Iterable[tuple[int, Line]]) -> Strung:
        """Return the nodes of roots, or of parts of them, with their numbers."""
        none = np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
        parts = [_filled(number, line.points_mm, line.diameters_mm) for number, line in lines]
        return cls(*(np.concatenate(part) for part in zip(none, *parts, strict=True)))


@dataclass(frozen=True)
class Ray:
    """A line of sight."""

    origin_mm: Array
    direction: Array

    def nearness(self, point_mm: Array) -> tuple[Array, Array]:
        """Return how far along the ray points (N, 3) lie, and how far beside it."""
        away = point_mm - self.origin_mm
        along = away @ self.direction
        return along, np.sqrt(np.maximum(np.einsum("ij,ij->i", away, away) - along**2, 0.0))


@dataclass(frozen=True)
class Screen:
    """How a browser looks at the scene."""

    camera_from_world: Array
    """4x4, OpenCV's axes."""
    fov: float
    """Vertical, radians."""
    aspect: float

    def inside(self, point_mm: Array, low: tuple[float, float], high: tuple[float, float]) -> NDArray[np.bool_]:
        """Tell which points (N, 3) show inside a rectangle; corners are from 0 to 1, from the upper left."""
        seen = point_mm @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            half = np.tan(self.fov / 2.0) * seen[:, 2]
            x, y = 0.5 + 0.5 * seen[:, 0] / (half * self.aspect), 0.5 + 0.5 * seen[:, 1] / half
        return np.asarray((seen[:, 2] > 0.0) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))


def root_at(strung: Strung, ray: Ray) -> tuple[int, Array] | None:
    """Return the root that a ray meets first, and where; None where it meets none.

    Of roots that the ray only passes near, the nearest beside it counts.
    """
    along, beside = ray.nearness(strung.point_mm)
    gap = beside - strung.radius_mm
    hit = (along > 0.0) & (gap < 0.0)
    if hit.any():
        best = int(np.flatnonzero(hit)[along[hit].argmin()])
    else:
        near = (along > 0.0) & (gap < _REACH * along)
        if not near.any():
            return None
        best = int(np.flatnonzero(near)[(gap[near] / along[near]).argmin()])
    return int(strung.root[best]), strung.point_mm[best]


def voxel_at(centre_mm: Array, half_mm: Array, ray: Ray) -> tuple[int, Array] | None:
    """Return the row of the voxel that a ray meets first, by the slab test of its box, and where it enters.

    None where it meets none.
    """
    along, beside = ray.nearness(centre_mm)
    near = np.flatnonzero((along > 0.0) & (beside < np.sqrt(3.0) * half_mm))
    if not len(near):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (centre_mm[near] - half_mm[near, None] - ray.origin_mm) / ray.direction
        second = (centre_mm[near] + half_mm[near, None] - ray.origin_mm) / ray.direction
    enters, leaves = np.fmin(first, second).max(axis=1), np.fmax(first, second).min(axis=1)
    hit = enters <= leaves
    if not hit.any():
        return None
    first_in = int(np.flatnonzero(hit)[enters[hit].argmin()])
    return int(near[first_in]), ray.origin_mm + enters[first_in] * ray.direction


def _filled(number: int, points_mm: Array, diameters_mm: Array) -> tuple[Array, Array, Index]:
    """Return the nodes of a root, with one in the middle of each piece."""
    middle = (points_mm[1:] + points_mm[:-1]) / 2.0
    radius = np.concatenate([diameters_mm, (diameters_mm[1:] + diameters_mm[:-1]) / 2.0]) / 2.0
    return np.concatenate([points_mm, middle]), radius, np.full(len(radius), number)
