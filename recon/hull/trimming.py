"""Trimming of the visual hull to the volume that the silhouettes require.

A visual hull is larger than the object. Where a root hides behind another in the views that would bound its sides, its
cross-section grows spikes, and the gaps between branching roots are filled. However, the largest sphere around a point
of a root's centre line that lies within all silhouettes has the radius of the root, since it is bounded by every view
that shows the root alone. The roots are therefore rebuilt as the union of such spheres along the hull's centre lines
and compared with the pictures. Where the spheres do not explain a silhouette (parts that are not tubular, or roots
thinner than the skeleton's voxels), the hull is kept.
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
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.optics.projection import ViewBank

Array = NDArray[np.float64]

_FLAT = 0.01
"""Minimum squared slope of a distance map for its gradient direction to be defined. The squared slope is 1 beside an
outline and smaller on a ridge."""
_REACH_PX = 0.75
"""Offset, on both sides of a pixel, at which a distance map is read to compute its slope, px. It is one and a half
samples."""
_MISSING = 0.02
"""Minimum decrease of a leaf's occupancy from the hull to the spheres for the leaf to be examined further. Smaller
decreases are within the accuracy of the occupancy, which is approximated as a linear function of the depth."""
_STEPS_MM = (0.4, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.025)
"""Step lengths of the search for sphere centres, mm. Their sum of 1.4 mm is the largest expected distance from the
skeleton to the centre line, which is half a voxel plus the error of the skeleton in wide roots. The last step is a
tenth of the diameter of the thinnest roots."""
_TIGHT_PX = 0.4
"""Maximum distance between a sphere and the outline in a view for the view to bound the sphere, px. It allows for noise
of the outlines and for sampling, which flattens the ridge of the distance map on a root's centre line. The weight of
the bound is 1 at half this distance and 0 at one and a half times this distance."""
_TIGHT_SHARE = 0.05
"""Minimum tolerance that replaces `_TIGHT_PX` for large spheres, as a fraction of the sphere's radius.

An off-the-shelf canister that is half a millimetre out of round displaces the outlines by half a pixel or more. With
0.4 px alone, no sphere covered the upper half of a carrot with a diameter of 18 mm."""
_HELD = 0.25, 5.0 / 12.0
"""Two thresholds for the fraction of the views that bound a sphere. If the fraction is below the first threshold, the
sphere is removed. Above the second, it is kept. In between, it is shrunk.

Every view that shows a root alone bounds its sphere. A sphere in a web between roots is bounded only by the few views
with lines of sight along the web."""
_LEAST_CURVE = 12
"""Minimum number of points of a centre line for its direction to be estimated. On shorter lines, such as the single
point to which a ball is thinned, points may move in any direction."""
_EVERYWHERE = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], np.float64) - 1.0
"""Directions from a cell to its 26 neighbours, shape (26, 3)."""
_EVERYWHERE /= np.linalg.norm(_EVERYWHERE, axis=1, keepdims=True)


@dataclass(frozen=True)
class TrimmedHull:
    """Hull trimmed to the volume that the silhouettes require."""

    leaves: Leaves
    spheres: Spheres
    """Spheres along the centre lines."""
    doubtful: Spheres
    """Spheres that are bounded by too few views, with the radius that the outlines allow. They include the spheres that
    were removed for this reason."""
    kept_mm3: float
    """Volume that is retained from the hull although no sphere covers it, mm3. It is required to explain a
    silhouette."""


def find_missing(bank: ViewBank, maps: DistanceMaps, shape: Leaves, outside: Leaves, inside: Spheres) -> tuple[Leaves, Leaves]:
    """Find the parts of the hull outside a shape that the silhouettes require.

    Parameters
    ----------
    shape : Leaves
        Shape that explains most of the silhouettes.
    outside : Leaves
        Part of the hull outside the shape. The occupancy is the difference from the shape.
    inside : Spheres
        Spheres inside the shape. Of the nodes on a line of sight that the shape does not explain, those nearest to the
        spheres are required. Without spheres, all nodes are required.

    Returns
    -------
    lacking, missing : Leaves
        Finest nodes outside the shape, and those of them that the silhouettes require. The occupancy is the difference
        from the shape.
    """
    lacking = outside.select(outside.occupancy > _MISSING).split()
    if not len(lacking.size) or not len(inside.radius_mm):
        return lacking, lacking
    needed = unexplained.required_fraction(bank, maps, shape, lacking, inside)
    return lacking, replace(lacking, occupancy=needed * lacking.occupancy).select(needed > 0.0)


def _perpendicular(points: Array) -> Array:
    """Return eight unit vectors (N, 8, 3) perpendicular to the centre line at each point (N, 3).

    They are constructed from the coordinate axis that is least parallel to the centre line, since a straight line has
    no unique normal.
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
    """Find the largest spheres that fit into all silhouettes near given points (N, 3) of centre lines.

    The points are moved perpendicular to the centre line to the centres of these spheres. Two sets of spheres are
    returned: the spheres of the trimmed shape, which are smaller where few views bound them, and the spheres that few
    views bound, at full size.
    """
    if not len(points):
        return Spheres(points, np.zeros(0)), Spheres(points, np.zeros(0))
    everywhere = np.broadcast_to(_EVERYWHERE, (len(points), *_EVERYWHERE.shape))
    points, radius = _move_to_maximum(bank, maps, points, _perpendicular(points) if len(points) >= _LEAST_CURVE else everywhere)
    # Where a curve ends inside a solid, the largest sphere lies beyond its end: spheres that are local maxima move in
    # all directions.
    largest = _find_largest(points, radius)
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
    """Move points (N, 3) in steps along given directions (N, D, 3) to where the surrounding spheres are largest.

    Return the new points (N, 3) and the radii of the spheres (N,), mm.
    """
    radius = _radius(bank, maps, points)
    for step_mm in _STEPS_MM:
        tried = _radius(bank, maps, (points[:, None] + step_mm * directions).reshape(-1, 3)).reshape(directions.shape[:2])
        best = tried.argmax(axis=1)
        better = tried.max(axis=1) > radius
        points = np.where(better[:, None], points + step_mm * directions[np.arange(len(points)), best], points)
        radius = np.maximum(radius, tried.max(axis=1))
    return points, radius


def _find_largest(points: Array, radius: Array) -> NDArray[np.int64]:
    """Return the indices of the spheres that are at least as large as every sphere centred inside them."""
    inside = cKDTree(points).query_ball_point(points, radius, workers=-1)
    return np.array([k for k, near in enumerate(inside) if radius[k] > 0 and radius[k] >= radius[near].max()], np.int64)


def _radius(bank: ViewBank, maps: DistanceMaps, points: Array, *, sharpen: bool = False) -> Array:
    """Return the radius (N,) of the largest sphere around each point (N, 3) that lies inside all silhouettes, mm.

    In each view, let D be the distance of the projected point from the outline, and (a, b) the normal of the outline.
    The plane of sight through the outline has the normal g = a du + b dv in space, so that the radius of the sphere is
    D / |g|. On a root's centre line, D has a crease; |a| and |b| are those of the steeper side. Sampling rounds the
    crease. For points on a crease, ``sharpen`` restores its height from the slopes on both sides. Points that fewer
    than `distance_maps.least_votes` views show have the radius 0.
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
    """Return the fraction (N,) of the views that bound each sphere.

    A view bounds a sphere if the sphere touches the outline in this view. Only views that show the centre of the sphere
    are counted.
    """

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
    """Return the radius of the largest sphere around a point inside the silhouette of one view, mm.

    Also return the image scale at the point in px/mm, and whether the view shows the point.
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
