"""Uncertainty of the volume due to roots in places that too few views show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon import device
from rhizotwin.recon.device import UInt32
from rhizotwin.recon.hull import distance_maps
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.tubes.tubes import TANGENT_NODES
from rhizotwin.recon.uncertainty.budget import Term
from rhizotwin.recon.uncertainty.hidden_top import LEAST_COSINE
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

_COLUMN_MM = 0.4
"""Minimum width of the columns of voxels whose hidden continuation is estimated, mm."""
_EDGE_MM = 0.5
"""Distance beyond the end of a shape at which too few views must see for the end to be considered hidden, mm. It is not
zero, since outlines are at half coverage."""
_ANYWHERE = 0.9
"""Fraction of the hidden length that contains the end of a root with a probability of 90 %. The position of the end is
assumed to be uniformly distributed over the hidden length."""
_UP = 2
"""Number of the vertical axis."""
_LOOKS = 16
"""Number of points along a hidden length at which visibility is tested."""
_WHERE = {
    -1: "below the lower edge of the pictures or of the backlight: mount the plant higher, or add a ring that looks lower",
    1: "below the net pot or behind it",
}
"""Description of the hidden places below (-1) and above (1) the shape, for the user."""


def occlusion_term(bank: ViewBank, maps: DistanceMaps, leaves: Leaves, solids: Leaves, roots: Sequence[Root], water: Water) -> Term:
    """Return the term of the error budget for volume that may be hidden in places that too few views show.

    Vertical columns of voxels that end at such a place are extended until enough views see again, or to the edge of the
    water, and so are horizontal columns of solids. A root continues beyond its tip in its own direction: its side is no
    end, also if it is nearly horizontal. Roots join upwards: if their cross-section increases towards the top, the
    columns hidden above it are assumed to be wider (`_widening`). The axis with the largest hidden volume is used.

    Parameters
    ----------
    bank, maps : ViewBank, DistanceMaps
        Views and their distance maps.
    leaves, solids : Leaves
        Leaves of the shape, and of its parts that are no roots.
    roots : sequence of Root
        Roots of the shape.
    water : Water
        Extent of the water.

    Returns
    -------
    Term
        The additional volume.
    """
    tips = _hidden_tips(bank, maps, roots, water)
    hidden = {
        axis: [tips * (axis != _UP)] + [_hidden_columns(bank, maps, part, water, axis, side) for side in (-1, 1)]
        for part, axes in ((_Voxels.of(solids), (0, 1)), (_Voxels.of(leaves, roots), (_UP,)))
        for axis in axes
    }
    axis = max(hidden, key=lambda a: sum(hidden[a]))
    where = _WHERE[-1 if hidden[axis][1] >= hidden[axis][2] else 1] if axis == _UP else _describe_side(bank)
    return Term(
        name="occluded",
        less_mm3=0.0,
        more_mm3=_ANYWHERE * sum(hidden[axis]),
        why=f"the shape may continue where too few views look, {where}",
    )


@dataclass(frozen=True)
class _Voxels:
    """Parts of a shape as voxels, whose rows are the columns that may continue."""

    cells: NDArray[np.int64]
    """Indices (N, 3) of the voxels."""
    full: NDArray[np.float32]
    """Occupied fraction (N,) of each voxel."""
    origin_mm: Array
    """Position (3,) of the corner of the voxel with index 0, canister frame, mm."""
    edge_mm: float
    roots: Sequence[Root]
    """Roots of the shape."""

    @classmethod
    def of(cls, leaves: Leaves, roots: Sequence[Root] = ()) -> _Voxels:
        """Merge leaves into voxels."""
        merged = leaves.merge(max(0, math.ceil(math.log2(_COLUMN_MM / leaves.grid.size_mm)))).split()
        return cls(merged.index.astype(np.int64), merged.occupancy, np.asarray(merged.grid.origin_mm), merged.grid.size_mm, roots)

    def steep(self, voxels: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return the mask (K,) of the voxels, given by their indices, that are not part of a nearly horizontal root."""
        if not any(len(root.points_mm) > 1 for root in self.roots):
            return np.ones(len(voxels), np.bool_)
        begin, end = (np.concatenate([root.points_mm[part] for root in self.roots]) for part in (slice(-1), slice(1, None)))
        radius_mm = 0.5 * np.concatenate([root.diameters_mm[1:] for root in self.roots])
        beside_mm, nearest = cKDTree(0.5 * (begin + end)).query(self.origin_mm + (self.cells[voxels] + 0.5) * self.edge_mm)
        cosine = np.abs(polyline.unit_vectors(end - begin)[nearest, 2])
        return np.asarray((cosine >= LEAST_COSINE) | (beside_mm > radius_mm[nearest] + self.edge_mm))


