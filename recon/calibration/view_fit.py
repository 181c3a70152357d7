"""Reprojection of the markers of one picture: residuals, their derivatives, and single-view poses (PnP)."""

from dataclasses import dataclass

import cv2
import numpy as np

from rhizotwin.recon.calibration.markers import Markers
from rhizotwin.recon.optics.cameras import matrix
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Camera, Scene

FLOOR_PX = 0.02
"""Systematic error of a measured corner that its covariance does not include, px. The error is caused by the lens
model, the print, and the pattern model."""
UNKNOWN_PX = 0.1
"""Standard deviation assumed for a corner whose covariance is unknown, px."""
_MISREAD_PX = 1.5, 10.0
"""Two thresholds for the reprojection error of the initial pose (SQPNP), px. The first applies to the median error, and
the second to the largest. Above either threshold, some markers may be misidentified. OpenCV's corners deviate by 0.1 to
0.2 px (`docs/calibration.md`), and the corners of a misidentified marker by at least the side of a marker."""
_RANSAC_PX, _RANSAC_TRIES = 3.0, 300
"""Two parameters of RANSAC: the inlier distance, px, and the number of trials. If half of the corners belong to
misidentified markers, about nine of 300 random samples of five corners are free of such corners."""
_ENOUGH_MM = 1e-5
"""Camera displacement per step below which the single-view fit ends, mm. The value is a thousandth of the accuracy of a
single view."""
WIDE = 3.0
"""Normalised residual of a marker at which its Cauchy weight is one half."""


@dataclass(frozen=True, kw_only=True)
class Sightings:
    """Markers measured in one picture, with their positions on the strip."""

    camera: Camera
    """Lens of the camera."""
    points_mm: Array
    """(M, 4, 3) positions of the corners on the strip, canister frame, mm."""
    px: Array
    """(M, 4, 2) measured corners, px."""
    whitener: Array
    """(M, 8, 8) matrices that whiten the residuals: ``whitener @ residual`` has unit covariance."""
    outward: Array
    """(M, 8) displacement of the corners if the marker's image is enlarged by 1 px on each side, px."""


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """Linearised least-squares problem of one picture about a camera pose.

    The unknowns are a twist of the pose applied from the left (rad and mm), the inset (px), which enlarges the markers
    on each side, and the relative change of the focal lengths.
    """

    normal: Array
    """(8, 8) weighted normal matrix."""
    gradient: Array
    """(8,) weighted gradient."""
    normals: Array
    """(M, 8, 8) contribution of each marker to the normal matrix."""
    gradients: Array
    """(M, 8) contribution of each marker to the gradient."""
    chi2: Array
    """(M,) squared norm of each marker's whitened residuals, before weighting."""
    rms_px: float
    """Weighted root mean square distance of the corners from their projections, px."""


def sightings(markers: Markers, scene: Scene) -> Sightings:
    """Match the measured markers of a picture with their positions on the strip."""
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
    """Linearise the reprojection of a picture's markers about a camera pose.

    Parameters
    ----------
    sightings : Sightings
        Measured corners and their positions on the strip.
    cam_from_canister : (4, 4) array
        Camera pose, mm.
    inset_px : float
        Apparent enlargement of the markers on each side, px; shared by all pictures.
    focal_scale : float
        Factor by which the focal lengths are multiplied; shared by all pictures.
    scale : float
        Factor by which the corners' standard deviations are multiplied.

    Returns
    -------
    Linearised
        Normal equations, weights and residuals.
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
        rms_px=float(np.sqrt(2.0 * np.sum(weight * square) / np.sum(weight))),
    )


def single_view(sightings: Sightings, *, polish: bool = True) -> Array | None:
    """Estimate ``cam_from_canister`` (4, 4) from one picture alone; return None if there is no solution."""
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
    """Return the transform (4, 4) of a small motion.

    The motion (6,) consists of a rotation vector, rad, followed by a shift, mm.
    """
    return frames.from_rotvec(step[:3], step[3:])


def adjoint(a_from_b: Array) -> Array:
    """Return the matrix (6, 6) that maps a small left-hand twist in frame b to the same twist in frame a."""
    found = np.asarray(np.kron(np.eye(2), a_from_b[:3, :3]), np.float64)
    found[3:, :3] = np.cross(a_from_b[:3, 3], a_from_b[:3, :3], axisb=0, axisc=0)
    return found
