"""Find the root or voxel under a click, and points inside a screen rectangle."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_REACH = 0.006
"""Maximum distance between the clicked ray and the surface of a picked root, divided by the distance of the root from
the eye. It corresponds to 4 pixels in a view with a height of 500 pixels."""


@dataclass(frozen=True)
class Nodes:
    """Nodes of all roots in common arrays, among which a clicked root is found."""

    point_mm: Array
    """Positions of the nodes (N, 3), mm."""
    radius_mm: Array
    """Radius of the root at each node (N,), mm."""
    root: Index
    """Number of the root on which each node lies (N,)."""

    @classmethod
    def of(cls, lines: Iterable[tuple[int, Line]]) -> Nodes:
        """Collect the nodes of roots.

        Each item of ``lines`` consists of the number of a root, and of the root or a part of it.
        """
        none = np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
        parts = [_add_midpoints(number, line.points_mm, line.diameters_mm) for number, line in lines]
        return cls(*(np.concatenate(part) for part in zip(none, *parts, strict=True)))


@dataclass(frozen=True)
class Ray:
    """Ray from the eye of the viewer."""

    origin_mm: Array
    """Position of the eye (3,), mm."""
    direction: Array
    """Unit direction (3,)."""

    def nearness(self, point_mm: Array) -> tuple[Array, Array]:
        """Return the distances (N,), mm, of points (N, 3) from the eye along the ray, and perpendicular to the ray."""
        away = point_mm - self.origin_mm
        along = away @ self.direction
        return along, np.sqrt(np.maximum(np.einsum("ij,ij->i", away, away) - along**2, 0.0))


@dataclass(frozen=True)
class Screen:
    """Camera of a browser."""

    camera_from_world: Array
    """Homogeneous transform (4, 4) to the camera frame, with the axes of OpenCV."""
    fov: float
    """Vertical field of view of the camera, rad."""
    aspect: float
    """Ratio of the picture's width to its height."""

    def inside(self, point_mm: Array, low: tuple[float, float], high: tuple[float, float]) -> NDArray[np.bool_]:
        """Return which points (N, 3) lie inside a rectangle on the screen.

        The coordinates of its corners are fractions of the width and height of the screen, from the upper left.
        """
        seen = point_mm @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            half = np.tan(self.fov / 2.0) * seen[:, 2]
            x, y = 0.5 + 0.5 * seen[:, 0] / (half * self.aspect), 0.5 + 0.5 * seen[:, 1] / half
        return np.asarray((seen[:, 2] > 0.0) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))


def root_at(nodes: Nodes, ray: Ray) -> tuple[int, Array] | None:
    """Return the number of the clicked root, and the position (3,), mm, of the clicked node.

    The clicked root is the first root that the ray hits. If the ray hits no root, it is the root nearest to the ray.
    Return None if no root is near.
    """
    along, beside = ray.nearness(nodes.point_mm)
    gap = beside - nodes.radius_mm
    hit = (along > 0.0) & (gap < 0.0)
    if hit.any():
        best = int(np.flatnonzero(hit)[along[hit].argmin()])
    else:
        near = (along > 0.0) & (gap < _REACH * along)
        if not near.any():
            return None
        best = int(np.flatnonzero(near)[(gap[near] / along[near]).argmin()])
    return int(nodes.root[best]), nodes.point_mm[best]


def voxel_at(centre_mm: Array, half_mm: Array, ray: Ray) -> tuple[int, Array] | None:
    """Return the index of the first voxel on a ray, and the point (3,), mm, at which the ray enters it.

    The point is computed with the slab test. Return None if the ray hits no voxel.
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


def _add_midpoints(number: int, points_mm: Array, diameters_mm: Array) -> tuple[Array, Array, Index]:
    """Return the nodes of a root and the midpoints between them, with their radii and root numbers."""
    middle = (points_mm[1:] + points_mm[:-1]) / 2.0
    radius = np.concatenate([diameters_mm, (diameters_mm[1:] + diameters_mm[:-1]) / 2.0]) / 2.0
    return np.concatenate([points_mm, middle]), radius, np.full(len(radius), number)
