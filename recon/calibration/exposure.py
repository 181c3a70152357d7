"""Exposure of each picture, measured on static content: the empty panel beside the canister.

A line of sight beside the canister shows the panel directly, and the same part of it in every view of a static camera.
The ratio of such pixels in one picture to those in all pictures of the station is the exposure of the picture. Lamps at
mains frequency under a rolling shutter, panels of which one half fades, and passing people make a picture brighter in
some places than in others; the ratio is therefore measured row by row, left and right of the canister.
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
"""Pixels are sampled with this step in both directions."""
_DARKEST = 1.0 / 255.0
"""Minimum brightness of a panel relative to the station, one level of 8 bits: a picture that is half black has less."""
_MARGIN_MM = 2.0
"""Margin beside canister and net pot."""
_LIT, _BRIGHT = 0.5, 0.9
"""Minimum brightness of the panel, relative to a quantile of the brightness beside the canister, and the quantile."""
_LEAST_PIXELS = 200
"""Minimum number of pixels of the empty panel: noise of a few per cent per pixel then averages to a few per mille."""
_LEAST_PATCH = 20
"""Minimum number of pixels of a patch of the panel."""
_ROWS = 2.0
"""Standard deviation, in sampled rows, over which the panel is smoothed: with 17 pixels beside the canister in each
row, a tenth of a pixel's noise remains; three bands of a lamp in a picture of 300 rows keep 99 % of their amplitude."""
UNEVEN = 0.01
"""Minimum relative deviation from the station's panel that is corrected: a third of the faintest film that is detected
(`CoverageSettings.film_depth`)."""


@dataclass(frozen=True, kw_only=True)
class Exposures:
    """Exposures of the pictures of a scan."""

    gain: Array
    """(V,) exposure relative to the station's median picture; 1 if unknown."""
    measured: bool
    """Whether it was measured on the panel beside the canister in all pictures."""
    clipped: Array
    """(V,) fraction of the panel's pixels that are at full scale."""
    level: Array
    """(V,) brightness of the panel, relative to full scale."""
    beside: tuple[Sides | None, ...] = ()
    """(V,) relative brightness of the panel on both sides of the canister; None if it is uniform, or if one side is not
    visible."""
    uneven: Array = field(default_factory=lambda: np.zeros(0))
    """(V,) standard deviation of the panel beside the canister relative to the station, after division by gain and
    ``beside``."""

    def select(self, places: Sequence[int]) -> Exposures:
        """Return the exposures of a subset of the pictures, by index."""
        return replace(
            self,
            beside=tuple(self.beside[k] for k in places) if self.beside else (),
            **{name: part[places] for name in ("gain", "clipped", "level", "uneven") if len(part := getattr(self, name))},
        )

    @property
    def dark(self) -> NDArray[np.bool_]:
        """Return the pictures (V,) with a dark panel, such as those that are half black or were taken without light."""
        return np.asarray(self.gain <= _DARKEST)

    @property
    def wander(self) -> float:
        """Return the standard deviation of the gain."""
        return float(np.std(self.gain))

    @property
    def bands(self) -> float:
        """Return the largest standard deviation within a picture that was corrected; 0 if none was."""
        return max((float(np.std(sides.share)) for sides in self.beside if sides is not None), default=0.0)

    def light(self, k: int, image_wh: tuple[int, int]) -> NDArray[np.float32] | np.float32:
        """Return the exposure of picture k: one number, or (H, W) if it varies over the picture."""
        sides = self.beside[k] if self.beside else None
        gain = np.float32(self.gain[k])
        return gain if sides is None else gain * sides.over(image_wh)


@dataclass(frozen=True, kw_only=True)
class Sides:
    """Relative brightness of the panel left and right of the canister, row by row."""

    rows: Array
    """(R,) rows of the picture."""
    columns: tuple[float, float]
    """Mean columns of the panel left and right of the canister."""
    share: Array
    """(2, R) brightness left and right relative to the station, divided by the gain."""

    def over(self, image_wh: tuple[int, int]) -> NDArray[np.float32]:
        """Return the brightness (H, W), interpolated linearly from left to right in each row, and extrapolated."""
        width, height = image_wh
        left, right = (np.interp(np.arange(height), self.rows, side)[:, None] for side in self.share)
        across = (np.arange(width)[None] - self.columns[0]) / (self.columns[1] - self.columns[0])
        return np.asarray(left + (right - left) * across, np.float32)


