"""How the canister stands in the strip of markers: its outer wall's own edges, seen against the backlight, tell.

The cameras come from the strip, which is on a net pot that may be misaligned; the light is refracted by the canister. A
line of sight that touches the outer wall passes the canister's axis at exactly the outer radius, whatever the wall and
the water do (Bouguer's invariant at
|b| = R_o): inside of it the picture is black (grazing light is reflected away), outside it shows the bare panel. All
edges of all views in one least-squares problem give the axis's offset and tilt; how far the edges lie outside of R_o
(blur, a canister of another size) is common to all and found with it, and so is how far the wall is from
round: the support of an oval with radii R + e and R - e is R + e cos 2(azimuth - its own) to first order in e / R.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rhizotwin.recon.optics.cameras import View, matrix
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey

LEVELS_MM = 2.5
"""Distance of the heights at which the edges are looked for."""
MARGIN_MM = 8.0
"""Edges this near to the net pot's skirt or the canister's base are left alone."""
REACH_MM = 4.0
"""How far from their places in a canister that stands true the edges are looked for."""
STEP_PX = 0.25
"""Spacing of the samples across an edge: two for a blur of half a pixel."""
LEAST_RISE = 0.25
"""An edge must rise by this share of the brightness outside of it within three pixels."""
LEAST_EDGES = 200
"""Two views show about as many (52 heights, two sides); one alone does not tell a tilt towards it from none."""
_SCALE = np.array([1e-3, 1e-3, 0.1, 0.1, 0.1, 0.1, 0.1])
"""Steps (rad, mm) that move an edge about as far: a milliradian over half the canister's height is 0.08 mm."""
PRIOR = np.array([np.deg2rad(1.0), np.deg2rad(1.0), 2.0, 2.0, 1.0, 0.25, 0.25])
"""How misaligned a net pot may stand (rad, mm), how far the edges may lie from the nominal radius (mm), and how far
from round cast tube is sold (half a millimetre between largest and smallest diameter)."""


@dataclass(frozen=True, kw_only=True)
class CanisterPose:
    """Where the canister's axis is in the strip's frame."""

    canister_from_strip: Array
    """(4, 4) without height and turn, which edges do not show."""
    sigma: Array
    """(4,) standard deviations: tilt about x, y (deg), offset x, y (mm)."""
    radius_excess_mm: float
    """How far the edges lie outside the nominal radius."""
    oval_mm: float
    """Half the difference between the largest and the smallest outer radius."""
    oval_deg: float
    """Azimuth of the largest, 0 to 180."""
    edges: int
    before_mm: float
    """Median distance of the edges from where a canister that stands true in the strip would have them."""
    after_mm: float


def find_canister(
    views: Sequence[View], images: Callable[[int], Grey], scene: Scene, *, settings: CalibrationSettings = CalibrationSettings()
) -> CanisterPose | None:
    """Find how the canister stands in the strip.

    Parameters
    ----------
    views : sequence of View
        Cameras in the strip's frame.
    images : callable
        Gives the picture of a view by its index.
    scene : Scene
        The canister's radius and height, the net pot's skirt.
    settings : CalibrationSettings
        How loosely the edges are fitted.

    Returns
    -------
    CanisterPose or None
        None where the pictures do not show enough of the canister's edges (a backlight no wider than the canister, dark
        surroundings).
    """
    lines = [_edge_lines(view, images(k), scene) for k, view in enumerate(views)]
    origin = np.concatenate([line[0] for line in lines])
    direction = np.concatenate([line[1] for line in lines])
    if len(origin) < LEAST_EDGES:
        return None
    radius_mm = scene.canister.outer_radius_mm

    def distances(unknown: Array) -> Array:
        canister_from_strip = frames.from_rotvec(np.array([unknown[0], unknown[1], 0.0]), np.array([unknown[2], unknown[3], 0.0]))
        start, along = frames.apply(canister_from_strip, origin), direction @ canister_from_strip[:3, :3].T
        away_mm, azimuth = _from_axis(start, along)
        return np.asarray(away_mm - radius_mm - unknown[5] * np.cos(2.0 * azimuth) - unknown[6] * np.sin(2.0 * azimuth))

    def residuals(unknown: Array) -> Array:
        return np.concatenate([distances(unknown) - unknown[4], unknown / PRIOR * settings.edge_mm / np.sqrt(len(origin))])

    fit = least_squares(residuals, np.zeros(7), loss="cauchy", f_scale=settings.edge_mm, x_scale=_SCALE)
    left = distances(fit.x) - fit.x[4]
    spread_mm = MAD * float(np.median(np.abs(left)))
    near = np.abs(left) < 4.0 * max(spread_mm, 1e-3)
    if near.sum() < LEAST_EDGES:
        return None
    jacobian = fit.jac[: len(left)][near]
    covariance = np.linalg.inv(jacobian.T @ jacobian) * spread_mm**2
    sigma = np.sqrt(np.diag(covariance))[:4]
    straight = distances(np.zeros(7))[near]
    return CanisterPose(
        canister_from_strip=frames.from_rotvec(np.array([fit.x[0], fit.x[1], 0.0]), np.array([fit.x[2], fit.x[3], 0.0])),
        sigma=np.concatenate([np.rad2deg(sigma[:2]), sigma[2:]]),
        radius_excess_mm=float(fit.x[4]),
        oval_mm=float(np.hypot(fit.x[5], fit.x[6])),
        oval_deg=float(np.rad2deg(0.5 * np.arctan2(fit.x[6], fit.x[5])) % 180.0),
        edges=int(near.sum()),
        before_mm=float(np.median(np.abs(straight - np.median(straight)))),
        after_mm=float(np.median(np.abs(left[near]))),
    )


