"""Compute a coarse visual hull of the roots during a scan.

It is displayed but not used for measurements. Cells that lie outside the roots in a picture are
removed, and the remaining cells are subdivided while their number is small. Each camera is estimated from the markers
in its own picture, the empty backlight of a pixel is the maximum value so far, and the smallest cells have an edge of 1
mm.
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
"""Maximum width of the pictures from which the hull is computed. With a field of view of 250 mm, a pixel then
corresponds to 0.6 mm, which is finer than the cells."""
DARK = 0.85
"""Maximum brightness of a pixel that shows a root, relative to its brightness without roots. Noise and the panel vary
by a few per cent, and a root of 0.2 mm covers a third of a pixel of 0.6 mm."""
COARSEST_MM, FINEST_MM = 4.0, 1.0
"""Edge length of the initial cells, and edge length of the smallest cells."""
MOST_CELLS = 40_000
"""Maximum number of cells. A browser can draw this number without delay."""
SPARE_PX = 1.0
"""Tolerance for the projection of a cell, px. It allows for errors of a camera pose that is estimated from a single
picture."""
LEAST_SEEN = 3
"""Minimum number of pictures in whose field of view a cell must lie. Other cells are removed."""
_REACH = 0.95
"""Radius of the grid of cells, relative to the radius R_o / n_water. Water within this radius is visible in all
views."""


@dataclass(frozen=True)
class _Seen:
    """Downsampled picture with its camera."""

    file: str
    view: View
    image: NDArray[np.float32]
    water: NDArray[np.bool_]
    """Mask (H, W) of the pixels through which the water is visible."""


@dataclass(frozen=True)
class _Outline:
    """Distance image of the pixels that show no root."""

    seen: _Seen
    away_px: NDArray[np.float32]
    """Distance (H, W) from each pixel to the nearest pixel that shows a root."""


class Hull:
    """Computes a coarse visual hull from the pictures taken so far.

    Parameters
    ----------
    scene : Scene
        Scene with the calibrated lens.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene, self._optics = scene, Optics.from_scene(scene)
        width = min(WIDEST_PX, scene.camera.image_wh[0])
        height = round(width * scene.camera.image_wh[1] / scene.camera.image_wh[0])
        self._camera = scene.camera.resized((width, height))
        self._seen: dict[int, list[_Seen]] = {}

    def add(self, file: str, ring: int, image: Grey, cam_from_canister: Array, cam_from_tank: Array | None = None) -> None:
        """Add a picture.

        Parameters
        ----------
        file, ring : str, int
            File name of the picture, by which it can be removed, and number of its ring.
        image : (H, W) uint8 or uint16 array
            Picture with linear values.
        cam_from_canister : (4, 4) array
            Camera pose with OpenCV axes, mm.
        cam_from_tank : (4, 4) array, optional
            Pose of the tank relative to the camera, mm, which is needed if the scene has a tank.
        """
        small = cv2.resize(image, self._camera.image_wh, interpolation=cv2.INTER_AREA).astype(np.float32)
        view = View(camera=self._camera, cam_from_canister=cam_from_canister, cam_from_tank=cam_from_tank)
        water = water_mask(view, self._optics, self._scene)
        self._seen.setdefault(ring, []).append(_Seen(file, view, small / np.iinfo(image.dtype).max, water))

    def drop(self, file: str) -> None:
        """Remove a picture by its file name."""
        for ring, seen in self._seen.items():
            self._seen[ring] = [one for one in seen if one.file != file]

    def evenness(self, ring: int) -> tuple[float, float] | None:
        """Return the 5th and 95th percentiles of the panel's brightness behind the water, as fractions of full scale.

        The percentiles are computed from all pictures at the same height of the camera, and are None before the first
        picture.
        """
        seen = self._seen.get(ring)
        if not seen:
            return None
        inside = seen[-1].water
        if not inside.any():
            return None
        panel = np.max([one.image for one in seen], axis=0)[inside]
        low, high = np.percentile(panel, [5.0, 95.0])
        return float(low), float(high)

    def carve(self) -> tuple[Array, float]:
        """Compute the visual hull of the roots.

        Returns
        -------
        tuple of ((N, 3) float64 array, float)
            Centres of the remaining cells in the canister frame, mm, and their edge length, mm.
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
        """Return the centres (N, 3) of a grid of cells.

        The grid fills the part of the water that is visible in all views at the same height.
        """
        optics = self._optics
        reach = _REACH * min(optics.inner_radius_mm, optics.outer_radius_mm / optics.n_water)
        side = np.arange(-reach, reach + edge_mm, edge_mm)
        height = np.arange(optics.floor_z_mm + edge_mm / 2.0, optics.water_z_mm, edge_mm)
        x, y, z = (axis.ravel() for axis in np.meshgrid(side, side, height, indexing="ij"))
        return np.column_stack([x, y, z])[np.hypot(x, y) < reach]

    def _outlines(self, seen: list[_Seen]) -> list[_Outline]:
        """Compute distance images of the pictures at one height of the camera.

        The list is empty if there are fewer than three pictures.
        """
        if len(seen) < LEAST_SEEN:
            return []
        panel = np.max([one.image for one in seen], axis=0)
        found = []
        for one in seen:
            empty = (one.image > DARK * panel) | ~one.water
            away_px = cv2.distanceTransform(empty.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            found.append(_Outline(one, np.asarray(away_px)))
        return found

    def _look(self, middles: Array, edge_mm: float, outline: _Outline) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return two masks (N,) of cells.

        The first selects cells in the field of view of a picture, and the second selects cells that show no root there.
        """
        view, water = outline.seen.view, outline.seen.water
        px = cameras.project_inner(view, self._optics, middles)
        height, width = water.shape
        at = np.round(np.nan_to_num(px, nan=-1.0)).astype(np.int64)
        seen = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
        seen[seen] = water[at[seen, 1], at[seen, 0]]
        # half the diagonal of the cell nearest to the camera, px, including the magnification by the water
        half_px = (
            view.camera.focal_px[0] * 0.5 * np.sqrt(3.0) * edge_mm * self._optics.n_water / (view.rho_mm - self._optics.outer_radius_mm)
        )
        empty = np.zeros(len(middles), bool)
        empty[seen] = outline.away_px[at[seen, 1], at[seen, 0]] > SPARE_PX + half_px
        return seen, empty
