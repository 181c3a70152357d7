"""Uncertainty of the volume of solids, which no tube explains and which are reconstructed from the silhouettes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from rhizotwin.recon.hull import carve
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.hull.spheres import join, shared_volume_mm3
from rhizotwin.recon.hull.trimming import TrimmedHull
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.uncertainty.budget import Term

_OUTLINE_PX, _OUTLINE_BINARY_PX = 0.1, 0.25
"""90 % half-widths of the position of an outline: for photographs, and for binary silhouettes. In photographs, bands 1
to 3 px wide in any direction are reconstructed with 0.97 to 1.02 of their width. The threshold of a binary silhouette
is unknown: it may contain pixels with any, half or full coverage. The extremes are half a pixel apart, and half of that
is almost the 90 % half-width."""
_ABSENT = 0.1
"""Fraction of the volume removed by trimming that is part of the shape, at most, with 90 % confidence. This fraction
applies to shapes of round roots. If a larger fraction of the hull outside the inscribed spheres had to be kept, the
shape is not round, and that fraction is used instead. For the square bar of a comb, along which few views look, all of
the removed volume was part of the shape, and 69 % of the comb's hull outside the spheres is kept. For a print, 17 % is
kept."""
_LEAST_PX, _LEAST_BINARY_PX = 0.2, 0.4
"""Systematic error of the radius of an inscribed sphere: for photographs, and for binary silhouettes. The radius is too
small because it is determined by the most restrictive of all outlines. A ball's outline passes a handful of places with
independent errors in each of 24 to 40 views. Among some hundred errors of 0.1 px at 90 %, the minimum lies 2.5 to 3.3
standard deviations inside: 0.15 to 0.2 px. Exact pictures of a ball of 10 mm beside the axis, 24 of 400 x 300, give
0.16 px. The spheres are 2.6 to 4.8 % too small by volume, the hull 1.1 to 1.4 %. Binary silhouettes determine an
outline to the pixel: 0.29 px of noise, of which the blur leaves 0.12. Measured are 0.35 to 0.4 px (rods of 2 mm, a
torus; 36 of 500 x 500)."""
_COARSER = 4
"""Node size of the hull that is carved to compute the relative excess, as a multiple of the node size of the shape's
hull. Only the ratio of two volumes is needed, so that large nodes are sufficient."""
_MUCH_KEPT = 0.05
"""Minimum fraction of untrimmed hull in the volume for which the excess of the hull is computed."""
_BY_AREA = 1.5
"""Ratio of the relative change of a solid's volume to the relative change of its area in the pictures. The volume is
proportional to the third power of the size, the area to the second."""
_INDEX = 0.002
"""90 % half-width of the relative volume due to the refractive index of the water. An error of the index of 0.001 (from
salts, or ten degrees) causes less than this."""


def estimate_terms(
    bank: ViewBank, hull: Hull, part: Leaves, solids: TrimmedHull, *, slack_px: float, half_excess: float, missed: float, binary: bool
) -> tuple[Term, ...]:
    """Return the terms of the error budget for solids.

    Parameters
    ----------
    part, solids : Leaves, TrimmedHull
        The part of the hull about them, and its trimmed form.
    slack_px : float
        Amount by which outlines were moved for `Hull.moved_in_mm3` and ``moved_out_mm3``.
    half_excess : float
        Relative growth of the hull when half of the views carve it.
    missed : float
        Fraction of the coverage that no part of the hull explains.
    binary : bool
        Whether the silhouettes determine an outline to the pixel only.
    """
    thick_mm3, kept = solids.leaves.volume_mm3(), solids.kept_mm3
    by_px = mm3_per_px(hull, slack_px=slack_px) * thick_mm3 / hull.leaves.volume_mm3()
    outline_px, least_px = (_OUTLINE_BINARY_PX, _LEAST_BINARY_PX) if binary else (_OUTLINE_PX, _LEAST_PX)
    outline, removed = outline_px * by_px, max(0.0, part.volume_mm3() - thick_mm3)
    beside = min(_unconstrained_mm3(bank, part, solids, least_px), removed) if removed > 0.0 else 0.0
    absent = max(_ABSENT, kept / max(kept + removed, 1e-9))
    trimmable = max(thick_mm3 - kept, 1e-9)
    excess = max(half_excess, min(removed / trimmable, 1.0) if kept < trimmable else 0.0)
    return (
        Term.symmetric("outlines", outline, f"the outlines of thick parts are uncertain by {outline_px:g} px"),
        Term(
            name="trimmed away",
            less_mm3=0.0,
            more_mm3=beside + absent * (removed - beside),
            why="parts of the hull that the silhouettes do not require may be present, mainly next to the outlines",
        ),
        Term(
            name="views disagree",
            less_mm3=0.0,
            more_mm3=_BY_AREA * missed * thick_mm3,
            why="some views show parts that others exclude: with errors of cameras or edges, the hull of all views is too small",
        ),
        Term(
            name="untrimmed hull",
            less_mm3=kept * excess,
            more_mm3=0.0,
            why="parts of the shape are untrimmed hull, which is too large where too few views bound it",
        ),
    )


def _unconstrained_mm3(bank: ViewBank, part: Leaves, thick: TrimmedHull, least_px: float) -> float:
    """Return the part of a hull's volume that outlines do not constrain, mm3.

    This part lies outside the spheres inscribed in thick parts: within ``least_px`` of them, or in spheres that few
    views bound.
    """
    leaves = thick.leaves
    if not len(leaves.size) or not len(thick.spheres.radius_mm):
        return 0.0
    reach_mm = leaves.grid.size_mm * float(leaves.size.max())
    tree = cKDTree(leaves.middles_mm, balanced_tree=False, compact_nodes=False)  # built in a third of the time, and rarely queried
    spheres, doubtful = (all_.select(tree.query(all_.centre_mm)[0] < reach_mm) for all_ in (thick.spheres, thick.doubtful))
    if not len(spheres.radius_mm):
        return 0.0
    more_mm = least_px / projection.px_a_mm(bank, spheres.centre_mm[int(spheres.radius_mm.argmax())])
    both = join([spheres, doubtful])
    wider = replace(both, radius_mm=both.radius_mm + more_mm)
    low = (wider.centre_mm - wider.radius_mm[:, None]).min(axis=0)
    high = (wider.centre_mm + wider.radius_mm[:, None]).max(axis=0)
    half_mm = 0.5 * part.grid.size_mm * part.size[:, None]
    middle = part.middles_mm
    near = part.select(((middle > low - half_mm) & (middle < high + half_mm)).all(axis=1))
    return shared_volume_mm3(wider, near) - shared_volume_mm3(spheres, near)


def mm3_per_px(hull: Hull, *, slack_px: float) -> float:
    """Return the increase of a hull's volume if its outlines are moved outwards by one pixel, mm3."""
    return (hull.moved_out_mm3 - hull.moved_in_mm3) / (2.0 * slack_px)


