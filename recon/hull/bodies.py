"""Frustums and spheres of which roots consist, and the leaves that their union fills."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.device import Bool, Float, UInt32, Vector3f, numbers, vectors, wholes
from rhizotwin.recon.hull.leaves import Leaves, concatenate
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]

_HALF_DIAGONAL = 0.87
"""Half the diagonal of a cube with an edge length of 1, sqrt(3) / 2, rounded up. If the depth of a cube's centre below
a surface exceeds this multiple of the edge length, the whole cube lies below the surface."""
_STEEPEST = 0.1
"""Minimum cosine of the angle between a frustum's axis and the normals of its end planes."""
_BIN_MM = 2.0
"""Edge length of a bin, mm. A body with an extent up to this length overlaps at most eight bins. With bins of 4 mm,
thin roots take 1.2 times as long to fill."""
_FAR_MM = -1e3
"""Depth of points that are outside all bodies listed in their bin, mm."""
_VECTORS = 4
"""Number of vectors of four components that describe a body."""


@dataclass(frozen=True)
class Bodies:
    """Frustums of cones, clipped by a plane at each end. A sphere is a frustum without length and planes.

    Successive frustums of a branch share the plane that bisects the angle between them, so that there are no gaps.
    """

    ends_mm: Array
    """Both ends of each axis, shape (N, 2, 3), canister frame, mm."""
    radii_mm: Array
    """Radii at both ends, shape (N, 2), mm."""
    normals: Array
    """Unit normals of the planes at both ends, shape (N, 2, 3), in the direction of the axis; 0 for spheres."""
    inner_mm: Array
    """Radius of a ball around the middle of each body that lies inside the union of all bodies, shape (N,), mm."""

    @staticmethod
    def spheres(centre_mm: Array, radius_mm: Array) -> Bodies:
        """Return spheres with given centres (N, 3) and radii (N,)."""
        ends = np.repeat(centre_mm[:, None], 2, axis=1)
        return Bodies(ends, np.stack([radius_mm, radius_mm], axis=1), np.zeros_like(ends), radius_mm)

    @property
    def outer_mm(self) -> Array:
        """Return the distances (N,) from the axes within which the bodies lie, mm."""
        way, widest = np.diff(self.ends_mm, axis=1), self.radii_mm.max(axis=1)
        cosine = (self.normals * polyline.unit_vectors(way)).sum(axis=2)
        tangent = np.sqrt(np.maximum(np.square(self.normals).sum(axis=2) - cosine**2, 0.0)) / np.maximum(cosine, _STEEPEST)
        return np.asarray(widest * np.hypot(1.0, tangent.max(axis=1)))


def join(parts: Sequence[Bodies]) -> Bodies:
    """Return all bodies of several sets."""
    return Bodies(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Bodies)))


