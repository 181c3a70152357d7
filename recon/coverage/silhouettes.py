"""Silhouettes: the fraction of each pixel that roots cover, and the signed distance to the outline in pixels.

The covered fraction of each pixel is computed relative to the empty backlight (`opaque_coverage`), so that the outline
preserves the width of roots thinner than a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, erfinv
from skimage.segmentation import clear_border

from rhizotwin.recon.lattice.distances import level_distance
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.settings import CoverageSettings

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

UPSAMPLING = 2
"""Number of samples of a distance map per pixel, in each direction. A spacing of half a pixel resolves outlines of
roots down to a width of about 0.6 px."""
UNSEEN_PX = 1e7
"""Value of a distance map at pixels that are not usable, px."""
_BLUR_PX = 0.7
"""Standard deviation of the Gaussian blur that is applied before outlines are drawn, px. `outline_level` compensates
for this blur, independently of the root's width."""
_LEAST_SEEN = 1e-3
"""Lower limit of the weight by which blurred coverage is divided. The weight is the blurred mask of usable pixels,
which is zero where no usable pixel is near."""
TRACE = 0.07
"""Blurred coverage above which a pixel may show a root. With a blur of 0.6 px, a root with a width of a third of a
pixel reaches this value."""
_SILENT_PX = 4
"""Distance beyond which a pixel no longer affects other pixels through blur, interpolation or dilation, px. The value
is an upper bound."""
_ROOM_PX = 8
"""Distance from covered pixels within which pictures are evaluated, px. It includes blur and interpolation
(`_SILENT_PX`), and the background beside a root."""
CORE, _CORE_PX, _LEAST_CORE = 0.6, 5, 20
"""Three parameters of the detection of resolved roots, in this order: the minimum opacity, the side of the square in
which all pixels must have this opacity, px, and the minimum number of such squares in a picture. The brightness of
roots is at most 0.3 (`translucency`). With any opacity threshold from 0.5 to 0.8, the median opacity inside resolved
roots is 0.98 (`printed_8ml`)."""
_NEAR_PX, _LEAST_NEAR = 13, 0.02
"""Two parameters of the local brightness of roots, which varies with the illumination. The first is the side of the
square over which the brightness of resolved roots is averaged, px. The second is the minimum fraction of this square
that resolved roots must cover (three pixels)."""
_LEAST_NOISE = 1e-4
"""Constant by which the noise threshold of the opacity is raised. The value is ten times the noise measured in pictures
that were simulated without noise (1e-5), and a fiftieth of the noise on a bench."""
_FLOOR = 0.1
"""Minimum coverage of pixels that show a root."""
_LEAST_PARTIAL = 0.01
"""Fraction of partly covered pixels, among all covered pixels, below which a silhouette is considered binary. Even a
root as wide as a picture of 1000 pixels has this fraction at its two edges, with or without a blur of 5 px."""


