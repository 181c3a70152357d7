"""Where in the water the roots are: a density over small cells that explains the coverage of all views at once.

Each cell of the search space casts a shadow of area ``a`` (mm2); a pixel's coverage is the sum of the shadows on it, at
most 1. The shadows are found by multiplicative algebraic reconstruction (MART; Gordon, Bender and Herman 1970, J.
Theor. Biol. 29:471), the method by which tomographic particle velocimetry finds sparse particles from few views
(Elsinga et al. 2006, Exp. Fluids 41:933):

    a <- a * exp( mean over views of log( measured / explained ) )

A pixel that is explained in excess is no contradiction where it is measured as covered in full. Shadows without support
in a single view shrink geometrically, so that ghosts, which every view explains by something else as well, die out; a
plain hull keeps them all. A step needs no more than a subset of views that look from everywhere (ordered subsets;
Hudson and Larkin 1994, IEEE TMI 13:601): ten of 80 views give the same shadows in as many steps, each with an eighth of
the work. Along a root the shadows add up to its diameter a millimetre of length.
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
from rhizotwin.recon.hull.leaves import Grid, Leaves, even
from rhizotwin.recon.roots.footprints import Footprints, Table, Windows

Array = NDArray[np.float64]

STEPS = 30
"""More steps make roots thinner and darker, 60 take 8 % of their shadow: what the pictures do not tell apart drifts."""
_VIEWS_A_STEP = 10
"""Views from which one step of the estimate is made: ordered subsets, so that a pass over all of them is several
steps."""
_THIN_OUT = (6, 12, 20)
"""Steps after which cells that cast next to no shadow are left out."""
_NOTHING = 1e-5
"""Shadow of a cell as a fraction of its face that counts for nothing."""
_LEAST_RATIO, _MOST_RATIO = 0.05, 3.0
"""A step changes no density by more than these factors."""
_LEAST_COVERAGE = 3e-3
"""Less than this counts as this much at the start: one empty view is no proof."""
_START = 2.5
"""Shadow of a cell before the first step, in areas of its face, where all pictures are dark."""
_FLOOR = 1e-3
"""Coverage added to both sides of a ratio, about the noise of a picture."""


@dataclass(frozen=True)
class Cells:
    """Even cubes of the search space."""

    grid: Grid
    index: NDArray[np.int32]
    """(N, 3) on the grid's finest lattice."""
    shadow_mm2: NDArray[np.float32]
    """(N,)"""
    tops_mm: tuple[tuple[float, float, float], ...] = ()
    """Where each of several plants hangs (`Evidence.tops_mm`)."""

    @property
    def centre_mm(self) -> Array:
        """Return the centres (N, 3), canister frame."""
        return np.asarray(self.grid.origin_mm) + (self.index + 0.5) * self.grid.size_mm

    @cached_property
    def tree(self) -> cKDTree:
        """Return the tree of the centres."""
        return cKDTree(self.centre_mm)

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Cells:
        """Return some of the cells, by mask (N,) or number (M,)."""
        return replace(self, index=self.index[which], shadow_mm2=self.shadow_mm2[which])


def even_cells(leaves: Leaves) -> Cells:
    """Cut leaves into even cells without shadows."""
    some = leaves.occupancy > 0.5
    index = even(leaves.index[some], leaves.size[some])
    return Cells(leaves.grid, index, np.zeros(len(index), np.float32))


def join(first: Cells, second: Cells) -> Cells:
    """Put cells of one grid together."""
    index, shadow_mm2 = np.concatenate([first.index, second.index]), np.concatenate([first.shadow_mm2, second.shadow_mm2])
    return replace(first, index=index, shadow_mm2=shadow_mm2)


def estimate(evidence: Evidence, cells: Cells, solid: Cells) -> tuple[Cells, NDArray[np.int64]]:
    """Find the shadows of cells; those that cast none are left out.

    Parameters
    ----------
    solid : Cells
        Cells of taproot and hypocotyl, which cover all that is behind them.

    Returns
    -------
    cells : Cells
        With their shadows, some of those given.
    number : (N,) int64 array
        Which of them.
    """
    number = np.arange(len(cells.index))
    if not len(number):
        return replace(cells, tops_mm=evidence.tops_mm), number
    footprints = Footprints.of(evidence, cells.centre_mm)
    thick = [Footprints.of(evidence, solid.centre_mm)] if len(solid.index) else []
    table = Table(footprints, Windows.around(footprints, *thick))
    every = range(evidence.bank.count)
    coverage = table.windows.cut(evidence, evidence.coverage)
    covered = dr.zeros(mi.Float, table.windows.pixels * len(every))
    while thick:
        organ = thick.pop()  # large, and of no use afterwards
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
            number, shadow, table = number[np.array(kept)], dr.gather(mi.Float, shadow, kept), table.chosen(kept)
            dr.eval(shadow)
            release()  # the steps of later passes are over more views
        done += count
    found = cells.chosen(number)
    return replace(found, shadow_mm2=np.array(shadow, np.float32), tops_mm=evidence.tops_mm), number


def schedule(views: int) -> list[int]:
    """Return into how many subsets the views are put in each pass.

    `STEPS` steps in all, the last of them over many views.
    """
    most = max(1, views // _VIEWS_A_STEP)
    last = [most // 2, most // 4]
    whole, rest = divmod(STEPS - sum(last), most)
    return [count for count in (*[most] * whole, rest, *last) if count]


def _subsets(views: int, count: int) -> list[range]:
    """Cut the views, which come in an order that spreads neighbours over the turn, into consecutive subsets."""
    ends = [views * k // count for k in range(count + 1)]
    return [range(*pair) for pair in pairwise(ends)]


def _improve(table: Table, views: range, coverage: Float, covered: Float, shadow: Float) -> Float:
    """Return the shadows after one step of MART over some views."""
    pixels = table.windows.pixels
    part = dr.arange(mi.UInt32, pixels * len(views)) + dr.opaque(mi.UInt32, pixels * views.start)
    explained = dr.gather(mi.Float, covered, part) + table.shadows(views, shadow)
    measured = mi.Float(dr.gather(mi.Float16, coverage, part))
    ratio = (measured + _FLOOR) / (dr.minimum(explained, 1.0) + _FLOOR)
    dr.eval(ratio)
    better = shadow * dr.exp(table.mean_log(ratio, views, _LEAST_RATIO, _MOST_RATIO))
    dr.eval(better)
    return better
