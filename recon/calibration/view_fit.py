"""Reprojection of one picture's markers.

The module computes residuals, their derivatives by the camera's pose, and the single-view pose (PnP).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from rhizotwin.recon.calibration.markers import Markers
from rhizotwin.recon.optics.cameras import matrix
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Camera, Scene

FLOOR_PX = 0.02
"""Systematic error of a measured corner, not in its covariance: lens model, print, and model of the pattern."""
UNKNOWN_PX = 0.1
"""Error of a corner without a covariance."""
_MISREAD_PX = 1.5, 10.0
"""Median and largest reprojection error of SQPNP, above which some markers may be misread: corners found by OpenCV are
off by 0.1 to 0.2 (`docs/calibration.md`), those of another marker by its side."""
_RANSAC_PX, _RANSAC_TRIES = 3.0, 300
"""Inlier distance, and number of trials: with half of the corners misread, nine of 300 samples of five contain no
misread corner."""
_ENOUGH_MM = 1e-5
"""Step of the camera below which the fit of one picture ends: a thousandth of the accuracy of a picture."""
WIDE = 3.0
"""Normalised residual of a marker at which its weight is halved (Cauchy)."""


@dataclass(frozen=True, kw_only=True)
class Sightings:
    """Markers of one picture with their positions on the strip."""

    camera: Camera
    points_mm: Array
    """(M, 4, 3) corners in the canister frame."""
    px: Array
    """(M, 4, 2)."""
    whitener: Array
    """(M, 8, 8): ``whitener @ residual`` has unit covariance."""
    outward: Array
    """(M, 8): movement of the corners if the marker's image grows by 1 px on each side."""


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """Linearised least squares of one picture about a pose, for a left-hand twist, the inset and the focus.

    Units are rad and mm for the twist, and px for the inset. The focus is the relative change of the focal lengths.
    """

    normal: Array
    """(8, 8)."""
    gradient: Array
    """(8,)."""
    normals: Array
    """(M, 8, 8) contribution of each marker."""
    gradients: Array
    """(M, 8)."""
    chi2: Array
    """(M,) of each marker, before weighting."""
    weight: Array
    """(M,)."""
    rms_px: float
    """Weighted root mean square of the corners' distances over both axes."""


def sightings(markers: Markers, scene: Scene) -> Sightings:
    """Match a picture's markers with their positions on the strip."""
    where = plan.marker_corners(scene.strip, scene.net_pot)
    px = markers.corners_px
    count = len(px)
    covariance = np.zeros((count, 8, 8)) + UNKNOWN_PX**2 * np.eye(8)
    if markers.covariance_px2 is not None:
        covariance = markers.covariance_px2 + FLOOR_PX**2 * np.eye(8)
    right = px[:, 1] - px[:, 0] + px[:, 2] - px[:, 3]
    down = px[:, 3] - px[:, 0] + px[:, 2] - px[:, 1]
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    return Sightings(
        camera=scene.camera,
        points_mm=np.array([where[int(k)] for k in markers.ids]).reshape(count, 4, 3),
        px=px,
        whitener=np.linalg.inv(np.linalg.cholesky(covariance)),
        outward=np.stack([-right - down, right - down, right + down, down - right], axis=1).reshape(count, 8),
    )


