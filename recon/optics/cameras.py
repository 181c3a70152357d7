"""Views of the canister: camera poses, back-projection of pixels, and projection of points through the water.

This module is the float64 reference of the kernels in `recon.optics.projection`.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import point_images, refraction, tank
from rhizotwin.recon.optics.refraction import Approach, Array, Optics
from rhizotwin.recon.optics.tank import TankView
from rhizotwin.scenes import frames, lens
from rhizotwin.scenes.model import Camera

Sway = tuple[float, float, float]
"""Displacement of the roots in one picture, which is proportional to the depth below the net pot. The three values are
the shifts in x and y per depth, mm/mm, and the rotation about z per depth, rad/mm, in the canister frame."""
STILL: Sway = (0.0, 0.0, 0.0)
"""Sway of static roots."""


@dataclass(frozen=True, kw_only=True)
class View:
    """Camera and pose of one picture."""

    camera: Camera
    """Lens and image size of the camera."""
    cam_from_canister: Array
    """(4, 4) transform from the canister frame to the camera's frame, mm, OpenCV axes."""
    cam_from_tank: Array | None = None
    """(4, 4) transform from the tank's frame to the camera's frame, mm; None if there is no tank. The tank's frame is
    that of the rig, rotated with the tank."""
    sway: Sway = STILL
    """Displacement of the roots in this picture, see `Sway`."""

    def move_camera(self, motion: Array) -> "View":
        """Return the view after a rigid motion (4, 4) of the camera in the camera's frame.

        The canister and the tank do not move.
        """
        tank = None if self.cam_from_tank is None else motion @ self.cam_from_tank
        return replace(self, cam_from_canister=motion @ self.cam_from_canister, cam_from_tank=tank)

    @property
    def centre_mm(self) -> Array:
        """Return the camera centre (3,) in the canister frame, mm."""
        return frames.invert(self.cam_from_canister)[:3, 3]

    @property
    def rho_mm(self) -> float:
        """Return the horizontal distance of the camera from the canister's axis, mm."""
        return float(np.hypot(*self.centre_mm[:2]))

    @property
    def azimuth_from_canister(self) -> Array:
        """Return the rotation (4, 4) about z that moves the camera centre to (rho, 0, z)."""
        x, y, _ = self.centre_mm
        return frames.rotation_z(-float(np.arctan2(y, x)))


def apply_sway(view: View, optics: Optics, points_mm: Array) -> Array:
    """Displace points (N, 3) of the roots by the sway of a view.

    The points are in the canister frame, mm.
    """
    x, y, z = points_mm.T
    aside, along, turned = view.sway
    return points_mm + ((optics.water_z_mm - z) * np.stack([aside - turned * y, along + turned * x, np.zeros_like(z)])).T


def sway_jacobian(view: View, optics: Optics, points_mm: Array) -> Array:
    """Return the derivatives (N, 3, 3) of `apply_sway` with respect to the points (N, 3)."""
    x, y, z = points_mm.T
    aside, along, turned = view.sway
    found = np.tile(np.eye(3), (len(points_mm), 1, 1))
    found[:, 0, 1], found[:, 1, 0] = -turned * (optics.water_z_mm - z), turned * (optics.water_z_mm - z)
    found[:, 0, 2], found[:, 1, 2] = turned * y - aside, -along - turned * x
    return found


def matrix(camera: Camera) -> Array:
    """Return the OpenCV camera matrix (3, 3)."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def camera_directions(camera: Camera, px: Array) -> Array:
    """Return the unit directions (N, 3) of pixels (N, 2) in the camera's frame, corrected for lens distortion.

    The lens distortion is inverted with an accuracy of 1e-10.
    """
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-13)
    flat = np.ascontiguousarray(px, np.float64).reshape(-1, 1, 2)
    undone = cv2.undistortPoints(flat, matrix(camera), np.array(camera.distortion), criteria=criteria).reshape(-1, 2)
    cam = np.concatenate([undone, np.ones((len(undone), 1))], axis=1)
    return np.asarray(cam / np.linalg.norm(cam, axis=1, keepdims=True))


def to_azimuth(view: View, directions: Array) -> Array:
    """Rotate directions (N, 3) from the camera's frame to the azimuth frame."""
    azimuth_from_cam = view.azimuth_from_canister @ frames.invert(view.cam_from_canister)
    return np.asarray(directions @ azimuth_from_cam[:3, :3].T)


