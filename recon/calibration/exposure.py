"""How each picture was exposed, told by what stands still in it: the bare panel beside the canister.

A line of sight that passes the canister by sees the panel itself, and in every view of a camera that stands still the
same part of it. What such pixels of one picture have over those of all pictures of the station is the picture's
exposure. Lamps at mains frequency under a rolling shutter, panels of which one half fades, and people who pass by make
a picture brighter in one place than in another: so it is asked row by row, left and right of the canister.
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
from rhizotwin.scenes.pictures import Grey

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEP = 4
"""One pixel of so many each way is looked at."""
_DARKEST = 1.0 / 255.0
"""Least brightness of a panel over the station's, one level of 8 bits: a picture that is half black has less."""
_MARGIN_MM = 2.0
"""Beside canister and net pot."""
_LIT, _BRIGHT = 0.5, 0.9
"""The panel is what is brighter than this share of the bright (this quantile) beside the canister."""
_LEAST_PIXELS = 200
"""Of bare panel: noise of a few per cent a pixel then leaves a few per mille of the mean."""
_LEAST_PATCH = 20
"""Pixels of a patch of it."""
_ROWS = 2.0
"""Standard deviation, in rows that are looked at, over which the panel is evened: with 17 pixels beside the canister in
each it leaves a tenth of the noise of a pixel; three bands of a lamp in a picture of 300 rows keep 99 % of their
height."""
UNEVEN = 0.01
"""Left as it is where the panel beside the canister differs by less from the station's: a third of the faintest film
that is told (`CoverageSettings.film_depth`)."""


@dataclass(frozen=True, kw_only=True)
class Exposures:
    """How the pictures of a scan were exposed."""

    gain: Array
    """(V,) exposure over that of the station's middle picture; 1 where nothing tells it."""
    told: bool
    """Whether the panel beside the canister told it in all pictures."""
    clipped: Array
    """(V,) share of the panel's pixels that are at full scale."""
    level: Array
    """(V,) brightness of the panel, of full scale."""
    beside: tuple[Sides | None, ...] = ()
    """(V,) how the panel on both sides of the canister differs from the station's; None where it does not, or one side
    is not seen."""
    uneven: Array = field(default_factory=lambda: np.zeros(0))
    """(V,) standard deviation of the panel beside the canister over the station's, its gain and its ``beside`` divided
    out."""

    def chosen(self, places: Sequence[int]) -> Exposures:
        """Return those of some of the pictures, by their places."""
        return replace(
            self,
            beside=tuple(self.beside[k] for k in places) if self.beside else (),
            **{name: part[places] for name in ("gain", "clipped", "level", "uneven") if len(part := getattr(self, name))},
        )

    @property
    def dark(self) -> NDArray[np.bool_]:
        """Tell the pictures (V,) whose panel is dark, as one that is half black or was taken without light."""
        return np.asarray(self.gain <= _DARKEST)

    @property
    def wander(self) -> float:
        """Return by how much the exposure wandered: standard deviation of its gain."""
        return float(np.std(self.gain))

    @property
    def bands(self) -> float:
        """Return the largest standard deviation within a picture that was evened out; 0: none had to be."""
        return max((float(np.std(sides.share)) for sides in self.beside if sides is not None), default=0.0)

    def light(self, k: int, image_wh: tuple[int, int]) -> NDArray[np.float32] | np.float32:
        """Return the k-th picture's exposure: one number, or (H, W) where it differs from place to place."""
        sides = self.beside[k] if self.beside else None
        gain = np.float32(self.gain[k])
        return gain if sides is None else gain * sides.over(image_wh)


@dataclass(frozen=True, kw_only=True)
class Sides:
    """How the panel left and right of the canister differs from the station's, row by row."""

    rows: Array
    """(R,) rows of the picture."""
    columns: tuple[float, float]
    """Where left and right are seen, on average."""
    share: Array
    """(2, R) brightness left and right over the station's, its gain divided out."""

    def over(self, image_wh: tuple[int, int]) -> NDArray[np.float32]:
        """Return the brightness (H, W) between and beyond, straight from left to right in each row."""
        width, height = image_wh
        left, right = (np.interp(np.arange(height), self.rows, side)[:, None] for side in self.share)
        across = (np.arange(width)[None] - self.columns[0]) / (self.columns[1] - self.columns[0])
        return np.asarray(left + (right - left) * across, np.float32)


