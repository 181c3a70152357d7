"""The pictures of a scan with the reconstruction drawn over them by the refraction that made it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.cameras import Cameras
from rhizotwin.corrections.lines import Line
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.dataset import Dataset, read_image

Array = NDArray[np.float64]
Colour = NDArray[np.uint8]

_SHIFT = 4
"""OpenCV draws lines at sixteenths of a pixel."""
LEAST_WIDE_PX = 1600
"""Pictures that are drawn over are enlarged to this at least: lines beside a root of two pixels leave it to be seen."""


@dataclass(frozen=True)
class Pictures(Cameras):
    """The pictures of a result that have cameras."""

    dataset: Dataset

    @classmethod
    def of(cls, dataset: Dataset, summary: dict[str, Any]) -> Pictures:
        """Gather pictures and cameras, with lens and water as the reconstruction found them."""
        found = Cameras.of(dataset, summary)
        return cls(found.files, found.views, found.table_deg, found.optics, dataset)

    def picture(self, place: int) -> Colour:
        """Return a picture (H, W, 3) as a screen shows it."""
        frame = next(frame for frame in self.dataset.frames if frame.file == self.files[place])
        grey = read_image(self.dataset, frame).astype(np.float64)
        grey = np.clip(grey / max(float(np.percentile(grey, 99.8)), 1.0), 0.0, 1.0)
        if not self.dataset.masks:
            grey = grey ** (1.0 / 2.2)  # linear in light, which screens are not
        return np.repeat(np.round(255.0 * grey).astype(np.uint8)[..., None], 3, axis=2)

    def pixels(self, place: int, points_mm: Array) -> Array:
        """Return where points (N, 3) show in a picture (N, 2); NaN where they have none."""
        within = np.hypot(points_mm[:, 0], points_mm[:, 1]) < self.optics.inner_radius_mm
        found = np.full((len(points_mm), 2), np.nan)
        if within.any():
            found[within] = cameras.project_inner(self.views[place], self.optics, points_mm[within])
        return found

    def nearest(self, azimuth_deg: float) -> int:
        """Return the picture whose camera stands nearest to a direction from the canister's axis."""
        centre = np.array([view.centre_mm for view in self.views])
        off = np.rad2deg(np.arctan2(centre[:, 1], centre[:, 0])) - azimuth_deg
        return int(np.abs((off + 180.0) % 360.0 - 180.0).argmin())

    def best_for(self, line: Line, count: int = 3) -> list[int]:
        """Return the pictures in which a root shows longest, as if there were no water.

        Water makes roots larger in all pictures nearly alike, and a click waits for the answer: of 31 roots of a day-30
        plant the first picture showed 89 % of the longest's length at least, 99 % in the median.
        """
        shown = []
        for view in self.views:
            seen = line.points_mm @ view.cam_from_canister[:3, :3].T + view.cam_from_canister[:3, 3]
            px = seen[:, :2] / seen[:, 2:] * view.camera.focal_px + view.camera.principal_px
            width, height = view.camera.image_wh
            out = (px < 0.0).any(axis=1) | (px[:, 0] > width - 1) | (px[:, 1] > height - 1)
            px[out] = np.nan
            shown.append(float(np.nansum(np.linalg.norm(np.diff(px, axis=0), axis=1))))
        return [int(place) for place in np.argsort(shown)[::-1][:count]]

    def drawn(self, place: int, lines: Mapping[int, Line], colours: Mapping[int, tuple[int, int, int]], *, thickness: int = 1) -> Colour:
        """Return a picture, enlarged where it is small, with both flanks of roots drawn over it.

        Parameters
        ----------
        place : int
            Number of the picture.
        lines, colours : dict of Line, dict of tuple of int
            Roots and their colours, by number.
        thickness : int
            Of the strokes, px.

        Returns
        -------
        (H, W, 3) uint8 array
            RGB.
        """
        image, scale = _enlarged(self.picture(place))
        if not lines:
            return image
        points = np.concatenate([line.points_mm for line in lines.values()])
        pixels = self.pixels(place, points)
        sides = [scale * (side + 0.5) - 0.5 for side in _flanks(self, place, lines, pixels)]
        first = np.cumsum([0, *(len(line.points_mm) for line in lines.values())])
        for side in sides:
            for place_of, number in enumerate(lines):
                _polyline(image, side[first[place_of] : first[place_of + 1]], colours[number], thickness)
        return image

    def with_outline(self, place: int, mesh: Mesh, colour: tuple[int, int, int], *, thickness: int = 1) -> Colour:
        """Return a picture, enlarged where it is small, with the outline of a surface drawn over it.

        Parameters
        ----------
        place : int
            Number of the picture.
        mesh : Mesh
            Canister frame.
        colour : tuple of int
            RGB.
        thickness : int
            Of the strokes, px.

        Returns
        -------
        (H, W, 3) uint8 array
            RGB.
        """
        image, scale = _enlarged(self.picture(place))
        corners = scale * (self.pixels(place, mesh.vertices_mm)[mesh.faces] + 0.5) - 0.5
        seen = corners[np.isfinite(corners).all(axis=(1, 2))]
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.fillPoly(mask, list(np.round(seen * 2**_SHIFT).astype(np.int32)), 255, cv2.LINE_8, _SHIFT)
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, contours, -1, colour, thickness, cv2.LINE_AA)
        return image


def _enlarged(image: Colour) -> tuple[Colour, int]:
    """Return a picture at least `LEAST_WIDE_PX` wide, and how many times as large it is.

    The middle of pixel k comes to scale (k + 0.5) - 0.5.
    """
    scale = -(-LEAST_WIDE_PX // image.shape[1])
    if scale <= 1:
        return image, 1
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8), scale


def _flanks(pictures: Pictures, place: int, lines: Mapping[int, Line], pixels: Array) -> list[Array]:
    """Return where both flanks of roots show.

    The centre lines, moved by the radius across the line of sight and the root.
    """
    centre = pictures.views[place].centre_mm
    moved = []
    for line in lines.values():
        along = np.gradient(line.points_mm, axis=0)
        across = np.cross(along, line.points_mm - centre)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        moved.append(across * line.diameters_mm[:, None] / 2.0)
    points = np.concatenate([line.points_mm for line in lines.values()])
    shift = np.concatenate(moved)
    found = [pictures.pixels(place, points + sign * shift) for sign in (1.0, -1.0)]
    return [np.where(np.isfinite(pixels), side, np.nan) for side in found]


def _polyline(image: Colour, pixels: Array, colour: tuple[int, int, int], thickness: int) -> None:
    """Draw what is seen of a line."""
    seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))
    for run in np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1):
        if len(run) > 1:
            at = np.round(pixels[run] * 2**_SHIFT).astype(np.int32).reshape(-1, 1, 2)
            cv2.polylines(image, [at], False, colour, thickness, cv2.LINE_AA, _SHIFT)
