"""Pose of the canister in the marker strip, estimated from the edges of the canister in front of the backlight.

The cameras are calibrated in the frame of the strip, which is attached to a net pot that may be misaligned with the
canister. The light, however, is refracted by the canister. A line of sight tangent to the outer wall passes the
canister's axis at exactly the outer radius, independent of the wall and the water (Bouguer's invariant at |b| = R_o).
Inside the edge, the picture is black, because grazing light is reflected away. Outside the edge, it shows the empty
panel.

The offset and tilt of the axis are estimated from the edges in all views by one least-squares fit. Two further unknowns
are common to all edges: their distance outside R_o, due to blur or a canister of another size, and the ovality of the
wall. The support function of an oval with the radii R + e and R - e is R + e cos 2(azimuth - azimuth of the largest
radius), to first order in e / R.

In a tank, the same relation holds for the lines of sight in the liquid, because light that enters the wall inside the
edge is strongly deflected. However, light reflected by the wall continues nearly straight. In front of a wide panel,
the edge is therefore as bright as the panel, and cannot be detected. (The twin's fast pictures omit reflections and
show a dark edge.) The rotation of the tank is a further unknown: refraction at its front moves both edges of all views
in the same direction, by a quarter of a degree per degree in water.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rhizotwin.recon.calibration.pose_errors import PoseErrors
from rhizotwin.recon.calibration.view_fit import twist
from rhizotwin.recon.optics import tank
from rhizotwin.recon.optics.cameras import View, cam_pixels, camera_directions, project_inner, tank_pose
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.robust import MAD, inverse, sandwich, scatter
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene, Tank
from rhizotwin.scenes.picture_codec import Grey

LEVELS_MM = 2.5
"""Vertical spacing of the heights at which the edges are measured, mm."""
MARGIN_MM = 8.0
"""Minimum vertical distance of the measured edge points from the net pot's skirt, the surfaces of the liquids, and the
canister's base, mm."""
REACH_MM = 4.0
"""Half-width of the search range around the edges of an aligned canister, mm."""
STEP_PX = 0.25
"""Spacing of the brightness samples across an edge, px. Two samples then fall within a blur of half a pixel."""
LEAST_RISE = 0.25
"""Minimum contrast of an accepted edge. The contrast is the rise of the brightness within three pixels, divided by the
brightness outside the canister."""
LEAST_EDGES = 200
"""Minimum number of edge points from which the pose is estimated. It is reached by two views, which show about 200
points (52 heights, two sides). A single view does not determine the tilt towards the camera."""
_SCALE = np.array([1e-3, 1e-3, 0.1, 0.1, 0.1, 0.1, 0.1, 4e-3])
"""Scale of each unknown, rad or mm, for the optimiser and for finite differences. A change by one scale moves the edges
by a similar distance for all unknowns. A tilt of one milliradian moves an edge by 0.08 mm at half the canister's
height. A rotation of the tank has a quarter of this effect over its depth, so its scale is four times as large."""
_POSE_SCALE = np.array([1e-3] * 3 + [0.1] * 3)
"""Scale of each component of a camera's twist, rad or mm, for finite differences. A change by one scale moves the edges
by a similar distance for all components."""
PRIOR = np.array([np.deg2rad(1.0), np.deg2rad(1.0), 2.0, 2.0, 1.0, 0.25, 0.25, np.deg2rad(2.0)])
"""Prior standard deviations of the unknowns. In this order, the unknowns are the tilt of the net pot (2 values, rad),
its offset (2 values, mm), the distance of the edges from the nominal radius (mm), the ovality (2 values, mm), and the
rotation of the tank (rad). The ovality is that of cast tube as sold, whose largest and smallest diameters differ by
half a millimetre. The rotation is that of a tank placed by eye."""
_OPEN = 7
"""Number of unknowns of a scan without a tank. A tank adds its rotation as the last unknown."""

TOGETHER_MM = 20.0
"""Length along an edge over which the position errors of edge points are correlated, mm. Over this length, the almost
vertical edge lies between the same two pixel columns. The correlation is 0.7, 0.5, 0.3 and 0.1 at distances of 2.5, 5,
10 and 20 mm (bench, 400x300 pixels)."""
LEAST_STIFFNESS = 0.1
"""Lower limit of the mean second derivative of the Cauchy loss, which scales the normal matrix from which the
covariance is computed. The mean is 0.14 if the edge points scatter by twice the scale of the loss, and 0.03 if they
scatter by five times the scale."""


