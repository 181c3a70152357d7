"""Where in the water the roots are: a density over small cells that explains the coverage of all views at once.

Each cell of the search space casts a shadow of area ``a`` (mm2); a pixel's coverage is the sum of the shadows on it, at most 1. The
shadows are found by multiplicative algebraic reconstruction (MART; Gordon, Bender and Herman 1970, J. Theor. Biol. 29:471), the
method by which tomographic particle velocimetry finds sparse particles from few views (Elsinga et al. 2006, Exp. Fluids 41:933):

    a <- a * exp( mean over views of log( measured / explained ) )

A pixel that is explained in excess is no contradiction where it is measured as covered in full. Shadows without support in a single
view shrink geometrically, so that ghosts, which every view explains by something else as well, die out; a plain hull keeps them all.
Along a root the shadows add up to its diameter a millimetre of length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from recon import projection
from recon.carve import Grid, Leaves
from recon.evidence import Evidence, bilinear
from recon.parsimony import even

Array = NDArray[np.float64]

ITERATIONS = 30
_THIN_OUT = (6, 12, 20)
"""Iterations after which cells that cast next to no shadow are left out."""
_NOTHING = 1e-5
"""Shadow of a cell as a fraction of its face that counts for nothing."""
_LEAST_RATIO, _MOST_RATIO = 0.05, 3.0
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

    @property
    def centre_mm(self) -> Array:
        """Return the centres (N, 3), canister frame."""
        return np.asarray(self.grid.origin_mm) + (self.index + 0.5) * self.grid.size_mm

    def chosen(self, which: NDArray[Any]) -> Cells:
        """Return some of the cells, by mask or number."""
        return Cells(self.grid, self.index[which], self.shadow_mm2[which])


def even_cells(leaves: Leaves) -> Cells:
    """Cut leaves into even cells without shadows."""
    some = leaves.occupancy > 0.5
    index = even(leaves.index[some], leaves.size[some])
    return Cells(leaves.grid, index, np.zeros(len(index), np.float32))


def join(first: Cells, second: Cells) -> Cells:
    """Put cells of one grid together."""
    return Cells(first.grid, np.concatenate([first.index, second.index]), np.concatenate([first.shadow_mm2, second.shadow_mm2]))


@dataclass(frozen=True)
class _Footprints:
    """Where cells fall on one view's picture."""

    base: int
    px: Any
    """mi.Vector2f"""
    px2_a_mm2: Any
    """mi.Float, area of a mm2 in the picture; 0 where the view says nothing about the cell."""


def estimate(evidence: Evidence, cells: Cells, solid: Cells, *, iterations: int = ITERATIONS) -> tuple[Cells, NDArray[np.int64]]:
    """Find the shadows of cells; those that cast none are left out.

    Parameters
    ----------
    solid : cells of thick organs, which cover all that is behind them.

    Returns
    -------
    cells : with their shadows, some of those given.
    number : (N,) which of them.
    """
    covered = _covered(evidence, solid)
    seen_from = _look(evidence, cells)
    shadow = _start(evidence, seen_from, len(cells.index)) * (2.5 * cells.grid.size_mm**2)
    number = np.arange(len(cells.index))
    for iteration in range(iterations):
        shadow = _improve(evidence, covered, seen_from, shadow)
        if iteration in _THIN_OUT:
            kept = dr.compress(shadow > _NOTHING * cells.grid.size_mm**2)
            number = number[np.array(kept)]
            shadow = dr.gather(mi.Float, shadow, kept)
            seen_from = [_Footprints(f.base, dr.gather(mi.Vector2f, f.px, kept), dr.gather(mi.Float, f.px2_a_mm2, kept)) for f in seen_from]
            dr.eval(shadow, [(f.px, f.px2_a_mm2) for f in seen_from])
    found = cells.chosen(number)
    return Cells(found.grid, found.index, np.array(shadow, np.float32)), number


