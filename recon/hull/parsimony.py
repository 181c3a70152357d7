"""What no picture needs is not root: from the hull to the roots inside it.

A visual hull is too large: where a root hides behind another in the views that would bound its flanks, its
cross-section grows tips and the crotches fill. But the largest sphere about a point of a root's centre line that no
view contradicts has the root's own radius, for it is bounded by whichever view shows the root alone. So the roots are
rebuilt as the union of these spheres along the hull's centre lines, and compared with the pictures: where a silhouette
is not explained by the spheres (parts that are no tubes, roots thinner than the skeleton's voxels), the hull is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage import morphology

from rhizotwin.recon import device
from rhizotwin.recon.device import Bool, Float, Point3f, UInt32, numbers, vectors, wholes
from rhizotwin.recon.hull import distance_maps
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.surface import paint, to_voxels
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SKELETON_MM = 0.5
"""About this edge have the voxels that are thinned to curves: finer ones grow hairs on rough surfaces."""
_SPACING_MM = 0.16
"""Of the points along a curve, at most: spheres of 0.5 mm roots overlap by more than half."""
_HALF_DIAGONAL = 0.87
"""Of a cube, sqrt(3) / 2 of its edge: what lies as deep lies wholly inside."""
_BIN_MM = 4.0
"""Edge of the bins in which spheres are looked up: a sphere no larger lies in eight at most."""
_DEEP_PX = 0.75
"""A silhouette must be left unexplained this deep inside its outline for the hull to be kept there; a third less counts
not at all, a third more in full."""
_FLAT = 0.01
"""Squared slope of a distance map, 1 beside an outline, below which it has no direction: on a ridge."""
_REACH_PX = 0.75
"""Distance at which an outline's slope is read on both sides: a sample and a half of the map."""
_MISSING = 0.02
"""Nodes that the spheres fill but for this are left: how full they are, linear in the depth, is known no better."""
_STEPS_MM = (0.4, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.025)
"""Centres are sought in falling steps: 1.4 mm together, half the skeleton's voxel and what it strays in wide roots; the
last is a tenth of the thinnest roots."""
_TIGHT_PX = 0.4
"""A view bounds a sphere when its outline is no farther than this beyond it: outlines' noise, and the crease that
sampling rounds off. Half of this bounds it in full, half as much again not at all."""
_HELD = 0.25, 5.0 / 12.0
"""A sphere that a smaller share of the seeing views bounds is none, one that a larger share bounds is whole; between
them it shrinks.

Every view that shows a root alone bounds its sphere. A sphere in a web between roots is bounded by the few views that
graze the web."""
_LEAST_CURVE = 12
"""Fewer points than this are no curve (a sphere thins to one): they may move in every direction."""
_EVERYWHERE = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], np.float64) - 1.0
"""The 26 directions to neighbouring cells."""
_EVERYWHERE /= np.linalg.norm(_EVERYWHERE, axis=1, keepdims=True)


@dataclass(frozen=True)
class Spheres:
    """Spheres inside the roots."""

    centre_mm: Array
    """(N, 3), canister frame."""
    radius_mm: Array
    """(N,)"""


@dataclass(frozen=True)
class Trimmed:
    """A hull trimmed to what its silhouettes need."""

    leaves: Leaves
    spheres: Spheres
    """Spheres along the centre lines."""
    kept: NDArray[np.float32]
    """(N,) of the leaves' occupancies what is hull still, because the spheres leave a silhouette unexplained."""

    @property
    def kept_mm3(self) -> float:
        """Return the volume that is hull still."""
        return self.leaves.volume_mm3(self.kept)

    def near(self, points_mm: Array, margin_mm: float) -> Trimmed:
        """Return the part that lies within a margin of points (M, 3)."""
        leaves, near = self.leaves, np.zeros(len(self.kept), bool)
        if len(points_mm):
            reach_mm = margin_mm + 0.5 * leaves.grid.size_mm * (leaves.size - 1)
            near = cKDTree(points_mm).query(leaves.middles_mm, workers=-1)[0] < reach_mm
        return replace(self, leaves=leaves.some(near), kept=self.kept[near])


def trim(bank: ViewBank, maps: DistanceMaps, leaves: Leaves) -> Trimmed:
    """Trim a hull to what its silhouettes need.

    The trimmed shape's occupancies are at most the hull's.
    """
    spheres = grow_spheres(bank, maps, centre_lines(leaves))
    if not len(spheres.radius_mm):
        return Trimmed(leaves, spheres, leaves.occupancy)
    index, size, hull, inside = _against_spheres(spheres, leaves)
    kept = np.minimum(hull, inside)
    missing = hull - kept > _MISSING
    if missing.any():
        needed = _needed(bank, maps, replace(leaves, index=index, size=size, occupancy=kept.copy()), index[missing])
        kept[missing] += needed * (hull - kept)[missing]
    some = kept > 0
    trimmed = replace(leaves, index=index[some], size=size[some], occupancy=kept[some])
    return Trimmed(trimmed, spheres, (kept - np.minimum(hull, inside))[some])


