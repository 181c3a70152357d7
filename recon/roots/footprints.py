"""Compact footprints of cells in all views, used to project shadows and to sample pictures.

The footprint of a cell in a view consists of the position of the cell's centre in the picture, and the area that 1 mm2
covers there. It takes six bytes: column and row in steps of a fraction of a pixel, with 16 bits each, and the area in
half precision. Only the window of each picture that contains cells is stored, one view after another, so that the work
depends on the size of the plant and not on the size of the picture. All views are processed in a loop within one
kernel, since compiling a kernel per view would take longer than running it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import Float, Kernel, UInt32, bilinear, is_positive, numbers, readable
from rhizotwin.recon.optics import projection

Array = NDArray[np.float64]

_STEPS = 65535
"""Number of quantisation steps along the longer side of a picture for stored positions. One step is 1/80 px for a side
of 800 px."""
_PIXELS_AT_ONCE = 1_000_000
"""Maximum number of pixels in the windows of the views that are processed together. At least one view is processed at a
time. Each thread needs memory for four numbers per pixel."""
_PARTS = 256
"""Number of groups into which the cells of a view are divided. The bounds of the footprints are searched in all groups
in parallel, without copying the cells."""


@dataclass(frozen=True)
class Windows:
    """Windows of equal size, one per view, that together contain all cells.

    Their pixels are flattened and concatenated.
    """

    low: NDArray[np.int64]
    """First column and row of each window, shape (V, 2)."""
    columns: int
    rows: int

    @property
    def pixels(self) -> int:
        """Return the number of pixels of one window."""
        return self.columns * self.rows

    @staticmethod
    def around(*several: Footprints) -> Windows:
        """Return windows that contain all footprints, including the pixels needed for bilinear interpolation."""
        bounds = [footprints.bounds() for footprints in several]
        low, high = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
        used = (high >= low).all(axis=1)  # a view may contain no cell
        size = (high - low + 2)[used].max(axis=0, initial=2)
        image_wh = np.asarray(several[0].image_wh)
        return Windows(np.clip(np.where(used[:, None], low, 0), 0, image_wh - size), int(size[0]), int(size[1]))

    def cut(self, evidence: Evidence, pictures: Kernel) -> Kernel:
        """Cut the windows out of whole pictures, flattened (V, H, W). The array type is preserved."""
        stack = pictures.numpy().reshape(len(self.low), evidence.image_wh[1], evidence.image_wh[0])
        parts = [picture[v : v + self.rows, u : u + self.columns].ravel() for picture, (u, v) in zip(stack, self.low, strict=True)]
        return type(pictures)(np.concatenate(parts))


@dataclass(frozen=True)
class Footprints:
    """Footprints of cells in all views."""

    views: int
    count: int
    """Number of cells."""
    image_wh: tuple[int, int]
    steps_a_px: Float
    """Number of steps per pixel in ``place`` (mi.Float)."""
    place: UInt32
    """Column and row of each cell in each view, in steps of a fraction of a pixel, 16 bits each (mi.UInt32, flattened
    (V, N))."""
    px2_a_mm2: Kernel
    """Ratio of the projected area, px2, to the area in space, mm2, for each cell in each view (mi.Float16, flattened
    (V, N)). It is 0 in a view that does not show the cell."""

    @staticmethod
    def project(evidence: Evidence, centre_mm: Array) -> Footprints:
        """Project cell centres (N, 3) into all views."""
        count, views, (width, height) = len(centre_mm), evidence.bank.count, evidence.size
        steps_a_px = dr.opaque(mi.Float, _STEPS / max(evidence.image_wh))
        p = projection.project_into_all(evidence.bank, centre_mm)
        view, _ = projection.pair_all(views, count)
        visible = p.visible & readable(p.px, width, height)
        px = dr.select(visible, p.px, mi.Vector2f(0.0))
        usable = dr.gather(mi.Float16, evidence.usable, view * (width * height) + mi.UInt32(px.y + 0.5) * width + mi.UInt32(px.x + 0.5))
        area = mi.Float16(dr.select(visible & is_positive(usable), dr.norm(dr.cross(p.du, p.dv)), 0.0))
        place = mi.UInt32(px.x * steps_a_px + 0.5) | (mi.UInt32(px.y * steps_a_px + 0.5) << 16)
        dr.eval(place, area)
        return Footprints(views, count, evidence.image_wh, steps_a_px, place, area)

    def bounds(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the lowest and the highest column and row of the footprints in each view, two arrays (V, 2).

        In a view without footprints, the highest values are far below the lowest.
        """
        lane = dr.arange(mi.UInt32, self.views * _PARTS)
        view, count = lane // _PARTS, dr.opaque(mi.UInt32, self.count)

        def body(cell: UInt32, *found: Kernel) -> tuple[Kernel, ...]:
            at = view * count + cell
            place, visible = dr.gather(mi.UInt32, self.place, at), is_positive(dr.gather(mi.Float16, self.px2_a_mm2, at))
            u, v = (mi.Int32(mi.Float(steps) / self.steps_a_px) for steps in (place & 0xFFFF, place >> 16))
            low = [dr.select(visible, dr.minimum(least, pixel), least) for least, pixel in zip(found[:2], (u, v), strict=True)]
            high = [dr.select(visible, dr.maximum(most, pixel), most) for most, pixel in zip(found[2:], (u, v), strict=True)]
            return cell + _PARTS, *low, *high

        state = [dr.full(mi.Int32, none, self.views * _PARTS) for none in (1 << 16, 1 << 16, -(1 << 16), -(1 << 16))]
        _, *found = dr.while_loop((lane % _PARTS, *state), lambda cell, *_: cell < count, body)
        dr.eval(found)
        pixels = np.array([np.array(part) for part in found], np.int64).reshape(4, self.views, _PARTS)
        return pixels[:2].min(axis=-1).T, pixels[2:].max(axis=-1).T