def direction_pixels(view: View, directions: Array) -> Array:
    """Project directions (..., 3) in the azimuth frame to pixels (..., 2); NaN where `cam_pixels` is."""
    cam_from_azimuth = view.cam_from_canister @ frames.invert(view.azimuth_from_canister)
    return cam_pixels(view.camera, directions @ cam_from_azimuth[:3, :3].T)


def cam_pixels(camera: Camera, cam: Array) -> Array:
    """Project directions (..., 3) in the camera's frame to pixels (..., 2).

    The pixels are NaN behind the camera, and where the lens distortion is not valid (`scenes.lens.fold_r2`).
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = np.where(cam[..., 2] > 0, cam[..., 0] / cam[..., 2], np.nan), cam[..., 1] / cam[..., 2]
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    x = np.where(r2 < lens.fold_r2(camera.distortion), x, np.nan)
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    return np.stack([fx * u + cx, fy * v + cy], axis=-1)


def tank_pose(view: View) -> Array:
    """Return the pose (4, 4) of the tank relative to a view's camera.

    Raises
    ------
    ValueError
        If the pose is unknown.
    """
    if view.cam_from_tank is None:
        raise ValueError(f"{view.cam_from_tank=} but expected a pose, because the scene has a tank")
    return view.cam_from_tank


def tank_view(view: View, optics: Optics) -> TankView:
    """Return the relative poses of the camera, the tank and the canister in a view."""
    if optics.tank is None:
        raise ValueError(f"{optics.tank=} but expected a tank")
    cam_from_tank = tank_pose(view)
    return TankView(
        tank=optics.tank,
        centre_mm=frames.invert(cam_from_tank)[:3, 3],
        azimuth_from_tank=view.azimuth_from_canister @ frames.invert(view.cam_from_canister) @ cam_from_tank,
        optics=optics,
    )


def approach(view: View, optics: Optics, directions: Array) -> tuple[Approach, NDArray[np.bool_]]:
    """Trace rays (N, 3), given in the camera's frame, up to the canister.

    Returns
    -------
    line : Approach
        Lines of sight in the azimuth frame.
    through : (N,) bool array
        Whether each ray passes through a tank's front below the liquid's surface; always true without a tank.
    """
    if optics.tank is not None:
        at = tank_view(view, optics)
        along = directions @ tank_pose(view)[:3, :3]
        return tank.approach(at, along[:, 1], along[:, 2])
    w, p_z = refraction.invariants(view.rho_mm, optics.outer_radius_mm, to_azimuth(view, directions))
    with np.errstate(invalid="ignore"):
        line = refraction.from_point(view.rho_mm, float(view.centre_mm[2]), w * optics.outer_radius_mm, p_z)
    return line, np.ones(len(directions), bool)


def length_behind_canister(view: View, optics: Optics, near: Approach, line: refraction.WaterLine) -> Array:
    """Return the horizontal length of lines of sight from the canister's outer wall to a tank's back wall.

    Parameters
    ----------
    view, optics : View, Optics
        Camera and pose of the view, and optics with a tank.
    near, line : Approach, refraction.WaterLine
        Lines of sight in front of the canister and in the water.

    Returns
    -------
    (...) array
        Length, mm.
    """
    at = tank_view(view, optics)
    tank_from_azimuth = frames.invert(at.azimuth_from_tank)
    heading = 2.0 * line.heading_rad - near.heading_rad  # the path out mirrors the path in
    t = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    nu = np.stack([np.sin(heading), -np.cos(heading)], axis=-1)
    leave = near.b_mm[..., None] * nu + np.sqrt(optics.outer_radius_mm**2 - near.b_mm**2)[..., None] * t
    x = leave @ tank_from_azimuth[0, :2] + tank_from_azimuth[0, 2] * line.entry_z_mm + tank_from_azimuth[0, 3]
    return np.asarray((x + at.tank.front_mm - at.tank.wall_mm) / np.maximum(-(t @ tank_from_azimuth[0, :2]), 1e-3))


def water_lines(view: View, optics: Optics, px: Array) -> tuple[refraction.WaterLine, NDArray[np.bool_]]:
    """Trace the lines of sight of pixels (N, 2) into the water.

    Returns
    -------
    line : WaterLine
        Lines of sight in the azimuth frame; NaN for rays that miss the water.
    enters : (N,) bool array
        Whether each ray enters the water through the wall.
    """
    near, through = approach(view, optics, camera_directions(view.camera, px))
    inside = through & refraction.reaches_water(optics, near)
    line = refraction.follow(optics, replace(near, b_mm=np.where(inside, near.b_mm, np.nan)))
    return line, inside & refraction.enters(optics, line)


def project(view: View, optics: Optics, points_mm: Array) -> tuple[Array, NDArray[np.int64]]:
    """Project points in the water into a view, and find all images of each point.

    Through a tank, and if nothing obstructs rays, only the image of `project_inner` is found.

    Parameters
    ----------
    points_mm : (N, 3) float64 array
        Points in the canister frame, mm, within the radius of the water.

    Returns
    -------
    px : (N, 3, 2) float64 array
        Pixels of up to three images; NaN for missing images.
    count : (N,) int64 array
        Number of images; 0 where the view is blind.
    """
    if optics.tank is not None or optics.unobstructed:
        px = project_inner(view, optics, points_mm)
        missing = np.full_like(px, np.nan)
        return np.stack([px, missing, missing], axis=1), np.isfinite(px[:, 0]).astype(np.int64)
    points = frames.apply(view.azimuth_from_canister, apply_sway(view, optics, points_mm))
    w, p_z = point_images.find_images(optics, view.rho_mm, float(view.centre_mm[2]), points)
    px = direction_pixels(view, refraction.direction_in_air(view.rho_mm, optics.outer_radius_mm, w, p_z))
    return px, np.asarray(np.isfinite(px[..., 0]).sum(axis=1), np.int64)


def project_inner(view: View, optics: Optics, points_mm: Array) -> Array:
    """Project points (N, 3) in the water to pixels (N, 2), for points that have exactly one image in a view.

    This function is faster than `project`. The pixels are NaN for points far from the axis, and for invisible points.
    """
    if optics.tank is not None:
        return project_through_tank(view, optics, points_mm)[0]
    if optics.unobstructed:
        return cam_pixels(view.camera, frames.apply(view.cam_from_canister, apply_sway(view, optics, points_mm)))
    points = frames.apply(view.azimuth_from_canister, apply_sway(view, optics, points_mm))
    w, p_z = point_images.find_single_image(optics, view.rho_mm, float(view.centre_mm[2]), points)
    return direction_pixels(view, refraction.direction_in_air(view.rho_mm, optics.outer_radius_mm, w, p_z))


def project_through_tank(view: View, optics: Optics, points_mm: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Project points in the water through a tank's front and the canister's wall, with derivatives.

    Parameters
    ----------
    points_mm : (N, 3) float64 array
        Points in the canister frame, mm, within the radius of the water.

    Returns
    -------
    px : (N, 2) float64 array
        Pixels; NaN for invisible points.
    visible : (N,) bool array
        Whether each point is visible.
    jacobian : (N, 2, 3) float64 array
        Derivatives of the pixels with respect to the points, px/mm, from the implicit function theorem: ``dq =
        -(df/dq)^-1 df/dP``.
    """
    at = tank_view(view, optics)
    points = frames.apply(view.azimuth_from_canister, apply_sway(view, optics, points_mm))
    q, visible = tank.find_rays(at, points)
    px = _pixels(view, q)
    visible &= np.isfinite(px).all(axis=1)
    by_ray = np.stack(
        [(_pixels(view, q + step) - _pixels(view, q - step)) / (2.0 * tank.DIFFERENCE) for step in tank.DIFFERENCE * np.eye(2)], axis=-1
    )
    slopes = tank.slopes(lambda trial: tank.miss(at, points, trial), q)
    line, _ = tank.trace(at, q[:, 0], q[:, 1])
    # f1 = P . nu - b and f2 = entry + slope (P . t + ...) - P_z, with their derivatives with respect to P
    by_point = np.zeros((len(q), 2, 3))
    by_point[:, 0, :2], by_point[:, 1, :2], by_point[:, 1, 2] = line.nu, line.slope[:, None] * line.t, -1.0
    jacobian = np.full((len(q), 2, 3), np.nan)
    jacobian[visible] = -by_ray[visible] @ np.linalg.solve(slopes[visible], by_point[visible])
    return px, visible, jacobian @ view.azimuth_from_canister[:3, :3] @ sway_jacobian(view, optics, points_mm)


def _pixels(view: View, q: Array) -> Array:
    """Return the pixels (N, 2) of rays.

    The rays are given by the components q (N, 2) of their unit directions along the tank's front.
    """
    with np.errstate(invalid="ignore"):
        direction = np.column_stack([-np.sqrt(1.0 - np.sum(q**2, axis=1)), q])
    return cam_pixels(view.camera, direction @ tank_pose(view)[:3, :3].T)
