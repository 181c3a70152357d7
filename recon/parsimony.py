"""What no picture needs is not root: from the hull to the roots inside it.

A visual hull is too large: where a root hides behind another in the views that would bound its flanks, its cross-section grows tips
and the crotches fill. But the largest ball about a point of a root's centre line that no view contradicts has the root's own
radius, for it is bounded by whichever view shows the root alone. So the roots are rebuilt as the union of these balls along the
hull's centre lines, and compared with the pictures: where a silhouette is not explained by the balls (parts that are no tubes,
roots thinner than the skeleton's voxels), the hull is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage import morphology

from recon import carve, projection
from recon.carve import DistanceMaps, Leaves
from recon.projection import ViewBank
from recon.silhouettes import UPSAMPLING
from recon.surface import paint, to_voxels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SKELETON_MM = 0.5
_SPACING_MM = 0.16
_BIN_MM = 4.0
_DEEP_PX = 0.75
"""A silhouette must be left unexplained this deep inside its outline for the hull to be kept there."""
_AGREEING_VIEWS = 2


@dataclass(frozen=True)
class Balls:
    """Balls inside the roots."""

    centre_mm: Array
    """(N, 3), canister frame."""
    radius_mm: Array
    """(N,)"""


def trim(bank: ViewBank, maps: DistanceMaps, leaves: Leaves) -> tuple[Leaves, Balls]:
    """Trim a hull to what its silhouettes need.

    Returns
    -------
    leaves : the trimmed shape, cut down to the finest nodes; its occupancies are at most the hull's.
    balls : the balls along the centre lines.
    """
    balls = grow_balls(bank, maps, centre_lines(leaves))
    index, occupancy = _finest(leaves)
    if not len(balls.radius_mm):
        return leaves, balls
    inside = _inside_balls(balls, leaves, index)
    kept = np.minimum(occupancy, inside)
    missing = occupancy - kept > 0.02
    if missing.any():
        needed = _needed(bank, maps, leaves, index, kept, missing)
        kept[needed] = occupancy[needed]
    some = kept > 0
    return (
        Leaves(
            grid=leaves.grid,
            index=index[some],
            size=np.ones(int(some.sum()), np.int32),
            occupancy=kept[some],
            occupancy_low=kept[some],
            occupancy_high=kept[some],
            blind_mm3=leaves.blind_mm3,
        ),
        balls,
    )


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
    pairs = cKDTree(nodes).query_pairs(1.8, output_type="ndarray")
    steps = max(1, int(np.ceil(1.4 * voxel_mm / _SPACING_MM)))
    share = (np.arange(1, steps) / steps)[None, :, None]
    between = nodes[pairs[:, 0]][:, None] * (1 - share) + nodes[pairs[:, 1]][:, None] * share
    points = np.concatenate([nodes, between.reshape(-1, 3)])
    return np.asarray(leaves.grid.origin_mm) + (points + low + 0.5) * voxel_mm


def _across(points: Array) -> tuple[Array, Array]:
    """Return two unit vectors (N, 3) across the local direction of a cloud of points along curves."""
    near = cKDTree(points).query(points, k=min(12, len(points)))[1]
    cloud = points[near] - points[near].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", cloud, cloud))
    return vectors[:, :, 0], vectors[:, :, 1]


def grow_balls(bank: ViewBank, maps: DistanceMaps, points: Array) -> Balls:
    """Move points across their curve to where the largest ball fits into all silhouettes, and return those balls."""
    if len(points) < 3:
        radius = _radius(bank, maps, points) if len(points) else np.zeros(0)
        return Balls(points[radius > 0], radius[radius > 0])
    first, second = _across(points)
    radius = _radius(bank, maps, points)
    angle = np.arange(8) * np.pi / 4
    for step_mm in (0.4, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.025):
        offset = step_mm * (np.cos(angle)[None, :, None] * first[:, None] + np.sin(angle)[None, :, None] * second[:, None])
        tried = _radius(bank, maps, (points[:, None] + offset).reshape(-1, 3)).reshape(len(points), 8)
        best = tried.argmax(axis=1)
        better = tried.max(axis=1) > radius
        points = np.where(better[:, None], points + offset[np.arange(len(points)), best], points)
        radius = np.maximum(radius, tried.max(axis=1))
    good = (radius > 0) & (radius < 1e3)
    return Balls(points[good], radius[good])


def _radius(bank: ViewBank, maps: DistanceMaps, points: Array) -> Array:
    """Return the radius in mm of the largest ball about each point that every view allows.

    In a view the distance D to the outline is that along the outline's normal (a, b); the plane of sight through the outline has the
    normal g = a du + b dv in space, so the ball's radius is D / |g|. On a root's centre line D has a crease: |a| and |b| are taken from
    the steeper of the two sides.
    """
    reach_px = 1.0

    def body(view: Any, least: Any, votes: Any) -> tuple[Any, Any, Any]:
        p, distance, seen = carve.look(bank, maps, view, point, mi.Bool(True))
        slope = []
        for shift in (mi.Vector2f(reach_px, 0), mi.Vector2f(0, reach_px)):
            sides = [dr.abs(maps.at(view, p.px + sign * shift, seen) - distance) for sign in (1.0, -1.0)]
            slope.append(dr.maximum(sides[0], sides[1]))
        norm_2 = slope[0] * slope[0] + slope[1] * slope[1] + 1e-9
        g_2 = (slope[0] * slope[0] * dr.squared_norm(p.du) + slope[1] * slope[1] * dr.squared_norm(p.dv)) / norm_2
        flat = norm_2 < 0.01
        g = dr.select(flat, dr.sqrt(dr.norm(p.du) * dr.norm(p.dv)), dr.sqrt(g_2))
        least = dr.minimum(least, dr.select(seen, distance / g, 1e4))
        return view + 1, least, votes + dr.select(seen, mi.UInt32(1), mi.UInt32(0))

    point = mi.Point3f(points.T.astype(np.float32))
    state = (mi.UInt32(0), dr.full(mi.Float, 1e4, len(points)), dr.zeros(mi.UInt32, len(points)))
    _, least, _ = dr.while_loop(state, lambda view, *_: view < bank.count, body)
    return np.array(least, dtype=np.float64)


def _finest(leaves: Leaves) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Cut all leaves to the finest nodes: (N, 3) index and (N,) occupancy."""
    indices, occupancies = [], []
    for edge in np.unique(leaves.size):
        chosen = leaves.size == edge
        offset = np.stack(np.meshgrid(*[np.arange(edge, dtype=np.int32)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        indices.append((leaves.index[chosen][:, None] + offset).reshape(-1, 3))
        occupancies.append(np.repeat(leaves.occupancy[chosen], len(offset)))
    return np.concatenate(indices), np.concatenate(occupancies)


def _inside_balls(balls: Balls, leaves: Leaves, index: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the fraction (N,) of each finest node inside the union of the balls."""
    size_mm = leaves.grid.size_mm
    low = np.asarray(leaves.grid.origin_mm) + index.min(axis=0) * size_mm
    high = np.asarray(leaves.grid.origin_mm) + (index.max(axis=0) + 1) * size_mm
    shape = np.maximum(np.ceil((high - low) / _BIN_MM), 1).astype(np.int64)
    # list the balls that reach into each bin
    first = np.clip(np.floor((balls.centre_mm - balls.radius_mm[:, None] - size_mm - low) / _BIN_MM), 0, shape - 1).astype(np.int64)
    last = np.clip(np.floor((balls.centre_mm + balls.radius_mm[:, None] + size_mm - low) / _BIN_MM), 0, shape - 1).astype(np.int64)
    extent = last - first + 1
    count = extent.prod(axis=1)
    ball = np.repeat(np.arange(len(count)), count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ex = extent[ball]
    offset = np.stack([place // (ex[:, 1] * ex[:, 2]), place // ex[:, 2] % ex[:, 1], place % ex[:, 2]], axis=1)
    bins = ((first[ball] + offset) * [shape[1] * shape[2], shape[2], 1]).sum(axis=1)
    order = np.argsort(bins, kind="stable")
    starts = np.searchsorted(bins[order], np.arange(shape.prod() + 1))
    packed = np.concatenate([balls.centre_mm, balls.radius_mm[:, None]], axis=1)[ball[order]].astype(np.float32)
    listed, begins = mi.Float(packed.ravel()), mi.UInt32(starts.astype(np.uint32))
    result = np.empty(len(index), np.float32)
    chunk = 1 << 22
    for at in range(0, len(index), chunk):
        part = index[at : at + chunk]
        q = [mi.Float(part[:, a].astype(np.float32)) * size_mm + float(leaves.grid.origin_mm[a] + 0.5 * size_mm) for a in range(3)]
        cell = [dr.clip(mi.Int32((q[a] - float(low[a])) / _BIN_MM), 0, int(shape[a]) - 1) for a in range(3)]
        bin_ = mi.UInt32((cell[0] * int(shape[1]) + cell[1]) * int(shape[2]) + cell[2])
        end = dr.gather(mi.UInt32, begins, bin_ + 1)
        centre = mi.Point3f(*q)

        def body(k: Any, depth: Any, centre: Any = centre) -> tuple[Any, Any]:
            entry = dr.gather(mi.Vector4f, listed, k)
            return k + 1, dr.maximum(depth, entry.w - dr.norm(centre - mi.Point3f(entry.x, entry.y, entry.z)))

        state = (dr.gather(mi.UInt32, begins, bin_), dr.full(mi.Float, -1e3, len(part)))
        _, depth = dr.while_loop(state, lambda k, _, end=end: k < end, body)
        result[at : at + chunk] = np.array(dr.clip(0.5 + depth / size_mm, 0.0, 1.0))
    return result


def _needed(
    bank: ViewBank, maps: DistanceMaps, leaves: Leaves, index: NDArray[np.int32], kept: NDArray[np.float32], missing: Mask
) -> Mask:
    """Tell which nodes the balls leave out although silhouettes need them: (N,)."""
    width, height = maps.image_wh[0] * UPSAMPLING, maps.image_wh[1] * UPSAMPLING
    solid = _points(leaves, index[kept >= 0.5])
    doubtful = _points(leaves, index[missing])
    votes = dr.zeros(mi.UInt32, dr.width(doubtful))
    values = np.array(maps.values).reshape(bank.count, height, width)
    for view in range(bank.count):
        covered = dr.zeros(mi.UInt8, width * height)
        u, v, seen = _sample(bank, view, solid, width, height)
        dr.scatter(covered, mi.UInt8(1), v * width + u, seen)
        picture = cv2.dilate(np.array(covered).reshape(height, width), np.ones((3, 3), np.uint8))
        unexplained = (values[view] > _DEEP_PX) & (values[view] < 0.5 * carve.UNSEEN_PX) & (picture == 0)
        if not unexplained.any():
            continue
        lacking = mi.UInt8(cv2.dilate(unexplained.astype(np.uint8), np.ones((3, 3), np.uint8)).ravel())
        u, v, seen = _sample(bank, view, doubtful, width, height)
        votes += mi.UInt32(dr.gather(mi.UInt8, lacking, v * width + u, seen))
        dr.eval(votes)
    needed = np.zeros(len(index), bool)
    needed[missing] = np.array(votes) >= _AGREEING_VIEWS
    return needed


def _points(leaves: Leaves, index: NDArray[np.int32]) -> Any:
    """Return the centres of finest nodes on the device."""
    centres = np.asarray(leaves.grid.origin_mm) + (index + 0.5) * leaves.grid.size_mm
    return mi.Point3f(centres.T.astype(np.float32))


def _sample(bank: ViewBank, view: int, points: Any, width: int, height: int) -> tuple[Any, Any, Any]:
    """Return the column and row of points on a view's distance map, and whether the view sees them."""
    p = projection.project(bank, dr.opaque(mi.UInt32, view, dr.width(points)), points, mi.Bool(True))
    u = (p.px.x + 0.5) * UPSAMPLING
    v = (p.px.y + 0.5) * UPSAMPLING
    seen = p.seen & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return mi.UInt32(dr.select(seen, u, 0)), mi.UInt32(dr.select(seen, v, 0)), seen
