"""Pose of the canister in the marker strip, from the edges of its outer wall in front of the backlight.

The cameras are calibrated with the strip, which is on a net pot that may be misaligned, while the light is refracted by
the canister. A line of sight tangent to the outer wall passes the canister's axis at exactly the outer radius, whatever
wall and water are (Bouguer's invariant at |b| = R_o): inside the edge the picture is black (grazing light is reflected
away), outside it shows the empty panel. All edges of all views in one least-squares problem give the axis's offset and
tilt. The distance of the edges outside R_o (blur, a canister of another size) is a common unknown, and so is the
deviation of the wall from round: the support function of an oval with radii R + e and R - e is R + e cos 2(azimuth -
its own) to first order in e / R.

In a tank, the same holds for the lines in the liquid: inside the edge, light that enters the wall is deflected far.
However, light reflected by the wall continues nearly straight: in front of a wide panel the edge is as bright as the
panel, and not detected (the twin's fast pictures, without reflections, show it dark). Rotation of a tank moves both
edges of all views in the same direction, by refraction at its front (a quarter of a degree per degree, in water); it is
a further unknown.
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
from rhizotwin.recon.optics.cameras import View, matrix, project_inner, tank_pose
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.robust import MAD, inverse, sandwich, scatter
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene, Tank
from rhizotwin.scenes.picture_codec import Grey

LEVELS_MM = 2.5
"""Spacing of the heights at which the edges are measured."""
MARGIN_MM = 8.0
"""Edges this near to the net pot's skirt or the canister's base are not used."""
REACH_MM = 4.0
"""Search range about the edges of a canister without misalignment."""
STEP_PX = 0.25
"""Spacing of the samples across an edge: two for a blur of half a pixel."""
LEAST_RISE = 0.25
"""Minimum rise of an edge within three pixels, as a fraction of the brightness outside."""
LEAST_EDGES = 200
"""Minimum number of edge points. Two views show about as many (52 heights, two sides); a single view does not determine
the tilt towards it."""
_SCALE = np.array([1e-3, 1e-3, 0.1, 0.1, 0.1, 0.1, 0.1, 4e-3])
"""Steps (rad, mm) with a similar effect on an edge: a milliradian over half the canister's height is 0.08 mm, and for
the rotation of a tank a quarter of that over its depth."""
_POSE_SCALE = np.array([1e-3] * 3 + [0.1] * 3)
"""The same for a camera's twist."""
PRIOR = np.array([np.deg2rad(1.0), np.deg2rad(1.0), 2.0, 2.0, 1.0, 0.25, 0.25, np.deg2rad(2.0)])
"""Prior standard deviations: misalignment of a net pot (rad, mm), distance of the edges from the nominal radius (mm),
ovality of cast tube as sold (half a millimetre between largest and smallest diameter), and rotation of a tank placed by
eye (rad)."""
_OPEN = 7
"""Number of unknowns without a tank."""

TOGETHER_MM = 20.0
"""Length along one side of a picture over which errors are correlated (0.7, 0.5, 0.3, 0.1 at 2.5, 5, 10, 20 mm; 400x300
bench): the edge, almost vertical, lies between the same two columns of pixels there."""
LEAST_STIFFNESS = 0.1
"""Minimum mean derivative of Cauchy's psi: it is 0.14 where the edges scatter by twice the loss's scale, and 0.03 at
five times."""


@dataclass(frozen=True, kw_only=True)
class CanisterPose:
    """Pose of the canister's axis in the strip's frame."""

    canister_from_strip: Array
    """(4, 4) without height and rotation about the axis, which edges do not determine."""
    covariance: Array
    """(4, 4) of tilt about x, y (rad) and offset x, y (mm), without the errors that the cameras share."""
    by_cameras: Array
    """(4, S) derivatives of the same by the errors that the cameras share (`PoseErrors`)."""
    sigma: Array
    """(4,) standard deviations, including those errors: tilt about x, y (deg), offset x, y (mm)."""
    radius_excess_mm: float
    """Distance of the edges outside the nominal radius."""
    oval_mm: float
    """Half the difference between the largest and the smallest outer radius."""
    oval_deg: float
    """Azimuth of the largest radius, 0 to 180."""
    edges: int
    tank_turn_deg: float
    """Rotation of the tank relative to the scene; 0 without a tank."""
    tank_sigma_deg: float
    """Its standard deviation."""
    before_mm: float
    """Median distance of the edges from those of a canister without misalignment."""
    after_mm: float


