"""Orthographic renderer of meshes for figures, with depth buffer, smooth normals and soft shading."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.drawing.normals import vertex_normals
from rhizotwin.recon.lattice.compiled import compiled
from rhizotwin.recon.results.parts import Mesh

Floats = NDArray[np.float64]
Pixels = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Side:
    """Viewing direction.

    It is defined by the two directions in the canister frame that point right and up in the picture.
    """

    name: str
    right: tuple[float, float, float]
    up: tuple[float, float, float]
    right_label: str

    @property
    def axes(self) -> Floats:
        """Rotation matrix (3, 3) whose rows are the directions right, up and towards the viewer."""
        return np.array([self.right, self.up, np.cross(self.right, self.up)])


FRONT = Side(name="front (seen from +x)", right=(0.0, 1.0, 0.0), up=(0.0, 0.0, 1.0), right_label="y (mm)")
"""View from +x."""
SIDE = Side(name="side (seen from -y)", right=(1.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), right_label="x (mm)")
"""View from -y."""


@dataclass(frozen=True, kw_only=True)
class Raster:
    """Rendered mesh as arrays of pixels, with the top row first."""

    hit: NDArray[np.bool_]
    """Mask (H, W) of the pixels that the surface covers."""
    depth_mm: Pixels
    """Depth map (H, W), as the coordinate of the surface towards the viewer, in mm. It is 0 in pixels without a
    surface."""
    normal: Pixels
    """Unit normals of the surface (H, W, 3) with the components right, up and towards the viewer."""


def rasterise(mesh: Mesh, side: Side, *, box_mm: tuple[float, float, float, float], px_mm: float) -> Raster:
    """Render a mesh in orthographic projection.

    Parameters
    ----------
    mesh : Mesh
        Mesh to render, canister frame.
    side : Side
        Viewing direction.
    box_mm : tuple of float
        Left, right, bottom and top edge of the picture, along the axes of ``side``.
    px_mm : float
        Edge length of a pixel.

    Returns
    -------
    Raster
        Mask, depth and normals of the pixels.
    """
    left, right, bottom, top = box_mm
    width, height = max(1, round((right - left) / px_mm)), max(1, round((top - bottom) / px_mm))
    view = mesh.vertices_mm @ side.axes.T
    flat = np.stack([(view[:, 0] - left) / px_mm - 0.5, (top - view[:, 1]) / px_mm - 0.5, view[:, 2]], axis=1)
    normals = vertex_normals(mesh) @ side.axes.T
    depth, normal = np.full((height, width), -np.inf), np.zeros((height, width, 3), np.float32)
    _draw_triangles(flat, np.ascontiguousarray(mesh.faces), normals, depth, normal)
    hit = np.isfinite(depth)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    return Raster(hit=hit, depth_mm=np.where(hit, depth, 0.0).astype(np.float32), normal=normal)


@compiled
def _draw_triangles(corners: Floats, faces: NDArray[np.int64], normals: Floats, depth: Floats, normal: Pixels) -> None:
    """Draw triangles into a depth map and a map of normals.

    A pixel is drawn if its centre is inside the triangle, and nearer to the viewer than what was drawn before.

    Parameters
    ----------
    corners : (V, 3) array
        Column and row of each vertex, in pixels, and its coordinate towards the viewer.
    faces : (F, 3) array
        Indices of the vertices.
    normals : (V, 3) array
        Normals of the vertices, of any length.
    depth, normal : (H, W) array, (H, W, 3) array
        Maps that are changed. Normals are interpolated, and do not have unit length.
    """
    height, width = depth.shape
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        a_x, a_y, a_z = corners[a, 0], corners[a, 1], corners[a, 2]
        b_x, b_y, b_z = corners[b, 0] - a_x, corners[b, 1] - a_y, corners[b, 2] - a_z
        c_x, c_y, c_z = corners[c, 0] - a_x, corners[c, 1] - a_y, corners[c, 2] - a_z
        det = b_x * c_y - c_x * b_y
        if det == 0.0:  # seen edge-on
            continue
        left, right = max(np.ceil(a_x + min(0.0, b_x, c_x)), 0.0), min(np.floor(a_x + max(0.0, b_x, c_x)), width - 1.0)
        top, bottom = max(np.ceil(a_y + min(0.0, b_y, c_y)), 0.0), min(np.floor(a_y + max(0.0, b_y, c_y)), height - 1.0)
        for row in range(int(top), int(bottom) + 1):
            for column in range(int(left), int(right) + 1):
                x, y = column - a_x, row - a_y
                w_b = (x * c_y - y * c_x) / det
                w_c = (y * b_x - x * b_y) / det
                z = a_z + w_b * b_z + w_c * c_z
                if min(w_b, w_c, 1.0 - w_b - w_c) >= -1e-9 and z > depth[row, column]:
                    depth[row, column] = z
                    for axis in range(3):
                        normal[row, column, axis] = (1.0 - w_b - w_c) * normals[a, axis] + w_b * normals[b, axis] + w_c * normals[c, axis]


def _blurred(image: Pixels, sigma_px: float) -> Pixels:
    """Blur an image with a Gaussian filter.

    If the filter is wide, the image is reduced first, which saves time.
    """
    fewer = max(1, int(sigma_px / 4.0))
    height, width = image.shape
    small = cv2.resize(image, (max(1, width // fewer), max(1, height // fewer)), interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(small, (0, 0), max(sigma_px / fewer, 0.5))
    return np.asarray(cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR))


def shade(
    raster: Raster, colour: tuple[float, float, float] | NDArray[np.floating], *, px_mm: float, shrink: int = 1, flat: bool = False
) -> Pixels:
    """Shade a rendered mesh.

    The light comes from the upper left, hollows are darker, and distant parts fade to white.

    Parameters
    ----------
    raster : Raster
        Rendered mesh.
    colour : (3,) or (H, W, 3) array
        RGB colour of the mesh, or of each pixel.
    px_mm : float
        Edge length of a pixel.
    shrink : int
        Downsampling factor of rows and columns.
    flat : bool
        Reduce the shading and disable the fading, so that colours that represent numbers remain readable.

    Returns
    -------
    (H / shrink, W / shrink, 4) array
        RGBA picture with values from 0 to 1, transparent outside the mesh.
    """
    light = np.array([-0.45, 0.65, 0.75], np.float32)
    light /= np.linalg.norm(light)
    lambert = np.clip(raster.normal @ light, 0.0, 1.0)
    hit = raster.hit.astype(np.float32)
    around = _blurred(raster.depth_mm * hit, 0.7 / px_mm) / np.maximum(_blurred(hit, 0.7 / px_mm), 1e-9)
    hollow = np.clip((around - raster.depth_mm) / 6.0, 0.0, 1.0)
    ambient = 0.8 if flat else 0.38
    light_here = (ambient + (1.0 - ambient) * lambert) * (1.0 - (0.25 if flat else 0.6) * hollow)
    rgb = np.asarray(colour, np.float32) * light_here[..., None]
    if raster.hit.any() and not flat:
        near, far = raster.depth_mm[raster.hit].max(), raster.depth_mm[raster.hit].min()
        fade = 0.35 * np.clip((near - raster.depth_mm) / max(near - far, 20.0), 0.0, 1.0)[..., None]
        rgb = rgb * (1.0 - fade) + 0.92 * fade
    rgba = np.concatenate([np.clip(rgb, 0.0, 1.0) * hit[..., None], hit[..., None]], axis=2)
    if shrink > 1:
        height, width = (n // shrink for n in hit.shape)
        rgba = cv2.resize(rgba[: height * shrink, : width * shrink], (width, height), interpolation=cv2.INTER_AREA)
    rgba[..., :3] /= np.maximum(rgba[..., 3:], 1e-9)
    return np.asarray(np.clip(rgba, 0.0, 1.0))
