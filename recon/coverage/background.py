"""Estimation of a ring's empty backlight from the pictures of a turn, and detection of pixels that show the water."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.coarse_lines import CoarseLines
from rhizotwin.recon.optics import cameras, refraction
from rhizotwin.recon.optics.refraction import Approach, Array, Optics
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.settings import CoverageSettings
from rhizotwin.scenes.model import Scene

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

_MARGIN_MM = 0.1
"""Minimum clearance of a line of sight from opaque parts for its pixel to be used, mm. The clearance allows for errors
of the cameras and of the canister's dimensions."""
_STEP = 4
"""Spacing of the pixel grid on which lines of sight are computed, px. The values of other pixels are interpolated."""
_FLANK = 0.98
"""Fraction of the canister's width within which pixels are used. Closer to the edges, the wall reflects nearly all
light."""
_LEAST_SHARE = 0.5
"""Minimum fraction of the views that must show the water at a pixel for its background to be estimated."""
_RIM_PX = 11
"""Side of the square around each glare pixel in which all pixels are classified as glare, px. The square extends the
glare by five pixels in each direction, to include its blurred rim."""
_GLARE_PX = 1.0
"""Standard deviation of the Gaussian smoothing before glare detection, px. Beside roots, JPEG compression makes single
pixels 5 % too bright in every fifth view. Without smoothing, such pixels were classified as glare, and the squares
around them (`_RIM_PX`) hid a tenth of a plant."""
_UPPER, _ALIKE = 0.2, 0.04
"""Two parameters of the background estimate. The first determines the reference brightness of a pixel, which is
exceeded in this fraction of the views. The second is a relative tolerance: views that differ less from the reference
brightness also show the panel, and are averaged. A pixel whose background is darker than the smooth surface by more is
treated as covered in every view. Roots may cover a pixel in four of five views. The tolerance is three times the noise
of a bench's panel (1.3 % with 6000 electrons). The mean is then too bright by 0.03 times the noise, or by a third of
the noise at a quarter of the light (from the moments of a normal distribution)."""
_CORE = 0.85
"""Fraction of the canister's width in which the smooth surface is fitted. In pictures simulated without noise, the
residual of the surface is 0.02 % within this fraction, 0.08 % up to 0.92, and 0.4 % up to 0.98. There, small camera
errors leave a part of the variation of the wall's transmittance in the background."""
_SAMPLES = 40_000
"""Approximate number of pixels to which the smooth surface is fitted. There are almost a thousand pixels for each of
its 45 coefficients."""
_FITS = 8
"""Number of successive fits of the smooth surface. After each fit, the tolerance for pixels brighter than the surface
is halved. It is large at first, because roots lower the first surfaces, and small at the end, because the flanks of a
reflection would raise the surface."""
_CLOSING_PX = 31
"""Maximum width of dark objects that are removed from a single picture by morphological closing, px. It corresponds to
7 mm at 0.23 mm per pixel (profile `bench`), whereas the hypocotyls of radishes without a globe in the library are 1.5
to 3 mm wide. Wider objects are rejected as outliers of the smooth surface."""
_BRIGHT = 0.9
"""Quantile of the background that represents its brightness. This quantile is not affected by glare and hot pixels."""
_AGREED = 0.5
"""Minimum fraction of the views that must agree in the brightness of a pixel. The pixel is then considered free of
roots in most views."""
_LEAST_SURE = 0.1
"""Minimum fraction of the bright pixels that must be free of roots in most views. If the fraction is smaller, the first
fit of the smooth surface uses all bright pixels."""
_MOST_ADDED = 0.25
"""Maximum brightness of a reflection that is subtracted from the pictures, as a fraction of the panel's brightness. If
the reflected object becomes brighter or darker by a fifth, the error is at most the default of
`CoverageSettings.glare`, which is tolerated."""
_DARK, _LEAST_DARK = 0.5, 30
"""Two parameters of the detection of roots behind reflections. A pixel shows a root if its brightness is below the
first value, as a fraction of the panel's brightness. The second value is the minimum number of such pixels."""
_DARKEST = 0.2
"""Quantile by which root pixels behind a reflection are compared with root pixels beside it. It is taken over the
brightness of each pixel in its darkest view. It represents pixels that a root covers completely, and exceeds the noise
of single pixels."""
_BESIDE_PX = 41
"""Side of the square around a reflection in which root pixels are used for comparison, px. Roots within this distance
are as bright as roots behind the reflection, because front light varies only over distances of 200 px and more
(the depth of the water)."""
_BLOCK_ROWS = 24
"""Number of picture rows that are processed at once. 24 rows of 40 views with 800 columns occupy 3 MB and fit in the
cache."""
_THREADS = 2
"""Number of threads for the background estimate. Each thread needs memory for a copy of its block of rows."""


