"""A coarse visual hull of the roots from the pictures so far, for the live page of a scan.

It is not for measurements: cameras are estimated from single pictures, the backlight is the brightest value of each
pixel so far, and the smallest cells have an edge of a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.background import water_mask
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

Array = NDArray[np.float64]

WIDEST_PX = 400
"""Pictures are reduced to this width: 0.6 mm per pixel for 250 mm, finer than the cells."""
DARK = 0.85
"""Fraction of the backlight below which a pixel is dark: noise and non-uniformity are a few per cent, and a root of 0.2
mm covers a third of such a pixel."""
COARSEST_MM, FINEST_MM = 4.0, 1.0
MOST_CELLS = 40_000
"""Largest number of cells after halving; software rendering draws them at once."""
SPARE_PX = 1.0
"""Tolerance of projected positions, for the error of a camera from a single picture."""
LEAST_SEEN = 3
"""Smallest number of pictures that cover a cell."""
_REACH = 0.95
"""Fraction of the radius within which all views see (R_o / n_water)."""


@dataclass(frozen=True)
class _Seen:
    """A reduced picture with its camera."""

    file: str
    view: View
    image: NDArray[np.float32]


@dataclass(frozen=True)
class _Outline:
    """The empty region in a picture."""

    view: View
    water: NDArray[np.bool_]
    """(H, W) pixels of water."""
    away_px: NDArray[np.float32]
    """(H, W) distance of each pixel to the nearest dark pixel in the water."""


class Sketch:
    """A visual hull that is refined with each picture."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._optics = scene, Optics.from_scene(scene)
        width = min(WIDEST_PX, scene.camera.image_wh[0])
        height = round(width * scene.camera.image_wh[1] / scene.camera.image_wh[0])
        self._camera = scene.camera.resized((width, height))
        self._seen: dict[int, list[_Seen]] = {}

    def add(self, file: str, ring: int, image: Grey, cam_from_canister: Array) -> None:
        """Add a picture (H, W) with its camera pose (4, 4)."""
        small = cv2.resize(image, self._camera.image_wh, interpolation=cv2.INTER_AREA).astype(np.float32)
        view = View(camera=self._camera, cam_from_canister=cam_from_canister)
        self._seen.setdefault(ring, []).append(_Seen(file, view, small / np.iinfo(image.dtype).max))

    def drop(self, file: str) -> None:
        """Remove a picture that was discarded."""
        for ring, seen in self._seen.items():
            self._seen[ring] = [one for one in seen if one.file != file]

    def evenness(self, ring: int) -> tuple[float, float] | None:
        """Return the 5th and 95th percentile of the backlight, as fractions of full scale; None without pictures."""
        seen = self._seen.get(ring)
        if not seen:
            return None
        inside = water_mask(seen[-1].view, self._optics, self._scene)
        if not inside.any():
            return None
        panel = np.max([one.image for one in seen], axis=0)[inside]
        low, high = np.percentile(panel, [5.0, 95.0])
        return float(low), float(high)

    def carve(self) -> tuple[Array, float]:
        """Return centres (N, 3), canister frame, of the cells that no picture excludes, and their edge, mm."""
        outlines = [found for seen in self._seen.values() for found in self._outlines(seen)]
        edge_mm = COARSEST_MM
        middles = self._grid(edge_mm)
        while True:
            views = np.zeros(len(middles), np.int64)
            for outline in outlines:
                seen, empty = self._look(middles, edge_mm, outline)
                views, middles = (views + seen)[~empty], middles[~empty]
            middles = middles[views >= LEAST_SEEN]
            if edge_mm <= FINEST_MM or 8 * len(middles) > MOST_CELLS or not len(middles):
                return middles, edge_mm
            edge_mm /= 2.0
            corner = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(8, 3) * edge_mm
            middles = (middles[:, None] + corner).reshape(-1, 3)

    def _grid(self, edge_mm: float) -> Array:
        """Return the cells that a view at their height would see from all sides."""
        optics = self._optics
        reach = _REACH * min(optics.inner_radius_mm, optics.outer_radius_mm / optics.n_water)
        side = np.arange(-reach, reach + edge_mm, edge_mm)
        height = np.arange(optics.floor_z_mm + edge_mm / 2.0, optics.water_z_mm, edge_mm)
        x, y, z = (axis.ravel() for axis in np.meshgrid(side, side, height, indexing="ij"))
        return np.column_stack([x, y, z])[np.hypot(x, y) < reach]

    def _outlines(self, seen: list[_Seen]) -> list[_Outline]:
        """Return the empty regions of a ring's pictures; none until the backlight is known."""
        if len(seen) < LEAST_SEEN:
            return []
        panel = np.max([one.image for one in seen], axis=0)
        found = []
        for one in seen:
            water = water_mask(one.view, self._optics, self._scene)
            empty = (one.image > DARK * panel) | ~water
            away_px = cv2.distanceTransform(empty.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            found.append(_Outline(one.view, water, np.asarray(away_px)))
        return found

    def _look(self, middles: Array, edge_mm: float, outline: _Outline) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which cells (N,) a picture covers, and which of them are empty in it."""
        view = outline.view
        px = cameras.project_inner(view, self._optics, middles)
        height, width = outline.water.shape
        at = np.round(np.nan_to_num(px, nan=-1.0)).astype(np.int64)
        seen = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
        seen[seen] = outline.water[at[seen, 1], at[seen, 0]]
        # half of a cell's diagonal at the nearest distance, magnified by the water
        half_px = (
            view.camera.focal_px[0] * 0.5 * np.sqrt(3.0) * edge_mm * self._optics.n_water / (view.rho_mm - self._optics.outer_radius_mm)
        )
        empty = np.zeros(len(middles), bool)
        empty[seen] = outline.away_px[at[seen, 1], at[seen, 0]] > SPARE_PX + half_px
        return seen, empty