@dataclass(frozen=True, kw_only=True)
class CanisterPose:
    """Pose of the canister's axis in the frame of the strip."""

    canister_from_strip: Array
    """(4, 4) transform from the frame of the strip to the canister frame, mm. The shift along the axis and the rotation
    about it are zero, because the edges do not determine them."""
    covariance: Array
    """(4, 4) covariance of the canister's tilt about x and y, rad, and its offset in x and y, mm. The errors shared by
    all cameras are not included."""
    by_cameras: Array
    """(4, S) derivatives of the canister's tilt, rad, and offset, mm, with respect to the S errors that all cameras
    share (`PoseErrors`)."""
    sigma: Array
    """(4,) standard deviations of the tilt about x and y, degrees, and of the offset in x and y, mm, including the
    errors shared by all cameras."""
    radius_excess_mm: float
    """Radius at which the edges are found, minus the nominal outer radius, mm."""
    oval_mm: float
    """Half the difference between the largest and the smallest outer radius, mm."""
    oval_deg: float
    """Azimuth of the largest outer radius, degrees, from 0 to 180."""
    edges: int
    """Number of edge points used in the fit."""
    tank_turn_deg: float
    """Rotation of the tank about the vertical axis, relative to its orientation in the scene, degrees. It is 0 without
    a tank."""
    tank_sigma_deg: float
    """Standard deviation of the tank's rotation, degrees; 0 without a tank."""
    before_mm: float
    """Median distance of the edge points from the edges of an aligned canister, mm. A distance common to all edge
    points is subtracted first."""
    after_mm: float
    """Median distance of the edge points from the fitted edges, mm."""


def _sigmas(covariance: Array, by_cameras: Array, errors: PoseErrors | None) -> Array:
    """Return the standard deviations (N,) of the estimates, including the propagated errors that all cameras share."""
    shared = np.zeros((6, 6)) if errors is None else errors.shared
    return np.asarray(np.sqrt(np.diag(covariance + by_cameras @ shared @ by_cameras.T)))


def find_canister(
    views: Sequence[View],
    images: Callable[[int], Grey],
    scene: Scene,
    *,
    errors: PoseErrors | None = None,
    settings: CalibrationSettings = CalibrationSettings(),
) -> CanisterPose | None:
    """Estimate the pose of the canister in the strip.

    Parameters
    ----------
    views : sequence of View
        Cameras of the views, in the frame of the strip.
    images : callable
        Function that returns the picture of a view from the index of the view.
    scene : Scene
        Scene with the radius and height of the canister, and the skirt of the net pot.
    errors : PoseErrors, optional
        Errors of the camera poses; by default, the cameras are treated as exact.
    settings : CalibrationSettings
        Scale of the robust loss for the edges.

    Returns
    -------
    CanisterPose or None
        Estimated pose. None if the pictures do not show enough of the canister's edges, for example because the
        backlight is no wider than the canister, or the surroundings are dark.
    """
    edges = _Edges.from_pixels([_edge_pixels(view, images(k), scene) for k, view in enumerate(views)], views, Optics.from_scene(scene))
    prior, scale = (part[: _OPEN if scene.tank is None else None] for part in (PRIOR, _SCALE))
    if len(edges.view) < LEAST_EDGES:
        return None

    def residuals(unknown: Array) -> Array:
        return np.concatenate([edges.off(unknown), unknown / prior * settings.edge_mm / np.sqrt(len(edges.view))])

    fit = least_squares(residuals, np.zeros(len(prior)), loss="cauchy", f_scale=settings.edge_mm, x_scale=scale)
    left = edges.off(fit.x)
    spread_mm = MAD * float(np.median(np.abs(left)))
    near = np.abs(left) < 4.0 * max(spread_mm, 1e-3)
    if near.sum() < LEAST_EDGES:
        return None
    covariance, by_cameras = _uncertainty(edges.select(near), fit.x, errors, settings)
    sigma = _sigmas(covariance, by_cameras, errors)
    straight = edges.off(np.zeros(len(prior)))[near]
    return CanisterPose(
        canister_from_strip=_canister_from_strip(fit.x),
        covariance=covariance[:4, :4],
        by_cameras=by_cameras[:4],
        sigma=np.concatenate([np.rad2deg(sigma[:2]), sigma[2:4]]),
        radius_excess_mm=float(fit.x[4]),
        oval_mm=float(np.hypot(fit.x[5], fit.x[6])),
        oval_deg=float(np.rad2deg(0.5 * np.arctan2(fit.x[6], fit.x[5])) % 180.0),
        edges=int(near.sum()),
        tank_turn_deg=float(np.rad2deg(fit.x[_OPEN])) if len(prior) > _OPEN else 0.0,
        tank_sigma_deg=float(np.rad2deg(sigma[4])) if len(prior) > _OPEN else 0.0,
        before_mm=float(np.median(np.abs(straight - np.median(straight)))),
        after_mm=float(np.median(np.abs(left[near]))),
    )


