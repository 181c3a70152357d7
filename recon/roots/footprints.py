"""Compact footprints of cells in all views, used to project shadows and to sample pictures.

The footprint of a cell in a view consists of the position of the cell's centre in the picture, and the area that 1 mm2
covers there. It takes six bytes: column and row in steps of a fraction of a pixel, with 16 bits each, and the area in
half precision.
"""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import is_positive, readable
from rhizotwin.recon.lattice.compiled import compiled
from rhizotwin.recon.optics import projection
from rhizotwin.scenes.monitor import threads

Array = NDArray[np.float64]
Pictures = NDArray[np.float32]

_STEPS = 65535
"""Number of quantisation steps along the longer side of a picture for stored positions. One step is 1/80 px for a side
of 800 px."""
_AT_ONCE = 16384
"""Number of cells whose values are averaged at once by one thread. Their sums fit into the cache."""
_FACTORS = 32
"""Number of values whose product replaces the sum of their logarithms. Even a product of this many values of 1e-9 can
be represented."""


@dataclass(frozen=True)
class Footprints:
    """Footprints of cells in all views."""

    image_wh: tuple[int, int]
    px_a_step: np.float32
    """Size of a step in ``place``, px."""
    place: NDArray[np.uint32]
    """Column and row of each cell in each view, in steps of a fraction of a pixel, 16 bits each, shape (V, N)."""
    px2_a_mm2: NDArray[np.uint16]
    """Ratio of projected area, px2, to the area in space, mm2, for each cell in each view, shape (V, N), as the bits
    of a number in half precision. It is 0 in a view that does not show the cell."""

    @staticmethod
    def project(evidence: Evidence, centre_mm: Array) -> Footprints:
        """Project cell centres (N, 3) into all views."""
        shape, (width, height) = (evidence.bank.count, len(centre_mm)), evidence.size
        px_a_step = np.float32(max(evidence.image_wh) / _STEPS)
        p = projection.project_into_all(evidence.bank, centre_mm)
        view, _ = projection.pair_all(*shape)
        visible = p.visible & readable(p.px, width, height)
        px = dr.select(visible, p.px, mi.Vector2f(0.0))
        usable = dr.gather(mi.Float16, evidence.usable, view * (width * height) + mi.UInt32(px.y + 0.5) * width + mi.UInt32(px.x + 0.5))
        area = mi.Float16(dr.select(visible & is_positive(usable), dr.norm(dr.cross(p.du, p.dv)), 0.0))
        steps = px / dr.opaque(mi.Float, float(px_a_step)) + 0.5
        place = mi.UInt32(steps.x) | (mi.UInt32(steps.y) << 16)
        dr.eval(place, area)
        return Footprints(evidence.image_wh, px_a_step, place.numpy().reshape(shape), area.numpy().view(np.uint16).reshape(shape))

    def select(self, which: NDArray[np.bool_]) -> Footprints:
        """Return the footprints of a subset of the cells, selected by a mask (N,)."""
        # Indexing would transpose the memory.
        return replace(self, place=np.compress(which, self.place, axis=1), px2_a_mm2=np.compress(which, self.px2_a_mm2, axis=1))

    def shadows(self, views: range, amount: NDArray[np.float32]) -> Pictures:
        """Project the cells' shadows (N,), mm2, into pictures (K, H, W) of consecutive views by bilinear splatting."""
        pictures, scale = np.zeros((len(views), *self.image_wh[::-1]), np.float32), _half_precision()

        def project(view: int) -> None:
            _splat(self.place[view], self.px2_a_mm2[view], scale, self.px_a_step, amount, pictures[view - views.start])

        with ThreadPoolExecutor(threads()) as pool:
            list(pool.map(project, views))
        return pictures

    def mean_log(self, parts: Iterable[tuple[range, Pictures]], least: float, most: float) -> Array:
        """Return the mean logarithm of the clipped picture values at each cell, averaged over the views that show it.

        The result (N,) is 0 for a cell that no view shows.

        Parameters
        ----------
        parts : iterable of (range, (K, H, W) float32 array)
            Consecutive views, and their pictures.
        least, most : float
            Limits to which the values are clipped.
        """
        count = self.place.shape[1]
        sums = np.zeros((2, count))

        def add(views: range, pictures: Pictures, begin: int) -> None:
            some = np.s_[begin : begin + _AT_ONCE]
            place, area = self.place[views.start : views.stop, some], self.px2_a_mm2[views.start : views.stop, some]
            _add_logs(place, area, self.px_a_step, pictures, (least, most), sums[:, some])

        with ThreadPoolExecutor(threads()) as pool:
            for part in parts:
                list(pool.map(partial(add, *part), range(0, count, _AT_ONCE)))
        return np.asarray(sums[0] / np.maximum(sums[1], 1.0))


def _half_precision() -> NDArray[np.float32]:
    """Return the values (65536,) of all numbers in half precision, in the order of their bits."""
    return np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)


@compiled
def _splat(
    place: NDArray[np.uint32],
    area: NDArray[np.uint16],
    scale: NDArray[np.float32],
    px_a_step: np.float32,
    amount: NDArray[np.float32],
    picture: NDArray[np.float32],
) -> None:
    """Add the shadows of cells to the picture of one view. Each shadow is distributed over four pixels."""
    for k in range(len(place)):
        if area[k] > 0:
            u, v = np.float32(place[k] & 0xFFFF) * px_a_step, np.float32(place[k] >> 16) * px_a_step
            column, row = int(u), int(v)
            right, down = u - np.float32(column), v - np.float32(row)
            upper, lower = amount[k] * scale[area[k]] * (np.float32(1.0) - down), amount[k] * scale[area[k]] * down
            picture[row, column] += upper * (np.float32(1.0) - right)
            picture[row, column + 1] += upper * right
            picture[row + 1, column] += lower * (np.float32(1.0) - right)
            picture[row + 1, column + 1] += lower * right


@compiled
def _add_logs(
    place: NDArray[np.uint32],
    area: NDArray[np.uint16],
    px_a_step: np.float32,
    pictures: Pictures,
    limits: tuple[float, float],
    sums: Array,
) -> None:
    """Add the logarithms of the pictures' values at cells, and the numbers of views that show them, to sums (2, N)."""
    total, votes = sums[0], sums[1]
    product = np.ones(len(total))
    for view in range(len(pictures)):
        picture = pictures[view]
        for k in range(len(total)):
            if area[view, k] > 0:
                u, v = np.float32(place[view, k] & 0xFFFF) * px_a_step, np.float32(place[view, k] >> 16) * px_a_step
                column, row = int(u), int(v)
                right, down = u - np.float32(column), v - np.float32(row)
                upper = picture[row, column] + right * (picture[row, column + 1] - picture[row, column])
                lower = picture[row + 1, column] + right * (picture[row + 1, column + 1] - picture[row + 1, column])
                product[k] *= min(max(upper + down * (lower - upper), limits[0]), limits[1])
                votes[k] += 1
        if view % _FACTORS == _FACTORS - 1 or view == len(pictures) - 1:
            for k in range(len(total)):
                total[k] += np.log(product[k])
                product[k] = 1.0
