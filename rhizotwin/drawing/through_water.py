"""Pictures of a result with their calibrated cameras: projection with refraction, and overlay of the outline."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line
from rhizotwin.drawing import root_colours
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.dataset import Dataset, read_image
from rhizotwin.stored.stored_cameras import Cameras

Array = NDArray[np.float64]
Colour = NDArray[np.uint8]

Rgb = tuple[int, int, int]

LEAST_WIDE_PX = 1600
"""Minimum width of a picture on which an outline is drawn, in pixels. Narrower pictures are enlarged, so that the
outline does not cover thin roots."""
THINNEST_PX = 1.2
"""Minimum width of a tube in a picture, in pixels. Narrower tubes would have gaps between the centres of pixels."""
_DISC = np.exp(2j * np.pi * np.arange(12) / 12)
"""Corners of a regular polygon that represents a disc of radius 1, as complex numbers."""
THIN_MM = 0.9
"""Maximum diameter of roots that are drawn as tubes, in mm. The reconstructed surface has gaps where a root is only a
few voxels thick."""
OUTLINE: Rgb = (255, 120, 0)
"""Colour of the outline of the reconstruction."""
_CASING: Rgb = (40, 40, 40)
"""Colour of the edges of the outline of selected roots, which is as light as the water."""


@dataclass(frozen=True)
class Pictures(Cameras):
    """Calibrated pictures of a result with their cameras."""

    dataset: Dataset

    @classmethod
    def of(cls, dataset: Dataset, summary: dict[str, Any]) -> Pictures:
        """Read the cameras of a result, see `Cameras.of`."""
        return cls(**vars(Cameras.of(dataset, summary)), dataset=dataset)

    def picture(self, place: int) -> Colour:
        """Return a picture (H, W, 3) in sRGB, in which the brightness is scaled to the full range."""
        frame = next(frame for frame in self.dataset.frames if frame.file == self.files[place])
        grey = read_image(self.dataset, frame).astype(np.float64)
        grey = np.clip(grey / max(float(np.percentile(grey, 99.8)), 1.0), 0.0, 1.0)
        if not self.dataset.masks:
            grey = grey ** (1.0 / 2.2)  # from linear intensities to a screen's gamma
        return np.repeat(np.round(255.0 * grey).astype(np.uint8)[..., None], 3, axis=2)

    def pixels(self, place: int, points_mm: Array) -> Array:
        """Project points (N, 3) into a picture, and return their pixels (N, 2).

        The pixel is NaN if the point is outside the water or is not visible through the canister.
        """
        within = np.hypot(points_mm[:, 0], points_mm[:, 1]) < self.optics.inner_radius_mm
        xy_px = np.full((len(points_mm), 2), np.nan)
        if within.any():
            xy_px[within] = cameras.project_inner(self.views[place], self.optics, points_mm[within])
        return xy_px

    def nearest(self, azimuth_deg: float) -> int:
        """Return the index of the picture whose camera has the azimuth nearest to the given one."""
        centre = np.array([view.centre_mm for view in self.views])
        off = np.rad2deg(np.arctan2(centre[:, 1], centre[:, 0])) - azimuth_deg
        return int(np.abs((off + 180.0) % 360.0 - 180.0).argmin())

    def best_for(self, line: Line, count: int = 3) -> list[int]:
        """Return the indices of the ``count`` pictures in which a root appears longest, neglecting refraction.

        Refraction magnifies a root almost equally in all pictures. For 31 roots of a 30-day-old plant, the length in
        the first picture was at least 89 % of the largest refracted length, and 99 % in the median.
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

    def draw_outline(
        self, place: int, surface: Mesh | None, lines: Mapping[int, Line], *, selected: Collection[int] = (), thickness: int = 1
    ) -> Colour:
        """Draw the outline of the reconstruction on a picture, and the outlines of selected roots in another colour.

        The outline of the reconstruction is that of the union of the surface and the tubes of thin roots, where the
        surface has gaps.

        Parameters
        ----------
        place : int
            Index of the picture.
        surface : Mesh or None
            Closed surface, canister frame; None: all roots are drawn as tubes.
        lines : Lines
            Centre lines of roots by number; may be empty.
        selected : collection of int
            Numbers of the roots whose outlines are drawn separately.
        thickness : int
            Line width, px.

        Returns
        -------
        (H, W, 3) uint8 array
            RGB picture, enlarged if it is narrower than `LEAST_WIDE_PX`.
        """
        image, scale = _enlarge(self.picture(place))
        parts = self._tubes(place, lines, scale, thickest_mm=np.inf if surface is None else THIN_MM)
        if surface is not None:
            parts.append(scale * (self.pixels(place, surface.vertices_mm)[surface.faces] + 0.5) - 0.5)
        _draw_contours(image, fill(parts, image.shape[:2]), OUTLINE, thickness)
        own = fill(self._tubes(place, {k: line for k, line in lines.items() if k in selected}, scale, thickest_mm=np.inf), image.shape[:2])
        for colour, wide in ((_CASING, thickness + 2), (root_colours.SELECTED, thickness)):
            _draw_contours(image, own, colour, wide)
        return image

    def _tubes(self, place: int, lines: Mapping[int, Line], scale: int, *, thickest_mm: float) -> list[Array]:
        """Return the projections of tubes as polygons, see `fill`.

        Each segment of a tube consists of two triangles, and each of its points is a disc. Points with a diameter above
        ``thickest_mm`` are omitted.
        """
        if not lines:
            return []
        left, right = (scale * (side + 0.5) - 0.5 for side in self._project_flanks(place, lines))
        middle, half = (left + right) / 2.0, (right - left) / 2.0
        half *= np.maximum(1.0, THINNEST_PX / 2.0 / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9))
        middle[np.concatenate([line.diameters_mm for line in lines.values()]) > thickest_mm] = np.nan
        left, right = middle - half, middle + half
        within = np.ones(len(middle) - 1, bool)
        within[np.cumsum([len(line.points_mm) for line in lines.values()])[:-1] - 1] = False  # no segment between two roots
        a, b, c, d = left[:-1][within], left[1:][within], right[1:][within], right[:-1][within]
        disc = np.linalg.norm(half, axis=1)[:, None, None] * np.stack([_DISC.real, _DISC.imag], axis=1)
        return [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1), middle[:, None] + disc]

    def _project_flanks(self, place: int, lines: Mapping[int, Line]) -> tuple[Array, Array]:
        """Project the left and right edge of each root into a picture, and return the pixels (N, 2) of both.

        An edge is the centre line, displaced by the radius perpendicular to the root and to the line of sight.
        """
        centre = self.views[place].centre_mm
        moved = []
        for line in lines.values():
            along = np.gradient(line.points_mm, axis=0)
            across = np.cross(along, line.points_mm - centre)
            across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
            moved.append(across * line.diameters_mm[:, None] / 2.0)
        points, shift = np.concatenate([line.points_mm for line in lines.values()]), np.concatenate(moved)
        return self.pixels(place, points + shift), self.pixels(place, points - shift)


