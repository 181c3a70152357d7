"""Exposure of each picture, measured on the part of the backlight panel that is visible beside the canister.

Lines of sight beside the canister show the panel directly. A static camera shows the same part of the panel in every
view. The exposure of a picture is the ratio of these pixels to the same pixels in all pictures of the station, times
the brightness of the station relative to its ring.

Lamps at mains frequency under a rolling shutter, panels that fade on one side, and passing people change the brightness
of only parts of a picture. The ratio is therefore measured row by row, left and right of the canister.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rhizotwin.recon.calibration.marker_fit import FULL
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEP = 4
"""Spacing of the sampled pixels in both directions, px."""
_DARKEST = 1.0 / 255.0
"""Lower limit of the panel's brightness, relative to the other pictures of the ring. It is one level of 8 bits, and is
reached by pictures that are half black."""
_MARGIN_MM = 2.0
"""Distance from the canister and the net pot within which the panel is not sampled, mm."""
_LIT, _BRIGHT = 0.5, 0.9
"""Two parameters of the selection of panel pixels. The second value is the level of a quantile of the brightness beside
the canister. A pixel shows the panel if its brightness exceeds the first value times this quantile."""
_LEAST_PIXELS = 200
"""Minimum number of panel pixels from which an exposure is measured. Noise of a few per cent per pixel is then averaged
to a few per mille."""
_LEAST_PATCH = 20
"""Minimum number of pixels of a patch of the panel for its mean brightness to be used."""
_ROWS = 2.0
"""Standard deviation of the Gaussian that smooths the brightness of the panel over neighbouring rows, in sampled rows.
With 17 pixels beside the canister in each row, the remaining noise is a tenth of that of a pixel. In a picture of 300
rows, three brightness bands of a lamp keep 99 % of their amplitude."""
UNEVEN = 0.01
"""Brightness variation within a picture above which the picture is corrected. The variation is the standard deviation
of the panel's relative brightness. The value is a third of the optical depth of the faintest detected film
(`CoverageSettings.film_depth`)."""


@dataclass(frozen=True, kw_only=True)
class Exposures:
    """Exposures of the pictures of a scan."""

    gain: Array
    """(V,) exposure of each picture relative to the median picture of its ring; 1 if unknown."""
    measured: bool
    """Whether the exposures of all pictures could be measured on the panel beside the canister."""
    clipped: Array
    """(V,) fraction of the panel's pixels at full scale."""
    level: Array
    """(V,) median brightness of the panel, relative to full scale."""
    beside: tuple[Sides | None, ...] = ()
    """(V,) relative brightness of the panel on both sides of the canister. None if the brightness is uniform, or if one
    side is not visible."""
    uneven: Array = field(default_factory=lambda: np.zeros(0))
    """(V,) standard deviation of the panel's brightness beside the canister that remains after division by ``gain`` and
    ``beside``. The brightness is relative to the station's median picture."""

    def select(self, places: Sequence[int]) -> Exposures:
        """Return the exposures of the pictures with the given indices."""
        return replace(
            self,
            beside=tuple(self.beside[k] for k in places) if self.beside else (),
            **{name: part[places] for name in ("gain", "clipped", "level", "uneven") if len(part := getattr(self, name))},
        )

    @property
    def dark(self) -> NDArray[np.bool_]:
        """Return whether the panel of each picture (V,) is dark.

        The panel is dark in pictures that are half black or were taken without light.
        """
        return np.asarray(self.gain <= _DARKEST)

    @property
    def wander(self) -> float:
        """Return the standard deviation of ``gain`` over all pictures."""
        return float(np.std(self.gain))

    @property
    def bands(self) -> float:
        """Return the largest brightness variation that was corrected within a picture.

        The variation is the standard deviation of the panel's relative brightness. It is 0 if no picture was corrected.
        """
        return max((float(np.std(sides.share)) for sides in self.beside if sides is not None), default=0.0)

    def light(self, k: int, image_wh: tuple[int, int]) -> NDArray[np.float32] | np.float32:
        """Return the exposure of picture k, either one number, or an array (H, W) if it varies over the picture."""
        sides = self.beside[k] if self.beside else None
        gain, (width, height) = np.float32(self.gain[k]), image_wh
        return (
            gain
            if sides is None
            else gain * sides.at(np.arange(height, dtype=np.float64)[:, None], np.arange(width, dtype=np.float64)).astype(np.float32)
        )


@dataclass(frozen=True, kw_only=True)
class Sides:
    """Relative brightness of the panel to the left and right of the canister, row by row."""

    rows: Array
    """(R,) picture rows at which the brightness is given."""
    columns: tuple[float, float]
    """Mean column of the panel pixels to the left of the canister, and of those to the right."""
    share: Array
    """(2, R) brightness of the panel on the left and on the right, relative to the same pixels in the station's median
    picture, and divided by the picture's median over all pixels."""

    def at(self, row: Array, column: Array) -> Array:
        """Return the relative brightness (...) of pixels.

        In each row, the brightness is interpolated linearly between the left and the right side, and extrapolated
        beyond.
        """
        left, right = (np.interp(row, self.rows, side) for side in self.share)
        return np.asarray(left + (right - left) * ((column - self.columns[0]) / (self.columns[1] - self.columns[0])))


