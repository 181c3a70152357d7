"""What the silhouettes leave open about thick organs and solid bodies, and about what lies where too few views see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.hull import carve, parsimony
from rhizotwin.recon.hull.carve import DistanceMaps, Grid, Hull, Leaves, Water
from rhizotwin.recon.hull.parsimony import Trimmed
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.uncertainty.budget import Term

Array = NDArray[np.float64]

_OUTLINE_PX = 0.1
"""An outline may be this far off (90 %): strips of 1 to 3 px come out with 0.97 to 1.02 of their width, whatever their direction."""
_ABSENT = 0.1
"""What no picture needs is taken to be absent; at 90 % confidence, a tenth of it may be there."""
_COARSER = 4
"""The hull of half the views is carved with nodes this much larger: only its excess is wanted."""
_MUCH_KEPT = 0.05
"""With less untrimmed hull than this share of the volume its excess is no concern."""
_INDEX = 0.002
"""An index wrong by 0.001 (salts, ten degrees) changes a volume by less than this share."""
_EDGE_MM = 0.5
"""A shape ends by up to this much below where sight ends: outlines are drawn at half a coverage."""
_ANYWHERE = 0.9
"""What goes on out of sight ends anywhere below the top of the water, nine times of ten within this part of the way."""
_REACH_MM = 12.0
"""A root's hidden end is looked for this far below the top of the water."""


def doubt(hull: Hull, trimmed: Trimmed, *, share: float, slack_px: float, half_excess: float) -> tuple[Term, ...]:
    """Return the terms of a trimmed hull.

    Parameters
    ----------
    share : how much of the trimmed volume is in the shape (the rest is given by tubes).
    slack_px : by how much outlines were moved for `Hull.moved_in_mm3` and ``moved_out_mm3``.
    half_excess : by how much the hull grows when half of the views carve it, as a share.
    """
    volume, whole = trimmed.leaves.volume_mm3(), hull.leaves.volume_mm3()
    by_px = (hull.moved_out_mm3 - hull.moved_in_mm3) / (2.0 * slack_px) * min(1.0, volume / whole)
    outline, removed, kept = share * _OUTLINE_PX * by_px, share * max(0.0, whole - volume), share * trimmed.kept_mm3
    trimmable = max(volume - trimmed.kept_mm3, 1e-9)
    excess = max(half_excess, min(removed / (share * trimmable), 1.0) if kept < share * trimmable else 0.0)
    return (
        Term(
            name="outlines",
            less_mm3=outline,
            more_mm3=outline,
            why="outlines of thick parts are known to a tenth of a pixel",
        ),
        Term(
            name="trimmed away",
            less_mm3=0.0,
            more_mm3=_ABSENT * removed,
            why="parts of the hull that no picture needs may be there all the same",
        ),
        Term(
            name="untrimmed hull",
            less_mm3=kept * excess,
            more_mm3=0.0,
            why="parts of the shape are hull that could not be trimmed, too large where too few views bound it",
        ),
    )


def half_excess(bank: ViewBank, frames: Sequence[int], maps: DistanceMaps, hull: Hull, trimmed: Trimmed, water: Water) -> float:
    """Return by how much a hull grows, as a share, when every other view carves it; 0 where little of it is kept.

    A flat face that no view looks along is bounded by the two views beside: its excess goes with one over the number of views, so that
    what half of the views add is what all of them have too much. (Round bodies' goes with its square: a third of that.)

    Parameters
    ----------
    frames : number of each view's frame, which rise round the turn.
    """
    if trimmed.kept_mm3 < _MUCH_KEPT * trimmed.leaves.volume_mm3():
        return 0.0
    fine = hull.leaves.grid
    low = np.asarray(fine.origin_mm)
    high = low + np.array(fine.coarse_shape) * fine.size_mm * 2**fine.levels
    grid = Grid.over(low, high, fine.size_mm * _COARSER)
    every_other = every_second(frames)
    half_maps = replace(maps, values=mi.Float(np.array(maps.values).reshape(bank.count, -1)[every_other].ravel()))
    volumes = [
        carve.carve(
            some,
            outlines,
            grid,
            radius_mm=water.radius_mm,
            top_mm=water.top_mm,
            bottom_mm=water.bottom_mm,
            min_votes=max(3, math.ceil(parsimony.VOTES * some.count)),
        ).leaves.volume_mm3()
        for some, outlines in ((bank, maps), (bank.chosen(every_other), half_maps))
    ]
    return max(0.0, volumes[1] / max(volumes[0], 1e-9) - 1.0)


def every_second(frames: Sequence[int]) -> list[int]:
    """Return the places, rising, of every other frame in the order of their numbers."""
    return sorted(np.argsort(frames)[::2].tolist())


def beyond_sight(bank: ViewBank, maps: DistanceMaps, leaves: Leaves, water: Water) -> Term:
    """Return what the shape may have above its top, where too few views see: its columns go on, at most to the top of the water."""
    size_mm, origin = leaves.grid.size_mm, np.asarray(leaves.grid.origin_mm)
    tops_mm = origin[2] + (leaves.index[:, 2] + leaves.size) * size_mm
    high = np.flatnonzero((tops_mm > water.top_mm - _REACH_MM) & (leaves.occupancy > 0))
    hidden = 0.0
    if len(high):
        part = replace(leaves, index=leaves.index[high], size=leaves.size[high], occupancy=leaves.occupancy[high])
        cells = parsimony.even(part.index, part.size).astype(np.int64)
        full = np.concatenate([np.repeat(part.occupancy[part.size == edge], edge**3) for edge in np.unique(part.size)])
        column = (cells[:, 0] - cells[:, 0].min()) * (np.ptp(cells[:, 1]) + 1) + cells[:, 1] - cells[:, 1].min()
        order = np.lexsort((cells[:, 2], column))
        last = np.append(np.flatnonzero(np.diff(column[order])), len(order) - 1)
        top = order[last]
        ends_mm = origin + (cells[top] + np.array([0.5, 0.5, 1.0])) * size_mm
        above = ends_mm + np.array([0.0, 0.0, _EDGE_MM])
        gap_mm = _ANYWHERE * np.maximum(water.top_mm - ends_mm[:, 2], 0.0)
        unseen = _votes(bank, maps, above) < max(3, math.ceil(parsimony.VOTES * bank.count))
        hidden = float((gap_mm * full[top])[unseen].sum() * size_mm**2)
    return Term(
        name="beyond sight", less_mm3=0.0, more_mm3=hidden, why="the roots go on where too few views see, below the net pot or behind it"
    )


def water(volume_mm3: float) -> Term:
    """Return what the water's index leaves open: what a thermometer or the pictures do not tell."""
    half = _INDEX * volume_mm3
    return Term(name="water", less_mm3=half, more_mm3=half, why="the water's index may differ from the one that was used")


def _votes(bank: ViewBank, maps: DistanceMaps, points_mm: Array) -> NDArray[np.int64]:
    """Return how many views see points (N, 3)."""
    point = mi.Point3f(points_mm.T.astype(np.float32))
    votes = np.zeros(len(points_mm), np.int64)
    for view in range(bank.count):
        _, _, seen = carve.look(bank, maps, dr.opaque(mi.UInt32, view, len(points_mm)), point, mi.Bool(True))
        votes += np.array(seen, np.int64)
    return votes