def centre_lines(leaves: Leaves) -> Array:
    """Thin the hull to curves and sample them densely: (N, 3) points in the canister frame, mm."""
    units = 2 ** max(0, int(np.ceil(np.log2(_SKELETON_MM / leaves.grid.size_mm) - 0.25)))
    index, size, occupancy = to_voxels(leaves, units)
    low = index.min(axis=0) - 1
    volume = np.zeros((index + size[:, None]).max(axis=0) - low + 1, np.float32)
    paint(volume, index - low, size, occupancy)
    voxel_mm = leaves.grid.size_mm * units
    nodes = np.argwhere(morphology.skeletonize(volume > 0.5)).astype(np.float64)
    if not len(nodes):
        return np.zeros((0, 3))
    pairs = cKDTree(nodes).query_pairs(1.8, output_type="ndarray")  # the 26 neighbours, up to sqrt(3) away
    steps = max(1, int(np.ceil(1.4 * voxel_mm / _SPACING_MM)))  # sqrt(2): most go on over an edge
    share = (np.arange(1, steps) / steps)[None, :, None]
    between = nodes[pairs[:, 0]][:, None] * (1 - share) + nodes[pairs[:, 1]][:, None] * share
    points = np.concatenate([nodes, between.reshape(-1, 3)])
    return np.asarray(leaves.grid.origin_mm) + (points + low + 0.5) * voxel_mm


def _across(points: Array) -> Array:
    """Return eight unit vectors (N, 8, 3) across the local direction of a cloud of points along curves.

    They are turned from the axis that the direction is least along: a straight row of points has no directions across
    of its own.
    """
    near = cKDTree(points).query(points, k=_LEAST_CURVE)[1]
    cloud = points[near] - points[near].mean(axis=1, keepdims=True)
    along = np.linalg.eigh(np.einsum("nki,nkj->nij", cloud, cloud))[1][:, :, 2]
    first = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    angle = (np.arange(8) * np.pi / 4)[None, :, None]
    across: Array = np.cos(angle) * first[:, None] + np.sin(angle) * np.cross(along, first)[:, None]
    return across


def grow_spheres(bank: ViewBank, maps: DistanceMaps, points: Array) -> Spheres:
    """Move points (N, 3) across their curve to where the largest spheres fit into all silhouettes; return these."""
    if not len(points):
        return Spheres(points, np.zeros(0))
    everywhere = np.broadcast_to(_EVERYWHERE, (len(points), *_EVERYWHERE.shape))
    points, radius = _moved(bank, maps, points, _across(points) if len(points) >= _LEAST_CURVE else everywhere)
    # where a curve ends inside a solid, the largest sphere lies beyond its end: spheres that none about them exceeds
    # look for it
    largest = _largest(points, radius)
    if len(largest):
        freed = _moved(bank, maps, points[largest], everywhere[: len(largest)])
        points, radius = np.concatenate([points, freed[0]]), np.concatenate([radius, freed[1]])
    blunt, radius = radius, np.maximum(radius, _radius(bank, maps, points, sharpen=True))
    good = radius > 0
    if good.any():
        none, whole = _HELD
        radius[good] *= np.clip((_held(bank, maps, points[good], blunt[good]) - none) / (whole - none), 0.0, 1.0)
        good = radius > 0
    return Spheres(points[good], radius[good])