def measure(images: Sequence[Grey], views: Sequence[View], stations: Sequence[tuple[int, int]], optics: Optics, scene: Scene) -> Exposures:
    """Measure the exposures of pictures.

    Parameters
    ----------
    images : sequence of (H, W) uint8 or uint16 array
        Pictures, linear in light.
    views : sequence of View
        Cameras of the pictures.
    stations : sequence of tuple of int
        Station of each picture.
    """
    gain, clipped, level = np.ones(len(images)), np.zeros(len(images)), np.full(len(images), np.nan)
    measured, uneven = True, np.zeros(len(images))
    sides: list[Sides | None] = [None] * len(images)
    for station in sorted(set(stations)):
        own = [k for k, one in enumerate(stations) if one == station]
        beside = np.logical_and.reduce([_beside(views[k], optics, scene) for k in own])
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
        gain[own] = np.maximum(np.median(ratio, axis=1).astype(np.float64), _DARKEST)
        row, column = (_STEP * at[panel][usable].astype(np.float64) for at in np.nonzero(beside))
        for k, one in zip(own, ratio, strict=True):
            sides[k], uneven[k] = _unevenness(one / gain[k], row, column, images[k].shape[1])
    return Exposures(gain=gain, measured=measured, clipped=clipped, level=level, beside=tuple(sides), uneven=uneven)


def _unevenness(ratio: Array, row: Array, column: Array, width: int) -> tuple[Sides | None, float]:
    """Return the relative brightness of a picture's panel (N,), and the unevenness that remains after its correction.

    It is evaluated in patches as high as the smoothing, over the inner and the outer half of each side.
    """
    left = column < 0.5 * width
    found = _sides(ratio, row, column, left)
    if found is not None and np.std(found.share) < UNEVEN:
        found = None
    if found is not None:
        at = (column - found.columns[0]) / (found.columns[1] - found.columns[0])
        first, last = (np.interp(row, found.rows, side) for side in found.share)
        ratio = ratio / (first + (last - first) * at)
    middle = np.where(left, np.median(column[left]) if left.any() else 0.0, np.median(column[~left]) if (~left).any() else 0.0)
    patch = np.floor(row / (4.0 * _ROWS * _STEP)) * 4.0 + 2.0 * left + (column > middle)
    _, inverse, count = np.unique(patch, return_inverse=True, return_counts=True)
    means = np.bincount(inverse, weights=ratio) / count
    noise = np.bincount(inverse, weights=(ratio - means[inverse]) ** 2) / np.maximum(count - 1, 1) / count
    whole = count >= _LEAST_PATCH
    more = np.var(means[whole]) - np.mean(noise[whole]) if whole.sum() > 1 else 0.0
    return found, float(np.sqrt(max(0.0, more)))


def _sides(ratio: Array, row: Array, column: Array, left: Mask) -> Sides | None:
    """Return the panel's ratio (N,) row by row on both sides; None if one of them is hardly visible."""
    if min(left.sum(), (~left).sum()) < _LEAST_PIXELS:
        return None
    rows = np.unique(row)
    share = []
    for side in (left, ~left):
        side_rows, inverse = np.unique(row[side], return_inverse=True)
        order = np.argsort(inverse, kind="stable")
        medians = [float(np.median(part)) for part in np.split(ratio[side][order], np.flatnonzero(np.diff(inverse[order])) + 1)]
        share.append(ndimage.gaussian_filter1d(np.interp(rows, side_rows, medians), _ROWS, mode="nearest"))
    columns = float(np.mean(column[left])), float(np.mean(column[~left]))
    return Sides(rows=rows, columns=columns, share=np.maximum(share, _DARKEST))


def _beside(view: View, optics: Optics, scene: Scene) -> Mask:
    """Return the pixels, sampled with `_STEP`, whose line of sight passes beside canister and net pot.

    Only heights between skirt and base are included.
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
