"""What a shape may have where too few views see: it goes on there, until it is seen to end or the water does."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon import device
from rhizotwin.recon.device import UInt32
from rhizotwin.recon.hull import distance_maps
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Leaves, even, evenly
from rhizotwin.recon.hull.surface import to_voxels
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.uncertainty.budget import Term

Array = NDArray[np.float64]

_COLUMN_MM = 0.4
"""A shape is looked at in columns at least this wide."""
_EDGE_MM = 0.5
"""A shape ends by up to this much before sight does: outlines are drawn at half a coverage."""
_ANYWHERE = 0.9
"""What goes on out of sight ends anywhere on its way, nine times of ten within this part of it."""
_LOOKS = 16
"""Places on the way out of sight where somebody may see the water empty again."""
_WHERE = {
    -1: "below the pictures' lower edge or the reach of the light: hang it higher, or add a ring that looks lower",
    1: "below the net pot or behind it",
}
"""Where sight ends along the vertical, by side."""


def occluded(bank: ViewBank, maps: DistanceMaps, leaves: Leaves, water: Water) -> Term:
    """Return what a shape may have where it is occluded, above as below and to all sides.

    Its columns along each axis that end where too few views see go on, at most to where enough of them see again or to
    the water's end. Of the axes the one counts along which most may be hidden.

    Parameters
    ----------
    bank, maps : ViewBank, DistanceMaps
        Views and their distance maps.
    leaves : Leaves
        Of the shape.
    water : Water
        Where it ends.

    Returns
    -------
    Term
        What there may be more.
    """
    units = 2 ** max(0, math.ceil(math.log2(_COLUMN_MM / leaves.grid.size_mm)))
    index, size, occupancy = to_voxels(leaves, units)
    cells = even(index, size).astype(np.int64)
    full = evenly(occupancy, size)
    edge_mm, origin = units * leaves.grid.size_mm, np.asarray(leaves.grid.origin_mm)
    hidden = {}
    for axis in range(3):
        for side in (-1, 1):
            last = _ends(cells, full, axis, side)
            direction = np.zeros(3)
            direction[axis] = side
            end_mm = origin + (cells[last] + 0.5 + 0.5 * direction) * edge_mm
            hidden[axis, side] = _ANYWHERE * float((gaps_mm(bank, maps, end_mm, direction, water) * full[last]).sum()) * edge_mm**2
    axis = max(range(3), key=lambda a: hidden[a, -1] + hidden[a, 1])
    side = max((-1, 1), key=lambda s: hidden[axis, s])
    where = _WHERE[side] if axis == 2 else _towards_wall(bank)
    return Term(
        name="occluded",
        less_mm3=0.0,
        more_mm3=hidden[axis, -1] + hidden[axis, 1],
        why=f"the shape goes on where too few views see, {where}",
    )


def _towards_wall(bank: ViewBank) -> str:
    """Say where sight ends to the sides: a round wall in air bends light away, a tank of liquid about it does not."""
    optics = bank.optics
    bends = optics.tank is None and optics.n_water > 1.0
    why = "where the water bends light away from the cameras" if bends else "beyond the pictures' sides or the reach of the light"
    return f"towards the wall, {why}"


def _ends(cells: NDArray[np.int64], full: NDArray[np.float32], axis: int, side: int) -> NDArray[np.int64]:
    """Return which cells (N, 3) are the last of their columns along an axis, on one side."""
    some = np.flatnonzero(full > 0)
    if not len(some):
        return some
    one, other = (cells[some, a] for a in range(3) if a != axis)
    column = one * (np.ptp(other) + 1) + other
    order = np.lexsort((side * cells[some, axis], column))
    return some[order[np.append(np.flatnonzero(np.diff(column[order])), len(order) - 1)]]


def gaps_mm(bank: ViewBank, maps: DistanceMaps, end_mm: Array, direction: Array, water: Water) -> Array:
    """Return how far (N,) something may go on from where it ends; 0 where enough views see that it ends.

    Parameters
    ----------
    bank, maps : ViewBank, DistanceMaps
        Views and their distance maps.
    end_mm : (N, 3) array
        Ends, canister frame.
    direction : (3,) array
        Along an axis.
    water : Water
        Where the water ends.
    """
    gap = np.zeros(len(end_mm))
    way = _way(end_mm, direction, water)
    ahead = end_mm + np.minimum(_EDGE_MM, way)[:, None] * direction
    open_ = np.flatnonzero((way > 0) & ~_seen(bank, maps, ahead))
    if len(open_):
        share = (np.arange(_LOOKS) + 1.0) / _LOOKS
        on_way = ahead[open_, None] + (share[:, None] * np.maximum(way[open_] - _EDGE_MM, 0.0)[:, None, None]) * direction
        seen = _seen(bank, maps, on_way.reshape(-1, 3)).reshape(len(open_), _LOOKS)
        first = np.where(seen.any(axis=1), share[seen.argmax(axis=1)], 1.0)
        gap[open_] = first * way[open_]
    return gap


def _way(from_mm: Array, direction: Array, water: Water) -> Array:
    """Return how far (N,) the water reaches from points (N, 3) in a direction along an axis; 0 outside."""
    if direction[2]:
        end = water.top_mm if direction[2] > 0 else water.bottom_mm
        return np.maximum((end - from_mm[:, 2]) * direction[2], 0.0)
    along, across = from_mm @ direction, from_mm[:, 1 if direction[0] else 0]
    return np.maximum(np.sqrt(np.maximum(water.radius_mm**2 - across**2, 0.0)) - along, 0.0)


def _seen(bank: ViewBank, maps: DistanceMaps, points_mm: Array) -> NDArray[np.bool_]:
    """Tell which points (N, 3) enough views see."""
    return _votes(bank, maps, points_mm) >= distance_maps.least_votes(bank.count)


def _votes(bank: ViewBank, maps: DistanceMaps, points_mm: Array) -> NDArray[np.int64]:
    """Return how many views see points (N, 3)."""
    if not len(points_mm):
        return np.zeros(0, np.int64)
    point = device.points(points_mm)

    def body(view: UInt32, votes: UInt32) -> tuple[UInt32, UInt32]:
        _, _, seen = distance_maps.look(bank, maps, view, point, mi.Bool(True))
        return view + 1, votes + dr.select(seen, mi.UInt32(1), mi.UInt32(0))

    state = (mi.UInt32(0), dr.zeros(mi.UInt32, len(points_mm)))
    return np.array(dr.while_loop(state, lambda view, _: view < bank.end, body)[1], np.int64)
