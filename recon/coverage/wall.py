"""Fouling of the canister's inner wall, told from the roots inside: algae films and bubbles.

Every line of sight passes the wall twice. Unrolled and seen over the turn, what is on the wall adds up in its place
while roots inside pass by; so a place of the wall is as dark as most of its views show it. Films are broad and faint:
their light is given back to the pictures. Bubbles are small, round and dark-rimmed: what they cover is not seen. Thin
long things stay: they are roots on the wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rhizotwin.recon.coverage.coarse_lines import CoarseLines, enlarged
from rhizotwin.recon.coverage.silhouettes import Image, Mask
from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.settings import CoverageSettings
from rhizotwin.scenes.monitor import Monitor

_TEXEL_MM = 1.0
"""A few sampled pixels wide (`_COLUMNS`), so that a view gives each the mean of several."""
_STEP = 8
"""Lines of sight are followed for one pixel in so many each way, and interpolated."""
_COLUMNS = 400
"""Columns of a picture that are looked at, and as many rows in proportion: still a few pixels a texel."""
_QUANTILE = 0.35
"""Of the views of a place: roots pass before it in fewer than the others."""
_LEAST_VIEWS = 5
"""Of three views or fewer the quantile is the least."""
_NARROWEST_TEXELS = 4
"""A film is at least so wide; roots on the wall are thinner."""
_WIDEST_BUBBLE_MM = 5.0
"""Two capillary lengths of water (2.7 mm): larger bubbles do not stay on a wall."""
_CLEAR, _CLEAR_VIEWS = 0.05, 4
"""A bubble stands alone: in so many views the ring round it is clearer than this."""
_OPAQUE = 0.98
"""Opacity is taken to be no more, so that optical depths are finite (3.9)."""
_ROUNDS = 2
"""The first knows nothing of the other side's film; the second takes it off."""


@dataclass(frozen=True)
class Crossings:
    """Where a view's lines of sight cross the wall: texel coordinates of the near and the far side."""

    coarse: Image
    """(2, 2, h, w) sides, columns and rows, for one pixel in `_STEP` each way: in full they would take more memory than
    all pictures."""
    image_wh: tuple[int, int]

    @property
    def column(self) -> tuple[Image, Image]:
        """Return the columns (H, W) of every pixel."""
        return self._enlarged(0)

    @property
    def row(self) -> tuple[Image, Image]:
        """Return the rows (H, W) of every pixel."""
        return self._enlarged(1)

    def _enlarged(self, axis: int) -> tuple[Image, Image]:
        near, far = (enlarged(side[axis], _STEP, self.image_wh) for side in self.coarse)
        return near, far


@dataclass(frozen=True)
class Wall:
    """The unrolled inner wall, in texels of about `_TEXEL_MM`.

    Row 0 is at the top of the water, column 0 at azimuth 0.
    """

    film: Image
    """(rows, columns) optical depth."""
    bubbles: Mask
    """(rows, columns)"""


@dataclass(frozen=True)
class Face:
    """One of the wall's two faces, unrolled."""

    texel_mm: float
    """About."""
    outside: bool
    beyond_mm: float = 0.0
    """It reaches so far above the water and below its floor, which lines of sight pass on their way into it."""

    def shape(self, optics: Optics) -> tuple[int, int]:
        """Return the rows and columns of its texels."""
        radius_mm = optics.outer_radius_mm if self.outside else optics.inner_radius_mm
        rows = max(1, round((optics.water_z_mm - optics.floor_z_mm + 2.0 * self.beyond_mm) / self.texel_mm))
        return rows, max(8, round(2.0 * np.pi * radius_mm / self.texel_mm))


INSIDE = Face(_TEXEL_MM, outside=False)
"""Where films and bubbles are."""