def water_mask(view: cameras.View, optics: Optics, scene: Scene) -> Mask:
    """Return the pixels (H, W) whose line of sight passes through the water to the backlight.

    The mask excludes the outermost 2 % of the canister's width, where the wall reflects nearly all light. It also
    excludes a margin of half a pixel plus `_MARGIN_MM` at opaque parts: the skirt of the net pot in front of and behind
    the canister, the net pot's grid or the water surface, and the canister's base out to the outer wall. The clearance
    of a line of sight from these parts is computed for every fourth pixel in each direction, and interpolated.
    """
    lines = CoarseLines.compute(view, optics, step=_STEP)
    inside = np.where(lines.through & refraction.reaches_water(optics, lines.line, _FLANK), 1.0, np.nan)
    clear = (inside * _clearance_mm(view, optics, scene, refraction.clip_to_water(optics, lines.line, _FLANK))).astype(np.float32)
    known = lines.upsample(np.isfinite(clear), nearest=True) > 0
    half_px_mm = 0.5 * (view.rho_mm + optics.outer_radius_mm) / view.camera.focal_px[1]
    return np.asarray(known & (lines.upsample(np.nan_to_num(clear, nan=-1.0)) > _MARGIN_MM + half_px_mm))


def _clearance_mm(view: cameras.View, optics: Optics, scene: Scene, near: Approach) -> Array:
    """Return the vertical clearance (N,) of lines of sight from opaque parts, mm.

    In a tank, the clearance from the liquid's surface is included. The clearance is NaN for lines that miss the water.
    """
    r_skirt, r_o, r_i, p_z = scene.net_pot.outer_radius_mm, optics.outer_radius_mm, optics.inner_radius_mm, near.p_z
    with np.errstate(invalid="ignore"):
        line = refraction.follow(optics, near)
        h_around = np.sqrt(optics.n_around**2 - p_z**2)
        in_wall = p_z / np.sqrt(optics.n_wall**2 - p_z**2)
        b_wall = near.b_mm * h_around / np.sqrt(optics.n_wall**2 - p_z**2)
        through_wall = np.sqrt(r_o**2 - b_wall**2) - np.sqrt(r_i**2 - b_wall**2)
        far_z = line.entry_z_mm + line.slope * 2.0 * np.sqrt(r_i**2 - line.b_mm**2)
        far_outer_z = far_z + in_wall * through_wall
        if optics.tank is None:
            outside = p_z / h_around * (np.sqrt(r_skirt**2 - near.b_mm**2) - np.sqrt(r_o**2 - near.b_mm**2))
            before, after, top_z = line.outer_z_mm - outside, far_outer_z + outside, scene.net_pot.skirt_bottom_mm
        else:
            beyond = cameras.length_behind_canister(view, optics, near, line)
            before, after, top_z = line.outer_z_mm, far_outer_z + p_z / h_around * beyond, optics.tank.level_mm
        clear = np.minimum(top_z - np.maximum(before, after), optics.water_z_mm - np.maximum(line.entry_z_mm, far_z))
        lowest = np.minimum(line.outer_z_mm, far_outer_z) - optics.floor_z_mm
        return np.minimum(clear, lowest if optics.tank is None else np.minimum(lowest, after - optics.bottom_z_mm))


def wall_light(view: cameras.View, optics: Optics) -> Image:
    """Return the transmittance (H, W) of the canister's walls in a view.

    Beyond the fraction `_FLANK` of the canister's width, the transmittance at this limit is returned. If the canister
    rotates about an axis other than its own, its edges move in the picture. The transmittance is therefore divided out
    before the backlight is estimated.
    """
    lines = CoarseLines.compute(view, optics, step=_STEP)
    return lines.upsample(refraction.transmittance(optics, refraction.clip_to_water(optics, lines.line, _FLANK)))


class Panel(NamedTuple):
    """Empty backlight of a ring, and the light that reflections add to it, in the units of the pictures."""

    light: Image
    """(H, W) empty backlight."""
    added: Image
    """(H, W) light that the wall reflects, which is subtracted from the pictures. It is 0 where there are no
    reflections."""
    glare: Mask
    """(H, W) mask of reflections that cannot be subtracted. Their light hides roots, so these pixels are not usable."""


