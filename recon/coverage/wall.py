"""Fouling of the canister's inner wall: detection and removal of algae films and bubbles.

Every line of sight crosses the wall twice. When the views of a turn are unrolled onto the wall, objects on the wall
remain in place, whereas roots inside the canister move. The optical depth of the wall is therefore the depth that most
views of a position agree on. Films are broad and faint, and their absorption is removed from the pictures. Bubbles are
small, round and dark-rimmed, and the pixels that they cover are not usable. Thin, long objects are retained, because
they are roots on the wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rhizotwin.recon.coverage.coarse_lines import CoarseLines, upsample
from rhizotwin.recon.coverage.silhouettes import Image, Mask
from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.settings import CoverageSettings
from rhizotwin.scenes.monitor import Monitor

_TEXEL_MM = 1.0
"""Edge length of a texel of the unrolled wall, mm. A texel spans a few sampled pixels (`_COLUMNS`), which are averaged
in each view."""
STEP = 8
"""Spacing of the pixel grid on which lines of sight are computed, px. The values of other pixels are interpolated."""
_COLUMNS = 250
"""Approximate number of columns that are sampled in the part of a picture that shows the water, which yields a few
pixels per texel. The rows are sampled with the same spacing."""
_QUANTILE = 0.35
"""Quantile of the optical depths of a texel in all views that is used as the optical depth of the wall. Roots cover a
texel in less than half of the views."""
LEAST_VIEWS = 5
"""Minimum number of views that must show a texel for it to be classified. With three views or fewer, the quantile is
the minimum. A texel at the top or the bottom of the wall is only visible in the nearest views, which are a sixth of a
ring."""
_NARROWEST_TEXELS = 4
"""Minimum width of a film, in texels. Roots on the wall are thinner."""
_WIDEST_BUBBLE_MM = 5.0
"""Maximum diameter of a bubble, mm. The value is about two capillary lengths of water (2.7 mm). Larger bubbles do not
adhere to a wall."""
_CLEAR, _CLEAR_VIEWS = 0.05, 4
"""Two parameters of the bubble test. A view shows that a dark spot is isolated if the optical depth of the ring around
it is below the first value. The second value is the minimum number of such views."""
_OPAQUE = 0.98
"""Upper limit of the opacity from which the optical depth is computed. It limits the optical depth to 3.9."""
_ROUNDS = 2
"""Number of iterations of the film estimate. The first iteration ignores the film on the opposite wall, and the second
subtracts it."""


@dataclass(frozen=True)
class Crossings:
    """Texel coordinates at which a view's lines of sight cross the near and the far wall."""

    coarse: Image
    """(2, 2, h, w) texel coordinates on a coarse pixel grid. The axes are the wall (near,
    far), the coordinate (column, row), the grid row, and the grid column. Full resolution would need more memory than
    all pictures."""
    step: int
    """Spacing of the coarse grid, px of the reduced picture."""
    image_wh: tuple[int, int]
    """Width and height of the reduced picture, px (`Face.shrink`)."""

    @property
    def sides(self) -> list[list[Image]]:
        """Return the texel column and the texel row (H, W) of every pixel, on the near and on the far wall."""
        return [[upsample(part, self.step, self.image_wh) for part in side] for side in self.coarse]


@dataclass(frozen=True)
class Wall:
    """Films and bubbles on the unrolled inner wall, in texels of about `_TEXEL_MM`.

    Row 0 is at the top of the water, and column 0 at azimuth 0.
    """

    film: Image
    """(rows, columns) optical depth of the films."""
    bubbles: Mask
    """(rows, columns) mask of bubbles."""


@dataclass(frozen=True)
class Face:
    """Unrolled inner or outer face of the wall."""

    texel_mm: float
    """Approximate edge length of a texel, mm."""
    outside: bool
    """Whether this is the outer face."""
    beyond_mm: float = 0.0
    """Height by which the face extends above the water surface and below the canister's floor, mm. Lines of sight
    through the water may cross the outer face there."""
    shrink: int = 1
    """Number of pixels, in both directions, that are averaged before pictures are unrolled: a power of two, up to
    `STEP`."""

    def shape(self, optics: Optics) -> tuple[int, int]:
        """Return the number of texel rows and columns."""
        radius_mm = optics.outer_radius_mm if self.outside else optics.inner_radius_mm
        rows = max(1, round((optics.water_z_mm - optics.floor_z_mm + 2.0 * self.beyond_mm) / self.texel_mm))
        return rows, max(8, round(2.0 * np.pi * radius_mm / self.texel_mm))


