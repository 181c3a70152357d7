"""A sketch of the roots from the pictures so far: cells that every picture leaves room for, halved as they become few.

It is for a person who watches a scan, not for measuring: the cameras are those of the markers in single pictures, the
backlight is the brightest that each pixel has shown, and cells end at a millimetre.
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
"""Pictures are made smaller than this first: 250 mm are then 0.6 mm a pixel, finer than the cells."""
DARK = 0.85
"""Share of the backlight below which something stands in the way: noise and panel are even to some per cent, and a root
of 0.2 mm covers a third of such a pixel."""
COARSEST_MM, FINEST_MM = 4.0, 1.0
MOST_CELLS = 40_000
"""Cells are not halved beyond this; a browser's software draws them at once."""
SPARE_PX = 1.0
"""How far a dark pixel may lie from where the camera of a single picture puts it."""
LEAST_SEEN = 3
"""Cells that fewer pictures see are left out: nothing is known of them yet."""
_REACH = 0.95
"""Share of the radius within which every view sees (R_o / n_water)."""


@dataclass(frozen=True)
class _Seen:
    """A small picture with its camera."""

    file: str
    view: View
    image: NDArray[np.float32]


@dataclass(frozen=True)
class _Outline:
    """What a picture shows to be empty."""

    view: View
    water: NDArray[np.bool_]
    """(H, W) where the water is seen."""
    away_px: NDArray[np.float32]
    """(H, W) from each pixel to what is dark in the water."""


class Sketch:
    """Grows with the pictures of a scan."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._optics = scene, Optics.from_scene(scene)
        width = min(WIDEST_PX, scene.camera.image_wh[0])
        height = round(width * scene.camera.image_wh[1] / scene.camera.image_wh[0])
        self._camera = scene.camera.resized((width, height))
        self._seen: dict[int, list[_Seen]] = {}

    def add(self, file: str, ring: int, image: Grey, cam_from_canister: Array) -> None:
        """Take a picture (H, W) with its camera (4, 4) in."""
        small = cv2.resize(image, self._camera.image_wh, interpolation=cv2.INTER_AREA).astype(np.float32)
        view = View(camera=self._camera, cam_from_canister=cam_from_canister)
        self._seen.setdefault(ring, []).append(_Seen(file, view, small / np.iinfo(image.dtype).max))

    def drop(self, file: str) -> None:
        """Forget a picture that was taken out."""
        for ring, seen in self._seen.items():
            self._seen[ring] = [one for one in seen if one.file != file]

    def evenness(self, ring: int) -> tuple[float, float] | None:
        """Return the darkest and the brightest twentieth of the panel behind the water, of full scale.

        None before a picture.
        """
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
        """Return the middles (N, 3) of the cells that no picture rules out, and the edge of a cell (mm).

        In the canister's frame.
        """
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
        """Return the cells that every view sees, were it at their height."""
        optics = self._optics
        reach = _REACH * min(optics.inner_radius_mm, optics.outer_radius_mm / optics.n_water)
        side = np.arange(-reach, reach + edge_mm, edge_mm)
        height = np.arange(optics.floor_z_mm + edge_mm / 2.0, optics.water_z_mm, edge_mm)
        x, y, z = (axis.ravel() for axis in np.meshgrid(side, side, height, indexing="ij"))
        return np.column_stack([x, y, z])[np.hypot(x, y) < reach]

    def _outlines(self, seen: list[_Seen]) -> list[_Outline]:
        """Return the outlines of a ring's pictures; none before the panel is known."""
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
        """Tell which cells (N,) a picture sees, and which of them it shows to be empty."""
        view = outline.view
        px = cameras.project_inner(view, self._optics, middles)
        height, width = outline.water.shape
        at = np.round(np.nan_to_num(px, nan=-1.0)).astype(np.int64)
        seen = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
        seen[seen] = outline.water[at[seen, 1], at[seen, 0]]
        # half a cell's diagonal, were it the nearest to the camera, and as large as the water shows it
        half_px = (
            view.camera.focal_px[0] * 0.5 * np.sqrt(3.0) * edge_mm * self._optics.n_water / (view.rho_mm - self._optics.outer_radius_mm)
        )
        empty = np.zeros(len(middles), bool)
        empty[seen] = outline.away_px[at[seen, 1], at[seen, 0]] > SPARE_PX + half_px
        return seen, empty
