"""Many small cubes placed in all pictures: only the blocks in which they lie are followed through the water."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.device import Bool, UInt32, Vector2f, Vector3f, points, vectors, wholes
from rhizotwin.recon.hull.boxes import Box
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import Projected, ViewBank

_BLOCK_MM = 0.6
"""Largest edge of a block. Half the change of the scale on the way from its middle (3 % a mm, as in `marks`) is
neglected: in a block's corner half a percent of 1.7 px, where pixels are 0.3 mm wide."""


@dataclass(frozen=True)
class Blocks:
    """Cubes of one size, (N,), in blocks that are projected into all views."""

    count: int
    block: UInt32
    """mi.UInt32, (N,) which block each cube lies in."""
    beside: Vector3f
    """mi.Vector3f, (N,) from the middle of the block to that of the cube."""
    blocks: UInt32
    """mi.UInt32, number of the blocks."""
    middle: Projected
    """Their middles, those of one view after those of another."""

    @staticmethod
    def of(bank: ViewBank, grid: Grid, index: NDArray[np.integer], edge: int = 1) -> Blocks:
        """Place cubes in all views.

        Parameters
        ----------
        bank : ViewBank
            Views.
        grid : Grid
            Whose nodes the cubes are, or several together.
        index : (N, 3) int array
            Lowest corners, in the grid's finest nodes.
        edge : int
            Of the cubes, in finest nodes: a power of two.
        """
        units = edge * 2 ** max(0, math.floor(math.log2(_BLOCK_MM / (edge * grid.size_mm))))
        lowest = index // units
        box = Box.around(lowest)
        number, block = np.unique(box.number(lowest), return_inverse=True)
        beside = (index + 0.5 * edge - (lowest + 0.5) * units) * grid.size_mm
        middle_mm = np.asarray(grid.origin_mm) + (box.cell(number) + 0.5) * units * grid.size_mm
        blocks, lane = dr.opaque(mi.UInt32, len(number)), dr.arange(mi.UInt32, bank.count * len(number))
        view = lane // blocks
        p = projection.project(bank, view, dr.gather(mi.Point3f, points(middle_mm), lane - view * blocks), mi.Bool(True))
        dr.eval(p.px, p.du, p.dv, p.seen)  # one by one, each would be a projection of its own
        return Blocks(len(index), wholes(block), vectors(beside), blocks, p)

    def at(self, view: UInt32, cube: UInt32) -> tuple[Vector2f, Vector3f, Vector3f, Bool]:
        """Return the pixels of cubes in views, a lane each, their gradients by the place, and whether they are seen."""
        at, p = view * self.blocks + dr.gather(mi.UInt32, self.block, cube), self.middle
        beside = dr.gather(mi.Vector3f, self.beside, cube)
        du, dv = dr.gather(mi.Vector3f, p.du, at), dr.gather(mi.Vector3f, p.dv, at)
        px = dr.gather(mi.Vector2f, p.px, at) + mi.Vector2f(dr.dot(du, beside), dr.dot(dv, beside))
        return px, du, dv, dr.gather(mi.Bool, p.seen, at)