def measure(images: Sequence[Grey], views: Sequence[View], stations: Sequence[tuple[int, int]], optics: Optics, scene: Scene) -> Exposures:
    """Measure the exposure of each picture on the empty panel beside the canister.

    Parameters
    ----------
    images : sequence of (H, W) uint8 or uint16 array
        Pictures, linear in light.
    views : sequence of View
        Cameras of the pictures.
    stations : sequence of tuple of int
        Station of each picture, as ring and placement.
    """
    gain, clipped, level = np.ones(len(images)), np.zeros(len(images)), np.full(len(images), np.nan)
    measured, uneven = True, np.zeros(len(images))
    sides: list[Sides | None] = [None] * len(images)
    for station in sorted(set(stations)):
        own = [k for k, one in enumerate(stations) if one == station]
        beside = np.logical_and.reduce([_beside_mask(views[k], optics, scene) for k in own])
        light = np.stack([images[k][::_STEP, ::_STEP][beside] / np.float32(np.iinfo(images[k].dtype).max) for k in own])
        panel = np.zeros(light.shape[1], bool)
        if light.shape[1]:
            middle = np.median(light, axis=0)
            panel = middle > _LIT * np.quantile(middle, _BRIGHT)
        if panel.sum() < _LEAST_PIXELS:
            measured = False
            continue
        light = light[:, panel]
        full = light >= FULL
        clipped[own], level[own] = full.mean(axis=1), np.median(light, axis=1)
        usable = ~full.any(axis=0)
        if usable.sum() < _LEAST_PIXELS:
            measured = False
            continue
        light = light[:, usable]
        ratio = light / np.median(light, axis=0)
        gain[own] = np.median(ratio, axis=1)
        row, column = (_STEP * at[panel][usable].astype(np.float64) for at in np.nonzero(beside))
        for k, one in zip(own, ratio, strict=True):
            sides[k], uneven[k] = _measure_unevenness(one / np.maximum(gain[k], _DARKEST), row, column, images[k].shape[1])
    _relate_placements(gain, level, stations)
    gain = np.maximum(gain, _DARKEST)
    return Exposures(gain=gain, measured=measured, clipped=clipped, level=level, beside=tuple(sides), uneven=uneven)


def _relate_placements(gain: Array, level: Array, stations: Sequence[tuple[int, int]]) -> None:
    """Multiply the gains (V,) of each placement of the camera by its brightness relative to the whole ring, in place.

    The placements of a ring have a common empty backlight (`coverage.measure`), but each gain was measured relative to
    its own placement.
    """
    for ring, placement in set(stations):
        whole = np.array([one[0] == ring for one in stations])
        own = whole & np.array([one[1] == placement for one in stations])
        if np.isfinite(level[whole]).all():
            gain[own] *= np.median(level[own]) / np.median(level[whole])


def _measure_unevenness(ratio: Array, row: Array, column: Array, width: int) -> tuple[Sides | None, float]:
    """Return the relative brightness of the panel on both sides, and the unevenness that remains after correction.

    The unevenness is the standard deviation of the mean brightness of patches of the panel pixels (N,), without the
    contribution of noise. A patch is as high as the smoothing, and covers the inner or the outer half of one side.
    """
    left = column < 0.5 * width
    found = _measure_sides(ratio, row, column, left)
    if found is not None and np.std(found.share) < UNEVEN:
        found = None
    if found is not None:
        ratio = ratio / found.at(row, column)
    middle = np.where(left, np.median(column[left]) if left.any() else 0.0, np.median(column[~left]) if (~left).any() else 0.0)
    patch = np.floor(row / (4.0 * _ROWS * _STEP)) * 4.0 + 2.0 * left + (column > middle)
    patches, count = np.unique(patch, return_counts=True)
    means = ndimage.mean(ratio, patch, patches)
    noise = ndimage.variance(ratio, patch, patches) / np.maximum(count - 1, 1)
    whole = count >= _LEAST_PATCH
    more = np.var(means[whole]) - np.mean(noise[whole]) if whole.sum() > 1 else 0.0
    return found, float(np.sqrt(max(0.0, more)))


def _measure_sides(ratio: Array, row: Array, column: Array, left: Mask) -> Sides | None:
    """Return the brightness of the panel pixels (N,) in each row, to the left and to the right of the canister.

    The result is None if one side has fewer than `_LEAST_PIXELS` pixels.
    """
    if min(left.sum(), (~left).sum()) < _LEAST_PIXELS:
        return None
    rows = np.unique(row)
    share = []
    for side in (left, ~left):
        side_rows = np.unique(row[side])
        medians = ndimage.median(ratio[side], row[side], side_rows)
        share.append(ndimage.gaussian_filter1d(np.interp(rows, side_rows, medians), _ROWS, mode="nearest"))
    columns = float(np.mean(column[left])), float(np.mean(column[~left]))
    return Sides(rows=rows, columns=columns, share=np.maximum(share, _DARKEST))


def _beside_mask(view: View, optics: Optics, scene: Scene) -> Mask:
    """Return the mask of pixels, `_STEP` px apart, whose line of sight passes beside the canister and the net pot.

    Only heights between the net pot's skirt and the canister's floor are included.
    """
    width, height = view.camera.image_wh
    u, v = np.meshgrid(np.arange(0, width, _STEP), np.arange(0, height, _STEP))
    directions = cameras.camera_directions(view.camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64))
    line, through = cameras.approach(view, optics, directions)
    past_mm = np.abs(line.b_mm)
    outer_mm = max(optics.outer_radius_mm, scene.net_pot.outer_radius_mm) + _MARGIN_MM
    climb = line.p_z / np.sqrt(optics.n_around**2 - line.p_z**2)
    z_mm = line.foot_z_mm + climb * (view.rho_mm - np.sqrt(view.rho_mm**2 - line.b_mm**2))  # at the distance of the axis
    below = through & (z_mm < scene.net_pot.skirt_bottom_mm) & (z_mm > optics.floor_z_mm)
    visible = ((past_mm > outer_mm) & below).reshape(u.shape)
    return cv2.erode(visible.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