@dataclass(frozen=True, kw_only=True)
class _Edges:
    """Lines of sight through the canister's edges."""

    views: Sequence[View]
    """(V,) cameras in the frame of the strip."""
    optics: Optics
    view: NDArray[np.int64]
    """(N,) index of the view of each line."""
    side: NDArray[np.int64]
    """(N,) side of the canister on which the line passes: 0 at the smaller azimuth, 1 at the larger azimuth."""
    ray: Array
    """(N, 3) direction of each line in the camera's frame."""
    place: NDArray[np.int64]
    """(N,) index of the pixel block that contains the edge point. A block is one pixel wide across the edge, and
    `TOGETHER_MM` long along the edge."""

    @staticmethod
    def from_pixels(found: Sequence[tuple[Array, Array]], views: Sequence[View], optics: Optics) -> _Edges:
        """Return the lines of sight through the edge pixels (M, 2) of each view."""
        px = np.concatenate([pixels for pixels, _ in found])
        owner = np.repeat(np.arange(len(views)), [len(pixels) for pixels, _ in found])
        rays = [camera_directions(view.camera, pixels) for (pixels, _), view in zip(found, views, strict=True) if len(pixels)]
        side = np.concatenate([sides for _, sides in found])
        one = px[(owner == owner[0]) & (side == side[0])] if len(px) else np.zeros((1, 2))
        along = int(np.argmax(np.ptp(one, axis=0)))  # rows, if edges are vertical in the pictures
        block = np.ones(2)
        block[along] = TOGETHER_MM * views[0].camera.focal_px[0] / views[0].rho_mm
        return _Edges(
            views=views,
            optics=optics,
            view=owner,
            side=side,
            ray=np.concatenate([*rays, np.empty((0, 3))]),
            place=np.asarray(np.unique(np.floor(px / block), axis=0, return_inverse=True)[1].ravel(), np.int64),
        )

    def lines(self, tank_turn_rad: float) -> tuple[Array, Array]:
        """Return a point (N, 3) and the direction (N, 3) of each line outside the canister, in the strip's frame.

        For a tank, these are the lines in the liquid.
        """
        if self.optics.tank is None:
            turned = np.einsum("ni,nij->nj", self.ray, np.array([view.cam_from_canister[:3, :3] for view in self.views])[self.view])
            return np.array([view.centre_mm for view in self.views])[self.view], turned
        turn = frames.rotation_z(tank_turn_rad)
        poses = np.array([tank_pose(view) @ turn for view in self.views])
        centre = np.array([frames.invert(pose)[:3, 3] for pose in poses])[self.view]
        q = np.einsum("ni,nij->nj", self.ray, poses[:, :3, :3][self.view])
        point, p, _ = tank.in_liquid(self.optics.tank, centre, q[:, 1], q[:, 2])
        strip_from_tank = np.array([frames.invert(view.cam_from_canister) @ pose for view, pose in zip(self.views, poses, strict=True)])
        here = strip_from_tank[self.view]
        return np.einsum("nij,nj->ni", here[:, :3, :3], point) + here[:, :3, 3], np.einsum("nij,nj->ni", here[:, :3, :3], p)

    def off(self, unknown: Array) -> Array:
        """Return the signed distance (N,) of each line from the outer wall, mm, positive outside the wall.

        The elements of ``unknown`` are the tilt (2 values), the offset (2 values), the excess of the radius, the
        ovality (2 values), and the rotation of the tank.
        """
        canister_from_strip = _canister_from_strip(unknown)
        origin, direction = self.lines(float(unknown[_OPEN]) if len(unknown) > _OPEN else 0.0)
        start, along = frames.apply(canister_from_strip, origin), direction @ canister_from_strip[:3, :3].T
        away_mm, azimuth = _distance_from_axis(start, along)
        oval_mm = unknown[5] * np.cos(2.0 * azimuth) + unknown[6] * np.sin(2.0 * azimuth)
        return np.asarray(away_mm - self.optics.outer_radius_mm - unknown[4] - oval_mm)

    def select(self, some: NDArray[np.bool_]) -> _Edges:
        """Return the subset of the lines for which the mask (N,) is True."""
        rows = {name: getattr(self, name)[some] for name in ("view", "side", "place", "ray")}
        return replace(self, **rows)