def _hidden_columns(bank: ViewBank, maps: DistanceMaps, part: _Voxels, water: Water, axis: int, side: int) -> float:
    """Return the volume of the columns of voxels that may continue on one side (-1 or 1) of an axis, mm3."""
    cells, full, edge_mm, direction = part.cells, part.full, part.edge_mm, side * np.eye(3)[axis]
    last = _ends(cells, full, axis, side)
    last = last[part.steep(last)]
    gap_mm = gaps_mm(bank, maps, part.origin_mm + (cells[last] + 0.5 + 0.5 * direction) * edge_mm, direction, water)
    wider = _widening(cells[:, 2], full, last, gap_mm / edge_mm) if (axis, side) == (_UP, 1) else 1.0
    before = CellSet.from_cells(cells).find(cells[last] - direction.astype(np.int64))  # a flat end cuts the last voxels
    section = np.where(before >= 0, np.maximum(full[last], full[before]), full[last])
    return wider * float(gap_mm @ section) * edge_mm**2


def _hidden_tips(bank: ViewBank, maps: DistanceMaps, roots: Sequence[Root], water: Water) -> float:
    """Return the volume of the roots that may continue beyond their last points, mm3."""
    if not roots:
        return 0.0
    ends_mm = np.array([root.points_mm[-1] for root in roots])
    onward = np.array([root.points_mm[-1] - root.points_mm[-min(TANGENT_NODES + 1, len(root.points_mm))] for root in roots])
    gap_mm = gaps_mm(bank, maps, ends_mm, polyline.unit_vectors(onward), water)
    return float(gap_mm @ [0.25 * np.pi * root.diameters_mm[-1] ** 2 for root in roots])


def _widening(height: NDArray[np.int64], full: NDArray[np.float32], last: NDArray[np.int64], gap: Array) -> float:
    """Return the cross-section in a hidden length above a shape, relative to that below it.

    It is assumed to increase over the hidden length as it does over an equal visible length below it, by at most a
    factor of two. The result is 1 if less than twice the hidden length is visible, so that the increase is unknown.

    Parameters
    ----------
    height : (N,) int64 array
        Vertical index of each voxel.
    full : (N,) float32 array
        Occupied fraction of each voxel.
    last : (K,) int64 array
        Indices of the voxels at the top of their columns.
    gap : (K,) float64 array
        Hidden length above them, in voxels.
    """
    weight = gap * full[last]
    if not weight.any():
        return 1.0
    low = height.min()
    section = np.cumsum(np.bincount(height - low, full))
    count = max(1, round(float(weight @ gap / weight.sum())))
    top = round(float(weight @ (height[last] - low) / weight.sum()))
    if top < 2 * count:
        return 1.0
    upper, lower = section[top] - section[top - count], section[top - count] - section[top - 2 * count]
    return float(np.clip(upper / max(lower, 1e-9), 1.0, 2.0))


def _describe_side(bank: ViewBank) -> str:
    """Return a description of the hidden places beside the shape, for the user.

    A round wall in air deflects light away from the cameras. The flat wall of a tank does not.
    """
    optics = bank.optics
    bends = optics.tank is None and optics.n_water > 1.0
    why = "where the water refracts light away from the cameras" if bends else "beyond the sides of the pictures or of the backlight"
    return f"towards the wall, {why}"


