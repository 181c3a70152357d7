"""Compute a coarse visual hull of the roots during a scan.

It is displayed but not used for measurements. Cells that lie outside the roots in a picture are
removed, and the remaining cells are subdivided. Each camera is estimated from the markers in its own picture, the empty
backlight of a pixel is the maximum value so far, and the smallest cells have an edge of 1 mm. The refraction is
computed for the corners of the largest cells only, once per picture, and interpolated between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

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
MOST_CELLS = 400_000
"""Maximum number of cells that are compared with the pictures, which takes two seconds for 40 pictures."""
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
    corners_px: NDArray[np.float32]
    """Pixel coordinates (2, X, Y, Z) of the corners of the largest cells. They are NaN if a corner is not visible."""


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
        reach = _REACH * min(self._optics.inner_radius_mm, self._optics.outer_radius_mm / self._optics.n_water)
        side = np.arange(-reach, reach + COARSEST_MM, COARSEST_MM)
        upward = np.arange(self._optics.floor_z_mm, self._optics.water_z_mm + COARSEST_MM, COARSEST_MM)
        self._reach_mm = reach
        self._corners_mm = np.stack(np.meshgrid(side, side, upward, indexing="ij"))

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
        corners = self._corners_mm.reshape(3, -1).T
        inside = np.hypot(corners[:, 0], corners[:, 1]) < self._reach_mm + 2.0 * COARSEST_MM
        px = np.full((len(corners), 2), np.nan, np.float32)
        px[inside] = cameras.project_inner(view, self._optics, corners[inside])
        corners_px = px.T.reshape(2, *self._corners_mm.shape[1:])
        self._seen.setdefault(ring, []).append(_Seen(file, view, small / np.iinfo(image.dtype).max, water, corners_px))

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
        middles = self._corners_mm[:, :-1, :-1, :-1].reshape(3, -1).T + edge_mm / 2.0
        middles = middles[np.hypot(middles[:, 0], middles[:, 1]) < self._reach_mm]
        while True:
            views = np.zeros(len(middles), np.int64)
            for outline in outlines:
                seen, empty = self._look(middles, edge_mm, outline)
                views = (views + seen)[~empty]
                middles = middles[~empty]
            middles = middles[views >= LEAST_SEEN]
            if edge_mm <= FINEST_MM or 8 * len(middles) > MOST_CELLS or not len(middles):
                return middles, edge_mm
            edge_mm /= 2.0
            corner = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(8, 3) * edge_mm
            middles = (middles[:, None] + corner).reshape(-1, 3)

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
        at_corner = (middles - self._corners_mm[:, 0, 0, 0]).T / COARSEST_MM
        px = [map_coordinates(axis, at_corner, order=1, cval=np.nan) for axis in outline.seen.corners_px]
        height, width = water.shape
        column, row = np.round(np.nan_to_num(px, nan=-1.0)).astype(np.int64)
        seen = (row >= 0) & (column >= 0) & (row < height) & (column < width)
        seen[seen] = water[row[seen], column[seen]]
        # half the diagonal of the cell nearest to the camera, px, including the magnification by the water
        half_px = (
            view.camera.focal_px[0] * 0.5 * np.sqrt(3.0) * edge_mm * self._optics.n_water / (view.rho_mm - self._optics.outer_radius_mm)
        )
        if edge_mm <= FINEST_MM:
            half_px = 0.0  # the smallest cells need not contain all of the roots, and look hardly thicker than they are
        empty = np.zeros(len(middles), bool)
        empty[seen] = outline.away_px[row[seen], column[seen]] > SPARE_PX + half_px
        return seen, empty
