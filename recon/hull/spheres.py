"""Spheres inside roots, and the volume of their union."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.device import Float, UInt32, numbers, vectors, wholes
from rhizotwin.recon.hull.leaves import Grid, Leaves

Array = NDArray[np.float64]

_HALF_DIAGONAL = 0.87
"""Half the diagonal of a cube with an edge length of 1, sqrt(3) / 2, rounded up. If the depth of a cube's centre below
a surface exceeds this multiple of the edge length, the whole cube lies below the surface."""
_BIN_MM = 4.0
"""Edge length of the bins used to look up spheres, mm. A sphere with a diameter up to this length overlaps at most
eight bins."""
_NEIGHBOURS = 4
"""Number of nearest sphere centres that are tested in the search for the nearest sphere. They are searched separately
in each group of spheres whose radii differ by less than a factor of two."""


@dataclass(frozen=True)
class Spheres:
    """Spheres inside the roots."""

    centre_mm: Array
    """Centres of the spheres, shape (N, 3), canister frame, mm."""
    radius_mm: Array
    """Radii of the spheres, shape (N,), mm."""


def subdivide_leaves(
    spheres: Spheres, leaves: Leaves
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Divide leaves until each lies entirely inside the spheres or is a finest node.

    Returns
    -------
    index : (N, 3) int32 array
        Lowest corner of each leaf, in units of the finest nodes.
    size : (N,) int32 array
        Edge length of each leaf, in units of the finest nodes.
    hull : (N,) float32 array
        Occupancy of each leaf in the hull.
    inside : (N,) float32 array
        Fraction of each leaf inside the spheres.
    """
    origin, finest_mm = np.asarray(leaves.grid.origin_mm), leaves.grid.size_mm
    low, high = leaves.index.min(axis=0), (leaves.index + leaves.size[:, None]).max(axis=0)
    listed = _Bins.build(spheres, origin + low * finest_mm, origin + high * finest_mm, finest_mm)
    done: list[tuple[NDArray[np.generic], ...]] = []
    carried = (np.zeros((0, 3), np.int32), np.zeros(0, np.float32))
    for edge in (2**k for k in range(int(np.log2(leaves.size.max())), -1, -1)):
        chosen = leaves.size == edge
        index = np.concatenate([carried[0], leaves.index[chosen]])
        hull = np.concatenate([carried[1], leaves.occupancy[chosen]])
        size_mm = edge * finest_mm
        depth = listed.depth_mm(origin + index * finest_mm + 0.5 * size_mm)
        inside = np.clip(0.5 + depth / size_mm, 0.0, 1.0).astype(np.float32)
        whole = depth > _HALF_DIAGONAL * size_mm if edge > 1 else np.ones(len(index), bool)
        done.append((index[whole], np.full(int(whole.sum()), edge, np.int32), hull[whole], inside[whole]))
        offset = np.array(list(np.ndindex(2, 2, 2)), np.int32) * (edge // 2)
        carried = ((index[~whole][:, None] + offset).reshape(-1, 3), np.repeat(hull[~whole], 8))
    index, size, hull, inside = (np.concatenate(column) for column in zip(*done, strict=True))
    return index, size, hull, inside


def fill(spheres: Spheres, grid: Grid) -> Leaves:
    """Fill spheres with leaves. The leaves are as large as possible inside, and finest nodes at the surface."""
    low, shape = np.asarray(grid.origin_mm), np.array(grid.coarse_shape)
    edge = 2**grid.levels
    if not len(spheres.radius_mm):
        return Leaves(grid, np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))
    listed = _Bins.build(spheres, low, low + shape * edge * grid.size_mm, _HALF_DIAGONAL * edge * grid.size_mm)
    index, done = np.argwhere(np.ones(shape, bool)).astype(np.int32) * edge, list[tuple[NDArray[np.generic], ...]]()
    offset = np.array(list(np.ndindex(2, 2, 2)), np.int32)
    while edge >= 1:
        size_mm = edge * grid.size_mm
        depth = listed.depth_mm(low + index * grid.size_mm + 0.5 * size_mm)
        share = np.clip(0.5 + depth / size_mm, 0.0, 1.0).astype(np.float32)
        whole = depth > _HALF_DIAGONAL * size_mm if edge > 1 else share > 0.0
        done.append((index[whole], np.full(int(whole.sum()), edge, np.int32), share[whole]))
        cut = index[~whole & (depth > -_HALF_DIAGONAL * size_mm)]
        edge //= 2
        index = (cut[:, None] + offset * edge).reshape(-1, 3)
    return Leaves(grid, *(np.concatenate(column) for column in zip(*done, strict=True)))


