"""Silhouettes: how much of each pixel a root covers, and the signed distance to the outline in pixels.

Two ways: ``coverage`` measures the covered fraction of each pixel against the empty backlight, and outlines it so that
roots thinner than a pixel keep their width; ``thesis`` is the binary way of the thesis (T3.4.2).
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
"""Samples of the distance map a pixel, each way: half a pixel resolves outlines of roots down to about 0.6 px."""
UNSEEN_PX = 1e7
"""Value of a distance map where its picture says nothing."""
_BLUR_PX = 0.7
"""Standard deviation of the blur before outlines are drawn; `outline_level` allows for it, however wide a band is."""
_LEAST_SEEN = 1e-3
"""Weight of what is seen about a pixel, below which nothing is."""
_SILENT_PX = 4
"""Blur, interpolation and widening reach less far than this."""
_CORE, _CORE_PX, _LEAST_CORE = 0.6, 5, 20
"""Root is resolved where opacity is above this over a square of this many pixels: a root of that width, whose own light
is at most 0.3 (`translucency`). The median inside is 0.98 of the backlight with any threshold from 0.5 to 0.8
(`printed_8ml`). Fewer such pixels than this tell no median."""
_NEAR_PX, _LEAST_NEAR = 13, 0.02
"""Resolved root within a square of this many pixels tells the brightness of a root there: the light on it changes along
it. Three pixels of the square (this share) or fewer tell none."""
_LEAST_NOISE = 1e-4
"""Opacity that noise has at least: ten times what pictures without noise have (1e-5, measured), and a fiftieth of a
bench's."""
_FLOOR = 0.1
"""Coverage below this is never root."""
_LEAST_PARTIAL = 0.01
"""Share of the covered pixels that are covered in part where coverage was measured, at least: a root as wide as a
picture of 1000 pixels has that many on its two edges, with 5 px of blur or none."""