def estimate(stack: Image, inside: Mask, settings: CoverageSettings = CoverageSettings()) -> Panel:
    """Estimate the empty backlight from the views of one ring with a static camera.

    The background of a pixel is the mean of the views whose brightness differs by at most 4 % from the upper quintile.
    This mean is too dark where an object covers the panel in nearly every view, such as the taproot on the axis or a
    dense cluster of roots. There, the mean is replaced by a smooth surface fitted to reliable pixels. The first fit of
    this surface uses only pixels with equal brightness in most views, because a cluster may hide a larger part of the
    panel than it leaves free.

    Parameters
    ----------
    stack : (V, H, W) float32 array
        Pictures of the views, linear in light, in any unit.
    inside : (V, H, W) bool array
        Pixels of each view that show the water, which differ between the views if the canister wobbles.
    settings : CoverageSettings
        Thresholds for dim pixels and glare.

    Returns
    -------
    Panel
        Empty backlight and reflections. The backlight is 0 where fewer than `_LEAST_SHARE` of the views show the water.
    """
    often = inside.sum(axis=0) >= _LEAST_SHARE * len(stack)
    rows = np.flatnonzero(often.any(axis=1))
    background, agreed = np.zeros(stack.shape[1:], np.float32), np.zeros(stack.shape[1:], bool)
    if not len(rows):
        return Panel(background, np.zeros_like(background), np.zeros(background.shape, bool))

    def block(begin: int) -> None:
        part = np.s_[begin : begin + _BLOCK_ROWS]
        background[part], agreed[part] = _upper_mean(stack[:, part], inside[:, part])

    with ThreadPoolExecutor(max_workers=_THREADS) as pool:
        list(pool.map(block, range(int(rows[0]), int(rows[-1]) + 1, _BLOCK_ROWS)))
    background[~often] = 0.0
    smooth = _smooth_surface(background, often, agreed, settings)
    brighter = cv2.GaussianBlur(np.where(smooth > 0, background - smooth, 0.0), (0, 0), _GLARE_PX)
    spots = (smooth > 0) & (brighter > settings.glare * smooth)
    around = cv2.dilate(spots.astype(np.uint8), np.ones((_RIM_PX, _RIM_PX), np.uint8)) > 0
    added = np.where(around, np.maximum(background - smooth, 0.0), 0.0).astype(np.float32)
    strong = spots & (added > _MOST_ADDED * smooth)
    if spots.any() and _is_wall_reflection(stack, inside, smooth, spots & ~strong, added):
        glare = cv2.dilate(strong.astype(np.uint8), np.ones((_RIM_PX, _RIM_PX), np.uint8)) > 0
        added[glare] = 0.0
        background = background - added
    else:
        glare, added = around, np.zeros_like(added)
    # Pixels that are always covered are darker than the surface, away from the flanks, where the surface is steep.
    covered = often & (background < (1.0 - _ALIKE) * smooth)
    return Panel(np.where(covered, smooth, background).astype(np.float32), added, np.asarray(glare))


def _upper_mean(part: Image, inside: Mask) -> tuple[Image, Mask]:
    """Return the mean (H, W) of those views that show the panel, and a mask of reliable pixels.

    A view (V, H, W) shows the panel at a pixel if its brightness is close to the upper quintile of all views. A pixel
    is reliable if most of its views contribute to the mean. ``inside`` (V, H, W) is the mask of pixels that show the
    water.
    """
    number = inside.sum(axis=0)
    # Excluded pixels are sorted last; the quintile is that of the views that show the water.
    part = np.where(inside, part, 0.0)
    rank = len(part) - 1 - np.asarray(_UPPER * number, np.int64)
    upper = np.take_along_axis(np.partition(part, np.unique(rank), axis=0), rank[None], axis=0)[0]
    near = np.abs(part - upper) <= _ALIKE * upper
    count = near.sum(axis=0)
    return np.where(near, part, 0.0).sum(axis=0) / np.maximum(count, 1), count >= _AGREED * number


