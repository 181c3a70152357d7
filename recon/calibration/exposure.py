"""How each picture was exposed, told by what stands still in it: the bare panel beside the canister.

A line of sight that passes the canister by sees the panel itself, and in every view of a camera that stands still the
same part of it. What such pixels of one picture have over those of all pictures of the station is the picture's
exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.marker_fit import FULL
from rhizotwin.recon.optics import cameras, refraction
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEP = 4
"""One pixel of so many each way is looked at."""
_MARGIN_MM = 2.0
"""Beside canister and net pot."""
_LIT, _BRIGHT = 0.5, 0.9
"""The panel is what is brighter than this share of the bright (this quantile) beside the canister."""
_LEAST_PIXELS = 200
"""Of bare panel: noise of a few per cent a pixel then leaves a few per mille of the mean."""


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

    @property
    def wander(self) -> float:
        """Return by how much the exposure wandered: standard deviation of its gain."""
        return float(np.std(self.gain))


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
    told = True
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
        gain[own] = np.median(light / np.median(light, axis=0), axis=1)
    return Exposures(gain=gain, told=told, clipped=clipped, level=level)


def _beside(view: View, optics: Optics, scene: Scene) -> Mask:
    """Tell the pixels, one of `_STEP` each way, whose line of sight passes canister and net pot by.

    It does so at heights between skirt and base.
    """
    width, height = view.camera.image_wh
    u, v = np.meshgrid(np.arange(0, width, _STEP), np.arange(0, height, _STEP))
    directions = cameras.pixel_directions(view, np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64))
    w, p_z = refraction.invariants(view.rho_mm, optics.outer_radius_mm, directions)
    past_mm = np.abs(w) * optics.outer_radius_mm
    outer_mm = max(optics.outer_radius_mm, scene.net_pot.outer_radius_mm) + _MARGIN_MM
    z_mm = view.centre_mm[2] + p_z / np.sqrt(1.0 - p_z**2) * view.rho_mm
    below = (z_mm < scene.net_pot.skirt_bottom_mm) & (z_mm > optics.floor_z_mm)
    seen = ((past_mm > outer_mm) & below).reshape(u.shape)
    return cv2.erode(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
