"""Estimation of all camera poses from the markers of all pictures together."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rhizotwin.recon.calibration import view_fit
from rhizotwin.recon.calibration.cameras import Camera, Ring, StripCalibration
from rhizotwin.recon.calibration.markers import Markers
from rhizotwin.recon.calibration.pose_errors import PoseErrors
from rhizotwin.recon.calibration.rig_fit import RigFit, fit_rig
from rhizotwin.recon.calibration.rig_start import first_rig
from rhizotwin.recon.calibration.view_fit import Sightings
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.markers import ids_text
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plan import LEAST_MARKERS

STILL_PX = 2.0
"""Median reprojection error of the views of a ring below which their camera is considered static, px. The error is
computed with one common camera pose for all views of the ring. Single views in which the camera moved are excluded only
if the camera was otherwise static."""
LOOSE = np.array([np.deg2rad(3.0), 10.0])
"""Maximum standard deviation of the camera's rotation, rad, and translation, mm, between the views of a ring. If the
views scatter more, they were not taken by a static camera, and are calibrated independently."""
LEAST_RING = 5
"""Minimum number of views of a ring in which single views with a moved camera are searched for."""
AS_CALIBRATED = 1e-7
"""Prior standard deviation of the relative focal length in fits that keep the calibrated focal length. It is so small
that the focal length does not change."""
STRANGERS = 3
"""Minimum number of foreign marker ids at which the pictures are rejected, because the scene file then describes a
wrong strip. Foreign ids are not on the strip, and are counted if they appear in at least two pictures."""


@dataclass(frozen=True, kw_only=True)
class Poses(StripCalibration):
    """Cameras of all views, in the order of the frames, with the calibration of the rig."""

    views: tuple[Camera, ...]
    """(F,) cameras of the views, in the order of the frames."""
    errors: PoseErrors
    """Errors of all camera poses."""
    turn_sigma_rad: Array
    """(F,) standard deviations of the table angles, rad. They are 0 for views that are not part of the rig's fit."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""


def find_poses(
    detected: Sequence[Markers],
    scene: Scene,
    captured: Sequence[Frame],
    *,
    settings: CalibrationSettings = CalibrationSettings(),
    single_view: bool = False,
) -> Poses:
    """Estimate the camera pose of every picture from its markers.

    An initial pose is estimated from each picture alone (PnP). A least-squares fit to all pictures then estimates the
    camera of each ring, every table angle, the pose of the canister on the table, and the movement of the camera
    between views (`recon.calibration.rig_fit`). Views with large residuals are excluded, and the reason is recorded.

    Parameters
    ----------
    detected : sequence of Markers
        Markers of each picture.
    scene : Scene
        Camera with lens distortion, strip and net pot.
    captured : sequence of Frame
        Frames of the pictures, with rings and commanded table angles. A table angle of None was not commanded, and is
        estimated from the pictures alone.
    settings : CalibrationSettings
        Thresholds for the exclusion of views, and priors of the rig.
    single_view : bool
        Whether to return the poses estimated from each picture alone, with unweighted corners (method of the thesis).

    Raises
    ------
    UserError
        If no camera pose could be estimated, or if the pictures show another strip.
    """
    if len(detected) != len(captured):
        raise ValueError(f"{len(detected)=} but {len(captured)=}")
    _reject_foreign_markers(detected, scene, captured)
    views: list[Camera] = []
    sightings: dict[int, Sightings] = {}
    for k, (markers, frame) in enumerate(zip(detected, captured, strict=True)):
        view, sight = _fit_single_view(markers, scene, frame, polish=not single_view)
        views.append(view)
        if sight is not None:
            sightings[k] = sight
    if not sightings:
        raise UserError(
            f"{captured[0].file}: {views[0].reason}. No camera pose could be estimated from any of the {len(captured)} pictures. "
            "Check the focus, the light, and the strip in the scene file, or provide camera poses."
        )
    median_px = float(np.median([views[k].reprojection_px for k in sightings]))
    for k in list(sightings):
        reason = _misfit_reason(views[k].reprojection_px, median_px, settings)
        if reason:
            views[k] = replace(views[k], used=False, reason=reason)
            if not single_view and len(sightings) > 1:
                del sightings[k]
    if single_view:
        _require_camera(views, captured)
        return _independent(views, median_px)
    return _fit_all_views(views, sightings, scene, captured, settings)


def _independent(views: Sequence[Camera], after_px: float) -> Poses:
    """Return the cameras of views that were calibrated independently."""
    errors = PoseErrors.independent([view.covariance for view in views])
    return Poses(views=tuple(views), errors=errors, turn_sigma_rad=np.zeros(len(views)), after_px=after_px)


