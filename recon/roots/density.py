"""Estimation of the root density in small cells of the water from the coverage of all views.

The roots in a cell of the search space cast a shadow of area ``a`` (mm2), which represents the density. The coverage of
a pixel is the sum of the shadows that fall on it, at most 1. The shadows are estimated by multiplicative algebraic
reconstruction (MART; Gordon, Bender and Herman 1970, J. Theor. Biol. 29:471), which is also used in tomographic
particle velocimetry to find sparse particles from few views (Elsinga et al. 2006, Exp. Fluids 41:933):

    a <- a * exp( mean over views of log( measured / explained ) )

A fully covered pixel does not contradict an explained coverage above 1. A shadow that a single view contradicts shrinks
geometrically. Ghosts therefore disappear, since their pixels are explained by other cells in every view, whereas a
visual hull keeps them. Each step uses a subset of views from all directions (ordered subsets; Hudson and Larkin 1994,
IEEE TMI 13:601). Ten of 80 views give the same shadows in the same number of steps, at an eighth of the work per step.
The shadows along a root sum to its diameter per millimetre of length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.hull.leaves import Grid, Leaves
from rhizotwin.recon.roots.footprints import Footprints

Array = NDArray[np.float64]

STEPS = 30
"""Number of iterations of the density estimation. With 60 iterations, roots would be thinner and darker, and their
shadow area would decrease by 8 %. The pictures do not constrain this decrease."""
_VIEWS_A_STEP = 10
"""Number of views per iteration (ordered subsets). One pass over all views therefore comprises several iterations."""
_THIN_OUT = (6, 12, 20)
"""Iterations after which cells with negligible shadows are removed."""
_NOTHING = 1e-5
"""Shadow area below which a cell is negligible, as a fraction of the area of a cell's face."""
_LEAST_RATIO, _MOST_RATIO = 0.05, 3.0
"""Limits of the ratio between measured and explained coverage, by which the shadow of a cell changes in one
iteration."""
_LEAST_COVERAGE = 3e-3
"""Lower limit of the coverage in the initial estimate. It prevents a single empty view from removing a cell."""
_START = 2.5
"""Initial shadow area of a cell that is covered in all views, relative to the area of a cell's face."""
_FLOOR = 1e-3
"""Constant added to the measured and to the explained coverage before their ratio is computed. It is approximately the
noise of a picture."""


@dataclass(frozen=True)
class Cells:
    """Cubic cells of equal size in the search space."""

    grid: Grid
    index: NDArray[np.int32]
    """Index of each cell on the finest lattice of `grid`, shape (N, 3)."""
    shadow_mm2: NDArray[np.float32]
    """Shadow area of each cell, shape (N,), mm2."""
    tops_mm: tuple[tuple[float, float, float], ...] = ()
    """Attachment points of the plants (see `Evidence.tops_mm`)."""

    @property
    def centre_mm(self) -> Array:
        """Return the cell centres (N, 3), canister frame, mm."""
        return np.asarray(self.grid.origin_mm) + (self.index + 0.5) * self.grid.size_mm

    def place(self, points_mm: Array) -> Array:
        """Convert points (N, 3) from mm to units of cells. The centre of a cell is at its index."""
        return np.asarray((points_mm - self.grid.origin_mm) / self.grid.size_mm - 0.5)

    @cached_property
    def tree(self) -> cKDTree:
        """Return a k-d tree of the cell centres."""
        return cKDTree(self.centre_mm)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Cells:
        """Return a subset of the cells, selected by a mask (N,) or indices (M,)."""
        return replace(self, index=self.index[which], shadow_mm2=self.shadow_mm2[which])


def split_leaves(leaves: Leaves) -> Cells:
    """Divide leaves into cells of equal size, whose shadows are set to zero.

    Leaves that are at most half full are ignored.
    """
    index = leaves.select(leaves.occupancy > 0.5).split().index
    return Cells(leaves.grid, index, np.zeros(len(index), np.float32))


def join(first: Cells, second: Cells) -> Cells:
    """Concatenate two sets of cells on the same lattice."""
    index, shadow_mm2 = np.concatenate([first.index, second.index]), np.concatenate([first.shadow_mm2, second.shadow_mm2])
    return replace(first, index=index, shadow_mm2=shadow_mm2)


def estimate(evidence: Evidence, cells: Cells, solid: Cells) -> tuple[Cells, NDArray[np.int64]]:
    """Estimate the shadow area of each cell, and remove cells with negligible shadows.

    Parameters
    ----------
    solid : Cells
        Cells of taproot and hypocotyl, which are opaque.

    Returns
    -------
    cells : Cells
        Cells with estimated shadows that remain after removal of negligible cells.
    number : (N,) int64 array
        Indices of the remaining cells among the given cells.
    """
    number = np.arange(len(cells.index))
    if not len(number):
        return replace(cells, tops_mm=evidence.tops_mm), number
    footprints, area_mm2 = Footprints.project(evidence, cells.centre_mm), cells.grid.size_mm**2
    views = evidence.bank.count
    coverage = np.stack([one.coverage for one in evidence.silhouettes], dtype=np.float16)
    covered = _solid_shadows(evidence, solid)
    passes = [_subsets(views, count) for count in schedule(views)]
    measured = ((part, coverage[part.start : part.stop].astype(np.float32)) for part in passes[0])
    shadow = _START * area_mm2 * np.exp(footprints.mean_log(measured, _LEAST_COVERAGE, 1.0))
    done = 0
    for subsets in passes:
        for part in subsets:
            seen = np.s_[part.start : part.stop]
            explained = covered[seen] + footprints.shadows(part, shadow.astype(np.float32))
            ratio = (coverage[seen].astype(np.float32) + _FLOOR) / (np.minimum(explained, 1.0) + _FLOOR)
            shadow *= np.exp(footprints.mean_log([(part, ratio)], _LEAST_RATIO, _MOST_RATIO))
        if any(done < step <= done + len(subsets) for step in _THIN_OUT):
            kept = shadow > _NOTHING * area_mm2
            number, shadow, footprints = number[kept], shadow[kept], footprints.select(kept)
        done += len(subsets)
    found = cells.select(number)
    return replace(found, shadow_mm2=shadow.astype(np.float32), tops_mm=evidence.tops_mm), number


def _solid_shadows(evidence: Evidence, solid: Cells) -> NDArray[np.float16]:
    """Return the coverage (V, H, W) by opaque cells, which exceeds 1 where cells overlap."""
    (width, height), views = evidence.image_wh, evidence.bank.count
    covered = np.zeros((views, height, width), np.float16)
    if len(solid.index):
        footprints = Footprints.project(evidence, solid.centre_mm)
        amount = np.full(len(solid.index), solid.grid.size_mm**2, np.float32)
        for part in _subsets(views, max(1, views // _VIEWS_A_STEP)):
            covered[part.start : part.stop] = footprints.shadows(part, amount)
    return covered


def schedule(views: int) -> list[int]:
    """Return the number of subsets into which the views are divided in each pass over all views.

    One iteration is made per subset, so that the subsets of all passes add up to `STEPS` iterations. The last passes
    use larger subsets.
    """
    most = max(1, views // _VIEWS_A_STEP)
    last = [most // 2, most // 4]
    whole, rest = divmod(STEPS - sum(last), most)
    return [count for count in (*[most] * whole, rest, *last) if count]


def _subsets(views: int, count: int) -> list[range]:
    """Split the views into subsets of consecutive indices.

    Consecutive views are assumed to have very different directions.
    """
    ends = [views * k // count for k in range(count + 1)]
    return [range(*pair) for pair in pairwise(ends)]
