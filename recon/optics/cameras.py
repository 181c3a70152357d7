"""Views of the canister: camera poses, back-projection of pixels, and projection of points through the water.

This module is the float64 reference of the kernels in `recon.optics.projection`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import refraction, tank
from rhizotwin.recon.optics.refraction import Approach, Array, Optics
from rhizotwin.recon.optics.tank import TankView
from rhizotwin.scenes import frames, lens
from rhizotwin.scenes.model import Camera

Sway = tuple[float, float, float]
"""Displacement of the roots in one picture, which is proportional to the depth below the net pot. The three values are
the shifts in x and y per depth, mm/mm, and the rotation about z per depth, rad/mm, in the canister frame."""
STILL: Sway = (0.0, 0.0, 0.0)
"""Sway of static roots."""
_SINGLE = 0.97
"""Maximum distance from the axis of points that `project_inner` projects without a tank, in units of R_o / n_water.
These points have exactly one image."""
_STEPS = 30
"""Maximum number of Newton steps. Damped steps near the wall converge slowly."""
_CLOSE_MM = 1e-8
"""Distance of a ray from the point below which the ray has converged, mm."""
_DIFFERENCE = 1e-7
"""Step of central differences in the components of rays. The step keeps half of the digits of double precision."""


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

    @cached_property
    def centre_mm(self) -> Array:
        """Return the camera centre (3,) in the canister frame, mm."""
        return frames.invert(self.cam_from_canister)[:3, 3]

    @cached_property
    def rho_mm(self) -> float:
        """Return the horizontal distance of the camera from the canister's axis, mm."""
        return float(np.hypot(*self.centre_mm[:2]))

    @cached_property
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
    _, d_y, p_z = to_azimuth(view, directions).T
    with np.errstate(invalid="ignore"):
        line = refraction.from_point(view.rho_mm, float(view.centre_mm[2]), view.rho_mm * d_y / np.sqrt(1.0 - p_z**2), p_z)
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


def ray_frame(view: View, optics: Optics) -> Array:
    """Return the pose (4, 4), relative to a view's camera, of the frame in which rays have two components.

    This is the frame of the tank or, without a tank, the azimuth frame. In both frames, a camera looks in the direction
    of -x. The components q (N, 2) of a ray are those of its unit direction along y and z.
    """
    return view.cam_from_canister @ frames.invert(view.azimuth_from_canister) if optics.tank is None else tank_pose(view)


def ray_directions(view: View, optics: Optics, q: Array) -> Array:
    """Return the unit directions (N, 3), in the camera's frame, of rays with the components q (N, 2)."""
    with np.errstate(invalid="ignore"):
        direction = np.column_stack([-np.sqrt(1.0 - np.sum(q**2, axis=1)), q])
    return np.asarray(direction @ ray_frame(view, optics)[:3, :3].T)


def straight_rays(view: View, optics: Optics, points_mm: Array) -> Array:
    """Return the components (N, 2) of straight rays to points (N, 3), at their apparent depth behind a tank's front."""
    frame_from_cam = frames.invert(ray_frame(view, optics))
    x, y, z = frame_from_cam[:3, 3]
    points = frames.apply(frame_from_cam @ view.cam_from_canister, points_mm)
    depth, aside = x - points[:, 0], points[:, 1:] - [y, z]
    if optics.tank is not None:
        box = optics.tank
        depth = x - box.front_mm + box.wall_mm / box.n_wall + (box.front_mm - box.wall_mm - points[:, 0]) / box.n_liquid
    return np.asarray(aside / np.sqrt(depth**2 + np.sum(aside**2, axis=1))[:, None])


def find_rays(view: View, optics: Optics, points_mm: Array, start: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find camera rays to points in the water by Newton's method.

    The two distances by which a ray misses its point (`refraction.miss_distances`) are solved for the two components of
    the ray. A step that would lead to a ray that misses the water, or farther from the point, is halved.

    Parameters
    ----------
    points_mm : (N, 3) float64
        Points in the canister frame, mm, within the radius of the water.
    start : (N, 2) float64
        Components of the initial rays (`ray_frame`). If they miss the water, they are first moved towards the axis.

    Returns
    -------
    q : (N, 2) float64
        Components of the rays; NaN if no ray reaches the point.
    visible : (N,) bool
        Whether a ray that enters the water through the wall was found.
    """
    points = frames.apply(view.azimuth_from_canister, points_mm)

    def miss(q: Array, some: NDArray[np.int64]) -> Array:
        return refraction.miss_distances(optics, approach(view, optics, ray_directions(view, optics, q))[0], points[some])

    left = np.arange(len(points))  # not converged yet
    q = _pull_inside(start, straight_rays(view, optics, np.array([[0.0, 0.0, optics.floor_z_mm]]))[0, 0], lambda q: miss(q, left))
    for _ in range(_STEPS):
        f = miss(q[left], left)
        size = np.linalg.norm(f, axis=1)
        going = size > _CLOSE_MM  # excludes rays that miss the water
        if not going.any():
            break
        left, f, size = left[going], f[going], size[going]
        rise = [miss(q[left] + aside, left) - miss(q[left] - aside, left) for aside in _DIFFERENCE * np.eye(2)]
        slope = np.stack(rise, axis=-1) / (2.0 * _DIFFERENCE)
        good = np.asarray(np.isfinite(slope).all(axis=(1, 2)))
        good[good] &= np.abs(np.linalg.det(slope[good])) > 1e-9
        step = np.zeros_like(f)
        step[good] = np.linalg.solve(slope[good], f[good][..., None])[..., 0]
        share = np.ones(len(left))
        for _ in range(8):
            trial = q[left] - share[:, None] * step
            worse = ~(np.linalg.norm(miss(trial, left), axis=1) <= size)
            if not (worse & good).any():
                break
            share[worse] *= 0.5
        q[left[~worse]] = trial[~worse]
    near, through = approach(view, optics, ray_directions(view, optics, q))
    visible = through & refraction.enters(optics, refraction.follow(optics, near))
    visible &= np.linalg.norm(refraction.miss_distances(optics, near, points), axis=1) < 1e2 * _CLOSE_MM
    return np.where(visible[:, None], q, np.nan), visible


def _pull_inside(start: Array, axis: float, miss: Callable[[Array], Array]) -> Array:
    """Move rays that miss the water towards the axis, given by its first component, until they reach the water."""
    q = start.copy()
    for _ in range(40):
        out = ~np.isfinite(miss(q)).all(axis=1)
        if not out.any():
            break
        q[out, 0] = axis + 0.95 * (q[out, 0] - axis)  # 40 steps leave an eighth of the distance
    return q


def project_inner(view: View, optics: Optics, points_mm: Array) -> Array:
    """Project points (N, 3) in the water to pixels (N, 2), for points that have exactly one image in a view.

    The points are in the canister frame, mm, within the radius of the water. The pixels are NaN for invisible points
    and, without a tank, for points far from the axis. Through a tank whose liquid and water have different refractive
    indices, a point may have several images, of which that nearest to the straight line to the point is found.
    """
    points = apply_sway(view, optics, points_mm)
    if optics.tank is None and optics.unobstructed:
        return cam_pixels(view.camera, frames.apply(view.cam_from_canister, points))
    single_mm = _SINGLE * optics.outer_radius_mm / optics.n_water if optics.tank is None else np.inf
    near, px = np.hypot(points[:, 0], points[:, 1]) < single_mm, np.full((len(points), 2), np.nan)
    q, _ = find_rays(view, optics, points[near], straight_rays(view, optics, points[near]))
    px[near] = cam_pixels(view.camera, ray_directions(view, optics, q))
    return px