def _look(evidence: Evidence, cells: Cells) -> list[_Footprints]:
    """Project cells into all views."""
    point = mi.Point3f(cells.centre_mm.T.astype(np.float32))
    width, height = evidence.image_wh
    prints = []
    for view in range(evidence.bank.count):
        p = projection.project(evidence.bank, dr.full(mi.UInt32, view, len(cells.index)), point, mi.Bool(True))
        seen = p.seen & (p.px.x > 0) & (p.px.x < width - 1.01) & (p.px.y > 0) & (p.px.y < height - 1.01)
        px = dr.select(seen, p.px, mi.Vector2f(0.0))
        base = view * evidence.pixels
        seen &= dr.gather(mi.Float, evidence.seen, base + mi.UInt32(px.y + 0.5) * width + mi.UInt32(px.x + 0.5)) > 0
        area = dr.select(seen, dr.norm(dr.cross(p.du, p.dv)), 0.0)
        dr.eval(px, area)
        prints.append(_Footprints(base, px, area))
    return prints


def _start(evidence: Evidence, seen_from: list[_Footprints], count: int) -> Any:
    """Return the geometric mean over the views of the coverage at each cell."""
    total, votes = dr.zeros(mi.Float, count), dr.zeros(mi.Float, count)
    for f in seen_from:
        seen = f.px2_a_mm2 > 0
        value = bilinear(evidence.coverage, f.base, evidence.image_wh[0], f.px.x, f.px.y, seen)
        total += dr.select(seen, dr.log(dr.maximum(value, 3e-3)), 0.0)
        votes += dr.select(seen, 1.0, 0.0)
        dr.eval(total, votes)
    return dr.exp(total / dr.maximum(votes, 1.0))


def _covered(evidence: Evidence, solid: Cells) -> Any:
    """Return the coverage by thick organs: mi.Float, (V, H, W) flattened."""
    covered = dr.zeros(mi.Float, evidence.pixels * evidence.bank.count)
    if len(solid.index):
        _cast(covered, evidence.image_wh[0], _look(evidence, solid), dr.full(mi.Float, solid.grid.size_mm**2, len(solid.index)))
    dr.eval(covered)
    return covered


def _cast(onto: Any, width: int, seen_from: list[_Footprints], shadow: Any) -> None:
    """Add the shadows of cells to the pictures of all views, bilinearly."""
    for f in seen_from:
        seen = f.px2_a_mm2 > 0
        column, row = mi.UInt32(f.px.x), mi.UInt32(f.px.y)
        fu, fv = f.px.x - mi.Float(column), f.px.y - mi.Float(row)
        at, area = f.base + row * width + column, shadow * f.px2_a_mm2
        for step, weight in ((0, (1 - fu) * (1 - fv)), (1, fu * (1 - fv)), (width, (1 - fu) * fv), (width + 1, fu * fv)):
            dr.scatter_reduce(dr.ReduceOp.Add, onto, area * weight, at + step, seen)
    dr.eval(onto)


def _improve(evidence: Evidence, covered: Any, seen_from: list[_Footprints], shadow: Any) -> Any:
    """Return the shadows after one step of MART over all views."""
    width = evidence.image_wh[0]
    explained = mi.Float(covered + 0.0)
    dr.eval(explained)
    _cast(explained, width, seen_from, shadow)
    ratio = (evidence.coverage + _FLOOR) / (dr.minimum(explained, 1.0) + _FLOOR)
    dr.eval(ratio)
    total, votes = dr.zeros(mi.Float, dr.width(shadow)), dr.zeros(mi.Float, dr.width(shadow))
    for f in seen_from:
        seen = f.px2_a_mm2 > 0
        value = bilinear(ratio, f.base, width, f.px.x, f.px.y, seen)
        total += dr.select(seen, dr.log(dr.clip(value, _LEAST_RATIO, _MOST_RATIO)), 0.0)
        votes += dr.select(seen, 1.0, 0.0)
    better = shadow * dr.exp(total / dr.maximum(votes, 1.0))
    dr.eval(better)
    return better