def shared_volume_mm3(spheres: Spheres, leaves: Leaves) -> float:
    """Return the volume of the intersection of spheres and leaves, mm3."""
    _, size, occupancy, inside = subdivide_leaves(spheres, leaves)
    return float((np.minimum(occupancy, inside) * (size * leaves.grid.size_mm) ** 3.0).sum(dtype=np.float64))


def depth_in_spheres(spheres: Spheres, points_mm: Array) -> NDArray[np.float32]:
    """Return the depth (N,) of points (N, 3) inside the union of spheres, mm. It is negative outside."""
    if not len(points_mm) or not len(spheres.radius_mm):
        return np.full(len(points_mm), -np.inf, np.float32)
    return _Bins.build(spheres, points_mm.min(axis=0), points_mm.max(axis=0), 0.0).depth_mm(points_mm)


@dataclass(frozen=True)
class _Bins:
    """Spatial index of spheres: cubic bins, each with a list of the spheres that overlap it."""

    low_mm: Array
    shape: NDArray[np.int64]
    entries: UInt32
    """Centre coordinates and radii of the spheres in all bins, flattened and ordered by bin (mi.Float)."""
    begins: UInt32
    """Index of the first entry of each bin, followed by the total number of entries (mi.UInt32)."""

    @staticmethod
    def build(spheres: Spheres, low: Array, high: Array, beside_mm: float) -> _Bins:
        """Create the index for the box between the corners ``low`` and ``high``.

        A sphere is listed in all bins within ``beside_mm`` of its surface.
        """
        shape = np.maximum(np.ceil((high - low) / _BIN_MM), 1).astype(np.int64)
        reach = spheres.radius_mm[:, None] + beside_mm
        first = np.clip(np.floor((spheres.centre_mm - reach - low) / _BIN_MM), 0, shape - 1).astype(np.int64)
        extent = np.clip(np.floor((spheres.centre_mm + reach - low) / _BIN_MM), 0, shape - 1).astype(np.int64) - first + 1
        count = extent.prod(axis=1)
        sphere = np.repeat(np.arange(len(count)), count)
        place, e = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count), extent[sphere]
        offset = np.stack([place // (e[:, 1] * e[:, 2]), place // e[:, 2] % e[:, 1], place % e[:, 2]], axis=1)
        bins = ((first[sphere] + offset) * [shape[1] * shape[2], shape[2], 1]).sum(axis=1)
        order = np.argsort(bins, kind="stable")
        begins = np.searchsorted(bins[order], np.arange(shape.prod() + 1)).astype(np.uint32)
        packed = np.concatenate([spheres.centre_mm, spheres.radius_mm[:, None]], axis=1)[sphere[order]].astype(np.float32)
        return _Bins(low, shape, numbers(packed), wholes(begins))

    def depth_mm(self, points_mm: Array) -> NDArray[np.float32]:
        """Return the depth (N,) of points (N, 3) inside the union of spheres, mm. It is negative outside."""
        if not len(points_mm):
            return np.zeros(0, np.float32)
        shape = self.shape
        cell = np.clip(np.floor((points_mm - self.low_mm) / _BIN_MM), 0, shape - 1).astype(np.int64)
        bin_ = wholes(cell @ [shape[1] * shape[2], shape[2], 1])
        end, centre = dr.gather(mi.UInt32, self.begins, bin_ + 1), mi.Point3f(vectors(points_mm))

        def body(k: UInt32, depth: Float) -> tuple[UInt32, Float]:
            sphere = dr.gather(mi.Vector4f, self.entries, k)
            return k + 1, dr.maximum(depth, sphere.w - dr.norm(centre - mi.Point3f(sphere.x, sphere.y, sphere.z)))

        state = (dr.gather(mi.UInt32, self.begins, bin_), dr.full(mi.Float, -1e3, len(points_mm)))
        return np.array(dr.while_loop(state, lambda k, _: k < end, body)[1])


def beyond_mm(spheres: Spheres, points: Array) -> Array:
    """Return the distance (N,) of points (N, 3) from the union of spheres, mm. It is approximate for points inside."""
    beyond, octave = np.full(len(points), np.inf), np.floor(np.log2(spheres.radius_mm))
    for one in np.unique(octave):
        some = np.flatnonzero(octave == one)
        away, near = cKDTree(spheres.centre_mm[some]).query(points, k=list(range(1, min(_NEIGHBOURS, len(some)) + 1)), workers=-1)
        beyond = np.minimum(beyond, (away - spheres.radius_mm[some][near]).min(axis=1))
    return beyond