def linearise(
    sightings: Sightings, cam_from_canister: Array, *, inset_px: float = 0.0, focal_scale: float = 1.0, scale: float = 1.0
) -> Linearised:
    """Linearise a picture's reprojection about a pose.

    Parameters
    ----------
    sightings : Sightings
        Corners and their positions on the strip.
    cam_from_canister : (4, 4) array
        The pose.
    inset_px : float
        Amount by which the markers' images are larger on each side (shared by all pictures).
    focal_scale : float
        Factor on the camera's focal lengths (shared by all pictures).
    scale : float
        Factor on the corners' standard deviations.

    Returns
    -------
    Linearised
        Residuals, Jacobian and weights.
    """
    count, camera = len(sightings.px), sightings.camera.focused(focal_scale)
    cam = frames.apply(cam_from_canister, sightings.points_mm.reshape(-1, 3))
    at_cam, slopes = cv2.projectPoints(cam, np.zeros(3), np.zeros(3), matrix(camera), np.array(camera.distortion))[:2]
    off = sightings.px.reshape(count, 8) - at_cam.reshape(count, 8) - inset_px * sightings.outward
    by_focus = (at_cam.reshape(count, 4, 2) - np.array(camera.principal_px)).reshape(count, 8, 1) / focal_scale
    design = np.concatenate([slopes[:, :6].reshape(count, 8, 6), sightings.outward[:, :, None], by_focus], axis=2)
    white = np.einsum("mij,mj->mi", sightings.whitener, off) / scale
    white_design = sightings.whitener @ design / scale
    chi2 = np.sum(white * white, axis=1)
    weight = 1.0 / (1.0 + chi2 / (8.0 * WIDE**2))
    square = np.sum(off * off, axis=1) / 8.0
    normals = weight[:, None, None] * (white_design.transpose(0, 2, 1) @ white_design)
    gradients = weight[:, None] * np.einsum("mij,mi->mj", white_design, white)
    return Linearised(
        normal=normals.sum(axis=0),
        gradient=gradients.sum(axis=0),
        normals=normals,
        gradients=gradients,
        chi2=chi2,
        weight=weight,
        rms_px=float(np.sqrt(2.0 * np.sum(weight * square) / np.sum(weight))),
    )


def single_view(sightings: Sightings, *, polish: bool = True) -> Array | None:
    """Return ``cam_from_canister`` (4, 4) from one picture alone, or None if there is no solution."""
    points, px = sightings.points_mm.reshape(-1, 3), sightings.px.reshape(-1, 2)
    camera, lens = matrix(sightings.camera), np.array(sightings.camera.distortion)
    ok, rotvec, shift = cv2.solvePnP(points, px, camera, lens, flags=cv2.SOLVEPNP_SQPNP)
    if ok:
        off_px = np.linalg.norm(cv2.projectPoints(points, rotvec, shift, camera, lens)[0].reshape(-1, 2) - px, axis=1)
    if not ok or np.median(off_px) > _MISREAD_PX[0] or off_px.max() > _MISREAD_PX[1]:
        cv2.setRNGSeed(0)
        ok, rotvec, shift, kept = cv2.solvePnPRansac(
            points, px, camera, lens, reprojectionError=_RANSAC_PX, iterationsCount=_RANSAC_TRIES, flags=cv2.SOLVEPNP_SQPNP
        )
        if not ok or kept is None or len(kept) < 4 * plan.LEAST_MARKERS - 4:
            return None
        chosen = np.ravel(kept)
        points, px = points[chosen], px[chosen]
    rotvec, shift = cv2.solvePnPRefineLM(points, px, camera, lens, rotvec, shift)
    cam_from_canister = frames.from_rotvec(np.ravel(rotvec), np.ravel(shift))
    if not np.all(np.isfinite(cam_from_canister)) or frames.apply(cam_from_canister, points)[:, 2].min() <= 0.0:
        return None
    for _ in range(8 if polish else 0):
        local = linearise(sightings, cam_from_canister)
        try:
            step = np.linalg.solve(local.normal[:6, :6], local.gradient[:6])
        except np.linalg.LinAlgError:
            return None
        cam_from_canister = twist(np.asarray(step, np.float64)) @ cam_from_canister
        if np.abs(step[3:]).max() < _ENOUGH_MM:
            break
    return cam_from_canister


def twist(step: Array) -> Array:
    """Return the transform of a small rotation vector (3) rad and shift (3) mm, stacked in one vector."""
    return frames.from_rotvec(step[:3], step[3:])


def adjoint(a_from_b: Array) -> Array:
    """Return the 6x6 matrix that maps a small left-hand twist in frame b to that in frame a."""
    rotation, shift = a_from_b[:3, :3], a_from_b[:3, 3]
    cross = np.array([[0.0, -shift[2], shift[1]], [shift[2], 0.0, -shift[0]], [-shift[1], shift[0], 0.0]])
    found = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = rotation
    found[3:, :3] = cross @ rotation
    return found