def _moved(bank: ViewBank, maps: DistanceMaps, points: Array, directions: Array) -> tuple[Array, Array]:
    """Move points (N, 3) along any of their directions (N, D, 3) to where the largest spheres fit.

    Return them with the radii (N,).
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
    """Return the numbers of the spheres that no sphere about a point inside them exceeds."""
    inside = cKDTree(points).query_ball_point(points, radius, workers=-1)
    return np.array([k for k, near in enumerate(inside) if radius[k] > 0 and radius[k] >= radius[near].max()], np.int64)


def _radius(bank: ViewBank, maps: DistanceMaps, points: Array, *, sharpen: bool = False) -> Array:
    """Return the radius in mm of the largest sphere about each point that every view allows.

    In a view the distance D to the outline is that along the outline's normal (a, b); the plane of sight through the
    outline has the normal g = a du + b dv in space, so the sphere's radius is D / |g|. On a root's centre line D has a
    crease: |a| and |b| are taken from the steeper of the two sides. The sampled map rounds the crease off; ``sharpen``
    restores its height from the slopes on both sides, for points that lie on it. Points that fewer than
    `distance_maps.least_votes` of the views see get the radius 0.
    """

    def body(view: UInt32, least: Float, votes: UInt32) -> tuple[UInt32, Float, UInt32]:
        allowed, _, seen = _allowed(bank, maps, view, point, sharpen=sharpen)
        return view + 1, dr.minimum(least, dr.select(seen, allowed, 1e4)), votes + dr.select(seen, mi.UInt32(1), mi.UInt32(0))

    point = device.points(points)
    state = (mi.UInt32(0), dr.full(mi.Float, 1e4, len(points)), dr.zeros(mi.UInt32, len(points)))
    _, least, votes = dr.while_loop(state, lambda view, *_: view < bank.end, body)
    dr.eval(least, votes)
    return np.where(np.array(votes) >= distance_maps.least_votes(bank.count), np.array(least, np.float64), 0.0)


def _held(bank: ViewBank, maps: DistanceMaps, points: Array, radius: Array) -> Array:
    """Return the share (N,) of the seeing views that bound spheres (N,), `_radius` without sharpening."""

    def body(view: UInt32, tight: UInt32, votes: UInt32) -> tuple[UInt32, UInt32, UInt32]:
        allowed, px_a_mm, seen = _allowed(bank, maps, view, point, sharpen=False)
        bounds = dr.clip(1.5 - (allowed - reach) * px_a_mm / _TIGHT_PX, 0.0, 1.0)
        return view + 1, tight + dr.select(seen, bounds, 0.0), votes + dr.select(seen, 1.0, 0.0)

    point, reach = device.points(points), numbers(radius)
    state = (mi.UInt32(0), dr.zeros(mi.Float, len(points)), dr.zeros(mi.Float, len(points)))
    _, tight, votes = dr.while_loop(state, lambda view, *_: view < bank.end, body)
    return np.array(tight / dr.maximum(votes, 1.0), dtype=np.float64)


def _allowed(bank: ViewBank, maps: DistanceMaps, view: UInt32, point: Point3f, *, sharpen: bool) -> tuple[Float, Float, Bool]:
    """Return the radius in mm of the largest sphere about a point that a view allows.

    With it, px/mm there, and whether the view sees it.
    """
    p, distance, seen = distance_maps.look(bank, maps, view, point, mi.Bool(True))
    slopes, peak = [], distance
    for unit in (mi.Vector2f(_REACH_PX, 0), mi.Vector2f(0, _REACH_PX)):
        # beside what is not seen the map jumps; a distance cannot grow faster than the way walked
        near = [dr.minimum(maps.at(view, p.px + sign * unit, seen), distance + _REACH_PX) for sign in (1.0, -1.0)]
        slopes.append(dr.maximum(dr.abs(near[0] - distance), dr.abs(near[1] - distance)))
        if sharpen:
            falls = [near[side] - maps.at(view, p.px + sign * 2.0 * unit, seen) for side, sign in ((0, 1.0), (1, -1.0))]
            crease = 0.5 * (near[0] + near[1]) + dr.clip(dr.minimum(falls[0], falls[1]), 0.0, _REACH_PX)
            peak = dr.maximum(peak, crease)
    norm_2 = dr.square(slopes[0]) + dr.square(slopes[1]) + 1e-9
    g_2 = (dr.square(slopes[0]) * dr.squared_norm(p.du) + dr.square(slopes[1]) * dr.squared_norm(p.dv)) / norm_2
    g = dr.select(norm_2 < _FLAT, dr.sqrt(dr.norm(p.du) * dr.norm(p.dv)), dr.sqrt(g_2))
    return peak / g, g, seen


def _against_spheres(
    spheres: Spheres, leaves: Leaves
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Cut leaves until each lies wholly inside the spheres or is a finest node.

    Returns
    -------
    index (N, 3), size (N,), the hull's occupancy (N,), and the fraction inside the spheres (N,).
    """
    origin, finest_mm = np.asarray(leaves.grid.origin_mm), leaves.grid.size_mm
    low, high = leaves.index.min(axis=0), (leaves.index + leaves.size[:, None]).max(axis=0)
    listed = _Listed.of(spheres, origin + low * finest_mm, origin + high * finest_mm, finest_mm)
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


def in_common_mm3(spheres: Spheres, leaves: Leaves) -> float:
    """Return the volume that lies in spheres and in leaves."""
    _, size, occupancy, inside = _against_spheres(spheres, leaves)
    return float((np.minimum(occupancy, inside) * (size * leaves.grid.size_mm) ** 3.0).sum(dtype=np.float64))


def depth_in_spheres(spheres: Spheres, points_mm: Array) -> NDArray[np.float32]:
    """Return how deep (N,) points (N, 3) lie inside the union of spheres; negative outside."""
    if not len(points_mm) or not len(spheres.radius_mm):
        return np.full(len(points_mm), -np.inf, np.float32)
    return _Listed.of(spheres, points_mm.min(axis=0), points_mm.max(axis=0), 0.0).depth_mm(points_mm)


