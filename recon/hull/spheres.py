"""Spheres inside roots, and the volume of their union."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.device import Float, UInt32, vectors
from rhizotwin.recon.hull.bins import Bins
from rhizotwin.recon.hull.leaves import Leaves, halve

Array = NDArray[np.float64]

HALF_DIAGONAL = 0.87
"""Half the diagonal of a cube with an edge length of 1, sqrt(3) / 2, rounded up. If the depth of a cube's centre below
a surface exceeds this multiple of the edge length, the whole cube lies below the surface."""
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

    @property
    def middle_mm(self) -> Array:
        """Return the centres (N, 3), mm."""
        return self.centre_mm

    @property
    def reach_mm(self) -> Array:
        """Return the radii (N,), mm."""
        return self.radius_mm

    @property
    def parameters(self) -> Array:
        """Return centres and radii (N, 4), mm."""
        return np.concatenate([self.centre_mm, self.radius_mm[:, None]], axis=1)

    def select(self, which: NDArray[np.bool_] | slice) -> Spheres:
        """Return a subset of the spheres, selected by a mask (N,) or a slice."""
        return Spheres(self.centre_mm[which], self.radius_mm[which])


def concatenate(parts: Sequence[Spheres]) -> Spheres:
    """Return all spheres of several sets."""
    none = np.zeros((0, 3)), np.zeros(0)
    centres, radii = zip(none, *((part.centre_mm, part.radius_mm) for part in parts), strict=True)
    return Spheres(np.concatenate(centres), np.concatenate(radii))


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
    listed = Bins.build(spheres, origin + low * finest_mm, origin + high * finest_mm, finest_mm)
    done: list[tuple[NDArray[np.generic], ...]] = []
    carried = (np.zeros((0, 3), np.int32), np.zeros(0, np.float32))
    for edge in (2**k for k in range(int(np.log2(leaves.size.max())), -1, -1)):
        chosen = leaves.size == edge
        index = np.concatenate([carried[0], leaves.index[chosen]])
        hull = np.concatenate([carried[1], leaves.occupancy[chosen]])
        size_mm = edge * finest_mm
        depth = depth_mm(listed, origin + index * finest_mm + 0.5 * size_mm)
        inside = np.clip(0.5 + depth / size_mm, 0.0, 1.0).astype(np.float32)
        whole = depth > HALF_DIAGONAL * size_mm if edge > 1 else np.ones(len(index), bool)
        done.append((index[whole], np.full(int(whole.sum()), edge, np.int32), hull[whole], inside[whole]))
        carried = halve(index[~whole], edge), np.repeat(hull[~whole], 8)
    index, size, hull, inside = (np.concatenate(column) for column in zip(*done, strict=True))
    return index, size, hull, inside


def shared_volume_mm3(spheres: Spheres, leaves: Leaves) -> float:
    """Return the volume of the intersection of spheres and leaves, mm3."""
    _, size, occupancy, inside = subdivide_leaves(spheres, leaves)
    return float((np.minimum(occupancy, inside) * (size * leaves.grid.size_mm) ** 3.0).sum(dtype=np.float64))


def depth_mm(listed: Bins, points_mm: Array) -> NDArray[np.float32]:
    """Return the depth (N,) of points (N, 3) inside the union of listed spheres, mm. It is negative outside."""
    if not len(points_mm) or not dr.width(listed.entries):
        return np.full(len(points_mm), -np.inf, np.float32)
    (begin, end), centre = listed.find(points_mm), mi.Point3f(vectors(points_mm))

    def body(k: UInt32, depth: Float) -> tuple[UInt32, Float]:
        sphere = dr.gather(mi.Vector4f, listed.entries, k)
        return k + 1, dr.maximum(depth, sphere.w - dr.norm(centre - mi.Point3f(sphere.x, sphere.y, sphere.z)))

    return np.array(dr.while_loop((begin, dr.full(mi.Float, -1e3, len(points_mm))), lambda k, _: k < end, body)[1])


def beyond_mm(spheres: Spheres, points: Array) -> Array:
    """Return the distance (N,) of points (N, 3) from the union of spheres, mm. It is approximate for points inside."""
    beyond, octave = np.full(len(points), np.inf), np.floor(np.log2(spheres.radius_mm))
    for one in np.unique(octave):
        some = np.flatnonzero(octave == one)
        away, near = cKDTree(spheres.centre_mm[some]).query(points, k=list(range(1, min(_NEIGHBOURS, len(some)) + 1)), workers=-1)
        beyond = np.minimum(beyond, (away - spheres.radius_mm[some][near]).min(axis=1))
    return beyond