def _reject_foreign_markers(detected: Sequence[Markers], scene: Scene, captured: Sequence[Frame]) -> None:
    """Raise a UserError if markers of another strip appear beside the markers of the scene's strip.

    Poses that were estimated from the ids common to two different strips would be wrong.
    """
    counts = Counter(marker_id for markers in detected if len(markers.ids) for marker_id in markers.foreign)
    strange = sorted(marker_id for marker_id, count in counts.items() if count > 1)
    if len(strange) >= STRANGERS:
        first = next(frame.file for frame, markers in zip(captured, detected, strict=True) if strange[0] in markers.foreign)
        strip = scene.strip
        raise UserError(
            f"{first}: markers of another strip ({strip.dictionary} ids {', '.join(str(k) for k in strange[:5])}) appear beside the "
            f"ids {ids_text(strip.dictionary, strip.first_id, strip.rows * strip.columns)} of the scene's strip. Correct dictionary, "
            "first_id, columns and rows of the strip in the scene file, or cover the other markers."
        )


def _fit_single_view(markers: Markers, scene: Scene, frame: Frame, *, polish: bool) -> tuple[Camera, Sightings | None]:
    """Estimate a view's camera pose from its own markers; return the camera and the matched markers.

    The markers are None if no pose was found.
    """
    count = len(markers.ids)
    nothing = Camera(file=frame.file, ring=frame.ring, used=False, markers=count)
    if count < LEAST_MARKERS:
        reason = (
            markers.diagnosis
            if count == 0 and markers.diagnosis
            else f"only {count} markers were found, at least {LEAST_MARKERS} are needed"
        )
        return replace(nothing, reason=reason), None
    sightings = view_fit.sightings(markers, scene)
    pose = view_fit.single_view(sightings, polish=polish)
    if pose is None:
        reason = (
            "its markers do not match the strip in the scene file (check columns, rows, first_id and sizes of the strip, and the camera)"
        )
        return replace(nothing, reason=reason), None
    local = view_fit.linearise(sightings, pose)
    return _add_pose(nothing, pose, local, np.asarray(np.linalg.inv(local.normal[:6, :6]), np.float64)), sightings


def _refocus(view: Camera, sightings: Sightings, focal_scale: float) -> Camera:
    """Estimate the pose of a view again, with the refined focal length.

    The function is applied to views that were not included in the fit of the rig.
    """
    pose = view_fit.single_view(replace(sightings, camera=sightings.camera.focused(focal_scale))) if view.used else None
    return view if pose is None else replace(view, cam_from_canister=pose)


def _add_pose(view: Camera, pose: Array, local: view_fit.Linearised, covariance: Array) -> Camera:
    return replace(view.with_pose(pose, covariance), used=True, reason=None, reprojection_px=local.rms_px)


def _misfit_reason(error_px: float | None, median_px: float, settings: CalibrationSettings, *, of: str = "all pictures") -> str | None:
    """Return the reason to exclude a view with a large reprojection error; None if the error is acceptable.

    ``of`` names the pictures whose median error is given.
    """
    if error_px is None or error_px <= min(max(settings.worst_px, settings.worst_factor * median_px), settings.hopeless_px):
        return None
    return (
        f"its markers deviate from the fitted camera by {error_px:.2g} px (median of {of}: {median_px:.2g} px), so the strip "
        "or the camera moved, or the picture is blurred"
    )


def _require_camera(views: Sequence[Camera], captured: Sequence[Frame]) -> None:
    if not any(view.used for view in views):
        raise UserError(
            f"{captured[0].file}: {views[0].reason}. No camera pose could be estimated from any picture. "
            "Check the strip, focal_px and distortion in the scene file."
        )


