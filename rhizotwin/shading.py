"""Orthographic renderer of meshes for figures, with depth buffer, smooth normals and soft shading."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.results.parts import Mesh

Floats = NDArray[np.float64]
Pixels = NDArray[np.float32]

PAIRS_AT_ONCE = 2_000_000
"""Maximum number of pairs of a triangle and a pixel that are processed in one vectorised step. It limits the memory."""


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
    # pixel centres are at integers, and rows count downwards
    flat = np.stack([(view[:, 0] - left) / px_mm - 0.5, (top - view[:, 1]) / px_mm - 0.5, view[:, 2]], axis=1)
    low = np.maximum(np.ceil(_of_faces(np.minimum, flat[:, :2], mesh.faces)).astype(np.int64), 0)
    high = np.minimum(np.floor(_of_faces(np.maximum, flat[:, :2], mesh.faces)).astype(np.int64) + 1, [width, height])
    size = np.maximum(high - low, 0)
    some = np.flatnonzero(size.prod(axis=1))  # most triangles of a fine mesh contain no pixel centre
    low, size, faces = low[some], size[some], mesh.faces[some]
    pairs, planes = size.prod(axis=1), _planes(flat, faces)
    normals = (vertex_normals(mesh) @ side.axes.T).astype(np.float32)

    depth = np.full(width * height, -np.inf)
    found = np.zeros((width * height, 3), np.float32)
    block = np.cumsum(pairs) // PAIRS_AT_ONCE
    for part in np.split(np.arange(len(pairs)), np.flatnonzero(np.diff(block)) + 1):
        triangle = np.repeat(part, pairs[part])
        if not len(triangle):
            continue
        step = np.arange(len(triangle)) - np.repeat(np.cumsum(pairs[part]) - pairs[part], pairs[part])
        step_y, step_x = np.divmod(step, size[triangle, 0])
        x, y = low[triangle, 0] + step_x, low[triangle, 1] + step_y
        w_b, w_c, z = (plane[0] * x + plane[1] * y + plane[2] for plane in planes[:, :, triangle])
        inside = np.flatnonzero(np.minimum(np.minimum(w_b, w_c), 1.0 - w_b - w_c) >= -1e-9)
        pixel, z = (y * width + x)[inside], z[inside]
        np.maximum.at(depth, pixel, z)
        front = z == depth[pixel]
        inside, pixel = inside[front], pixel[front]
        weights = np.stack([1.0 - w_b[inside] - w_c[inside], w_b[inside], w_c[inside]], axis=1).astype(np.float32)
        found[pixel] = np.einsum("ij,ijk->ik", weights, normals[faces[triangle[inside]]])
    hit = np.isfinite(depth)
    length = np.sqrt(np.einsum("ij,ij->i", found, found))[:, None]
    normal = (found / np.where(length > 0.0, length, 1.0)).astype(np.float32)
    shape = (height, width)
    return Raster(
        hit=hit.reshape(shape),
        depth_mm=np.where(hit, depth, 0.0).astype(np.float32).reshape(shape),
        normal=normal.reshape(*shape, 3),
    )


def _of_faces(least: np.ufunc, values: Floats, faces: NDArray[np.int64]) -> Floats:
    """Return the minimum or maximum (F, K), over the three corners of each face (F, 3), of K values per vertex (V, K).

    ``least`` is the function of two arrays that computes the minimum or the maximum.
    """
    a, b, c = (values[corner] for corner in faces.T)
    return np.asarray(least(least(a, b), c))


def _planes(flat: Floats, faces: NDArray[np.int64]) -> Floats:
    """Return three linear functions of the pixel for each triangle (3, 3, F).

    The functions are the barycentric weights of the second and third corner, and the depth. Each consists of the
    derivatives by x and y and the value at the origin. All are NaN for triangles seen edge-on, which cover no pixel.
    """
    a, b, c = (flat[corner].T for corner in faces.T)
    (b_x, b_y, b_z), (c_x, c_y, c_z) = b - a, c - a
    det = b_x * c_y - c_x * b_y
    det[det == 0.0] = np.nan
    by_x, by_y = np.stack([c_y, -b_y]) / det, np.stack([-c_x, b_x]) / det
    planes = np.stack([by_x, by_y, -by_x * a[0] - by_y * a[1]], axis=1)
    depth = planes[0] * b_z + planes[1] * c_z
    depth[2] += a[2]
    return np.concatenate([planes, depth[None]])


def vertex_normals(mesh: Mesh) -> Floats:
    """Return the outward normals (V, 3) of the vertices.

    The normal of a vertex is the sum of the area vectors of its triangles, and does not have unit length. Their
    orientation makes the signed volume of the mesh positive.
    """
    a, b, c = mesh.corners_mm
    area = np.cross(b - a, c - a)
    if np.einsum("ij,ij->", a - mesh.vertices_mm.mean(axis=0), area) < 0.0:
        area = -area
    count = len(mesh.vertices_mm)
    return np.stack([np.bincount(mesh.faces.ravel(), weights=np.repeat(area[:, k], 3), minlength=count) for k in range(3)], axis=1)


def unit_normals(mesh: Mesh) -> Floats:
    """Return the outward unit normals (V, 3) of the vertices.

    The normal of a vertex without triangles is zero.
    """
    normals = vertex_normals(mesh)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


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
        rgba = rgba[: height * shrink, : width * shrink].reshape(height, shrink, width, shrink, 4).mean(axis=(1, 3))
    rgba[..., :3] /= np.maximum(rgba[..., 3:], 1e-9)
    return np.asarray(np.clip(rgba, 0.0, 1.0))