@dataclass(frozen=True)
class _Listed:
    """Spheres listed by the cubic bins they reach into."""

    low_mm: Array
    shape: NDArray[np.int64]
    entries: UInt32
    """mi.Float, x y z r of the spheres of one bin after the other."""
    begins: UInt32
    """mi.UInt32, first entry of each bin, and the end."""

    @staticmethod
    def of(spheres: Spheres, low: Array, high: Array, beside_mm: float) -> _Listed:
        """List spheres, and what lies so far beside them, in bins that cover a box."""
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
        return _Listed(low, shape, numbers(packed), wholes(begins))

    def depth_mm(self, points_mm: Array) -> NDArray[np.float32]:
        """Return how deep (N,) points (N, 3) lie inside the union of the spheres; negative outside."""
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


def _needed(bank: ViewBank, maps: DistanceMaps, trimmed: Leaves, uncertain: NDArray[np.int32]) -> NDArray[np.float32]:
    """Tell how much (N,), 0 to 1, silhouettes need of the uncertain finest nodes (N, 3).

    The trimmed shape does not explain these.

    One view that lacks a node may be wrong: what the second most lacking one lacks is needed.
    """
    width, height = maps.samples_wh
    voxel, size, filled = to_voxels(trimmed, 2)
    some = filled > 0.25
    solid = _points(trimmed, 2 * even(voxel[some], size[some]), 2)
    share = numbers(np.clip(2.0 * evenly(filled[some], size[some]) - 0.5, 0.0, 1.0))
    places = _points(trimmed, uncertain, 1)
    most, second = dr.zeros(mi.Float, dr.width(places)), dr.zeros(mi.Float, dr.width(places))
    values, columns = np.array(maps.values).reshape(bank.count, height, width), dr.opaque(mi.UInt32, width)
    for view in range(bank.count):
        p, seen = _seen(bank, maps, view, solid)
        place = maps.sample(p.px) + 0.5
        covered = dr.zeros(mi.Float, width * height)
        dr.scatter_reduce(dr.ReduceOp.Max, covered, share, mi.UInt32(place.y) * columns + mi.UInt32(place.x), seen)
        explained = _spread(np.array(covered).reshape(height, width), 3)
        deep = np.clip(1.5 * values[view] / _DEEP_PX - 1.0, 0.0, 1.0) * (values[view] < distance_maps.TELLS_PX)
        lacking = (deep * (1.0 - explained)).astype(np.float32)
        if not lacking.any():
            continue
        p, seen = _seen(bank, maps, view, places)
        lacks = dr.select(seen, replace(maps, values=numbers(_spread(lacking, 5))).at(0, p.px, seen), 0.0)
        most, second = dr.maximum(most, lacks), dr.maximum(second, dr.minimum(most, lacks))
        dr.eval(most, second)
    return np.array(second)


def _spread(picture: NDArray[np.float32], edge: int) -> NDArray[np.float32]:
    """Widen a picture (H, W) by a square of an odd edge, and smooth its steps."""
    return np.asarray(cv2.blur(cv2.dilate(picture, np.ones((edge, edge), np.uint8)), (3, 3)), np.float32)


def even(index: NDArray[np.int32], size: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cut cubes of several sizes into unit cubes: (M, 3) indices."""
    parts = []
    for edge in np.unique(size):
        offset = np.array(list(np.ndindex(edge, edge, edge)), np.int32)
        parts.append((index[size == edge][:, None] + offset).reshape(-1, 3))
    return np.concatenate(parts) if parts else index


def evenly(values: NDArray[np.float32], size: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the values (M,) of the unit cubes that `even` cuts cubes with values (N,) into."""
    return np.concatenate([np.repeat(values[size == edge], edge**3) for edge in np.unique(size)]) if len(size) else values


def _points(leaves: Leaves, index: NDArray[np.int32], edge: int) -> Point3f:
    """Return the centres of nodes of an edge on the device."""
    centres = np.asarray(leaves.grid.origin_mm) + (index + 0.5 * edge) * leaves.grid.size_mm
    return device.points(centres)


def _seen(bank: ViewBank, maps: DistanceMaps, view: int, points: Point3f) -> tuple[projection.Projected, Bool]:
    """Project points into a view: (projection, whether the view sees them on its distance map)."""
    p = projection.project(bank, dr.opaque(mi.UInt32, view, dr.width(points)), points, mi.Bool(True))
    (width, height), place = (dr.opaque(mi.Float, count) for count in maps.samples_wh), maps.sample(p.px)
    seen = p.seen & (place.x >= -0.5) & (place.x < width - 0.5) & (place.y >= -0.5) & (place.y < height - 0.5)
    return p, seen
