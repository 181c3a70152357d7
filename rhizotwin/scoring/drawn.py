"""Project the surface and the roots of a result into a picture, with refraction by wall and water."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.silhouettes import Image
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

_FINE = 8
"""Number of subsamples per pixel in each direction."""
_SHIFT = 4
"""Number of fractional bits of the vertex coordinates passed to OpenCV. Vertices are rounded to sixteenths of a
subsample."""
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
"""Structuring element of an erosion that corrects OpenCV's polygon fill, which also fills the pixels on the outline.
Filled discs (polygons with 40 vertices) extend 0.48 subsamples too far before the erosion, and 0.42 subsamples too
little after it. The mean of both is accurate to 0.03 subsamples."""


def coverage(view: View, optics: Optics, mesh: Mesh, roots: Sequence[Root]) -> Image:
    """Compute the fraction of each pixel (H, W) that a shape covers.

    Parameters
    ----------
    view : View
        Camera with its pose.
    optics : Optics
        Refractive media of the canister.
    mesh : Mesh
        Surface mesh, mm, canister frame.
    roots : sequence of Root
        Roots, drawn with their diameters because roots thinner than a voxel may have no surface.
    """
    width, height = view.camera.image_wh
    fine = np.zeros((height * _FINE, width * _FINE), np.uint8)
    corners = pixels(view, optics, mesh.vertices_mm)[mesh.faces] if len(mesh.faces) else np.zeros((0, 3, 2))
    for polygons in (corners, *(_project_segments(view, optics, root) for root in roots)):
        inside = np.isfinite(polygons).all(axis=(1, 2))
        placed = ((polygons[inside] + 0.5) * _FINE - 0.5) * 2**_SHIFT  # pixel centres have integer coordinates in both grids
        for polygon in np.round(placed).astype(np.int32):
            cv2.fillConvexPoly(fine, polygon, 1, cv2.LINE_8, _SHIFT)
    both = fine + cv2.erode(fine, _CROSS)
    return 0.5 * both.reshape(height, _FINE, width, _FINE).mean(axis=(1, 3), dtype=np.float32)


def pixels(view: View, optics: Optics, points_mm: Array) -> Array:
    """Project points (N, 3), mm, canister frame, to pixels (N, 2). Points that are not visible are NaN."""
    within = np.hypot(points_mm[:, 0], points_mm[:, 1]) < optics.inner_radius_mm
    found = np.full((len(points_mm), 2), np.nan)
    if within.any():
        found[within] = cameras.project_inner(view, optics, points_mm[within])
    return found


def _project_segments(view: View, optics: Optics, root: Root) -> Array:
    """Return the projection of each segment of a root as a quadrangle (N - 1, 4, 2), in pixels.

    Its long sides are the projected axis, shifted to both sides by the radius, perpendicular to the line of sight.
    """
    points = root.points_mm
    across = np.cross(np.gradient(points, axis=0), points - view.centre_mm)
    across *= (0.5 * root.diameters_mm / np.maximum(np.linalg.norm(across, axis=1), 1e-12))[:, None]
    one, other = (pixels(view, optics, points + side * across) for side in (1.0, -1.0))
    return np.stack([one[:-1], one[1:], other[1:], other[:-1]], axis=1)
