"""Renderings of the shape from the front and from the side, at the same scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.drawing import root_colours, shading
from rhizotwin.recon.results.parts import Mesh

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Type of a rectangle in a projection: left, right, bottom and top, mm."""

SHAPE_RGB = np.array(root_colours.SURFACE) / 255.0
"""Colour of the reconstructed shape, ochre."""
SHRINK = 2
"""Supersampling factor of renderings in each direction."""
PANEL_PX = 640
"""Height of a rendering, pixels."""
MARGIN_MM = 4.0
"""Margin around the shape, mm."""
BAR_MM = 10.0
"""Length of the scale bar, mm."""
_INK = (40, 40, 40)
_NARROWEST, _FLATTEST = 0.5, 0.6
"""Minimum ratios of width to height, and of height to width."""


@dataclass(frozen=True)
class Rendering:
    """Shape seen from one side."""

    side: shading.Side
    box: Box
    rgba: NDArray[np.uint8]
    """Picture (H, W, 4), transparent outside the shape."""

    def webp(self) -> bytes:
        """Return the picture as a WebP file."""
        return webp(self.rgba)

    def on_white(self) -> NDArray[np.uint8]:
        """Return the picture (H, W, 3) on white."""
        share = self.rgba[..., 3:] / 255.0
        return np.asarray(np.round(share * self.rgba[..., :3] + 255.0 * (1.0 - share)), np.uint8)


def webp(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture (H, W, 3 or 4), RGB or RGBA, as a WebP file."""
    order = [2, 1, 0, 3][: picture.shape[2]]
    return bytes(cv2.imencode(".webp", picture[..., order], [cv2.IMWRITE_WEBP_QUALITY, 85])[1])


def render(surface: Mesh, *, height_px: int = PANEL_PX) -> list[Rendering]:
    """Render a surface from the front and from the side, at the same scale and height."""
    if not len(surface.faces):
        return []
    both = (shading.FRONT, shading.SIDE)
    return [_render(surface, side, box, height_px) for side, box in zip(both, boxes(surface.vertices_mm, both), strict=True)]


def boxes(points_mm: Floats, sides: Sequence[shading.Side]) -> list[Box]:
    """Return rectangles of the same size around points (N, 3) that are projected to several sides."""
    flat = [points_mm @ side.axes[:2].T for side in sides]
    middle = [(points.min(axis=0) + points.max(axis=0)) / 2.0 for points in flat]
    half = np.max([np.ptp(points, axis=0) / 2.0 for points in flat], axis=0) + MARGIN_MM
    half = np.maximum(half, [_NARROWEST * half[1], _FLATTEST * half[0]])
    return [(float(x - half[0]), float(x + half[0]), float(y - half[1]), float(y + half[1])) for x, y in middle]


def raster(mesh: Mesh, side: shading.Side, box: Box, *, height_px: int = PANEL_PX) -> tuple[shading.Raster, float]:
    """Rasterise a mesh with supersampling, and return the raster with the edge of its pixels, mm.

    Parameters
    ----------
    mesh : Mesh
        Mesh, canister frame.
    side, box : shading.Side, Box
        Viewing direction, and rectangle that is drawn.
    height_px : int
        Height of the picture without supersampling, px.
    """
    px_mm = (box[3] - box[2]) / (height_px * SHRINK)
    return shading.rasterise(mesh, side, box_mm=box, px_mm=px_mm), px_mm


def _render(surface: Mesh, side: shading.Side, box: Box, height_px: int) -> Rendering:
    seen, px_mm = raster(surface, side, box, height_px=height_px)
    shaded = shading.shade(seen, SHAPE_RGB, px_mm=px_mm, shrink=SHRINK)
    return Rendering(side, box, np.asarray(np.round(255.0 * shaded), np.uint8))


def overview(renderings: Sequence[Rendering]) -> NDArray[np.uint8]:
    """Return renderings beside each other as one picture (H, W, 3) on white, with a scale bar."""
    picture = np.concatenate([one.on_white() for one in renderings], axis=1)
    left, bottom = 16, len(picture) - 16
    low, high = renderings[0].box[2:]
    cv2.line(picture, (left, bottom), (left + round(BAR_MM * len(picture) / (high - low)), bottom), _INK, 3)
    cv2.putText(picture, f"{BAR_MM:g} mm", (left, bottom - 10), _INK, cv2.FontFace("sans"), 22)
    return picture