def _sigmas(covariance: Array, by_cameras: Array, errors: PoseErrors | None) -> Array:
    """Return the standard deviations (N,) of the estimates, including the cameras' errors."""
    shared = np.zeros((1, 1)) if errors is None else errors.shared
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
        Cameras in the strip's frame.
    images : callable
        Function that returns the picture of a view by its index.
    scene : Scene
        Radius and height of the canister, and skirt of the net pot.
    errors : PoseErrors, optional
        Errors of the cameras; without, they count as exact.
    settings : CalibrationSettings
        Scale of the robust loss for the edges.

    Returns
    -------
    CanisterPose or None
        None if the pictures do not show enough of the canister's edges (a backlight no wider than the canister, dark
        surroundings).
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
        canister_from_strip=frames.from_rotvec(np.array([fit.x[0], fit.x[1], 0.0]), np.array([fit.x[2], fit.x[3], 0.0])),
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
    """(V,) in the strip's frame."""
    optics: Optics
    view: NDArray[np.int64]
    """(N,) index of the view."""
    side: NDArray[np.int64]
    """(N,) 0 or 1."""
    ray: Array
    """(N, 3) direction, camera's frame."""
    place: NDArray[np.int64]
    """(N,) index of the pixel of the edge, merged with neighbours along the edge over `TOGETHER_MM`."""

    @staticmethod
    def from_pixels(found: Sequence[tuple[Array, Array]], views: Sequence[View], optics: Optics) -> _Edges:
        """Return the lines of sight through each view's pixels (M, 2)."""
        px = np.concatenate([pixels for pixels, _ in found])
        owner = np.repeat(np.arange(len(views)), [len(pixels) for pixels, _ in found])
        undone = [
            cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix(view.camera), np.array(view.camera.distortion)).reshape(-1, 2)
            for (pixels, _), view in zip(found, views, strict=True)
            if len(pixels)
        ]
        side = np.concatenate([sides for _, sides in found])
        one = px[(owner == owner[0]) & (side == side[0])] if len(px) else np.zeros((1, 2))
        along = int(np.argmax(np.ptp(one, axis=0)))  # rows, if edges are vertical in the pictures
        block = np.ones(2)
        block[along] = TOGETHER_MM * views[0].camera.focal_px[0] / views[0].rho_mm
        rays = np.column_stack([np.concatenate([*undone, np.empty((0, 2))]), np.ones(len(px))])
        return _Edges(
            views=views,
            optics=optics,
            view=owner,
            side=side,
            ray=rays / np.linalg.norm(rays, axis=1, keepdims=True),
            place=np.asarray(np.unique(np.floor(px / block), axis=0, return_inverse=True)[1].ravel(), np.int64),
        )

    def lines(self, tank_turn_rad: float) -> tuple[Array, Array]:
        """Return a point (N, 3) and the direction (N, 3) of each line where it meets the canister, strip's frame."""
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
        """Return the distance (N,) of the lines outside a wall.

        The unknowns of the wall are tilt (2), offset (2), excess of radius, oval (2), and rotation of the tank.
        """
        canister_from_strip = frames.from_rotvec(np.array([unknown[0], unknown[1], 0.0]), np.array([unknown[2], unknown[3], 0.0]))
        origin, direction = self.lines(float(unknown[_OPEN]) if len(unknown) > _OPEN else 0.0)
        start, along = frames.apply(canister_from_strip, origin), direction @ canister_from_strip[:3, :3].T
        away_mm, azimuth = _from_axis(start, along)
        oval_mm = unknown[5] * np.cos(2.0 * azimuth) + unknown[6] * np.sin(2.0 * azimuth)
        return np.asarray(away_mm - self.optics.outer_radius_mm - unknown[4] - oval_mm)

    def select(self, some: NDArray[np.bool_]) -> _Edges:
        """Return a subset of the lines."""
        rows = {name: getattr(self, name)[some] for name in ("view", "side", "place", "ray")}
        return replace(self, **rows)

    def displace(self, step: Array) -> _Edges:
        """Return the same pixels' lines after every camera moved by a left-hand twist (6,) of ``cam_from_canister``."""
        return replace(self, views=[view.move_camera(twist(step)) for view in self.views])


