"""Attenuation of roots, estimated from the pictures, and coverage of translucent roots.

A root transmits the fraction ``exp(-mu c)`` of the light along a chord c. With front light, the root also has a
brightness b of its own, relative to the backlight. A round root of radius w therefore has the opacity

    alpha(x) = (1 - b) (1 - exp(-2 mu sqrt(w^2 - x^2)))        at the distance x from its axis.

In the profile across a resolved root, mu and w have different effects. The profile of an opaque root is a box. The
profile of a translucent root is round, and fainter for thinner roots. mu is therefore fitted to the profiles of
straight roots that do not overlap others. For roots thinner than a few pixels, the pictures determine only the opacity
integrated across the root, A = integral of alpha. The radius w then follows from A and mu, and the coverage is the
opacity times ``2 w / A``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from rhizotwin.recon.coverage.silhouettes import CORE, Image, Mask, opaque_coverage

Array = NDArray[np.float64]

CLEARLY = 1.2
"""Ratio of two residual variances above which roots are classified as translucent. It is the variance of the best fit
of opaque roots, divided by that of the best fit of translucent roots.

The ratio is 1.03 for an opaque plant of the twin, and 1.4 to 3.3 for translucent roots (2 per mm). Random deviations
are smaller with hundreds of samples."""
_REACH_PX, _STEP_PX = 14.0, 0.5
"""Two parameters of the sampled profiles, px. The first is half the length of a profile, which exceeds half the width
of the widest root plus its flanks. The second is the spacing of the samples."""
_OFFSETS = np.arange(-_REACH_PX, _REACH_PX + 1e-6, _STEP_PX)
"""Offsets of the profile samples from the axis of the root, px."""
_ALONG_PX = (-3.0, -1.5, 0.0, 1.5, 3.0)
"""Positions along a root at which profiles across the root are sampled, px. The profiles are averaged if they agree to
within `_SAME`."""
_SAME = 0.12
"""Maximum standard deviation of the opacity between the profiles of one root. The limit is above the noise, and below
the change of the opacity at a crossing root."""
_WIDTH_PX = (4.0, 11.0)
"""Minimum and maximum full width at half maximum of roots whose profiles are fitted, px. Narrower profiles consist
mostly of blur, and faint roots would be under-represented among them."""
_FLANK_PX = 1.7
"""Distance from the half-maximum of a profile at which a blur of 0.85 px has decayed, px. It is two standard deviations
of this blur."""
_EMPTY = 0.06
"""Maximum opacity beside a root that does not overlap others."""
_GOOD = (0.02, 0.04)
"""Two limits for the root mean square residual of a fitted profile. The second limit is used if too few profiles
satisfy the first, as in a dense cluster of opaque roots."""
_MOST = 3000
"""Approximate maximum number of profiles that are sampled per view."""
_A_BIN, _LEAST = 120, 30
"""Two limits for the number of profiles. The first is the maximum number of profiles in each interval of widths, which
is one pixel long. The second is the minimum total number for an estimate. The median of 30 profiles has an uncertainty
of a quarter of their standard deviation."""
FAINTEST_LEARNED = 0.5
"""Lowest attenuation that is tried, 1/mm. An estimate equal to this value is an upper bound and not a measurement."""
_MU_PER_MM = np.concatenate([np.geomspace(FAINTEST_LEARNED, 8.0, 25), [16.0, 1e3]])
"""Attenuations that are tried, 1/mm. They increase in steps of 12 %, and are followed by a nearly opaque and an opaque
value."""
_BLUR_PX = (0.3, 0.45, 0.6, 0.75, 1.0)
"""Standard deviations of the blur that are tried, px. They range from that of the square pixel to that of a defocused
camera."""
_DARK, _STRAIGHT = 0.3, 0.8
"""Two limits for the positions at which profiles are sampled: the minimum blurred opacity, and the minimum coherence of
the structure tensor. Positions that satisfy both limits lie on the axes of roots, away from crossings."""
_DARKEST_CORES, _MOST_OWN = 0.005, 0.3
"""Two parameters of the brightness of the roots themselves. The brightness is estimated as a quantile of the brightness
inside wide roots, whose level is the first value. The second value is the upper limit of the estimate. The minimum,
instead of a quantile, would be affected by noise."""
_RADII_PX = np.geomspace(1.0, 7.5, 80)
"""Radii of the roots in the model profiles, px, in steps of 2.6 %. The range is half of `_WIDTH_PX`, extended to allow
for the effects of blur and translucency."""
_MOST_GAIN = 20.0
"""Maximum gain, which is the ratio of coverage to opacity. A root that absorbs a twentieth of the light has this
gain."""
_OWN = (0.0, 0.5, 1.0)
"""Candidates for the brightness of the roots themselves, as fractions of the brightness inside the darkest wide
roots."""
_LONGEST_PX = 60.0
"""Minimum extent of connected objects that are treated as roots, px."""
_FINE = 16
"""Number of samples per pixel of the model profiles."""
_PEAK_BLUR_PX = 1.0
"""Standard deviation of the Gaussian blur that is applied before the peak of the opacity near each pixel is determined,
px. The blur suppresses the noise of single pixels."""
_SIGMA_PX = 0.5
"""Standard deviation of the pictures' blur that is assumed when gains are tabulated, px. It includes the blur by the
square pixel."""
_THINNEST_MM = 0.08
"""Minimum radius for which the ratio of coverage to opacity is tabulated, mm. Thinner structures are noise."""


@dataclass(frozen=True)
class Hairs:
    """Root hairs, modelled as a grey sleeve around every root."""

    length_mm: float
    """Length of the hairs, which is the thickness of the sleeve, mm."""
    mu_per_mm: float
    """Attenuation of the sleeve, 1/mm."""


@dataclass(frozen=True)
class Attenuation:
    """Optical properties of roots in front of the backlight, which determine the coverage from the opacity."""

    own: float = 0.0
    """Brightness of the roots themselves due to front light, relative to the backlight."""
    mu_per_mm: float = np.inf
    """Attenuation of the roots, 1/mm. It is infinite for opaque roots."""

    def coverage(self, opacity: Image, usable: Mask, px_a_mm: float) -> Image:
        """Convert the opacity of a picture to the coverage by roots, both (H, W).

        The opacity of translucent roots is multiplied by the gain of a straight round root. This root is chosen such
        that the peak of its blurred opacity equals the peak of the picture's blurred opacity near the pixel. The gain
        is chosen such that the coverage of this root, which is at most 1, sums to its diameter.
        """
        if self.mu_per_mm == np.inf:
            return opaque_coverage(opacity, usable, self.own)
        peaks, gains = _tabulate_gains(self.mu_per_mm, px_a_mm)
        clear = np.clip(opacity / np.float32(1.0 - self.own), 0.0, 1.0).astype(np.float32)
        peak = cv2.dilate(cv2.GaussianBlur(clear, (0, 0), _PEAK_BLUR_PX), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
        return np.minimum(clear * np.interp(peak, peaks, gains), 1.0).astype(np.float32)


def learn(opacities: list[Image], usable: list[Mask], px_a_mm: float) -> Attenuation:
    """Estimate the attenuation and brightness of roots from the opacity of some views.

    Parameters
    ----------
    opacities : list of (H, W) float32 array
        1 - picture / backlight of each view.
    usable : list of (H, W) bool array
        Masks of usable pixels of each view.
    px_a_mm : float
        Scale of the pictures at the canister's axis, px/mm.
    """
    own, found = [np.zeros(0)], []
    for opacity, here in zip(opacities, usable, strict=True):
        large = _large_objects(opacity, here)
        core = cv2.erode(((opacity > CORE) & large & here).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        own.append(1.0 - opacity[core])
        found.append(_sample_profiles(np.where(large, opacity, 0.0).astype(np.float32), here))
    cores = np.concatenate(own)
    bright = float(np.clip(np.quantile(cores, _DARKEST_CORES), 0.0, _MOST_OWN)) if len(cores) else 0.0
    profiles, width = (np.concatenate(part) for part in zip(*found, strict=True))
    chosen = _balance_widths(width)
    return _fit(profiles[chosen], width[chosen], px_a_mm, bright)


def _large_objects(opacity: Image, usable: Mask) -> Mask:
    """Return the mask (H, W) of large connected objects and of the pixels beside them."""
    dark = ((cv2.GaussianBlur(opacity, (0, 0), 1.0) > _EMPTY) & usable).astype(np.uint8)
    _, label, stats, _ = cv2.connectedComponentsWithStats(dark, connectivity=8)
    large = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) > _LONGEST_PX
    large[0] = False
    return np.asarray(cv2.dilate(large[label].astype(np.uint8), np.ones((7, 7), np.uint8)) > 0)


def _sample_profiles(opacity: Image, usable: Mask) -> tuple[Array, Array]:
    """Sample profiles of the opacity across straight roots that do not overlap others.

    Return the profiles (N, `_OFFSETS`), centred on the roots, and their full widths at half maximum (N,), px.
    """
    smooth = cv2.GaussianBlur(opacity, (0, 0), 1.0)
    g_x, g_y = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    xx, yy, xy = (cv2.GaussianBlur(a, (0, 0), 3.0) for a in (g_x * g_x, g_y * g_y, g_x * g_y))
    straight = np.hypot(xx - yy, 2.0 * xy) > _STRAIGHT * (xx + yy)
    rows, columns = (at[:: 1 + len(at) // _MOST] for at in np.nonzero((smooth > _DARK) & usable & straight))
    if not len(rows):
        return np.zeros((0, len(_OFFSETS))), np.zeros(0)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)[rows, columns].astype(np.float64)
    n_x, n_y = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, v = columns[:, None] + n_x * _OFFSETS, rows[:, None] + n_y * _OFFSETS
    sections = np.array([map_coordinates(opacity, [v + s * n_x, u - s * n_y], order=1) for s in _ALONG_PX])
    profile = sections.mean(axis=0)
    middle = len(_OFFSETS) // 2
    half = 0.5 * profile[:, middle - 1 : middle + 2].mean(axis=1)
    right, left = _find_fall(profile[:, middle:], half), _find_fall(profile[:, middle::-1], half)
    width, shift = right + left, 0.5 * (right - left)
    near = np.abs(_OFFSETS) <= 0.5 * width[:, None] + _FLANK_PX
    same = np.where(near, sections.std(axis=0), 0.0).max(axis=1) < _SAME
    use = (np.abs(shift) < 0.5) & (width > _WIDTH_PX[0]) & (width < _WIDTH_PX[1]) & same
    moved = [np.interp(_OFFSETS + s, _OFFSETS, p) for s, p in zip(shift[use], profile[use], strict=True)]
    centred = np.reshape(moved, (-1, len(_OFFSETS)))
    beside = np.abs(np.abs(_OFFSETS) - (0.5 * width[use] + _FLANK_PX)[:, None] - _STEP_PX) <= _STEP_PX
    lone = np.where(beside, centred, 0.0).max(axis=1, initial=0.0) < _EMPTY
    return centred[lone], width[use][lone]


def _find_fall(profile: Array, level: Array) -> Array:
    """Return the distance (N,) from the start of each profile to the point where it falls below a level, px.

    The profiles have the shape (N, M), and the levels have the shape (N,). The distance is 0 if a profile does not fall
    below its level.
    """
    below = profile < level[:, None]
    first = np.maximum(np.argmax(below, axis=1), 1)
    row = np.arange(len(profile))
    above, under = profile[row, first - 1], profile[row, first]
    share = (above - level) / np.maximum(above - under, 1e-6)
    return np.where(below.any(axis=1) & ~below[:, 0], (first - 1 + share) * _STEP_PX, 0.0)


def _balance_widths(width: Array) -> NDArray[np.int64]:
    """Return the indices of a selection of profiles in which all widths have similar weight."""
    rng = np.random.default_rng(0)
    order = rng.permutation(len(width))
    bins = np.floor(width[order])
    return np.concatenate([order[:0]] + [order[bins == one][:_A_BIN] for one in np.unique(bins)])


def _model_profiles(radius_px: Array, mu_a_px: float, blur_px: float) -> tuple[Array, Array]:
    """Return sample offsets (M,), and the blurred opacity (N, M) across round roots of the given radii.

    The brightness of the roots themselves is not included.
    """
    x = np.arange(-_REACH_PX * _FINE, _REACH_PX * _FINE + 1) / _FINE
    opacity = 1.0 - np.exp(-2.0 * mu_a_px * np.sqrt(np.maximum(radius_px[:, None] ** 2 - x**2, 0.0)))
    return x, cv2.GaussianBlur(opacity, (0, 0), sigmaX=blur_px * _FINE, sigmaY=1e-3, borderType=cv2.BORDER_CONSTANT)


def _fit(profiles: Array, width: Array, px_a_mm: float, bright: float) -> Attenuation:
    """Estimate the attenuation that best explains the profiles.

    The roots are classified as opaque if there are too few profiles.
    """
    opaque = Attenuation(bright)
    if len(profiles) < _LEAST:
        return opaque
    window = (np.abs(_OFFSETS) <= 0.5 * width[:, None] + _FLANK_PX).astype(np.float64)
    own = bright * np.array(_OWN)
    cost = np.zeros((len(_MU_PER_MM), len(own), len(_BLUR_PX), len(profiles)))
    own_2, count = (profiles**2 * window).sum(axis=1)[:, None], window.sum(axis=1)[:, None]
    for i, mu in enumerate(_MU_PER_MM):
        for j, blur_px in enumerate(_BLUR_PX):
            band = _model_profiles(_RADII_PX, mu / px_a_mm, blur_px)[1][:, :: int(_FINE * _STEP_PX)]
            cross, band_2 = (profiles * window) @ band.T, window @ (band**2).T
            for k, full in enumerate(1.0 - own):
                cost[i, k, j] = ((own_2 - 2.0 * full * cross + full**2 * band_2) / count).min(axis=1)
    left, bins = cost.min(axis=(0, 1, 2)), np.floor(width)
    good = left < next((limit**2 for limit in _GOOD if (left < limit**2).sum() >= _LEAST), 0.0)
    used = [one for one in np.unique(bins[good]) if (good & (bins == one)).sum() >= _LEAST // 3]
    if not used:
        return opaque
    typical = np.mean([np.median(cost[..., good & (bins == one)], axis=-1) for one in used], axis=0).min(axis=2)
    i, k = divmod(int(np.argmin(typical)), len(own))
    mu = _parabola_minimum(_MU_PER_MM, typical.min(axis=1), i)
    is_translucent = typical[-1].min() > CLEARLY * typical.min()
    return Attenuation(float(own[k]), mu) if is_translucent else opaque


def _parabola_minimum(at: Array, cost: Array, best: int) -> float:
    """Return the value of ``at`` at which the cost (N,) is smallest.

    The value is interpolated by a parabola in log ``at`` through the smallest cost and its two neighbours.
    """
    if best in (0, len(at) - 1):
        return float(at[best])
    a, b, _ = np.polyfit(np.log(at[best - 1 : best + 2]) - np.log(at[best]), cost[best - 1 : best + 2], 2)
    return float(at[best] * np.exp(-b / (2.0 * a))) if a > 0.0 else float(at[best])


def _tabulate_gains(mu_per_mm: float, px_a_mm: float) -> tuple[Array, Array]:
    """Tabulate the gains (N,) of round roots as a function of the peaks (N,) of their blurred opacity.

    Multiplied by the gain and limited to 1, the opacity across a root sums to its diameter.
    """
    radii = np.geomspace(_THINNEST_MM, 3.0, 100) * px_a_mm
    radii = radii[radii < _REACH_PX - 3.0]
    x, sharp = _model_profiles(radii, mu_per_mm / px_a_mm, _SIGMA_PX)
    _, smooth = _model_profiles(radii, mu_per_mm / px_a_mm, float(np.hypot(_SIGMA_PX, _PEAK_BLUR_PX)))
    low, high = np.ones(len(radii)), np.full(len(radii), _MOST_GAIN)
    for _ in range(40):  # bisection
        gain = 0.5 * (low + high)
        small = np.minimum(sharp * gain[:, None], 1.0).sum(axis=1) * (x[1] - x[0]) < 2.0 * radii
        low, high = np.where(small, gain, low), np.where(small, high, gain)
    return smooth.max(axis=1), 0.5 * (low + high)
