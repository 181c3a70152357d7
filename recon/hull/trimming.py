"""Trim the hull to what the silhouettes require.

A visual hull is too large: where a root hides behind another in the views that would bound its flanks, its
cross-section grows spikes and the crotches fill. However, the largest sphere about a point of a root's centre line that
no view contradicts has the root's own radius, since it is bounded by every view that shows the root alone. The roots
are therefore rebuilt as the union of these spheres along the hull's centre lines and compared with the pictures: where
the spheres do not explain a silhouette (parts that are not tubes, roots thinner than the skeleton's voxels), the hull
is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon import device
from rhizotwin.recon.device import Bool, Float, Point3f, UInt32, numbers
from rhizotwin.recon.hull import distance_maps, unexplained
from rhizotwin.recon.hull.centre_lines import centre_lines
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.spheres import Spheres, subdivide_leaves
from rhizotwin.recon.optics.projection import ViewBank

Array = NDArray[np.float64]

_FLAT = 0.01
"""Minimum squared slope of a distance map (1 beside an outline) for a direction to be defined; it is smaller on a
ridge."""
_REACH_PX = 0.75
"""Distance at which an outline's slope is read on both sides: one and a half samples of the map."""
_MISSING = 0.02
"""Minimum difference between the fill fractions of hull and spheres: the fraction, linear in the depth, is not more
accurate."""
_STEPS_MM = (0.4, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.025)
"""Decreasing steps of the search for centres: 1.4 mm in total, half a skeleton voxel plus its deviation in wide roots;
the last is a tenth of the thinnest roots."""
_TIGHT_PX = 0.4
"""Distance beyond a sphere within which an outline bounds it: the noise of outlines, and rounding of the crease by
sampling. The weight is 1 at half this distance and 0 at one and a half times."""
_TIGHT_SHARE = 0.05
"""The same as a fraction of the sphere's radius, if larger: a canister half a millimetre out of round, as bought, moves
outlines by half a pixel and more, and with 0.4 px alone the upper half of a carrot of 18 mm was in no sphere."""
_HELD = 0.25, 5.0 / 12.0
"""Fractions of the views that bound a sphere: below the first, it is removed; above the second, it is kept; between
them, it shrinks.

Every view that shows a root alone bounds its sphere. A sphere in a web between roots is only bounded by the few views
that graze the web."""
_LEAST_CURVE = 12
"""Minimum number of points of a curve; fewer (a sphere is thinned to one) may move in any direction."""
_EVERYWHERE = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], np.float64) - 1.0
"""The 26 directions to neighbouring cells."""
_EVERYWHERE /= np.linalg.norm(_EVERYWHERE, axis=1, keepdims=True)


@dataclass(frozen=True)
class TrimmedHull:
    """Hull trimmed to what its silhouettes require."""

    leaves: Leaves
    spheres: Spheres
    """Spheres along the centre lines."""
    doubtful: Spheres
    """Spheres constrained by too few views, and those removed for that reason, with the radius the outlines allow."""
    kept: NDArray[np.float32]
    """(N,) part of the leaves' occupancies that remains hull, since the spheres do not explain a silhouette."""

    @property
    def kept_mm3(self) -> float:
        """Return the volume that remains hull."""
        return self.leaves.volume_mm3(self.kept)


def trim(bank: ViewBank, maps: DistanceMaps, leaves: Leaves) -> TrimmedHull:
    """Trim a hull to what its silhouettes require.

    The occupancies of the trimmed shape are at most those of the hull.
    """
    points = centre_lines(leaves) if len(leaves.size) else np.zeros((0, 3))
    spheres, doubtful = grow_spheres(bank, maps, points)
    if not len(spheres.radius_mm):
        return TrimmedHull(leaves, spheres, doubtful, leaves.occupancy)
    index, size, hull, inside = subdivide_leaves(spheres, leaves)
    kept = np.minimum(hull, inside)
    missing = hull - kept > _MISSING
    if missing.any():
        needed = unexplained.required_fraction(
            bank, maps, replace(leaves, index=index, size=size, occupancy=kept.copy()), index[missing], spheres
        )
        kept[missing] += needed * (hull - kept)[missing]
    some = kept > 0
    trimmed = replace(leaves, index=index[some], size=size[some], occupancy=kept[some])
    return TrimmedHull(trimmed, spheres, doubtful, (kept - np.minimum(hull, inside))[some])


