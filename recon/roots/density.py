"""Root density over small cells of the water that explains the coverage of all views at once.

Each cell of the search space casts a shadow of area ``a`` (mm2). The coverage of a pixel is the sum of the shadows on
it, at most 1. The shadows are estimated by multiplicative algebraic reconstruction (MART; Gordon, Bender and Herman
1970, J. Theor. Biol. 29:471), as used in tomographic particle velocimetry to find sparse particles from few views
(Elsinga et al. 2006, Exp. Fluids 41:933):

    a <- a * exp( mean over views of log( measured / explained ) )

A pixel measured as fully covered does not contradict explained coverage above 1. A shadow that is contradicted by a
single view shrinks geometrically, so that ghosts, whose pixels are explained by other cells in every view, disappear; a
visual hull keeps them. Each step uses a subset of views from all directions (ordered subsets; Hudson and Larkin 1994,
IEEE TMI 13:601): ten of 80 views give the same shadows in the same number of steps, at an eighth of the work per step.
The shadows along a root sum to its diameter per millimetre of length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import Float, release
from rhizotwin.recon.hull.leaves import Grid, Leaves, to_unit_cubes
from rhizotwin.recon.roots.footprints import Footprints, Table, Windows

Array = NDArray[np.float64]

STEPS = 30
"""Number of steps. More steps make roots thinner and darker: with 60 steps, roots lose 8 % of their shadow, as the
pictures do not constrain it."""
_VIEWS_A_STEP = 10
"""Number of views per step (ordered subsets), so that one pass over all views makes several steps."""
_THIN_OUT = (6, 12, 20)
"""Steps after which cells with negligible shadows are removed."""
_NOTHING = 1e-5
"""Negligible shadow of a cell, as a fraction of its face area."""
_LEAST_RATIO, _MOST_RATIO = 0.05, 3.0
"""Bounds of the factor by which one step changes a density."""
_LEAST_COVERAGE = 3e-3
"""Lower bound of coverage in the initial estimate: a single empty view does not exclude a cell."""
_START = 2.5
"""Initial shadow of a cell that all views show as covered, in units of its face area."""
_FLOOR = 1e-3
"""Coverage added to both sides of a ratio, about the noise of a picture."""


@dataclass(frozen=True)
class Cells:
    """Cubic cells of equal size in the search space."""

    grid: Grid
    index: NDArray[np.int32]
    """(N, 3) cell indices on the finest lattice of the grid."""
    shadow_mm2: NDArray[np.float32]
    """(N,) shadow area."""
    tops_mm: tuple[tuple[float, float, float], ...] = ()
    """Attachment points of several plants (`Evidence.tops_mm`)."""

    @property
    def centre_mm(self) -> Array:
        """Return the cell centres (N, 3), canister frame."""
        return np.asarray(self.grid.origin_mm) + (self.index + 0.5) * self.grid.size_mm

    @cached_property
    def tree(self) -> cKDTree:
        """Return a k-d tree of the cell centres."""
        return cKDTree(self.centre_mm)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Cells:
        """Return a subset of the cells, by mask (N,) or indices (M,)."""
        return replace(self, index=self.index[which], shadow_mm2=self.shadow_mm2[which])


def split_leaves(leaves: Leaves) -> Cells:
    """Split leaves into cells of equal size with zero shadows."""
    some = leaves.occupancy > 0.5
    index = to_unit_cubes(leaves.index[some], leaves.size[some])
    return Cells(leaves.grid, index, np.zeros(len(index), np.float32))


def join(first: Cells, second: Cells) -> Cells:
    """Concatenate cells of the same grid."""
    index, shadow_mm2 = np.concatenate([first.index, second.index]), np.concatenate([first.shadow_mm2, second.shadow_mm2])
    return replace(first, index=index, shadow_mm2=shadow_mm2)


def estimate(evidence: Evidence, cells: Cells, solid: Cells) -> tuple[Cells, NDArray[np.int64]]:
    """Estimate the shadows of cells and remove cells without a shadow.

    Parameters
    ----------
    solid : Cells
        Cells of taproot and hypocotyl, which fully cover everything behind them.

    Returns
    -------
    cells : Cells
        The remaining cells, with shadows.
    number : (N,) int64 array
        Their indices among the given cells.
    """
    number = np.arange(len(cells.index))
    if not len(number):
        return replace(cells, tops_mm=evidence.tops_mm), number
    footprints = Footprints.project(evidence, cells.centre_mm)
    thick = [Footprints.project(evidence, solid.centre_mm)] if len(solid.index) else []
    table = Table(footprints, Windows.around(footprints, *thick))
    every = range(evidence.bank.count)
    coverage = table.windows.cut(evidence, evidence.coverage)
    covered = dr.zeros(mi.Float, table.windows.pixels * len(every))
    while thick:
        organ = thick.pop()  # large, and not needed afterwards
        covered = Table(organ, table.windows).shadows(every, dr.full(mi.Float, solid.grid.size_mm**2, organ.count))
        del organ
    dr.eval(covered)
    shadow = dr.exp(table.mean_log(coverage, every, _LEAST_COVERAGE, 1.0)) * (_START * cells.grid.size_mm**2)
    dr.eval(shadow)
    done = 0
    for count in schedule(evidence.bank.count):
        for views in _subsets(evidence.bank.count, count):
            shadow = _improve(table, views, coverage, covered, shadow)
        if any(done < step <= done + count for step in _THIN_OUT):
            kept = dr.compress(shadow > _NOTHING * cells.grid.size_mm**2)
            number, shadow, table = number[np.array(kept)], dr.gather(mi.Float, shadow, kept), table.select(kept)
            dr.eval(shadow)
            release()  # the steps of later passes are over more views
        done += count
    found = cells.select(number)
    return replace(found, shadow_mm2=np.array(shadow, np.float32), tops_mm=evidence.tops_mm), number


def schedule(views: int) -> list[int]:
    """Return the number of subsets into which each pass divides the views.

    The total is `STEPS`; the last passes use large subsets.
    """
    most = max(1, views // _VIEWS_A_STEP)
    last = [most // 2, most // 4]
    whole, rest = divmod(STEPS - sum(last), most)
    return [count for count in (*[most] * whole, rest, *last) if count]


def _subsets(views: int, count: int) -> list[range]:
    """Split the views, ordered so that neighbours are spread over the turn, into consecutive subsets."""
    ends = [views * k // count for k in range(count + 1)]
    return [range(*pair) for pair in pairwise(ends)]


def _improve(table: Table, views: range, coverage: Float, covered: Float, shadow: Float) -> Float:
    """Return the shadows after one MART step over a subset of views."""
    pixels = table.windows.pixels
    part = dr.arange(mi.UInt32, pixels * len(views)) + dr.opaque(mi.UInt32, pixels * views.start)
    explained = dr.gather(mi.Float, covered, part) + table.shadows(views, shadow)
    measured = mi.Float(dr.gather(mi.Float16, coverage, part))
    ratio = (measured + _FLOOR) / (dr.minimum(explained, 1.0) + _FLOOR)
    dr.eval(ratio)
    better = shadow * dr.exp(table.mean_log(ratio, views, _LEAST_RATIO, _MOST_RATIO))
    dr.eval(better)
    return better