@dataclass(frozen=True)
class Silhouette:
    """One view's silhouette."""

    coverage: Image
    """(H, W), 0 to 1: fraction of the pixel covered by root."""
    seen: Mask
    """(H, W): the picture says something about the water here."""
    opacity: NDArray[np.float16] | None = None
    """(H, W), 0 to 1: light that roots absorb, over what an opaque root would; None where the picture is a silhouette
    already."""

    @property
    def binary(self) -> bool:
        """Tell whether pixels are root or none: an outline that is known to the pixel only."""
        covered = self.coverage[self.seen & (self.coverage > 0.0)]
        return float(np.mean(covered < 1.0)) < _LEAST_PARTIAL if covered.size else False

    def cut(self, window: Window) -> Silhouette:
        """Return the part in a window."""
        (left, top), (width, height) = window.low_px, window.size_px
        part = np.s_[top : top + height, left : left + width]
        return Silhouette(self.coverage[part], self.seen[part], None if self.opacity is None else self.opacity[part])


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels, the same in all pictures."""

    low_px: tuple[int, int]
    """First column and row."""
    size_px: tuple[int, int]
    """Columns and rows."""

    @staticmethod
    def around(silhouettes: Sequence[Silhouette]) -> Window:
        """Return the window that holds what any of the pictures tells.

        With a margin of silence or the picture's border about it.
        """
        told = np.logical_or.reduce([silhouette.seen for silhouette in silhouettes])
        low, size = [], []
        for axis in (0, 1):  # columns, then rows
            some = np.flatnonzero(told.any(axis=axis))
            first, last = (some[0], some[-1]) if len(some) else (0, 0)
            low.append(max(0, int(first) - _SILENT_PX))
            size.append(min(told.shape[1 - axis], int(last) + 1 + _SILENT_PX) - low[-1])
        return Window((low[0], low[1]), (size[0], size[1]))


def opacity(image: Image, background: Image, seen: Mask) -> Image:
    """Return the opacity (H, W): 0 at the empty backlight, 1 where no light comes; 0 where nothing is seen.

    Parameters
    ----------
    image, background : (H, W) float32 array
        Linear grey in one scale.
    seen : (H, W) bool array
        Pixels with a usable background.
    """
    return np.where(seen, 1.0 - image / np.where(seen, background, 1.0), 0.0).astype(np.float32)


def measure(opacity: Image, seen: Mask, settings: CoverageSettings = CoverageSettings(), *, own: float = 0.0) -> Silhouette:
    """Measure the coverage by opaque roots: 0 at the empty backlight, 1 at the brightness of resolved root.

    Parameters
    ----------
    opacity : (H, W) float32 array
        As `opacity` returns it.
    seen : (H, W) bool array
        Pixels with a usable background.
    settings : CoverageSettings
        What stands out from the noise.
    own : float
        Brightness of a root by itself over the backlight's, where the picture shows none wide enough to tell.
    """
    # Front light makes roots brighter than black: what resolved roots show inside is full coverage, there and nearby.
    core = cv2.erode((opacity > _CORE).astype(np.uint8), np.ones((_CORE_PX, _CORE_PX), np.uint8)).astype(bool) & seen
    full = np.float32(np.median(opacity[core])) if core.sum() >= _LEAST_CORE else np.float32(1.0 - own)
    weight = cv2.boxFilter(core.astype(np.float32), -1, (_NEAR_PX, _NEAR_PX))
    local = cv2.boxFilter(np.where(core, opacity, 0.0).astype(np.float32), -1, (_NEAR_PX, _NEAR_PX))
    reference = np.where(weight > _LEAST_NEAR, local / np.maximum(weight, 1e-6), full)
    return without_noise((opacity / reference).astype(np.float32), above_noise(opacity, seen, settings), seen)


def without_noise(coverage: Image, above: Mask, seen: Mask) -> Silhouette:
    """Return a silhouette of coverage (H, W) where it is above the noise."""
    return Silhouette(np.clip(np.where(above & seen, coverage, 0.0), 0.0, 1.0).astype(np.float32), seen)


def above_noise(opacity: Image, seen: Mask, settings: CoverageSettings = CoverageSettings()) -> Mask:
    """Tell the pixels (H, W) whose surroundings (Gaussian of a pixel) are darker than noise makes them.

    The noise is that of the empty backlight: the median absolute deviation of the smoothed opacity, most of which is
    empty.
    """
    smooth = cv2.GaussianBlur(opacity, (0, 0), 1.0)
    if not seen.any():
        return seen
    values = smooth[seen][::7]
    middle = np.median(values)
    noise = MAD * np.median(np.abs(values - middle))
    return np.asarray(smooth > middle + settings.noise_sigmas * noise + _LEAST_NOISE)


def thesis(image: Image, seen: Mask) -> Silhouette:
    """Return the silhouette (H, W) of T3.4.2: Otsu's threshold, joined with hysteresis on Sobel edges, then opened."""
    if not seen.any():
        return Silhouette(np.zeros(image.shape, np.float32), seen)
    dark = image < filters.threshold_otsu(image[seen])
    edges = filters.sobel(np.where(seen, image, np.median(image[seen])))
    high = filters.threshold_otsu(edges[seen])
    lines = filters.apply_hysteresis_threshold(edges, 0.5 * high, high)
    joined = ((dark | lines) & seen).astype(np.uint8)
    opened = cv2.morphologyEx(joined, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return Silhouette(opened.astype(np.float32), seen)


def outline_level(peak: NDArray[np.floating]) -> Image:
    """Return the level of blurred coverage that outlines a band of whatever width, from the peak across it.

    A band of half-width a, blurred by a Gaussian of width s, peaks at ``m = erf(a / (sqrt(2) s))`` and has the value
    ``erf(2 a / (sqrt(2) s)) / 2`` at its edge: ``t(m) = erf(2 erfinv(m)) / 2``, one half where the band is wide.
    """
    m = np.clip(peak, 0.0, 1.0 - 1e-6)
    return (0.5 * erf(2.0 * erfinv(m))).astype(np.float32)


_LEVELS = outline_level(np.linspace(0.0, 1.0, 1025))
"""`outline_level`, tabulated."""


def blurred(silhouette: Silhouette, sigma_px: float) -> Image:
    """Return the coverage (H, W) blurred by a Gaussian in which what is not seen takes no part.

    Normalised convolution (Knutsson and Westin 1993): counted as empty, a speck before a thick root would have an
    outline at its corners.
    """
    weight = cv2.GaussianBlur(silhouette.seen.astype(np.float32), (0, 0), sigma_px)
    covered = cv2.GaussianBlur(np.where(silhouette.seen, silhouette.coverage, np.float32(0.0)), (0, 0), sigma_px)
    return np.asarray(covered / np.maximum(weight, _LEAST_SEEN))


def signed_distance(silhouette: Silhouette) -> Image:
    """Return the signed distance to the outline in pixels, positive inside, (2 H, 2 W) on the half-pixel grid.

    Where the picture says nothing, and within a pixel of it, the value is `UNSEEN_PX`; elsewhere the unseen counts as
    inside. Sample (i, j) lies at the pixel position ((j + 0.5) / 2 - 0.5, (i + 0.5) / 2 - 0.5).
    """
    size = (silhouette.coverage.shape[1] * UPSAMPLING, silhouette.coverage.shape[0] * UPSAMPLING)
    fine = cv2.resize(blurred(silhouette, _BLUR_PX), size, interpolation=cv2.INTER_CUBIC)
    peak = cv2.dilate(fine, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
    level = np.maximum(_LEVELS[np.clip(peak * 1024.0, 0, 1024).astype(np.int32)], _FLOOR * 0.5)
    level[peak < _FLOOR] = 1.0
    value = fine - level
    unseen = cv2.resize(silhouette.seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    value[unseen] = 1.0
    distance = level_distance(value)
    distance /= np.float32(UPSAMPLING)
    distance[cv2.dilate(unseen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = UNSEEN_PX
    return distance