def _uncertainty(edges: _Edges, found: Array, errors: PoseErrors | None, settings: CalibrationSettings) -> tuple[Array, Array]:
    """Return the covariance of tilt and offset (K, K), and their derivatives by the cameras' shared errors (K, S).

    K is 4, and 5 with a tank, whose rotation comes last.

    Edges of one side of one view are correlated, and so are those on the same pixels of a static camera in all views:
    the position of an edge between two pixels determines its error. The two sides of a view are uncorrelated (below
    0.1) except for the view's own pose, which is propagated with the others.
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
        return covariance, np.zeros((len(chosen), 1))
    by_pose = _slopes(lambda step: edges.displace(step).off(found), np.zeros(6), _POSE_SCALE)
    follow = np.zeros((len(edges.views), len(found), 6))
    np.add.at(follow, edges.view, -stiff * jacobian[:, :, None] * by_pose[:, None, :])
    follow = (bread @ follow)[:, chosen]
    own = follow @ errors.own @ follow.transpose(0, 2, 1)
    return covariance + own.sum(axis=0), np.einsum("vij,vjs->is", follow, errors.carry)


def _slopes(function: Callable[[Array], Array], at: Array, scale: Array) -> Array:
    """Return central differences (N, K) of a function with a thousandth of each unknown's scale (K,) as the step."""
    steps = 1e-3 * np.diag(scale)
    return np.stack([(function(at + step) - function(at - step)) / (2.0 * step.max()) for step in steps], axis=1)


def _from_axis(start: Array, along: Array) -> tuple[Array, Array]:
    """Return the distance (N,) of lines (N, 3), (N, 3) from the z axis, and the azimuth (N,) of the nearest point."""
    cross = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    azimuth = np.arctan2(-along[:, 0] * cross, along[:, 1] * cross)
    return np.abs(cross) / np.hypot(along[:, 0], along[:, 1]), azimuth


def _edge_pixels(view: View, image: Grey, scene: Scene) -> tuple[Array, Array]:
    """Return the pixels (M, 2) of both edges of one picture, and the side (M,) of each."""
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
    """Return the pixels (M, 2) of points beside the canister: in the open, or in a tank's liquid."""
    if scene.tank is not None:
        return project_inner(view, _liquid(scene, scene.tank), points_mm)
    turn = cv2.Rodrigues(view.cam_from_canister[:3, :3])[0]
    shift, lens = view.cam_from_canister[:3, 3], np.array(view.camera.distortion)
    return np.asarray(cv2.projectPoints(points_mm, turn, shift, matrix(view.camera), lens)[0].reshape(-1, 2), np.float64)


def _liquid(scene: Scene, around: Tank) -> Optics:
    """Return the optics of a tank without a canister."""
    radius_mm = around.front_mm - around.wall_mm
    return replace(
        Optics.from_scene(scene), outer_radius_mm=radius_mm, inner_radius_mm=radius_mm, n_wall=around.n_liquid, n_water=around.n_liquid
    )


def _measure_edge(view: View, image: Grey, at: Array, inner: Array) -> Array:
    """Return the pixels (M, 2) of the edge near the tangent points, one per height where the edge is clear."""
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
    place, clear = _steepest(profile.astype(np.float64), offset)
    return np.asarray(at[clear] + place[clear, None] * outward[clear])


def _steepest(profile: Array, offset: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the offset at which profiles (N, S) rise most steeply outward, and whether the rise is clear.

    The offset is the centroid of the rise about its peak.
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
