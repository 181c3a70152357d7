"""Search space: cells of the water that may contain roots, and cells of taproot and hypocotyl."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence, bright_spots, core_outline, generous_outline
from rhizotwin.recon.coverage.silhouettes import Mask
from rhizotwin.recon.device import Float, UInt32, halves, points, readable
from rhizotwin.recon.hull import carve, distance_maps
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.optics import projection
from rhizotwin.recon.roots import density
from rhizotwin.recon.roots.density import Cells
from rhizotwin.scenes.monitor import Monitor

_CELL_PX = 0.75
"""Edge length of the cells of the search space, as projected into the pictures, px."""
_MOST_BRIGHT = 0.025
"""Maximum fraction of the views that show a point of a taproot or solid in a bright spot. A single view is always
accepted.

A bubble covers a point in one view, whereas a gap between roots is visible in several views. With 0.05, which is two of
40 views, gaps are closed, and the length of a thick print is 7 % instead of 1 % too large."""
_MOST_CELLS = 2_000_000
"""Maximum number of cells, since their footprints in all views must fit in memory. A larger search space is divided
into larger cells."""


def carve_cells(evidence: Evidence, water: Water, px_a_mm: float, *, monitor: Monitor) -> tuple[Cells, Cells]:
    """Carve the cells that may contain roots, and the cells of taproot and hypocotyl, out of the water.

    Parameters
    ----------
    px_a_mm : float
        Image scale, px/mm, which determines the size of the cells.

    Returns
    -------
    cells, core : Cells
        Cells that may contain roots, and cells of taproot and hypocotyl, on the same lattice.
    """
    size_mm = _CELL_PX / px_a_mm
    window = evidence.window.at_origin()
    generous = DistanceMaps.compute(evidence.silhouettes, "search", monitor, generous_outline, window)
    low, high = np.array([-water.radius_mm, -water.radius_mm, water.bottom_mm]), np.array([water.radius_mm, water.radius_mm, water.top_mm])
    while True:
        grid = Grid.over(low, high, size_mm)
        cells = density.split_leaves(_carve(evidence, generous, grid, water))
        if len(cells.index) <= _MOST_CELLS:
            break
        size_mm *= 1.26 ** math.ceil(math.log2(len(cells.index) / _MOST_CELLS))  # a factor of 1.26 halves their number
    del generous
    spots = [bright_spots(one) for one in evidence.silhouettes]
    pairs = zip(evidence.silhouettes, spots, strict=True)
    closed = [replace(one, coverage=np.where(spot, np.float32(1.0), one.coverage)) for one, spot in pairs]
    deep = DistanceMaps.compute(closed, "core", monitor, core_outline, window)
    core = density.split_leaves(_carve(evidence, deep, grid, water))
    return cells, core.select(~_find_bright_cells(evidence, core, spots))


def _find_bright_cells(evidence: Evidence, core: Cells, spots: Sequence[Mask]) -> NDArray[np.bool_]:
    """Return the mask (N,) of cells that appear in a bright spot in too many views to be part of a thick root."""
    views = [k for k, one in enumerate(spots) if one.any()]
    bright = np.zeros(len(core.index), np.int64)
    if views and len(core.index):
        bright = _count_views(evidence.select_views(views), core, [spots[k] for k in views])
    some = np.flatnonzero(bright)
    often = np.zeros(len(bright), bool)
    if len(some):
        views_of = _count_views(evidence, core.select(some), [np.ones(one.shape, bool) for one in spots])
        often[some] = bright[some] > np.maximum(_MOST_BRIGHT * views_of, 1.0)
    return often


def _count_views(evidence: Evidence, cells: Cells, masks: Sequence[Mask]) -> NDArray[np.int64]:
    """Return the number of views (N,) in which each cell is projected onto a pixel of that view's mask."""
    marked, point, (width, height) = halves(masks), points(cells.centre_mm), evidence.size

    def body(view: UInt32, count: Float) -> tuple[UInt32, Float]:
        p = projection.project(evidence.bank, view, point, mi.Bool(True))
        column, row = mi.UInt32(p.px.x + 0.5), mi.UInt32(p.px.y + 0.5)
        at = view * (width * height) + row * width + column
        return view + 1, count + mi.Float(dr.gather(mi.Float16, marked, at, p.visible & readable(p.px, width, height)))

    state = dr.zeros(mi.UInt32, len(cells.index)), dr.zeros(mi.Float, len(cells.index))
    return np.array(dr.while_loop(state, lambda view, _: view < evidence.bank.end, body)[1], np.int64)


def _carve(evidence: Evidence, maps: DistanceMaps, grid: Grid, water: Water) -> Leaves:
    """Carve the water with given distance maps, and return the remaining leaves."""
    hull = carve.carve(
        evidence.bank,
        maps,
        grid,
        water,
        min_votes=distance_maps.least_votes(evidence.bank.count),
        slack_px=0.0,  # the interval of this hull is not needed: nodes beside the outline are classified early
    )
    return hull.leaves
