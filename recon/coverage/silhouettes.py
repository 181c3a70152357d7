"""Silhouettes: the fraction of each pixel that a root covers, and the signed distance to the outline in pixels.

There are two methods. ``coverage`` measures the covered fraction of each pixel relative to the empty backlight, with an
outline that preserves the width of roots thinner than a pixel. ``thesis`` is the binary method of the thesis (T3.4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, erfinv
from skimage import filters

from rhizotwin.recon.coverage.level_distance import level_distance
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.settings import CoverageSettings

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

UPSAMPLING = 2
"""Samples of the distance map per pixel in each direction: half a pixel resolves outlines of roots down to about 0.6
px."""
UNSEEN_PX = 1e7
"""Value of a distance map at unusable pixels."""
_BLUR_PX = 0.7
"""Standard deviation of the blur before outlines are drawn; `outline_level` compensates for it at any width."""
_LEAST_SEEN = 1e-3
"""Minimum weight of usable pixels in the neighbourhood of a pixel."""
_SILENT_PX = 4
"""Upper bound of the reach of blur, interpolation and dilation."""
_CORE, _CORE_PX, _LEAST_CORE = 0.6, 5, 20
"""Opacity threshold, width of the square, and minimum number of pixels of resolved roots, whose own brightness is at
most 0.3 (`translucency`). The median inside is 0.98 of the backlight with any threshold from 0.5 to 0.8
(`printed_8ml`)."""
_NEAR_PX, _LEAST_NEAR = 13, 0.02
"""Width of the square in which resolved roots define the local brightness of roots, which changes with the
illumination, and minimum fraction of the square (three pixels)."""
_LEAST_NOISE = 1e-4
"""Minimum noise of opacity: ten times that of pictures without noise (1e-5, measured), and a fiftieth of a bench's."""
_FLOOR = 0.1
"""Minimum coverage of root."""
_LEAST_PARTIAL = 0.01
"""Minimum fraction of partly covered pixels among covered ones if coverage was measured: a root as wide as a picture of
1000 pixels has that many at its two edges, with or without 5 px of blur."""


@dataclass(frozen=True)
class Silhouette:
    """Silhouette of one view."""

    coverage: Image
    """(H, W), 0 to 1: fraction of the pixel covered by root."""
    usable: Mask
    """(H, W): mask of usable pixels."""
    opacity: NDArray[np.float16] | None = None
    """(H, W), 0 to 1: light absorbed by roots, relative to an opaque root; None if the picture is a mask."""

    @property
    def binary(self) -> bool:
        """Return whether pixels are either root or background, so that the outline is only known to the pixel."""
        covered = self.coverage[self.usable & (self.coverage > 0.0)]
        return float(np.mean(covered < 1.0)) < _LEAST_PARTIAL if covered.size else False

    def cut(self, window: Window) -> Silhouette:
        """Return the part within a window."""
        (left, top), (width, height) = window.low_px, window.size_px
        part = np.s_[top : top + height, left : left + width]
        return Silhouette(self.coverage[part], self.usable[part], None if self.opacity is None else self.opacity[part])


@dataclass(frozen=True)
class Window:
    """Rectangle of pixels, the same in all pictures."""

    low_px: tuple[int, int]
    """First column and row."""
    size_px: tuple[int, int]
    """Number of columns and rows."""

    @staticmethod
    def around(silhouettes: Sequence[Silhouette]) -> Window:
        """Return the window that contains the usable pixels of all pictures.

        It includes a margin of unusable pixels, unless limited by the border of the picture.
        """
        usable = np.logical_or.reduce([silhouette.usable for silhouette in silhouettes])
        low, size = [], []
        for axis in (0, 1):  # columns, then rows
            some = np.flatnonzero(usable.any(axis=axis))
            first, last = (some[0], some[-1]) if len(some) else (0, 0)
            low.append(max(0, int(first) - _SILENT_PX))
            size.append(min(usable.shape[1 - axis], int(last) + 1 + _SILENT_PX) - low[-1])
        return Window((low[0], low[1]), (size[0], size[1]))


def opacity(image: Image, background: Image, usable: Mask) -> Image:
    """Return the opacity (H, W): 0 at the empty backlight, 1 without light; 0 for unusable pixels.

    Parameters
    ----------
    image, background : (H, W) float32 array
        Linear grey in the same units.
    usable : (H, W) bool array
        Pixels with a usable background.
    """
    return np.where(usable, 1.0 - image / np.where(usable, background, 1.0), 0.0).astype(np.float32)


