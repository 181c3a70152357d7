"""What the silhouettes leave open about taproot, hypocotyl and solid bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from rhizotwin.recon.hull import carve
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Hull
from rhizotwin.recon.hull.parsimony import Trimmed
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.uncertainty.budget import Term

_OUTLINE_PX = 0.1
"""An outline may be this far off (90 %): bands of 1 to 3 px come out with 0.97 to 1.02 of their width, whatever their
direction."""
_ABSENT = 0.1
"""What no picture needs is taken to be absent; at 90 % confidence, a tenth of it may be there."""
_COARSER = 4
"""The hull of half the views is carved with nodes this much larger: only its excess is wanted."""
_MUCH_KEPT = 0.05
"""With less untrimmed hull than this share of the volume its excess is no concern."""
_INDEX = 0.002
"""An index wrong by 0.001 (salts, ten degrees) changes a volume by less than this share."""


def estimate(hull: Hull, trimmed: Trimmed, thick: Trimmed, *, slack_px: float, half_excess: float) -> tuple[Term, ...]:
    """Return the terms of a trimmed hull.

    Parameters
    ----------
    thick : Trimmed
        The part of it that is in the shape (the rest is given by tubes).
    slack_px : float
        By how much outlines were moved for `Hull.moved_in_mm3` and ``moved_out_mm3``.
    half_excess : float
        By how much the hull grows when half of the views carve it, as a share.
    """
    volume, whole, thick_mm3 = (leaves.volume_mm3() for leaves in (trimmed.leaves, hull.leaves, thick.leaves))
    share = thick_mm3 / max(volume, 1e-9)
    by_px = mm3_per_px(hull, slack_px=slack_px) * min(1.0, volume / whole)
    outline, removed, kept = share * _OUTLINE_PX * by_px, share * max(0.0, whole - volume), thick.kept_mm3
    trimmable = max(thick_mm3 - kept, 1e-9)
    excess = max(half_excess, min(removed / trimmable, 1.0) if kept < trimmable else 0.0)
    return (
        Term.even("outlines", outline, "outlines of thick parts are known to a tenth of a pixel"),
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


def mm3_per_px(hull: Hull, *, slack_px: float) -> float:
    """Return by how much a hull grows for every pixel that its outlines are moved out."""
    return (hull.moved_out_mm3 - hull.moved_in_mm3) / (2.0 * slack_px)


def half_excess(bank: ViewBank, frames: Sequence[int], maps: DistanceMaps, hull: Hull, thick: Trimmed, water: Water) -> float:
    """Return by how much a hull grows, as a share, when every other view carves it; 0 where little of it is kept.

    A flat face that no view looks along is bounded by the two views beside: its excess goes with one over the number of
    views, so that what half of the views add is what all of them have too much. (Round bodies' goes with its square: a
    third of that.)

    Parameters
    ----------
    frames : sequence of int
        Number of each view's frame, which rise round the turn.
    """
    if thick.kept_mm3 <= _MUCH_KEPT * thick.leaves.volume_mm3():
        return 0.0
    fine = hull.leaves.grid
    low = np.asarray(fine.origin_mm)
    high = low + np.array(fine.coarse_shape) * fine.size_mm * 2**fine.levels
    grid = Grid.over(low, high, fine.size_mm * _COARSER)
    every_other = every_second(frames)
    half_maps = replace(maps, values=mi.Float(np.array(maps.values).reshape(bank.count, -1)[every_other].ravel()))
    volumes = [
        carve.carve(some, outlines, grid, water).leaves.volume_mm3()
        for some, outlines in ((bank, maps), (bank.chosen(every_other), half_maps))
    ]
    return max(0.0, volumes[1] / max(volumes[0], 1e-9) - 1.0)


def every_second(frames: Sequence[int]) -> list[int]:
    """Return the places, rising, of every other frame in the order of their numbers."""
    return sorted(np.argsort(frames)[::2].tolist())


def water(volume_mm3: float) -> Term:
    """Return what the water's index leaves open: what a thermometer or the pictures do not tell."""
    return Term.even("water", _INDEX * volume_mm3, "the water's index may differ from the one that was used")