def _canister_from_strip(unknown: Array) -> Array:
    """Return the pose (4, 4) of the strip in the canister, given its tilt and offset."""
    return frames.from_rotvec(np.array([unknown[0], unknown[1], 0.0]), np.array([unknown[2], unknown[3], 0.0]))


def _uncertainty(edges: _Edges, found: Array, errors: PoseErrors | None, settings: CalibrationSettings) -> tuple[Array, Array]:
    """Return the covariance of tilt and offset, and their derivatives with respect to the shared camera errors.

    The covariance has the shape (K, K), and the derivatives have the shape (K, S). K is 4 without a tank. With a tank,
    K is 5, and the last unknown is the rotation of the tank.

    The errors of edge points on one side of a view are correlated. With a static camera, the errors of edge points on
    the same pixels are also correlated between views, because the position of an edge between two pixels determines its
    error. The errors on the two sides of a view are uncorrelated (below 0.1) except for the error of the camera pose,
    which is propagated separately.
    """
    chosen = [0, 1, 2, 3, *range(_OPEN, len(found))]
    jacobian = _slopes(edges.off, found, _SCALE[: len(found)])
    square = (edges.off(found) / settings.edge_mm) ** 2
    psi = edges.off(found) / (1.0 + square)  # psi of Cauchy's loss, and its mean derivative
    stiff = max(float(np.mean((1.0 - square) / (1.0 + square) ** 2)), LEAST_STIFFNESS)
    parts = stiff * jacobian[:, :, None] * jacobian[:, None, :]
    normal = parts.sum(axis=0) + np.diag((settings.edge_mm / PRIOR[: len(found)]) ** 2 / len(edges.view))
    meat = scatter(jacobian * psi[:, None], 2 * edges.view + edges.side, edges.place, curvatures=parts, normal=normal)
    bread = inverse(normal)
    covariance = sandwich(normal, meat, bread * float(np.mean(psi**2)) / stiff)[np.ix_(chosen, chosen)]
    if errors is None:
        return covariance, np.zeros((len(chosen), 6))

    def displaced(step: Array) -> Array:
        return replace(edges, views=[view.move_camera(twist(step)) for view in edges.views]).off(found)

    by_pose = _slopes(displaced, np.zeros(6), _POSE_SCALE)
    follow = np.zeros((len(edges.views), len(found), 6))
    np.add.at(follow, edges.view, -stiff * jacobian[:, :, None] * by_pose[:, None, :])
    follow = (bread @ follow)[:, chosen]
    own = follow @ errors.own @ follow.transpose(0, 2, 1)
    return covariance + own.sum(axis=0), np.einsum("vij,vjs->is", follow, errors.carry)


def _slopes(function: Callable[[Array], Array], at: Array, scale: Array) -> Array:
    """Return the derivatives (N, K) of a function with respect to K unknowns, from central differences.

    The step is a thousandth of each unknown's ``scale`` (K,).
    """
    steps = 1e-3 * np.diag(scale)
    return np.stack([(function(at + step) - function(at - step)) / (2.0 * step.max()) for step in steps], axis=1)


def _distance_from_axis(start: Array, along: Array) -> tuple[Array, Array]:
    """Return the distance (N,) of lines from the z axis, and the azimuth (N,) of the point nearest to the axis.

    The lines are given by points (N, 3) and directions (N, 3).
    """
    cross = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    azimuth = np.arctan2(-along[:, 0] * cross, along[:, 1] * cross)
    return np.abs(cross) / np.hypot(along[:, 0], along[:, 1]), azimuth