INSIDE = Face(_TEXEL_MM, outside=False)
"""Inner face of the wall, which bears films and bubbles."""


def crossings(view: View, optics: Optics, face: Face = INSIDE) -> Crossings:
    """Compute the texel coordinates of the two points at which a view's lines of sight cross a face of the wall.

    The pictures are reduced by `Face.shrink`. The coordinates are undefined for pixels whose line of sight misses the
    water.
    """
    lines = CoarseLines.compute(view, optics, step=STEP, beyond=True)
    outer = refraction.clip_to_water(optics, lines.line)
    line = refraction.follow(optics, outer)
    half = np.sqrt(np.maximum(optics.inner_radius_mm**2 - line.b_mm**2, 0.0))
    x, y, _ = view.centre_mm
    rows, columns = face.shape(optics)
    near, near_z = line.b_mm[:, None] * line.nu - half[:, None] * line.t, line.entry_z_mm
    if face.outside:
        at_mm = np.sqrt(optics.outer_radius_mm**2 - outer.b_mm**2)
        near, near_z = outer.b_mm[:, None] * outer.nu - at_mm[:, None] * outer.t, line.outer_z_mm
    # The path out of the canister mirrors the path in, about the middle of the path in the water.
    far = near - 2.0 * (near * line.t).sum(axis=1, keepdims=True) * line.t
    far_z = 2.0 * (line.entry_z_mm + line.slope * half) - near_z
    found = []
    for at, z, centre in ((near, near_z, 0.0), (far, far_z, np.pi)):  # centred, so that the azimuth is continuous over the picture
        azimuth = np.mod(np.arctan2(at[:, 1], at[:, 0]) - centre + np.pi, 2.0 * np.pi) - np.pi + centre + np.arctan2(y, x)
        column = azimuth * columns / (2.0 * np.pi) - 0.5
        height_mm = optics.water_z_mm - optics.floor_z_mm + 2.0 * face.beyond_mm
        row = (optics.water_z_mm + face.beyond_mm - z) * rows / height_mm - 0.5
        found.append([column.reshape(lines.shape), row.reshape(lines.shape)])
    width, height = (-(-size // face.shrink) for size in lines.image_wh)
    return Crossings(np.array(found, np.float32), STEP // face.shrink, (width, height))


def look_up(panorama: Image, column: Image, row: Image) -> Image:
    """Interpolate an unrolled wall (rows, columns) at texel coordinates (H, W).

    Columns are periodic, and rows are clamped.
    """
    ringed = np.concatenate([panorama[:, -1:], panorama, panorama[:, :1]], axis=1)
    around = np.mod(column, np.float32(panorama.shape[1])) + np.float32(1.0)
    return np.asarray(cv2.remap(ringed, around, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def sum_crossings(panorama: Image, where: Crossings) -> Image:
    """Return the sum of an unrolled wall's values (rows, columns) at the two crossings of each pixel (H, W)."""
    near, far = (look_up(panorama, column, row) for column, row in where.sides)
    return np.asarray(near + far)


def detect_fouling(
    opacity: dict[int, Image],
    usable: dict[int, Mask],
    where: dict[int, Crossings],
    optics: Optics,
    monitor: Monitor,
    settings: CoverageSettings = CoverageSettings(),
) -> Wall:
    """Detect films and bubbles on the inner wall.

    Parameters
    ----------
    opacity : dict of (H, W) float32 array
        1 - picture / backlight, keyed by frame number.
    usable : dict of (H, W) bool array
        Masks of usable pixels, keyed by frame number.
    where : dict of Crossings
        Crossings of each view's lines of sight with the wall, keyed by frame number.
    optics : Optics
        Radii and heights of the canister.
    monitor : Monitor
        Receives progress messages for each view.
    settings : CoverageSettings
        Thresholds for films and bubbles.
    """
    rows, columns = INSIDE.shape(optics)
    step = max(1, next(iter(opacity.values())).shape[1] // _COLUMNS)
    sampled = np.s_[::step, ::step]
    depth = {k: -np.log1p(-np.minimum(picture[sampled], _OPAQUE)) for k, picture in opacity.items()}
    keys, film = list(opacity), np.zeros((rows, columns), np.float32)
    found = monitor.each(lambda k: _texels(where[k], usable[k], sampled, (rows, columns)), "wall", keys)
    places = dict(zip(keys, found, strict=True))
    for _ in range(_ROUNDS):
        views = np.concatenate(monitor.each(partial(_mean_depth, places, depth, film), "wall", keys))
        dark = _quantile(views).reshape(rows, columns)
        # Roots on the wall are not film, and neither are their fringes that remain after the opening.
        faint = np.where(dark > settings.film_most, 0.0, dark)
        broad = ndimage.grey_opening(faint, size=_NARROWEST_TEXELS, mode="wrap")
        broad = np.minimum(faint, ndimage.grey_dilation(broad, size=3, mode="wrap"))  # the opening makes the edges square
        film = np.where(broad > settings.film_depth, broad, 0.0).astype(np.float32)
    return Wall(film, _bubbles(dark - film, (views - film.ravel()).reshape(-1, rows, columns), settings.bubble_depth))


def _texels(where: Crossings, usable: Mask, sampled: tuple[slice, slice], size: tuple[int, int]) -> NDArray[np.int32]:
    """Return the flat texel indices (2, h, w) of a view's sampled pixels on the near and far wall.

    The index of pixels that are not usable is -1.
    """
    rows, columns = size
    sides = []
    for side in where.sides:
        column, row = (np.rint(at[sampled]).astype(np.int32) for at in side)
        here = usable[sampled] & (row >= 0) & (row < rows)
        sides.append(np.where(here, row * columns + np.mod(column, columns), -1))
    return np.stack(sides)


def _mean_depth(places: dict[int, NDArray[np.int32]], depth: dict[int, Image], film: Image, k: int) -> Image:
    """Return the mean optical depth (2, texels) in view ``k``, with the film on the opposite wall subtracted.

    The depth is NaN for texels that the view does not show.
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
    """Return the quantile `_QUANTILE` (N,) of observations (V, N) of each texel; 0 if there are too few views."""
    ordered = np.sort(observed, axis=0)  # NaN last
    number = np.isfinite(ordered).sum(axis=0)
    rank = (_QUANTILE * np.maximum(number - 1, 0)).astype(np.int64)
    return np.where(number >= LEAST_VIEWS, np.take_along_axis(ordered, rank[None], axis=0)[0], 0.0).astype(np.float32)


def _bubbles(dark: Image, views: Image, least: float) -> Mask:
    """Return the mask (rows, columns) of small isolated dark spots on the unrolled wall, dilated by one texel.

    A spot is isolated if several views (V, rows, columns) show it with a clear ring around it. A root that touches the
    wall extends beyond the spot in every view, so its ring is never clear. A spot caused by a cluster of roots inside
    the canister is as clear as its ring in views whose lines of sight miss the cluster.
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


def remove_fouling(opacity: Image, usable: Mask, where: Crossings, wall: Wall) -> tuple[Image, Mask]:
    """Remove films from the opacity of a picture, and mark pixels that bubbles hide as not usable.

    Parameters
    ----------
    opacity : (H, W) float32 array
        Opacity of the picture.
    usable : (H, W) bool array
        Mask of usable pixels.
    where : Crossings
        Crossings of the picture's lines of sight with the wall.
    wall : Wall
        Films and bubbles on the wall.

    Returns
    -------
    (H, W) float32 array, (H, W) bool array
        Opacity without films, and mask of usable pixels.
    """
    free = 1.0 - (1.0 - opacity) * np.exp(sum_crossings(wall.film, where))
    return np.where(usable, free, 0.0).astype(np.float32), usable & (sum_crossings(wall.bubbles.astype(np.float32), where) < 0.5)