def _perpendicular(points: Array) -> Array:
    """Return eight unit vectors (N, 8, 3) perpendicular to the local direction of points along curves.

    The reference is the axis least aligned with the direction, as a straight row of points defines no perpendicular.
    """
    near = cKDTree(points).query(points, k=_LEAST_CURVE)[1]
    cloud = points[near] - points[near].mean(axis=1, keepdims=True)
    along = np.linalg.eigh(np.einsum("nki,nkj->nij", cloud, cloud))[1][:, :, 2]
    first = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    angle = (np.arange(8) * np.pi / 4)[None, :, None]
    across: Array = np.cos(angle) * first[:, None] + np.sin(angle) * np.cross(along, first)[:, None]
    return across


def grow_spheres(bank: ViewBank, maps: DistanceMaps, points: Array) -> tuple[Spheres, Spheres]:
    """Move points (N, 3) perpendicular to their curve to where the largest spheres fit into all silhouettes.

    Return the spheres, shrunk where few views bound them, and those with few bounds at full size.
    """
    if not len(points):
        return Spheres(points, np.zeros(0)), Spheres(points, np.zeros(0))
    everywhere = np.broadcast_to(_EVERYWHERE, (len(points), *_EVERYWHERE.shape))
    points, radius = _move_to_maximum(bank, maps, points, _perpendicular(points) if len(points) >= _LEAST_CURVE else everywhere)
    # Where a curve ends inside a solid, the largest sphere lies beyond its end: spheres that are local maxima move in
    # all directions.
    largest = _largest(points, radius)
    if len(largest):
        freed = _move_to_maximum(bank, maps, points[largest], everywhere[: len(largest)])
        points, radius = np.concatenate([points, freed[0]]), np.concatenate([radius, freed[1]])
    blunt, radius = radius, np.maximum(radius, _radius(bank, maps, points, sharpen=True))
    points, radius, blunt = points[radius > 0], radius[radius > 0], blunt[radius > 0]
    if not len(points):
        return Spheres(points, radius), Spheres(points, radius)
    none, whole = _HELD
    share = np.clip((_bounding_fraction(bank, maps, points, blunt) - none) / (whole - none), 0.0, 1.0)
    return Spheres(points[share > 0.0], (share * radius)[share > 0.0]), Spheres(points[share < 1.0], radius[share < 1.0])


def _move_to_maximum(bank: ViewBank, maps: DistanceMaps, points: Array, directions: Array) -> tuple[Array, Array]:
    """Move points (N, 3) along any of their directions (N, D, 3) to where the largest spheres fit.

    Return the points and the radii (N,).
    """
    radius = _radius(bank, maps, points)
    for step_mm in _STEPS_MM:
        tried = _radius(bank, maps, (points[:, None] + step_mm * directions).reshape(-1, 3)).reshape(directions.shape[:2])
        best = tried.argmax(axis=1)
        better = tried.max(axis=1) > radius
        points = np.where(better[:, None], points + step_mm * directions[np.arange(len(points)), best], points)
        radius = np.maximum(radius, tried.max(axis=1))
    return points, radius


def _largest(points: Array, radius: Array) -> NDArray[np.int64]:
    """Return the indices of spheres that no sphere about a point inside them exceeds."""
    inside = cKDTree(points).query_ball_point(points, radius, workers=-1)
    return np.array([k for k, near in enumerate(inside) if radius[k] > 0 and radius[k] >= radius[near].max()], np.int64)