@dataclass(frozen=True)
class _Bins:
    """Cubic bins, each with a list of the bodies that may overlap it."""

    low_mm: Array
    shape: NDArray[np.int64]
    entries: Float
    """Parameters of the bodies in all bins, flattened and ordered by bin.

    These are an end and its radius, the other end and its radius, the normal at the first end and `Bodies.inner_mm`,
    the normal at the second end and `Bodies.outer_mm`."""
    begins: UInt32
    """Index of the first body of each bin, followed by the total number of bodies."""

    @staticmethod
    def build(bodies: Bodies, low_mm: Array, high_mm: Array, beside_mm: float) -> _Bins:
        """Create the bins of the box between two corners (3,), with the bodies within ``beside_mm`` of each bin."""
        shape, outer = np.maximum(np.ceil((high_mm - low_mm) / _BIN_MM), 1).astype(np.int64), bodies.outer_mm
        reach, ends = (outer + beside_mm)[:, None], bodies.ends_mm
        corners = ends.min(axis=1) - reach, ends.max(axis=1) + reach
        first, last = (np.clip(np.floor((corner - low_mm) / _BIN_MM), 0, shape - 1).astype(np.int64) for corner in corners)
        extent = last - first + 1
        count = extent.prod(axis=1)
        body = np.repeat(np.arange(len(count)), count)
        place, e = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count), extent[body]
        offset = np.stack([place // (e[:, 1] * e[:, 2]), place // e[:, 2] % e[:, 1], place % e[:, 2]], axis=1)
        bins = ((first[body] + offset) * [shape[1] * shape[2], shape[2], 1]).sum(axis=1)
        order = np.argsort(bins, kind="stable")
        begins = np.searchsorted(bins[order], np.arange(shape.prod() + 1)).astype(np.uint32)
        last_column = np.stack([*bodies.radii_mm.T, bodies.inner_mm, outer], axis=1)[..., None]
        parameters = np.concatenate([np.concatenate([bodies.ends_mm, bodies.normals], axis=1), last_column], axis=2)
        return _Bins(low_mm, shape, numbers(parameters[body[order]].astype(np.float32)), wholes(begins))

    def depths_mm(self, point: Vector3f) -> tuple[Float, Float, Float]:
        """Return three depths of points inside the union of the bodies, mm. They are negative outside.

        The first one is the depth below the lateral surface of a body, between its planes. As in pictures of tubes, the
        distance from the axis is perpendicular to it, and the radius beyond the ends of the axis is that of the end.
        The other two are a lower and an upper bound of the depth.
        """
        shape = [dr.opaque(mi.UInt32, int(count)) for count in self.shape]
        cell = dr.clip((point - vectors(self.low_mm[None])) / _BIN_MM, 0.0, mi.Vector3f(shape) - 1.0)
        at = (mi.UInt32(cell.x) * shape[1] + mi.UInt32(cell.y)) * shape[2] + mi.UInt32(cell.z)
        begin, end = dr.gather(mi.UInt32, self.begins, at), dr.gather(mi.UInt32, self.begins, at + 1)

        def body(k: UInt32, depth: Float, inner: Float, outer: Float) -> tuple[UInt32, Float, Float, Float]:
            parts = [dr.gather(mi.Vector4f, self.entries, _VECTORS * k + part) for part in range(_VECTORS)]
            a, b, after, before = (mi.Vector3f(part.x, part.y, part.z) for part in parts)
            (first, second, least, most), offset, way = (part.w for part in parts), point - a, b - a
            length = dr.norm(way) + 1e-9  # of a sphere, 0
            along = dr.dot(offset, way) / length
            aside = dr.norm(offset - along / length * way)
            slope = length / dr.sqrt(dr.square(length) + dr.square(second - first))
            share = dr.clip(along / length, 0.0, 1.0)
            lateral = (dr.lerp(first, second, share) - aside) * slope
            between = (dr.dot(offset, after) >= 0.0) & (dr.dot(b - point, before) >= 0.0)
            depth = dr.maximum(depth, dr.select(between, lateral, _FAR_MM))
            inner = dr.maximum(inner, least - dr.norm(offset - 0.5 * way))
            return k + 1, depth, inner, dr.maximum(outer, most - dr.norm(offset - share * way))

        far = dr.full(mi.Float, _FAR_MM, dr.width(point))
        return dr.while_loop((begin, far, far + 0.0, far + 0.0), lambda k, *_: k < end, body)[1:]


def fill(bodies: Bodies, leaves: Leaves) -> Leaves:
    """Return the part of leaves inside the union of bodies.

    Leaves are divided until each lies entirely inside or outside the bodies, or is a finest node. No occupancy exceeds
    that of the given leaves.
    """
    origin, finest_mm = np.asarray(leaves.grid.origin_mm), leaves.grid.size_mm
    low, high = leaves.index.min(axis=0, initial=0), (leaves.index + leaves.size[:, None]).max(axis=0, initial=0)
    box_mm = origin + low * finest_mm, origin + high * finest_mm
    edge, done, cut = int(leaves.size.max(initial=1)), list[Leaves](), leaves.select(slice(0))
    while edge:
        bins = _Bins.build(bodies, *box_mm, _HALF_DIAGONAL * edge * finest_mm)
        given = leaves.select(leaves.size == edge)
        inside, divided = zip(_classify(bins, cut, edge, 8), _classify(bins, given, edge, 1), strict=True)
        done.extend(inside)
        cut, edge = concatenate(divided), edge // 2
    return concatenate(done)


def _classify(bins: _Bins, leaves: Leaves, edge: int, parts: int) -> tuple[Leaves, Leaves]:
    """Return those nodes with a given edge that lie inside the bodies, and those to divide.

    Each leaf consists of 1 or 8 nodes. They are classified on the device, and only those of the result are read back.
    """
    count, grid = parts * len(leaves.size), leaves.grid
    if not (count and dr.width(bins.entries)):
        return (leaves.select(slice(0)),) * 2
    corners, eight = edge * np.array(list(np.ndindex(2, 2, 2)), np.int32), dr.opaque(mi.UInt32, parts)
    node, finest, edge_mm = dr.arange(mi.UInt32, count), dr.opaque(mi.Bool, edge == 1), dr.opaque(mi.Float, edge * grid.size_mm)
    offset = dr.gather(mi.Vector3f, vectors((corners + 0.5 * edge) * grid.size_mm + grid.origin_mm), node % eight)
    low_mm = dr.gather(mi.Vector3f, vectors(leaves.index), node // eight) * dr.opaque(mi.Float, grid.size_mm)
    depth, inner, outer = (value / edge_mm for value in bins.depths_mm(low_mm + offset))
    whole, cut = inner > _HALF_DIAGONAL, outer > -_HALF_DIAGONAL
    share = dr.select(finest & ~whole, dr.clip(0.5 + depth, 0.0, 1.0), 1.0)
    chosen = (whole | (cut & finest)) & (share > 0.0), cut & ~whole & ~finest
    dr.eval(share, chosen)

    def read(some: Bool) -> Leaves:
        which = dr.compress(some)
        leaf, corner = np.divmod(np.array(which), parts)
        occupancy = np.minimum(leaves.occupancy[leaf], np.array(dr.gather(mi.Float, share, which)))
        return Leaves(grid, leaves.index[leaf] + corners[corner], np.full(len(leaf), edge, np.int32), occupancy)

    return read(chosen[0]), read(chosen[1])