def _draw_contours(image: Colour, mask: NDArray[np.uint8], colour: Rgb, thickness: int) -> None:
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(image, contours, -1, colour, thickness, cv2.LINE_AA)


def fill(polygons: Sequence[Array], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Fill the union of convex polygons.

    All polygons are given the same orientation, so that the winding number is zero only outside the union. It is the
    sum, along each row, over the edges to the left of a pixel, which count 1 or -1 depending on their direction.

    Parameters
    ----------
    polygons : sequence of (N, K, 2) arrays
        Corners of polygons, in pixels. Polygons with a NaN are omitted.
    shape : (int, int)
        Height and width of the mask.

    Returns
    -------
    (H, W) uint8 array
        255 in pixels whose centre is inside a polygon, otherwise 0.
    """
    height, width = shape
    turns = np.zeros(height * (width + 1), np.int64)
    for corners in polygons:
        corners = corners[np.isfinite(corners).all(axis=(1, 2))]
        x, y = corners[..., 0], corners[..., 1]
        area = (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)
        start, end = corners.reshape(-1, 2), np.roll(corners, -1, axis=1).reshape(-1, 2)
        sign = np.where((end[:, 1] > start[:, 1]) == np.repeat(area > 0.0, corners.shape[1]), 1, -1)
        down = (start[:, 1] < end[:, 1])[:, None]
        upper, lower = np.where(down, start, end), np.where(down, end, start)
        first, stop = (np.clip(np.ceil(point[:, 1]), 0, height).astype(np.int64) for point in (upper, lower))
        rows = stop - first
        edge = np.repeat(np.arange(len(rows)), rows)
        row = np.arange(len(edge)) - np.repeat(np.cumsum(rows) - rows - first, rows)
        slope = (lower - upper)[:, 0] / np.maximum((lower - upper)[:, 1], 1e-300)
        column = np.clip(np.ceil(upper[edge, 0] + slope[edge] * (row - upper[edge, 1])), 0, width).astype(np.int64)
        np.add.at(turns, row * (width + 1) + column, sign[edge])
    return np.where(np.cumsum(turns.reshape(height, width + 1), axis=1)[:, :width] != 0, 255, 0).astype(np.uint8)


def _enlarge(image: Colour) -> tuple[Colour, int]:
    """Enlarge a picture by an integer factor to a width of at least `LEAST_WIDE_PX`.

    The factor is returned with the picture. The centre of the original pixel k is at factor * (k + 0.5) - 0.5.
    """
    scale = -(-LEAST_WIDE_PX // image.shape[1])
    if scale <= 1:
        return image, 1
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8), scale