def _radius(bank: ViewBank, maps: DistanceMaps, points: Array, *, sharpen: bool = False) -> Array:
    """Return the radius in mm of the largest sphere about each point that every view allows.

    In a view, the distance D to the outline is along the outline's normal (a, b); the plane of sight through the
    outline has the normal g = a du + b dv in space, so that the sphere's radius is D / |g|. On a root's centre line D
    has a crease: |a| and |b| are those of the steeper side. The sampled map rounds the crease; ``sharpen`` restores its
    height from the slopes on both sides, for points on it. Points visible in fewer than `distance_maps.least_votes`
    views have the radius 0.
    """

    def body(view: UInt32, least: Float, votes: UInt32) -> tuple[UInt32, Float, UInt32]:
        allowed, _, usable = _view_radius(bank, maps, view, point, sharpen=sharpen)
        return view + 1, dr.minimum(least, dr.select(usable, allowed, 1e4)), votes + dr.select(usable, mi.UInt32(1), mi.UInt32(0))

    point = device.points(points)
    state = (mi.UInt32(0), dr.full(mi.Float, 1e4, len(points)), dr.zeros(mi.UInt32, len(points)))
    _, least, votes = dr.while_loop(state, lambda view, *_: view < bank.end, body)
    dr.eval(least, votes)
    return np.where(np.array(votes) >= distance_maps.least_votes(bank.count), np.array(least, np.float64), 0.0)


def _bounding_fraction(bank: ViewBank, maps: DistanceMaps, points: Array, radius: Array) -> Array:
    """Return the fraction (N,) of the views that bound spheres (N,), of those that show them."""

    def body(view: UInt32, tight: UInt32, votes: UInt32) -> tuple[UInt32, UInt32, UInt32]:
        allowed, px_a_mm, usable = _view_radius(bank, maps, view, point, sharpen=False)
        tight_mm = dr.maximum(_TIGHT_PX / px_a_mm, _TIGHT_SHARE * reach)
        bounds = dr.clip(1.5 - (allowed - reach) / tight_mm, 0.0, 1.0)
        return view + 1, tight + dr.select(usable, bounds, 0.0), votes + dr.select(usable, 1.0, 0.0)

    point, reach = device.points(points), numbers(radius)
    state = (mi.UInt32(0), dr.zeros(mi.Float, len(points)), dr.zeros(mi.Float, len(points)))
    _, tight, votes = dr.while_loop(state, lambda view, *_: view < bank.end, body)
    return np.array(tight / dr.maximum(votes, 1.0), dtype=np.float64)


def _view_radius(bank: ViewBank, maps: DistanceMaps, view: UInt32, point: Point3f, *, sharpen: bool) -> tuple[Float, Float, Bool]:
    """Return the radius in mm of the largest sphere about a point that a view allows.

    Also return px/mm at the point, and whether the view shows it.
    """
    p, distance, usable = distance_maps.project_and_read(bank, maps, view, point, mi.Bool(True))
    slopes, peak = [], distance
    for unit in (mi.Vector2f(_REACH_PX, 0), mi.Vector2f(0, _REACH_PX)):
        # Next to unusable pixels the map jumps; a distance cannot grow faster than the offset.
        near = [dr.minimum(maps.at(view, p.px + sign * unit, usable), distance + _REACH_PX) for sign in (1.0, -1.0)]
        slopes.append(dr.maximum(dr.abs(near[0] - distance), dr.abs(near[1] - distance)))
        if sharpen:
            falls = [near[side] - maps.at(view, p.px + sign * 2.0 * unit, usable) for side, sign in ((0, 1.0), (1, -1.0))]
            crease = 0.5 * (near[0] + near[1]) + dr.clip(dr.minimum(falls[0], falls[1]), 0.0, _REACH_PX)
            peak = dr.maximum(peak, crease)
    norm_2 = dr.square(slopes[0]) + dr.square(slopes[1]) + 1e-9
    g_2 = (dr.square(slopes[0]) * dr.squared_norm(p.du) + dr.square(slopes[1]) * dr.squared_norm(p.dv)) / norm_2
    g = dr.select(norm_2 < _FLAT, dr.sqrt(dr.norm(p.du) * dr.norm(p.dv)), dr.sqrt(g_2))
    return peak / g, g, usable