def crossings(view: View, optics: Optics, face: Face = INSIDE) -> Crossings:
    """Follow a view's pixels to where they pass a face of the wall, near and far.

    Where they miss the water the coordinates mean nothing.
    """
    lines = CoarseLines.of(view, optics, step=_STEP, beyond=True)
    outer = refraction.within(optics, lines.line)
    line = refraction.follow(optics, outer)
    half = np.sqrt(np.maximum(optics.inner_radius_mm**2 - line.b_mm**2, 0.0))
    x, y, _ = view.centre_mm
    rows, columns = face.shape(optics)
    near, near_z = line.b_mm[:, None] * line.nu - half[:, None] * line.t, line.entry_z_mm
    if face.outside:
        at_mm = np.sqrt(optics.outer_radius_mm**2 - outer.b_mm**2)
        near, near_z = outer.b_mm[:, None] * outer.nu - at_mm[:, None] * outer.t, line.outer_z_mm
    # the way out is the way in, mirrored in the middle of the water
    far = near - 2.0 * (near * line.t).sum(axis=1, keepdims=True) * line.t
    far_z = 2.0 * (line.entry_z_mm + line.slope * half) - near_z
    found = []
    for at, z, centre in ((near, near_z, 0.0), (far, far_z, np.pi)):  # the centre, so that the azimuth is even over the picture
        azimuth = np.mod(np.arctan2(at[:, 1], at[:, 0]) - centre + np.pi, 2.0 * np.pi) - np.pi + centre + np.arctan2(y, x)
        column = azimuth * columns / (2.0 * np.pi) - 0.5
        height_mm = optics.water_z_mm - optics.floor_z_mm + 2.0 * face.beyond_mm
        row = (optics.water_z_mm + face.beyond_mm - z) * rows / height_mm - 0.5
        found.append([column.reshape(lines.shape), row.reshape(lines.shape)])
    return Crossings(np.array(found, np.float32), lines.image_wh)


