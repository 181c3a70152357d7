"""Views of the canister: a camera with its pose, pixels to rays and points to pixels through the water.

Float64 reference.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.refraction import Array, Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera


@dataclass(frozen=True, kw_only=True)
class View:
    """A camera where it stood when it took a picture."""

    camera: Camera
    cam_from_canister: Array

    @property
    def centre_mm(self) -> Array:
        """Camera centre (3,) in the canister frame."""
        return frames.invert(self.cam_from_canister)[:3, 3]

    @property
    def rho_mm(self) -> float:
        """Horizontal distance of the camera from the canister's axis."""
        return float(np.hypot(*self.centre_mm[:2]))

    @property
    def azimuth_from_canister(self) -> Array:
        """4x4 rotation about z that brings the camera's centre to (rho, 0, z)."""
        x, y, _ = self.centre_mm
        return frames.rotation_z(-float(np.arctan2(y, x)))


def matrix(camera: Camera) -> Array:
    """Return the 3x3 OpenCV camera matrix."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def camera_directions(camera: Camera, px: Array) -> Array:
    """Return unit directions (N, 3) in the camera's frame of pixels (N, 2), lens distortion undone to 1e-10."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-13)
    flat = np.ascontiguousarray(px, np.float64).reshape(-1, 1, 2)
    undone = cv2.undistortPoints(flat, matrix(camera), np.array(camera.distortion), criteria=criteria).reshape(-1, 2)
    cam = np.concatenate([undone, np.ones((len(undone), 1))], axis=1)
    return np.asarray(cam / np.linalg.norm(cam, axis=1, keepdims=True))


def pixel_directions(view: View, px: Array) -> Array:
    """Return unit directions (N, 3) in the azimuth frame of pixels (N, 2), lens distortion undone to 1e-10."""
    return in_azimuth(view, camera_directions(view.camera, px))


def in_azimuth(view: View, directions: Array) -> Array:
    """Turn directions (N, 3) from the camera's frame into the azimuth frame."""
    azimuth_from_cam = view.azimuth_from_canister @ frames.invert(view.cam_from_canister)
    return np.asarray(directions @ azimuth_from_cam[:3, :3].T)


def direction_pixels(view: View, directions: Array) -> Array:
    """Return the pixels (..., 2) of directions (..., 3) in the azimuth frame; NaN for what is behind the camera."""
    cam_from_azimuth = view.cam_from_canister @ frames.invert(view.azimuth_from_canister)
    cam = directions @ cam_from_azimuth[:3, :3].T
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = np.where(cam[..., 2] > 0, cam[..., 0] / cam[..., 2], np.nan), cam[..., 1] / cam[..., 2]
    k1, k2, p1, p2, k3 = view.camera.distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    (fx, fy), (cx, cy) = view.camera.focal_px, view.camera.principal_px
    return np.stack([fx * u + cx, fy * v + cy], axis=-1)


def water_lines(view: View, optics: Optics, px: Array) -> tuple[refraction.WaterLine, NDArray[np.bool_]]:
    """Follow pixels (N, 2) into the water.

    Returns
    -------
    line : WaterLine
        Lines of sight in the azimuth frame, NaN where the ray misses.
    enters : (N,) bool array
        Whether the ray enters the water through the wall.
    """
    w, p_z = refraction.invariants(view.rho_mm, optics.outer_radius_mm, pixel_directions(view, px))
    inside = np.abs(w) < optics.w_limit
    w = np.where(inside, w, np.nan)
    line = refraction.trace(optics, view.rho_mm, float(view.centre_mm[2]), w, p_z)
    with np.errstate(invalid="ignore"):
        enters = (
            inside & (line.entry_z_mm < optics.water_z_mm) & (line.entry_z_mm > optics.floor_z_mm) & (line.outer_z_mm > optics.bottom_z_mm)
        )
    return line, enters


def project(view: View, optics: Optics, points_mm: Array) -> tuple[Array, NDArray[np.int64]]:
    """Project water points into a view, every image of each.

    Parameters
    ----------
    points_mm : (N, 3) float64 array
        In the canister frame, inside the water's radius.

    Returns
    -------
    px : (N, 3, 2) float64 array
        Pixels of up to three images, NaN where there are fewer.
    count : (N,) int64 array
        Number of images; 0 where the view is blind.
    """
    points = frames.apply(view.azimuth_from_canister, points_mm)
    w, p_z, count = refraction.images(optics, view.rho_mm, float(view.centre_mm[2]), points)
    return direction_pixels(view, refraction.direction_in_air(view.rho_mm, optics.outer_radius_mm, w, p_z)), count


def project_inner(view: View, optics: Optics, points_mm: Array) -> Array:
    """Project water points (N, 3) that a view sees once, fast.

    Their pixels (N, 2), NaN for those far out and those it cannot see.
    """
    w, p_z = refraction.image(optics, view.rho_mm, float(view.centre_mm[2]), frames.apply(view.azimuth_from_canister, points_mm))
    return direction_pixels(view, refraction.direction_in_air(view.rho_mm, optics.outer_radius_mm, w, p_z))