def _is_wall_reflection(stack: Image, inside: Mask, smooth: Image, spots: Mask, added: Image) -> bool:
    """Return whether excess light is reflected by the wall, and not emitted by a brighter part of the panel.

    Roots cover the panel, but they do not cover reflections of the wall. If the excess light is a reflection, it is
    therefore added to the brightness of the roots behind it.
    """
    about = cv2.dilate(spots.astype(np.uint8), np.ones((_BESIDE_PX, _BESIDE_PX), np.uint8))
    rows, columns = np.nonzero((about > 0) & (smooth > 0))
    darkest = np.where(inside[:, rows, columns], stack[:, rows, columns], np.inf).min(axis=0, initial=np.inf) / smooth[rows, columns]
    here, beside = ((darkest < _DARK) & part[rows, columns] for part in (spots, added == 0.0))
    if here.sum() < _LEAST_DARK or beside.sum() < _LEAST_DARK:
        return False
    brighter = np.quantile(darkest[here], _DARKEST) - np.quantile(darkest[beside], _DARKEST)
    return bool(brighter > 0.5 * np.median(added[rows, columns][here] / smooth[rows, columns][here]))


def _smooth_surface(background: Image, inside: Mask, sure: Mask, settings: CoverageSettings) -> Image:
    """Fit a smooth surface to the background.

    The surface is a polynomial in the position across the canister and the row, in a Chebyshev basis. Dark outliers and
    glare are rejected. The first fit uses the pixels (H, W) in ``sure``. Later fits add or reject pixels according to
    their residuals.
    """
    rows, columns = np.nonzero(inside)
    u = 2.0 * (columns - columns.min()) / max(1, np.ptp(columns)) - 1.0
    v = 2.0 * (rows - rows.min()) / max(1, np.ptp(rows)) - 1.0
    values = background[rows, columns].astype(np.float64)
    step = max(1, len(values) // _SAMPLES)
    sample = np.arange(0, len(values), step)
    core = np.abs(u) < _CORE
    sample = sample[core[sample]]
    degrees = (8, 4)
    basis = np.polynomial.chebyshev.chebvander2d(u[sample], v[sample], degrees)
    lit = values[sample] > settings.dim * np.quantile(values[sample], _BRIGHT) if len(sample) else np.zeros(0, bool)
    first = lit & sure[rows[sample], columns[sample]]
    trusted = first if first.sum() > _LEAST_SURE * lit.sum() else lit
    coefficients = np.zeros(basis.shape[1])
    surface = np.zeros_like(background)
    if not trusted.any():  # the picture is black
        return surface
    for number in range(_FITS):
        # normal equations: the basis is nearly orthogonal, and an SVD of 40 000 rows takes ten times as long
        some = basis[trusted]
        coefficients = np.linalg.lstsq(some.T @ some, some.T @ values[sample][trusted], rcond=None)[0]
        residual = values[sample] - basis @ coefficients
        scale = MAD * np.median(np.abs(residual[trusted])) + 1e-3 * np.abs(values[sample]).max()
        trusted = (residual > -3.0 * scale) & (residual < np.maximum(0.5**number * settings.glare * values[sample], 3.0 * scale))
    shape = (degrees[0] + 1, degrees[1] + 1)
    surface[rows[core], columns[core]] = np.polynomial.chebyshev.chebval2d(u[core], v[core], coefficients.reshape(shape))
    return surface


def bright_pixels(background: Image, inside: Mask, settings: CoverageSettings = CoverageSettings()) -> Mask:
    """Return the pixels (H, W) of ``inside`` whose background (H, W) is bright enough to measure coverage."""
    if not inside.any():
        return inside
    return inside & (background > settings.dim * np.quantile(background[inside], _BRIGHT))


def estimate_single(image: Image, inside: Mask, settings: CoverageSettings = CoverageSettings()) -> Image:
    """Estimate the empty backlight from a single picture.

    This estimate is used for cameras that moved between the views. Dark objects up to 31 px wide are removed by
    morphological closing, and wider objects are replaced by a smooth surface.

    Parameters
    ----------
    image : (H, W) float32 array
        Picture, linear in light.
    inside : (H, W) bool array
        Pixels that show the water.
    settings : CoverageSettings
        Thresholds for dim pixels and glare.

    Returns
    -------
    (H, W) float32 array
        Empty backlight in the units of the picture.
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_CLOSING_PX, _CLOSING_PX))
    closed = cv2.morphologyEx(
        np.where(inside, image, 0.0).astype(np.float32),
        cv2.MORPH_CLOSE,
        disc,
    )
    closed[~inside] = 0.0
    smooth = _smooth_surface(closed, inside, inside, settings)
    covered = inside & (smooth > 0)
    return np.where(covered, smooth, closed).astype(np.float32)