def _from_axis(start: Array, along: Array) -> tuple[Array, Array]:
    """Return the distance (N,) of lines (N, 3), (N, 3) from the z axis, and the azimuth (N,) at which they pass it."""
    cross = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    azimuth = np.arctan2(-along[:, 0] * cross, along[:, 1] * cross)
    return np.abs(cross) / np.hypot(along[:, 0], along[:, 1]), azimuth


def _edge_lines(view: View, image: Grey, scene: Scene) -> tuple[Array, Array]:
    """Return the lines of sight (origins, directions) through the edges of one picture, in the strip's frame."""
    canister = scene.canister
    low = -canister.height_mm + MARGIN_MM
    high = min(scene.net_pot.skirt_bottom_mm, scene.water.level_mm) - MARGIN_MM
    z = np.arange(low, high, LEVELS_MM)
    centre = view.centre_mm
    azimuth, half = np.arctan2(centre[1], centre[0]), np.arccos(np.clip(canister.outer_radius_mm / view.rho_mm, -1.0, 1.0))
    found = [
        _measured(view, image, _circle(azimuth + side * half, canister.outer_radius_mm, z), _circle(azimuth + side * half, 0.0, z))
        for side in (-1.0, 1.0)
    ]
    px = np.concatenate(found)
    if not len(px):
        return np.empty((0, 3)), np.empty((0, 3))
    undone = cv2.undistortPoints(px.reshape(-1, 1, 2), matrix(view.camera), np.array(view.camera.distortion))
    rays = np.concatenate([undone.reshape(-1, 2), np.ones((len(px), 1))], axis=1) @ view.cam_from_canister[:3, :3]
    return np.broadcast_to(centre, rays.shape), rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _circle(angle_rad: float, radius_mm: float, z: Array) -> Array:
    return np.stack([np.full_like(z, radius_mm * np.cos(angle_rad)), np.full_like(z, radius_mm * np.sin(angle_rad)), z], axis=1)


def _pixels(view: View, points_mm: Array) -> Array:
    turn = cv2.Rodrigues(view.cam_from_canister[:3, :3])[0]
    shift, lens = view.cam_from_canister[:3, 3], np.array(view.camera.distortion)
    return np.asarray(cv2.projectPoints(points_mm, turn, shift, matrix(view.camera), lens)[0].reshape(-1, 2), np.float64)


def _measured(view: View, image: Grey, tangent_mm: Array, inner_mm: Array) -> Array:
    """Return the pixels (M, 2) of the edge near the projected points of tangency, one a height where it is clear."""
    at = _pixels(view, tangent_mm)
    outward = at - _pixels(view, inner_mm)
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
    """Return where profiles (N, S) rise most steeply outward, and whether they do clearly.

    The place is the centroid of the rise about its peak.
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