@dataclass(frozen=True)
class Silhouette:
    """Silhouette of the roots in one view."""

    coverage: Image
    """(H, W) fraction of each pixel that roots cover, 0 to 1."""
    usable: Mask
    """(H, W) mask of usable pixels."""
    opacity: NDArray[np.float16] | None = None
    """(H, W) light absorbed by roots, relative to an opaque root, 0 to 1; None if the picture is a mask."""

    @property
    def binary(self) -> bool:
        """Return whether all pixels are either root or background.

        The outline of such a silhouette is only accurate to one pixel.
        """
        covered = self.coverage[self.usable & (self.coverage > 0.0)]
        return float(np.mean(covered < 1.0)) < _LEAST_PARTIAL if covered.size else False

    def cut(self, window: Window) -> Silhouette:
        """Crop the silhouette to a window."""
        return self._change(lambda part: part[window.part])

    def paste(self, window: Window, image_wh: tuple[int, int]) -> Silhouette:
        """Return the silhouette in a picture of which it is a window. The pixels outside the window are not usable."""

        def enlarge(part: NDArray[Any]) -> NDArray[Any]:
            whole = np.zeros(image_wh[::-1], part.dtype)
            whole[window.part] = part
            return whole

        return self._change(enlarge)

    def _change(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Silhouette:
        return Silhouette(change(self.coverage), change(self.usable), None if self.opacity is None else change(self.opacity))


@dataclass(frozen=True)
class Window:
    """Rectangle of pixels that is the same in all pictures, and that contains all roots."""

    low_px: tuple[int, int]
    """First column and first row of the window."""
    size_px: tuple[int, int]
    """Number of columns and rows of the window."""
    empty_px: tuple[tuple[int, int], tuple[int, int]] = ((0, 0), (0, 0))
    """Numbers of columns and rows before the window, and after it, in which all views show the empty background. The
    pixels outside of these are not usable."""

    @staticmethod
    def around(silhouettes: Sequence[Silhouette]) -> Window:
        """Return the smallest window that contains all pixels that may show a root, with a border.

        These are the pixels with more coverage than `TRACE`, and unusable pixels that are enclosed by usable pixels.
        The border is `_ROOM_PX` wide. Where it would extend beyond the usable pixels of all views, it consists of
        `_SILENT_PX` unusable pixels, or ends at the edge of the picture.
        """
        usable = reduce(np.logical_or, [silhouette.usable for silhouette in silhouettes])
        seen = find_bounds(usable)
        inner = np.s_[seen[0][1] : seen[1][1], seen[0][0] : seen[1][0]]
        roots = reduce(np.logical_or, [_possible_roots(silhouette.coverage[inner], silhouette.usable[inner]) for silhouette in silhouettes])
        low, high = find_bounds(roots if roots.any() else ~roots)
        low, high, picture = seen[0] + low - _ROOM_PX, seen[0] + high + _ROOM_PX, np.array(usable.shape[::-1])
        low = np.where(low <= seen[0], np.maximum(seen[0] - _SILENT_PX, 0), low)
        high = np.where(high >= seen[1], np.minimum(seen[1] + _SILENT_PX, picture), high)
        (left, top), (right, bottom) = np.maximum([low - seen[0], seen[1] - high], 0).tolist()
        return replace(Window.between(low, high), empty_px=((left, top), (right, bottom)))

    @staticmethod
    def between(low: NDArray[np.int64], high: NDArray[np.int64]) -> Window:
        """Return the window from the first column and row to those after the last one, both of shape (2,)."""
        (left, top), (width, height) = low.tolist(), (high - low).tolist()
        return Window((left, top), (width, height))

    @property
    def part(self) -> tuple[slice, slice]:
        """Return the slices of rows and columns that select the window from a picture."""
        (left, top), (width, height) = self.low_px, self.size_px
        return np.s_[top : top + height, left : left + width]

    def at_origin(self) -> Window:
        """Return the window in the coordinates of pictures that are cropped to it."""
        return replace(self, low_px=(0, 0))


def find_bounds(mask: Mask) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first column and row that contain a pixel of a mask, and those after the last one, both of shape (2,).

    They are 0 if the mask is empty.
    """
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return np.array([left, top], np.int64), np.array([left + width, top + height], np.int64)


def _possible_roots(coverage: Image, usable: Mask) -> Mask:
    """Return the mask (H, W) of covered pixels, and of unusable pixels enclosed by usable pixels."""
    return np.asarray((coverage > TRACE) & usable | clear_border(~usable))


def opacity(image: Image, background: Image, usable: Mask) -> Image:
    """Return the opacity (H, W): 0 for the empty backlight, and 1 for a black pixel.

    The opacity of pixels that are not usable is 0.

    Parameters
    ----------
    image, background : (H, W) float32 array
        Picture and empty backlight, linear in light, in the same units.
    usable : (H, W) bool array
        Mask of pixels whose background is usable.
    """
    return np.where(usable, 1.0 - image / np.where(usable, background, 1.0), 0.0).astype(np.float32)


def opaque_coverage(opacity: Image, usable: Mask, own: float = 0.0) -> Image:
    """Return the coverage (H, W) by opaque roots: 0 for the empty backlight, 1 for the brightness of resolved roots.

    Parameters
    ----------
    opacity : (H, W) float32 array
        Opacity, as returned by the function `opacity`.
    usable : (H, W) bool array
        Mask of pixels whose background is usable.
    own : float
        Brightness of roots relative to the backlight, used if no root is wide enough for its brightness to be measured.
    """
    # Front light makes roots brighter than black, so the opacity inside resolved roots is that of full coverage nearby.
    core = cv2.erode((opacity > CORE).astype(np.uint8), np.ones((_CORE_PX, _CORE_PX), np.uint8)).astype(bool) & usable
    full = np.float32(np.median(opacity[core])) if core.sum() >= _LEAST_CORE else np.float32(1.0 - own)
    weight = cv2.boxFilter(core.astype(np.float32), -1, (_NEAR_PX, _NEAR_PX))
    local = cv2.boxFilter(np.where(core, opacity, 0.0).astype(np.float32), -1, (_NEAR_PX, _NEAR_PX))
    reference = np.where(weight > _LEAST_NEAR, local / np.maximum(weight, 1e-6), full)
    return (opacity / reference).astype(np.float32)


def suppress_noise(coverage: Image, opacity: Image, usable: Mask, settings: CoverageSettings = CoverageSettings()) -> Silhouette:
    """Create a silhouette from coverage, set to zero where the opacity does not exceed the noise of the backlight.

    The opacity is first smoothed by a Gaussian with a standard deviation of one pixel. The noise is estimated by the
    median absolute deviation of the smoothed opacity, because most pixels show the background.

    Parameters
    ----------
    coverage, opacity : (H, W) float32 array
        Coverage, and the opacity from which it was computed.
    usable : (H, W) bool array
        Mask of usable pixels.
    settings : CoverageSettings
        Thresholds for noise.
    """
    smooth = cv2.GaussianBlur(opacity, (0, 0), 1.0)
    values = smooth[usable][::7] if usable.any() else np.zeros(1)
    middle = np.median(values)
    noise = MAD * np.median(np.abs(values - middle))
    above = usable & (smooth > middle + settings.noise_sigmas * noise + _LEAST_NOISE)
    return Silhouette(np.clip(np.where(above, coverage, 0.0), 0.0, 1.0).astype(np.float32), usable)


def outline_level(peak: NDArray[np.floating]) -> Image:
    """Return the level of blurred coverage at which the outline of a root lies, from the peak across the root.

    Blurred by a Gaussian with the standard deviation s, a band of half-width a has the peak ``m = erf(a / (sqrt(2)
    s))``, and the value ``erf(2 a / (sqrt(2) s)) / 2`` at its edge. For any width, the level is therefore ``t(m) =
    erf(2 erfinv(m)) / 2``, which is one half for a wide band.
    """
    m = np.clip(peak, 0.0, 1.0 - 1e-6)
    return (0.5 * erf(2.0 * erfinv(m))).astype(np.float32)


_LEVELS = outline_level(np.linspace(0.0, 1.0, 1025))
"""Values of `outline_level` for 1025 peaks from 0 to 1."""


def blur_coverage(silhouette: Silhouette, sigma_px: float) -> Image:
    """Blur the coverage (H, W) by a Gaussian, using usable pixels only.

    This is a normalised convolution (Knutsson and Westin 1993). If pixels that are not usable were treated as empty, a
    speck in front of a thick root would have an outline.
    """
    weight = cv2.GaussianBlur(silhouette.usable.astype(np.float32), (0, 0), sigma_px)
    covered = cv2.GaussianBlur(np.where(silhouette.usable, silhouette.coverage, np.float32(0.0)), (0, 0), sigma_px)
    return np.asarray(covered / np.maximum(weight, _LEAST_SEEN))


def signed_distance(silhouette: Silhouette) -> Image:
    """Return the signed distance (2 H, 2 W) to the outline, px, which is positive inside.

    The samples have a spacing of half a pixel: sample (i, j) lies at the pixel position ((j + 0.5) / 2 - 0.5, (i + 0.5)
    / 2 - 0.5). At pixels that are not usable, and within one pixel of them, the value is `UNSEEN_PX`. For the distance
    at other pixels, pixels that are not usable count as inside.
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