def _edge_pixels(view: View, image: Grey, scene: Scene) -> tuple[Array, Array]:
    """Return the pixels (M, 2) of the canister's two edges in one picture, and the side (M,) of each pixel."""
    canister = scene.canister
    low = -canister.height_mm + MARGIN_MM
    high = min(scene.net_pot.skirt_bottom_mm, scene.water.level_mm, np.inf if scene.tank is None else scene.tank.level_mm) - MARGIN_MM
    z = np.arange(low, high, LEVELS_MM)
    centre, away_mm = view.centre_mm, view.rho_mm
    if scene.tank is not None:  # apparent distance of the camera, from within the liquid
        away_mm = scene.tank.front_mm + scene.tank.n_liquid * (away_mm - scene.tank.front_mm)
    azimuth, half = np.arctan2(centre[1], centre[0]), np.arccos(np.clip(canister.outer_radius_mm / away_mm, -1.0, 1.0))
    found = [
        _measure_edge(view, image, *(_pixels(view, scene, _circle(azimuth + side * half, r, z)) for r in (canister.outer_radius_mm, 0.0)))
        for side in (-1.0, 1.0)
    ]
    return np.concatenate(found), np.repeat([0, 1], [len(px) for px in found])


def _circle(angle_rad: float, radius_mm: float, z: Array) -> Array:
    return np.stack([np.full_like(z, radius_mm * np.cos(angle_rad)), np.full_like(z, radius_mm * np.sin(angle_rad)), z], axis=1)


def _pixels(view: View, scene: Scene, points_mm: Array) -> Array:
    """Return the pixels (M, 2) of points beside the canister, which are in air or in a tank's liquid."""
    if scene.tank is not None:
        return project_inner(view, _liquid(scene, scene.tank), points_mm)
    return cam_pixels(view.camera, frames.apply(view.cam_from_canister, points_mm))


def _liquid(scene: Scene, around: Tank) -> Optics:
    """Return the optics of a tank that contains liquid, but no canister."""
    radius_mm = around.front_mm - around.wall_mm
    return replace(
        Optics.from_scene(scene), outer_radius_mm=radius_mm, inner_radius_mm=radius_mm, n_wall=around.n_liquid, n_water=around.n_liquid
    )


def _measure_edge(view: View, image: Grey, at: Array, inner: Array) -> Array:
    """Return the pixels (M, 2) of one edge of the canister, searched near the given tangent points.

    One pixel is returned for each height at which the edge is distinct.
    """
    outward = at - inner
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    reach_px = max(REACH_MM * view.camera.focal_px[0] / view.rho_mm, 6.0)
    offset = np.arange(-reach_px, reach_px + STEP_PX / 2.0, STEP_PX)
    px = at[:, None, :] + offset[None, :, None] * outward[:, None, :]
    width, height = view.camera.image_wh
    inside = ((px[..., 0] >= 0) & (px[..., 0] <= width - 1) & (px[..., 1] >= 0) & (px[..., 1] <= height - 1)).all(axis=1)
    at, outward, px = at[inside], outward[inside], px[inside].astype(np.float32)
    if not len(at):
        return np.empty((0, 2))
    profile = cv2.remap(image.astype(np.float32), px[..., 0], px[..., 1], cv2.INTER_LINEAR)
    place, clear = _find_steepest(profile.astype(np.float64), offset)
    return np.asarray(at[clear] + place[clear, None] * outward[clear])


def _find_steepest(profile: Array, offset: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the offset (N,) of the edge in each profile (N, S), and whether the edge is distinct.

    The offset is the centroid of the brightness increase in the steepest part of the profile.
    """
    span = round(3.0 / STEP_PX)
    rise = np.maximum(np.diff(profile, axis=1), 0.0)
    summed = np.cumsum(np.pad(rise, ((0, 0), (1, 0))), axis=1)
    window = summed[:, span:] - summed[:, :-span]
    first = np.argmax(window, axis=1)
    index = np.arange(rise.shape[1])
    near = (index >= first[:, None]) & (index < first[:, None] + span)
    weight = np.where(near, rise, 0.0)
    total = np.maximum(weight.sum(axis=1), 1e-12)
    place = weight @ (offset[:-1] + STEP_PX / 2.0) / total
    outside = np.take_along_axis(profile, np.minimum(first + span, profile.shape[1] - 1)[:, None], axis=1)[:, 0]
    clear = (total > LEAST_RISE * np.maximum(outside, 1e-12)) & (first > 0) & (first + span < rise.shape[1])
    return place, clear