def look_up(panorama: Image, column: Image, row: Image) -> Image:
    """Interpolate the unrolled wall (rows, columns) at texel coordinates (H, W).

    It goes round in columns and ends in rows.
    """
    ringed = np.concatenate([panorama[:, -1:], panorama, panorama[:, :1]], axis=1)
    around = np.mod(column, np.float32(panorama.shape[1])) + np.float32(1.0)
    return np.asarray(cv2.remap(ringed, around, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def passed(panorama: Image, where: Crossings) -> Image:
    """Return what lines of sight (H, W) pass of an unrolled wall (rows, columns), near and far together."""
    near, far = (look_up(panorama, *at) for at in zip(where.column, where.row, strict=True))
    return np.asarray(near + far)


def study(
    opacity: dict[int, Image],
    seen: dict[int, Mask],
    where: dict[int, Crossings],
    optics: Optics,
    monitor: Monitor,
    settings: CoverageSettings = CoverageSettings(),
) -> Wall:
    """Find the films and bubbles on the wall.

    Parameters
    ----------
    opacity : dict of (H, W) float32 array
        One less image over backlight, by number of the frame.
    seen : dict of (H, W) bool array
        Where it says something.
    where : dict of Crossings
        Where it looks through the wall.
    optics : Optics
        The canister's radii and heights.
    monitor : Monitor
        Hears of every view.
    settings : CoverageSettings
        What is a film, and what a bubble.
    """
    rows, columns = INSIDE.shape(optics)
    step = max(1, next(iter(opacity.values())).shape[1] // _COLUMNS)
    sampled = np.s_[::step, ::step]
    depth = {k: -np.log1p(-np.minimum(picture[sampled], _OPAQUE)) for k, picture in opacity.items()}
    keys, film = list(opacity), np.zeros((rows, columns), np.float32)
    found = monitor.each(lambda k: _texels(where[k], seen[k], sampled, (rows, columns)), "wall", keys)
    places = dict(zip(keys, found, strict=True))
    for _ in range(_ROUNDS):
        views = np.concatenate(monitor.each(partial(_observed, places, depth, film), "wall", keys))
        dark = _quantile(views).reshape(rows, columns)
        # roots on the wall are no film, nor is what the opening leaves of their fringe
        faint = np.where(dark > settings.film_most, 0.0, dark)
        broad = ndimage.grey_opening(faint, size=_NARROWEST_TEXELS, mode="wrap")
        broad = np.minimum(faint, ndimage.grey_dilation(broad, size=3, mode="wrap"))  # the opening squares the edges
        film = np.where(broad > settings.film_depth, broad, 0.0).astype(np.float32)
    return Wall(film, _bubbles(dark - film, (views - film.ravel()).reshape(-1, rows, columns), settings.bubble_depth))


def _texels(where: Crossings, seen: Mask, sampled: tuple[slice, slice], size: tuple[int, int]) -> NDArray[np.int32]:
    """Return the texels (2, h, w) that a view's sampled pixels look through, near and far; -1 where nothing is seen."""
    rows, columns = size
    sides = []
    for near_or_far in zip(where.row, where.column, strict=True):
        row, column = (np.rint(at[sampled]).astype(np.int32) for at in near_or_far)
        here = seen[sampled] & (row >= 0) & (row < rows)
        sides.append(np.where(here, row * columns + np.mod(column, columns), -1))
    return np.stack(sides)


def _observed(places: dict[int, NDArray[np.int32]], depth: dict[int, Image], film: Image, k: int) -> Image:
    """Return the mean optical depth (2, texels) of the places that view ``k`` sees, the other side's film taken off.

    NaN elsewhere.
    """
    sides = []
    for side in (0, 1):
        here = places[k][side] >= 0
        at, other = places[k][side][here], places[k][1 - side][here]
        value = depth[k][here] - np.where(other >= 0, film.ravel()[other], 0.0)
        number = np.bincount(at, minlength=film.size)
        total = np.bincount(at, weights=value, minlength=film.size)
        sides.append(np.where(number > 0, total / np.maximum(number, 1), np.nan).astype(np.float32))
    return np.stack(sides)


def _quantile(observed: Image) -> Image:
    """Return the quantile (N,) of what is observed (V, N) at each place; 0 where too few views see it."""
    ordered = np.sort(observed, axis=0)  # NaN last
    number = np.isfinite(ordered).sum(axis=0)
    rank = (_QUANTILE * np.maximum(number - 1, 0)).astype(np.int64)
    return np.where(number >= _LEAST_VIEWS, np.take_along_axis(ordered, rank[None], axis=0)[0], 0.0).astype(np.float32)


def _bubbles(dark: Image, views: Image, least: float) -> Mask:
    """Tell the small dark places of the unrolled wall (rows, columns) that stand alone, with a texel about them.

    Where a root touches the wall it goes on from there in every view (V, rows, columns), so that none shows a clear
    ring round the place; and where a crowd of roots inside makes it dark, it is as clear as its ring in those views
    that look past them.
    """
    rows, columns = dark.shape
    square = np.ones((3, 3), bool)
    label, _ = ndimage.label(np.concatenate([dark, dark], axis=1) > least, structure=square)
    found = np.zeros(dark.shape, bool)
    for number, (row, column) in enumerate(ndimage.find_objects(label), start=1):
        if max(row.stop - row.start, column.stop - column.start) * _TEXEL_MM > _WIDEST_BUBBLE_MM or column.start >= columns:
            continue
        high, low = max(0, row.start - 2), min(rows, row.stop + 2)
        place = np.mod(np.arange(column.start - 2, column.stop + 2), columns)
        dots = np.zeros((low - high, len(place)), bool)
        dots[row.start - high : row.stop - high, 2:-2] = label[row, column] == number
        body = ndimage.binary_dilation(dots, structure=square)
        ring = ndimage.binary_dilation(body, structure=square) & ~body
        here = views[:, high:low][:, :, place]
        clear = (here[:, ring] < _CLEAR).all(axis=1)  # NaN is not clear
        inside = here[clear][:, dots]
        inside = inside[np.isfinite(inside)]
        if clear.sum() >= _CLEAR_VIEWS and len(inside) and np.median(inside) > least:
            found[high:low, place] |= body
    return found


def cleared(opacity: Image, seen: Mask, where: Crossings, wall: Wall) -> tuple[Image, Mask]:
    """Return a picture's opacity (H, W) without the films, and where it is not hidden by bubbles.

    Parameters
    ----------
    opacity : (H, W) float32 array
        Of the picture.
    seen : (H, W) bool array
        Where it tells anything.
    where : Crossings
        Where its pixels cross the wall.
    wall : Wall
        Films and bubbles.

    Returns
    -------
    (H, W) float32 array, (H, W) bool array
        Opacity and where it tells anything.
    """
    free = 1.0 - (1.0 - opacity) * np.exp(passed(wall.film, where))
    return np.where(seen, free, 0.0).astype(np.float32), seen & (passed(wall.bubbles.astype(np.float32), where) < 0.5)
