"""Search space: cells of the water that may contain roots, and cells of taproot and hypocotyl."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence, bright_spots, core_outline, generous_outline
from rhizotwin.recon.coverage.silhouettes import Mask
from rhizotwin.recon.hull import agreement, carve
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
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
    while True:
        cells = _carve(evidence, generous, size_mm, water)
        if len(cells.index) <= _MOST_CELLS:
            break
        size_mm *= 1.26 ** math.ceil(math.log2(len(cells.index) / _MOST_CELLS))  # a factor of 1.26 halves their number
    del generous
    spots = [bright_spots(one) for one in evidence.silhouettes]
    pairs = zip(evidence.silhouettes, spots, strict=True)
    closed = [replace(one, coverage=np.where(spot, np.float32(1.0), one.coverage)) for one, spot in pairs]
    deep = DistanceMaps.compute(closed, "core", monitor, core_outline, window)
    core = _carve(evidence, deep, size_mm, water)
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
    count = np.zeros(len(cells.index), np.int64)
    for view, mask in enumerate(masks):
        pixel, inside = agreement.pixels(evidence.bank.select([view]), cells.centre_mm, mask.shape)
        count[inside] += mask.ravel()[pixel[inside]]
    return count


def _carve(evidence: Evidence, maps: DistanceMaps, size_mm: float, water: Water) -> Cells:
    """Carve cells of a given size out of the water with given distance maps."""
    # The interval of this hull is not needed: without slack, nodes beside the outline are classified early.
    return density.split_leaves(carve.carve(evidence.bank, maps, water.grid(size_mm), water, slack_px=0.0).leaves)