class Table:
    """Footprints of a set of cells, with windows for projecting shadows and sampling pictures.

    A subset of the cells is stored as a list of indices, since a copy of the footprints would double the memory.
    """

    def __init__(self, footprints: Footprints, windows: Windows, cells: UInt32 = None) -> None:
        self.footprints, self.windows = footprints, windows
        self._cells = dr.arange(mi.UInt32, footprints.count) if cells is None else cells
        self._low = [numbers(windows.low[:, axis]) for axis in (0, 1)]
        self._columns, self._pixels = (dr.opaque(mi.UInt32, number) for number in (windows.columns, windows.pixels))
        dr.eval(self._low, self._cells)

    def select(self, kept: UInt32) -> Table:
        """Return the table for a subset of the cells, selected by indices (mi.UInt32)."""
        return Table(self.footprints, self.windows, dr.gather(mi.UInt32, self._cells, kept))

    def _at(self, view: UInt32) -> tuple[Float, Float, Float]:
        """Return column and row within the window, and the projected area, of all cells in a view."""
        footprints = self.footprints
        lane = view * dr.opaque(mi.UInt32, footprints.count) + self._cells
        place, area = dr.gather(mi.UInt32, footprints.place, lane), mi.Float(dr.gather(mi.Float16, footprints.px2_a_mm2, lane))
        u, v = (
            mi.Float(steps) / footprints.steps_a_px - dr.gather(mi.Float, low, view)
            for steps, low in zip((place & 0xFFFF, place >> 16), self._low, strict=True)
        )
        return u, v, area

    def shadows(self, views: range, amount: Float) -> Float:
        """Project the cells' shadows (mi.Float, mm2) into the windows of consecutive views by bilinear splatting."""
        count = max(1, _PIXELS_AT_ONCE // self.windows.pixels)
        starts = range(views.start, views.stop, count)
        parts = [self._few_shadows(range(start, min(start + count, views.stop)), amount) for start in starts]
        return parts[0] if len(parts) == 1 else dr.concat(parts)

    def _few_shadows(self, views: range, amount: Float) -> Float:
        """Project the cells' shadows into the windows of a few views.

        Each shadow is distributed over four pixels. The four values are stored together at the upper left pixel, in a
        separate copy for each thread, and are then summed for every pixel. This takes a quarter of the time of four
        atomic additions.
        """
        corners = dr.zeros(mi.Float, 4 * self.windows.pixels * len(views))
        dr.eval(corners)
        first = dr.opaque(mi.UInt32, views.start)

        def body(view: UInt32) -> tuple[UInt32]:
            u, v, area = self._at(view)
            column, row = mi.UInt32(u), mi.UInt32(v)
            fu, fv = u - mi.Float(column), v - mi.Float(row)
            shadow = amount * area * mi.Vector4f((1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv, fu * fv)
            at = (view - first) * self._pixels + row * self._columns + column
            dr.scatter_reduce(dr.ReduceOp.Add, corners, shadow, at, is_positive(area), mode=dr.ReduceMode.Expand)
            return (view + 1,)

        self._loop(views, (), body)
        lane = dr.arange(mi.UInt32, self.windows.pixels * len(views))
        steps = (0, 1, self._columns, self._columns + 1)
        total = sum(dr.gather(mi.Float, corners, 4 * (lane - step) + corner, lane >= step) for corner, step in enumerate(steps))
        dr.eval(total)
        return total

    def mean_log(self, pictures: Float, views: range, least: float, most: float) -> Float:
        """Return the mean logarithm of the clipped picture values at each cell, averaged over the views that show it.

        The result (mi.Float) is 0 for a cell that no view shows.

        Parameters
        ----------
        pictures : Float
            Flattened windows of the pictures of these views.
        """
        first = dr.opaque(mi.UInt32, views.start)

        def body(view: UInt32, total: Float, votes: Float) -> tuple[UInt32, Float, Float]:
            u, v, area = self._at(view)
            visible = is_positive(area)
            value = bilinear(pictures, (view - first) * self._pixels, self._columns, u, v, visible)
            return view + 1, total + dr.select(visible, dr.log(dr.clip(value, least, most)), 0.0), votes + dr.select(visible, 1.0, 0.0)

        count = dr.width(self._cells)
        _, total, votes = self._loop(views, (dr.zeros(mi.Float, count), dr.zeros(mi.Float, count)), body)
        return total / dr.maximum(votes, 1.0)

    def _loop(self, views: range, state: tuple[Kernel, ...], body: Callable[..., tuple[Kernel, ...]]) -> tuple[Kernel, ...]:
        end = dr.opaque(mi.UInt32, views.stop)
        begin = dr.opaque(mi.UInt32, views.start, dr.width(self._cells))
        found: tuple[Kernel, ...] = dr.while_loop((begin, *state), lambda view, *_: view < end, body)
        return found
