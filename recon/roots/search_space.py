"""Where roots may be, and where taproot and hypocotyl are for certain: carved out of the water in cells."""

from __future__ import annotations

import math

import numpy as np

from rhizotwin.recon.coverage import evidence
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.hull import carve, distance_maps
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.roots import density
from rhizotwin.recon.roots.density import Cells
from rhizotwin.scenes.monitor import Monitor

_CELL_PX = 0.75
"""Edge of the cells of the search space, seen from the cameras."""
_MOST_CELLS = 2_000_000
"""A search space with more cells is made coarser: its footprints in all views must fit in memory."""


def px_a_mm(seen: Evidence, water: Water) -> float:
    """Return px/mm at the middle of the water."""
    at = seen.project(np.array([[0.0, 0.0, 0.5 * (water.top_mm + water.bottom_mm)]]))
    return float(np.median(np.sqrt(np.linalg.norm(at.du, axis=-1) * np.linalg.norm(at.dv, axis=-1))))


def carve_cells(seen: Evidence, water: Water, px_a_mm: float, *, monitor: Monitor) -> tuple[Cells, Cells]:
    """Carve where roots may be, and where taproot and hypocotyl are for certain, out of the water.

    Parameters
    ----------
    px_a_mm : float
        Scale of the pictures; cells are as large as they resolve.

    Returns
    -------
    cells, core : Cells
        On the same lattice.
    """
    size_mm = _CELL_PX / px_a_mm
    generous = DistanceMaps.drawn(seen.silhouettes, "search", monitor, evidence.generous_outline)
    low, high = np.array([-water.radius_mm, -water.radius_mm, water.bottom_mm]), np.array([water.radius_mm, water.radius_mm, water.top_mm])
    while True:
        grid = Grid.over(low, high, size_mm)
        cells = density.even_cells(_carve(seen, generous, grid, water))
        if len(cells.index) <= _MOST_CELLS:
            break
        size_mm *= 1.26 ** math.ceil(math.log2(len(cells.index) / _MOST_CELLS))  # each 1.26 halves their number
    del generous
    deep = DistanceMaps.drawn(seen.silhouettes, "core", monitor, evidence.core_outline)
    return cells, density.even_cells(_carve(seen, deep, grid, water))


def _carve(seen: Evidence, maps: DistanceMaps, grid: Grid, water: Water) -> Leaves:
    """Carve outlines out of the water."""
    hull = carve.carve(
        seen.bank,
        maps,
        grid,
        water,
        min_votes=distance_maps.least_votes(seen.bank.count),
        slack_px=0.0,  # nobody asks for this hull's interval: nodes beside the outline are decided early
    )
    return hull.leaves