def _fit_all_views(
    views: list[Camera], sightings: dict[int, Sightings], scene: Scene, captured: Sequence[Frame], settings: CalibrationSettings
) -> Poses:
    """Fit the rig to the views, exclude views in which the strip or the camera moved, and fit again.

    If a camera was moved freely, its views keep the poses that were estimated from their own markers.
    """
    keys = _rig_keys(views, sorted(sightings), scene, captured)
    if not keys:
        return _independent(views, float(np.median([views[k].reprojection_px for k in sightings])))
    while True:
        first = first_rig(_view_poses(views, keys), [captured[k] for k in keys], direction=scene.turntable.direction)
        sights = [sightings[k] for k in keys]
        fit = fit_rig(sights, first.rig, first.command_rad, first.known, replace(settings, focus_prior=AS_CALIBRATED))
        worst = _find_moved_views(fit, keys, settings)
        if not worst:
            break
        for k, moved in worst.items():
            views[k] = replace(views[k], used=False, reason=moved)
        keys = [k for k in keys if k not in worst]
    refocused = fit_rig(sights, fit.rig, first.command_rad, first.known, settings)
    focal_scale = 1.0
    # Otherwise, the calibrated lens is more accurate, because focus is hard to separate from distance.
    if abs(refocused.rig.focal_scale - 1.0) > settings.focus_sure * refocused.focal_sigma:
        fit, focal_scale = refocused, refocused.rig.focal_scale
        for k in set(sightings) - set(keys):
            views[k] = _refocus(views[k], sightings[k], focal_scale)
    covariance = fit.errors.covariance()
    for i, k in enumerate(keys):
        view = _add_pose(views[k], fit.rig.pose(i), fit.views[i], covariance[i])
        turn = scene.turntable.direction * np.rad2deg(fit.rig.angle_rad[i])
        cam_from_rig = fit.rig.own[i] @ fit.rig.cam_from_rig[fit.rig.ring[i]]
        reason = _misfit_reason(view.reprojection_px, float(np.median([local.rms_px for local in fit.views])), settings)
        views[k] = replace(
            view,
            used=reason is None,
            reason=reason,
            table_deg=float(turn) if first.known[i] else None,
            cam_from_tank=_tank_pose(scene, cam_from_rig) if first.known[i] else None,  # otherwise the rig's azimuth is unknown
        )
    _require_camera(views, captured)
    place = {k: i for i, k in enumerate(keys)}
    turn_sigma = np.zeros(len(views))
    turn_sigma[keys] = fit.turn_sigma_rad
    return Poses(
        views=tuple(views),
        errors=fit.errors.reorder([place.get(k) for k in range(len(views))], [view.covariance for view in views]),
        turn_sigma_rad=turn_sigma,
        rings=_collect_rings(fit, first.stations),
        table_from_canister=fit.rig.table_from_canister,
        inset_px=fit.rig.inset_px,
        focal_scale=focal_scale,
        focal_found=refocused.rig.focal_scale,
        focal_sigma=refocused.focal_sigma,
        before_px=float(np.median([view_fit.linearise(sightings[k], first.rig.rig_pose(i)).rms_px for i, k in enumerate(keys)])),
        after_px=float(np.median([local.rms_px for local in fit.views])),
        warnings=first.warnings,
    )


def _tank_pose(scene: Scene, cam_from_rig: Array) -> Array | None:
    """Return the pose (4, 4) of the tank relative to a camera; None if there is no tank.

    The tank is fixed in the rig.
    """
    return None if scene.tank is None else cam_from_rig @ frames.rotation_z(np.deg2rad(scene.tank.turn_deg))


def _collect_rings(fit: RigFit, stations: Sequence[tuple[int, int]]) -> tuple[Ring, ...]:
    """Return the static camera of each station, and the standard deviations of its small movements."""
    return tuple(
        Ring(
            ring=ring,
            placement=placement,
            cam_from_rig=fit.rig.cam_from_rig[r],
            covariance=fit.ring_covariance(r),
            own_deg=float(np.rad2deg(fit.rig.spread[r, 0])),
            own_mm=float(fit.rig.spread[r, 1]),
        )
        for r, (ring, placement) in enumerate(stations)
    )


def _view_poses(views: Sequence[Camera], keys: Sequence[int]) -> list[Array]:
    return [pose for k in keys if (pose := views[k].cam_from_canister) is not None]


def _rig_keys(views: Sequence[Camera], keys: list[int], scene: Scene, captured: Sequence[Frame]) -> list[int]:
    """Return the indices of the views whose camera was static except for small movements."""
    first = first_rig(_view_poses(views, keys), [captured[k] for k in keys], direction=scene.turntable.direction)
    loose = np.any(first.rig.spread > LOOSE, axis=1)
    return [k for k, ring in zip(keys, first.rig.ring, strict=True) if not loose[ring]]


def _find_moved_views(fit: RigFit, keys: Sequence[int], settings: CalibrationSettings) -> dict[int, str]:
    """Find views in which the camera moved.

    Return the reason for the exclusion of each of these views, keyed by frame number.
    """
    found: dict[int, str] = {}
    for ring in range(len(fit.rig.cam_from_rig)):
        members = np.flatnonzero(fit.rig.ring == ring).tolist()
        if len(members) < LEAST_RING:
            continue
        median_px = float(np.median(fit.rig_px[members]))
        for i in members:
            reason = _misfit_reason(float(fit.rig_px[i]), median_px, settings, of="its ring") if median_px < STILL_PX else None
            if reason:
                found[keys[i]] = reason
    return found
