"""Frustums of wide tubes, and the leaves that they fill."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.device import Float, UInt32, vectors
from rhizotwin.recon.hull import spheres
from rhizotwin.recon.hull.bins import Bins
from rhizotwin.recon.hull.leaves import Grid, Leaves, halve
from rhizotwin.recon.hull.spheres import HALF_DIAGONAL, Spheres
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]

_STEEPEST = 0.1
"""Minimum cosine of the angle between a frustum's axis and the normals of its end planes."""
_FAR_MM = -1e3
"""Depth of points that are outside all bodies listed in their bin, mm."""


@dataclass(frozen=True)
class Frustums:
    """Frustums of cones, clipped by a plane at each end.

    Successive frustums of a branch share the plane that bisects the angle between them, so that there are no gaps.
    """

    ends_mm: Array
    """Both ends of each axis, shape (N, 2, 3), canister frame, mm."""
    radii_mm: Array
    """Radii at both ends, shape (N, 2), mm."""
    normals: Array
    """Unit normals of the planes at both ends, shape (N, 2, 3), in the direction of the axis."""

    @property
    def middle_mm(self) -> Array:
        """Return the middles of the axes (N, 3), mm."""
        return np.asarray(self.ends_mm.mean(axis=1))

    @property
    def reach_mm(self) -> Array:
        """Return the radii (N,) of spheres around the frustums, mm."""
        return np.hypot(self._half_height_mm, self.radii_mm.max(axis=1))

    @property
    def parameters(self) -> Array:
        """Return the parameters (N, 16).

        These are an end and its radius, the other end and its radius, the normal at the first end and the cosine of the
        slope of the lateral surface, the normal at the second end and half the height of the cylinder around the
        frustum.
        """
        slope = np.cos(np.arctan2(np.diff(self.radii_mm, axis=1)[:, 0], self._length_mm))
        (a, b), (normal_a, normal_b) = self.ends_mm.transpose(1, 0, 2), self.normals.transpose(1, 0, 2)
        last = self._half_height_mm[:, None]
        return np.concatenate([a, self.radii_mm[:, :1], b, self.radii_mm[:, 1:], normal_a, slope[:, None], normal_b, last], axis=1)

    @property
    def _length_mm(self) -> Array:
        return np.asarray(np.linalg.norm(np.diff(self.ends_mm, axis=1)[:, 0], axis=1))

    @property
    def _half_height_mm(self) -> Array:
        way = polyline.unit_vectors(np.diff(self.ends_mm, axis=1))
        cosine = np.clip((self.normals * way).sum(axis=2).min(axis=1), _STEEPEST, 1.0)
        return 0.5 * self._length_mm + self.radii_mm.max(axis=1) * np.sqrt(1.0 / cosine**2 - 1.0)


def _depths_mm(listed: Bins, points_mm: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return two depths (N,) of points (N, 3) inside listed frustums, mm. They are negative outside.

    The first one is the depth below the lateral surface of a frustum, between its planes. As in pictures of tubes, the
    distance from the axis is perpendicular to it, and the radius beyond the ends of the axis is that of the end. The
    second one is an upper bound of the depth, from the cylinders around the frustums.
    """
    if not len(points_mm):
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    (begin, end), point = listed.find(points_mm), mi.Point3f(vectors(points_mm))

    def body(k: UInt32, lateral: Float, bound: Float) -> tuple[UInt32, Float, Float]:
        first, second, third, fourth = (dr.gather(mi.Vector4f, listed.entries, 4 * k + part) for part in range(4))
        a, b = mi.Point3f(first.x, first.y, first.z), mi.Point3f(second.x, second.y, second.z)
        after = dr.dot(point - a, mi.Vector3f(third.x, third.y, third.z))
        before = dr.dot(b - point, mi.Vector3f(fourth.x, fourth.y, fourth.z))
        way, offset = b - a, point - a
        length = dr.norm(way)
        axis = way / length
        along = dr.dot(offset, axis)
        aside = dr.norm(offset - along * axis)
        depth = (dr.lerp(first.w, second.w, dr.clip(along / length, 0.0, 1.0)) - aside) * third.w
        between = (after >= 0.0) & (before >= 0.0)
        outer = dr.minimum(dr.maximum(first.w, second.w) - aside, fourth.w - dr.abs(along - 0.5 * length))
        return k + 1, dr.maximum(lateral, dr.select(between, depth, _FAR_MM)), dr.maximum(bound, outer)

    far = dr.full(mi.Float, _FAR_MM, len(points_mm))
    _, lateral, bound = dr.while_loop((begin, far, far + 0.0), lambda k, *_: k < end, body)
    dr.eval(lateral, bound)
    return np.array(lateral), np.array(bound)


def fill(frustums: Frustums, tips: Spheres, inscribed: Spheres, grid: Grid) -> Leaves:
    """Fill the union of frustums and rounded tips with leaves.

    Leaves are as large as possible inside the inscribed spheres, and finest nodes elsewhere.

    Parameters
    ----------
    frustums, tips : Frustums, Spheres
        Frustums, and spheres at the ends of the branches.
    inscribed : Spheres
        Spheres inside their union.
    """
    low, shape = np.asarray(grid.origin_mm), np.array(grid.coarse_shape)
    edge = 2**grid.levels
    if not len(frustums.radii_mm):
        return Leaves(grid, np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))
    box = low, low + shape * edge * grid.size_mm, HALF_DIAGONAL * edge * grid.size_mm
    cones, ends, inner = (Bins.build(bodies, *box) for bodies in (frustums, tips, inscribed))
    index, done = np.argwhere(np.ones(shape, bool)).astype(np.int32) * edge, list[tuple[NDArray[np.generic], ...]]()
    while edge > 1:
        size_mm = edge * grid.size_mm
        middle = low + (index + 0.5 * edge) * grid.size_mm
        whole = spheres.depth_mm(inner, middle) > HALF_DIAGONAL * size_mm
        done.append((index[whole], np.full(int(whole.sum()), edge, np.int32), np.ones(int(whole.sum()), np.float32)))
        cut = index[~whole & (np.maximum(spheres.depth_mm(ends, middle), _depths_mm(cones, middle)[1]) > -HALF_DIAGONAL * size_mm)]
        index = halve(cut, edge)
        edge //= 2
    middle = low + (index + 0.5) * grid.size_mm
    depth = np.maximum(spheres.depth_mm(ends, middle), _depths_mm(cones, middle)[0])
    share = np.clip(0.5 + depth / grid.size_mm, 0.0, 1.0).astype(np.float32)
    some = share > 0.0
    done.append((index[some], np.ones(int(some.sum()), np.int32), share[some]))
    return Leaves(grid, *(np.concatenate(column) for column in zip(*done, strict=True)))