def measure(images: Sequence[Grey], views: Sequence[View], stations: Sequence[tuple[int, int]], optics: Optics, scene: Scene) -> Exposures:
    """Measure how pictures were exposed.

    Parameters
    ----------
    images : sequence of (H, W) uint8 or uint16 array
        Linear in light.
    views : sequence of View
        Their cameras.
    stations : sequence of tuple of int
        Which standing of the camera each belongs to.
    """
    gain, clipped, level = np.ones(len(images)), np.zeros(len(images)), np.full(len(images), np.nan)
    told, uneven = True, np.zeros(len(images))
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
            told = False
            continue
        light = light[:, panel]
        full = light >= FULL
        clipped[own], level[own] = full.mean(axis=1), np.median(light, axis=1)
        usable = ~full.any(axis=0)
        if usable.sum() < _LEAST_PIXELS:
            told = False
            continue
        light = light[:, usable]
        ratio = light / np.median(light, axis=0)
        gain[own] = np.maximum(np.median(ratio, axis=1).astype(np.float64), _DARKEST)
        row, column = (_STEP * at[panel][usable].astype(np.float64) for at in np.nonzero(beside))
        for k, one in zip(own, ratio, strict=True):
            sides[k], uneven[k] = _unevenness(one / gain[k], row, column, images[k].shape[1])
    return Exposures(gain=gain, told=told, clipped=clipped, level=level, beside=tuple(sides), uneven=uneven)


def _unevenness(ratio: Array, row: Array, column: Array, width: int) -> tuple[Sides | None, float]:
    """Return how a picture's panel (N,) differs from the station's, and how much is left when that is divided out.

    It is looked at in patches of so many rows as are evened, of the inner and the outer half of each side.
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
    """Return the panel's ratio (N,) row by row on both sides; None where one of them is hardly seen."""
    if min(left.sum(), (~left).sum()) < _LEAST_PIXELS:
        return None
    rows = np.unique(row)
    share = []
    for side in (left, ~left):
        told, inverse = np.unique(row[side], return_inverse=True)
        order = np.argsort(inverse, kind="stable")
        medians = [float(np.median(part)) for part in np.split(ratio[side][order], np.flatnonzero(np.diff(inverse[order])) + 1)]
        share.append(ndimage.gaussian_filter1d(np.interp(rows, told, medians), _ROWS, mode="nearest"))
    columns = float(np.mean(column[left])), float(np.mean(column[~left]))
    return Sides(rows=rows, columns=columns, share=np.maximum(share, _DARKEST))


def _beside(view: View, optics: Optics, scene: Scene) -> Mask:
    """Tell the pixels, one of `_STEP` each way, whose line of sight passes canister and net pot by.

    It does so at heights between skirt and base.
    """
    width, height = view.camera.image_wh
    u, v = np.meshgrid(np.arange(0, width, _STEP), np.arange(0, height, _STEP))
    directions = cameras.camera_directions(view.camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64))
    line, through = cameras.approach(view, optics, directions)
    past_mm = np.abs(line.b_mm)
    outer_mm = max(optics.outer_radius_mm, scene.net_pot.outer_radius_mm) + _MARGIN_MM
    climb = line.p_z / np.sqrt(optics.n_around**2 - line.p_z**2)
    z_mm = line.foot_z_mm + climb * (view.rho_mm - np.sqrt(view.rho_mm**2 - line.b_mm**2))  # as far off as the axis
    below = through & (z_mm < scene.net_pot.skirt_bottom_mm) & (z_mm > optics.floor_z_mm)
    seen = ((past_mm > outer_mm) & below).reshape(u.shape)
    return cv2.erode(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