def measure(opacity: Image, usable: Mask, settings: CoverageSettings = CoverageSettings(), *, own: float = 0.0) -> Silhouette:
    """Measure the coverage by opaque roots: 0 at the empty backlight, 1 at the brightness of resolved root.

    Parameters
    ----------
    opacity : (H, W) float32 array
        As returned by `opacity`.
    usable : (H, W) bool array
        Pixels with a usable background.
    settings : CoverageSettings
        Thresholds for noise.
    own : float
        Brightness of a root relative to the backlight, used if no root is wide enough to measure it.
    """
    # Front light makes roots brighter than black: the opacity inside resolved roots is full coverage there and nearby.
    core = cv2.erode((opacity > _CORE).astype(np.uint8), np.ones((_CORE_PX, _CORE_PX), np.uint8)).astype(bool) & usable
    full = np.float32(np.median(opacity[core])) if core.sum() >= _LEAST_CORE else np.float32(1.0 - own)
    weight = cv2.boxFilter(core.astype(np.float32), -1, (_NEAR_PX, _NEAR_PX))
    local = cv2.boxFilter(np.where(core, opacity, 0.0).astype(np.float32), -1, (_NEAR_PX, _NEAR_PX))
    reference = np.where(weight > _LEAST_NEAR, local / np.maximum(weight, 1e-6), full)
    return suppress_noise((opacity / reference).astype(np.float32), above_noise(opacity, usable, settings), usable)


def suppress_noise(coverage: Image, above: Mask, usable: Mask) -> Silhouette:
    """Return a silhouette of coverage (H, W), with values at the noise level set to zero."""
    return Silhouette(np.clip(np.where(above & usable, coverage, 0.0), 0.0, 1.0).astype(np.float32), usable)


def above_noise(opacity: Image, usable: Mask, settings: CoverageSettings = CoverageSettings()) -> Mask:
    """Return the pixels (H, W) whose surroundings (Gaussian of a pixel) are darker than the noise level.

    The noise is that of the empty backlight: the median absolute deviation of the smoothed opacity, most of which is
    background.
    """
    smooth = cv2.GaussianBlur(opacity, (0, 0), 1.0)
    if not usable.any():
        return usable
    values = smooth[usable][::7]
    middle = np.median(values)
    noise = MAD * np.median(np.abs(values - middle))
    return np.asarray(smooth > middle + settings.noise_sigmas * noise + _LEAST_NOISE)


def thesis(image: Image, usable: Mask) -> Silhouette:
    """Return the silhouette (H, W) of T3.4.2: Otsu threshold, hysteresis on Sobel edges, and opening."""
    if not usable.any():
        return Silhouette(np.zeros(image.shape, np.float32), usable)
    dark = image < filters.threshold_otsu(image[usable])
    edges = filters.sobel(np.where(usable, image, np.median(image[usable])))
    high = filters.threshold_otsu(edges[usable])
    lines = filters.apply_hysteresis_threshold(edges, 0.5 * high, high)
    joined = ((dark | lines) & usable).astype(np.uint8)
    opened = cv2.morphologyEx(joined, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return Silhouette(opened.astype(np.float32), usable)


def outline_level(peak: NDArray[np.floating]) -> Image:
    """Return the level of blurred coverage at the edge of a band of any width, from the peak across it.

    A band of half-width a, blurred by a Gaussian of width s, has the peak ``m = erf(a / (sqrt(2) s))`` and the value
    ``erf(2 a / (sqrt(2) s)) / 2`` at its edge: ``t(m) = erf(2 erfinv(m)) / 2``, which is one half for a wide band.
    """
    m = np.clip(peak, 0.0, 1.0 - 1e-6)
    return (0.5 * erf(2.0 * erfinv(m))).astype(np.float32)


_LEVELS = outline_level(np.linspace(0.0, 1.0, 1025))
"""Table of `outline_level`."""


def blur_coverage(silhouette: Silhouette, sigma_px: float) -> Image:
    """Return the coverage (H, W) blurred by a Gaussian over usable pixels only.

    This is normalised convolution (Knutsson and Westin 1993). If unusable pixels counted as empty, a speck in front of
    a thick root would have an outline.
    """
    weight = cv2.GaussianBlur(silhouette.usable.astype(np.float32), (0, 0), sigma_px)
    covered = cv2.GaussianBlur(np.where(silhouette.usable, silhouette.coverage, np.float32(0.0)), (0, 0), sigma_px)
    return np.asarray(covered / np.maximum(weight, _LEAST_SEEN))


def signed_distance(silhouette: Silhouette) -> Image:
    """Return the signed distance to the outline in pixels, positive inside, (2 H, 2 W) on the half-pixel grid.

    At unusable pixels, and within a pixel of them, the value is `UNSEEN_PX`; elsewhere they count as inside. Sample (i,
    j) lies at the pixel position ((j + 0.5) / 2 - 0.5, (i + 0.5) / 2 - 0.5).
    """
    size = (silhouette.coverage.shape[1] * UPSAMPLING, silhouette.coverage.shape[0] * UPSAMPLING)
    fine = cv2.resize(blur_coverage(silhouette, _BLUR_PX), size, interpolation=cv2.INTER_CUBIC)
    peak = cv2.dilate(fine, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
    level = np.maximum(_LEVELS[np.clip(peak * 1024.0, 0, 1024).astype(np.int32)], _FLOOR * 0.5)
    level[peak < _FLOOR] = 1.0
    value = fine - level
    unseen = cv2.resize(silhouette.usable.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    value[unseen] = 1.0
    distance = level_distance(value)
    distance /= np.float32(UPSAMPLING)
    distance[cv2.dilate(unseen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = UNSEEN_PX
    return distance