def _ends(cells: NDArray[np.int64], full: NDArray[np.float32], axis: int, side: int) -> NDArray[np.int64]:
    """Return the indices (K,) of the occupied cells that are the last of their column.

    Columns are parallel to an axis. ``side`` is the direction in which the last cell is sought: -1 or 1.
    """
    some = np.flatnonzero(full > 0)
    if not len(some):
        return some
    one, other = (cells[some, a] for a in range(3) if a != axis)
    column = one * (np.ptp(other) + 1) + other
    order = np.lexsort((side * cells[some, axis], column))
    return some[order[np.append(np.flatnonzero(np.diff(column[order])), len(order) - 1)]]


def gaps_mm(bank: ViewBank, maps: DistanceMaps, end_mm: Array, direction: Array, water: Water) -> Array:
    """Return the distances (N,) by which roots may extend beyond their ends without being seen, mm.

    The distance is 0 where enough views show that the root ends.

    Parameters
    ----------
    bank, maps : ViewBank, DistanceMaps
        Views and their distance maps.
    end_mm : (N, 3) array
        Ends, canister frame.
    direction : (3,) or (N, 3) array
        Unit vector of the direction in which all or each of them continue.
    water : Water
        Extent of the water.
    """
    gap, direction = np.zeros(len(end_mm)), np.broadcast_to(direction, end_mm.shape)
    way = _water_extent(end_mm, direction, water)
    ahead = end_mm + np.minimum(_EDGE_MM, way)[:, None] * direction
    open_ = np.flatnonzero((way > 0) & ~_are_visible(bank, maps, ahead))
    if len(open_):
        share = (np.arange(_LOOKS) + 1.0) / _LOOKS
        steps_mm = share * np.maximum(way[open_] - _EDGE_MM, 0.0)[:, None]
        on_way = ahead[open_, None] + steps_mm[..., None] * direction[open_, None]
        visible = _are_visible(bank, maps, on_way.reshape(-1, 3)).reshape(len(open_), _LOOKS)
        first = np.where(visible.any(axis=1), share[visible.argmax(axis=1)], 1.0)
        gap[open_] = first * way[open_]
    return gap


def _water_extent(from_mm: Array, direction: Array, water: Water) -> Array:
    """Return the distances (N,) from points (N, 3) to the edge of the water in directions (N, 3), mm.

    The distance is 0 for points outside the water.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.where(direction[:, 2] > 0.0, water.top_mm, water.bottom_mm)
        vertical = np.where(direction[:, 2] == 0.0, np.inf, (level - from_mm[:, 2]) / direction[:, 2])
        flat = np.sum(direction[:, :2] ** 2, axis=1)
        along = np.sum(from_mm[:, :2] * direction[:, :2], axis=1)
        inside = water.radius_mm**2 - np.sum(from_mm[:, :2] ** 2, axis=1)
        sideways = np.where(flat == 0.0, np.inf, (np.sqrt(np.maximum(along**2 + flat * inside, 0.0)) - along) / flat)
    return np.where(inside < 0.0, 0.0, np.maximum(np.minimum(vertical, sideways), 0.0))


def _are_visible(bank: ViewBank, maps: DistanceMaps, points_mm: Array) -> NDArray[np.bool_]:
    """Return the mask (N,) of points (N, 3) that enough views show.

    The number of views is that of the carving (`distance_maps.least_votes`).
    """
    return _votes(bank, maps, points_mm) >= distance_maps.least_votes(bank.count)


def _votes(bank: ViewBank, maps: DistanceMaps, points_mm: Array) -> NDArray[np.int64]:
    """Return the number (N,) of views that show each point (N, 3)."""
    if not len(points_mm):
        return np.zeros(0, np.int64)
    point = device.points(points_mm)

    def body(view: UInt32, votes: UInt32) -> tuple[UInt32, UInt32]:
        _, _, usable = distance_maps.project_and_read(bank, maps, view, point, mi.Bool(True))
        return view + 1, votes + dr.select(usable, mi.UInt32(1), mi.UInt32(0))

    state = (mi.UInt32(0), dr.zeros(mi.UInt32, len(points_mm)))
    return np.array(dr.while_loop(state, lambda view, _: view < bank.end, body)[1], np.int64)
