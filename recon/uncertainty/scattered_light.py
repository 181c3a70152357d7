"""Light that is scattered around roots, and the uncertainty of the volume due to it.

Turbid water, lens flare, and sharpening or tone mapping in the camera distribute part of a pixel's signal over its
surroundings. Beside roots, the picture is then slightly too dark (or too bright, if the camera sharpens). The error is
proportional to the blurred coverage.

Pixels are compared with themselves in other views of the same camera: where roots often pass, the empty backlight is
less accurate, and an error of half a percent would look the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.uncertainty.budget import Term

_WIDE = 6.0
"""Standard deviation of the Gaussian that represents the scattering, in pixels of the reduced pictures. It is larger
than the blur of a lens and the flanks of a root."""
_REDUCTIONS = (1, 2, 4, 8)
"""Factors by which pictures are reduced, so that scattering over 6 to 48 px is represented. With a single width,
scattering over three times this width is underestimated by a half or more."""
_BESIDE_PX = 4.0
"""Minimum distance between a silhouette and the pixels in which scattered light is measured, px. Nearer pixels belong
to the flanks or the hairs of roots (1.5 mm at 0.4 mm per pixel)."""
_ROOT = 0.5
"""Minimum coverage of the pixels that belong to a root."""
_BINS = 12
"""Number of classes into which pixels are divided by their blurred coverage."""
_LEAST = 300
"""Minimum number of pixels in a class, before the reduction. With noise of 5 % per pixel, the median of a class is then
accurate to 0.4 %."""
_ENOUGH = 0.05
"""Minimum range of the blurred coverage over all pixels, and over the means of the classes."""
_VIEWS = 10
"""Number of views of each camera that are used, evenly spaced over the turn."""
_OTHERS = 3
"""Minimum number of other views of the same camera in which a pixel must also be beside roots. The mean then contains
only a quarter of each view's own value. For cameras with at most this number of views, pixels are not compared with
other views."""


def scattered_fraction(silhouettes: Sequence[Silhouette], stations: Sequence[tuple[int, int]]) -> float | None:
    """Return the fraction of light that is scattered around roots.

    The result is None if too few pixels beside roots are visible, and for masks, which have no opacity.

    Parameters
    ----------
    silhouettes : sequence of Silhouette
        Silhouettes with opacity, including noise; those without opacity are not used.
    stations : sequence of tuple of int
        Station of each view; views of one station share the backlight.

    Returns
    -------
    float or None
        Slope of the opacity beside roots over the blurred coverage, both relative to the same pixel in other views.
        Medians of classes are used, so that undetected thin roots, which affect few pixels, have no influence. The
        slope is too small if the blur is narrower or wider than the scattering, so the steepest of several is returned.
    """
    slopes = [_slope(silhouettes, stations, reduction) for reduction in _REDUCTIONS]
    return max((slope for slope in slopes if slope is not None), key=abs, default=None)


def _slope(silhouettes: Sequence[Silhouette], stations: Sequence[tuple[int, int]], reduction: int) -> float | None:
    """Return the slope of the opacity beside roots over the coverage that is blurred over `_WIDE` reduced pixels."""
    about, dark = [np.zeros(0, np.float32)], [np.zeros(0, np.float32)]
    for station in sorted(set(stations)):
        own = [one for one, at in zip(silhouettes, stations, strict=True) if at == station and one.opacity is not None]
        for one, other in _relative_to_others(own[:: max(1, len(own) // _VIEWS)], reduction):
            about.append(one)
            dark.append(other)
    x, y = np.concatenate(about), np.concatenate(dark)
    if not len(x) or np.ptp(x) < _ENOUGH:
        return None
    place = np.minimum(((x - x.min()) / np.ptp(x) * _BINS).astype(np.int64), _BINS - 1)
    count = np.bincount(place, minlength=_BINS) * reduction**2
    filled = np.flatnonzero(count >= _LEAST)
    at = np.array([x[place == one].mean() for one in filled])
    if len(filled) < 3 or np.ptp(at) < _ENOUGH:
        return None
    medians = np.array([np.median(y[place == one]) for one in filled])
    weight = np.sqrt(count[filled])
    return float(np.polyfit(at, medians, 1, w=weight)[0])


def scattered_term(share: float, thin_mm3: float) -> Term:
    """Return the term of the error budget for light that is scattered around roots.

    The opacity of thin roots, and thus their volume, is reduced by about the fraction of light that is scattered into
    them. For a radish, a bean and a wheat with mean diameters of 0.7 to 1.6 pixels, the reduction of the volume was 0.5
    to 0.8 times ``share``, for shares of 0.05 to 0.32. The outlines of thick roots, at half of the opacity, do not
    move: a printed root of 7 pixels lost 0.1 % at a share of 0.05 (docs/decisions/volume-interval.md).

    Parameters
    ----------
    share : float
        Fraction of light that is scattered around roots; negative for sharpened pictures.
    thin_mm3 : float
        Volume of thin roots, mm3.
    """
    finding = f"beside roots, light is {'increased' if share < 0 else 'reduced'} by {100.0 * abs(share):.1f} % of what they absorb"
    return Term(
        name="scattered light",
        less_mm3=max(-share, 0.0) * thin_mm3,
        more_mm3=max(share, 0.0) * thin_mm3,
        why=f"{finding}: change the water, clean the lens, and switch off sharpening and tone mapping in the camera",
    )


def _relative_to_others(views: Sequence[Silhouette], reduction: int) -> Iterator[tuple[Image, Image]]:
    """Yield the blurred coverage and the opacity of the pixels beside roots, for each view of one camera.

    Means of the same pixel over all views in which it is beside roots are subtracted from both, unless there are at
    most `_OTHERS` views.
    """
    if len(views) <= _OTHERS:
        yield from (_beside(view, reduction)[1:] for view in views)
        return
    shape: tuple[int, ...] = tuple(size // reduction for size in views[0].coverage.shape)
    total, darkness, count = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.int32)
    for view in views:  # two passes over the views, to limit memory
        beside, about, dark = _beside(view, reduction)
        total[beside] += about
        darkness[beside] += dark
        count[beside] += 1
    for view in views:
        beside, about, dark = _beside(view, reduction)
        often, n = count[beside] > _OTHERS, count[beside].astype(np.float32)
        yield (about - total[beside] / n)[often], (dark - darkness[beside] / n)[often]


def _beside(silhouette: Silhouette, reduction: int) -> tuple[Mask, Image, Image]:
    """Return the mask (H, W) of reduced pixels beside roots, and their blurred coverage (N,) and opacity (N,)."""
    root = (silhouette.coverage > _ROOT) & silhouette.usable
    away = cv2.distanceTransform((~root).astype(np.uint8), cv2.DIST_L2, 5)
    inner = cv2.erode(silhouette.usable.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    beside = inner & (away > _BESIDE_PX) & (away < 4.0 * _WIDE * reduction)
    coverage = np.where(silhouette.usable, silhouette.coverage, 0.0).astype(np.float32)
    width, height = (size // reduction for size in coverage.shape[::-1])

    def reduced(image: Image) -> Image:
        return np.asarray(cv2.resize(image[: height * reduction, : width * reduction], (width, height), interpolation=cv2.INTER_AREA))

    wholly = reduced(beside.astype(np.float32)) > 1.0 - 1e-6
    wide = cv2.GaussianBlur(reduced(coverage), (0, 0), _WIDE)
    return wholly, wide[wholly], reduced(np.asarray(silhouette.opacity, np.float32))[wholly]