def half_excess(bank: ViewBank, frames: Sequence[int], maps: DistanceMaps, hull: Hull, thick: TrimmedHull, water: Water) -> float:
    """Return the relative increase of a hull's volume if only every other view carves it.

    The result is 0 if the volume contains little untrimmed hull. A flat face that no view looks along is bounded by the
    two adjacent views. Its excess is inversely proportional to the number of views, so that the increase with half of
    the views equals the excess with all views. The excess of round bodies is inversely proportional to the square of
    the number of views, so that it is a third of the increase.

    Parameters
    ----------
    frames : sequence of int
        Frame number of each view, ascending around the turn.
    """
    if thick.kept_mm3 <= _MUCH_KEPT * hull.leaves.volume_mm3():
        return 0.0
    every_other, grid = every_second(frames), water.grid(hull.leaves.grid.size_mm * _COARSER)
    half = carve.carve(bank.select(every_other), maps.select_views(every_other), grid, water).leaves
    return max(0.0, half.volume_mm3() / hull.leaves.volume_mm3() - 1.0)


def every_second(frames: Sequence[int]) -> list[int]:
    """Return the indices of every other view, in ascending order.

    Views are counted in the order of their frame numbers.
    """
    return sorted(np.argsort(frames)[::2].tolist())


def water_term(volume_mm3: float) -> Term:
    """Return the term of the error budget for the refractive index of the water.

    The term applies if the index is neither measured nor estimated.
    """
    return Term.symmetric("water", _INDEX * volume_mm3, "the refractive index of the water may differ from the value used")
