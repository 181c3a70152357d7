"""Camera stage: use given cameras, or estimate cameras from the markers and the canister's edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration import bare_canister, markers, poses
from rhizotwin.recon.calibration.cameras import LEAST_VIEWS, Camera, Cameras, MarkerCalibration, StripCalibration
from rhizotwin.recon.calibration.canister_pose import CanisterPose, find_canister
from rhizotwin.recon.calibration.strip_to_canister import StripToCanister
from rhizotwin.recon.calibration.vessel_shape import refuse_corners
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames, model
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor

FOCUS_GIVEN = 1e-4
"""Relative standard deviation of the focal length of a calibrated lens. A calibration reached 0.009 %
(`docs/calibration.md`)."""

_LEAST_BLURS = 3
"""Minimum number of markers from which the blur of a picture is computed. A single marker may contain a highlight."""


def find_cameras(
    pictures: Pictures,
    *,
    settings: CalibrationSettings = CalibrationSettings(),
    monitor: Monitor,
    measure: bool = True,
    single_view: bool = False,
) -> Cameras:
    """Use the cameras given in the dataset, or estimate the camera of every picture from markers or edges.

    Parameters
    ----------
    settings : CalibrationSettings
        Thresholds for the exclusion of views, and priors of the rig.
    measure, single_view : bool
        See `markers.detect_markers` and `poses.find_poses`; ``single_view`` also assumes an aligned strip.

    Returns
    -------
    Cameras
        Cameras in the order of the frames.

    Raises
    ------
    UserError
        If fewer than `LEAST_VIEWS` pictures have a camera pose, or if the scene has a tank but no marker strip.
    """
    scene, optics = pictures.dataset.scene, Optics.from_scene(pictures.dataset.scene)
    if scene.tank is not None:
        _require_markers(pictures, single_view)
    if all(frame.cam_from_canister is not None for frame in pictures.frames):
        poses_given = [np.array(frame.cam_from_canister) for frame in pictures.frames]
        return _require_views(pictures, _exact_cameras(pictures, scene.camera, poses_given))
    if scene.strip.rows == 0:
        return _require_views(pictures, _calibrate_bare(pictures, monitor))
    detected = _detect_markers(pictures, measure, monitor)
    with monitor.stage("poses"):
        solved = poses.find_poses(detected, scene, pictures.frames, settings=settings, single_view=single_view)
    lens = scene.camera.focused(solved.focal_scale)
    _require_round_vessel(pictures, solved, lens)
    left_out = tuple(f"{view.file} is excluded: {view.reason}" for view in solved.views if not view.used)
    with monitor.stage("canister"):
        canister = None if single_view else _find_canister(pictures, solved, lens, settings)
    chain = StripToCanister.combine(solved, canister)
    found = tuple(chain.camera(k, view) for k, view in enumerate(solved.views))
    if scene.tank:
        found = tuple(_rotate_tank(camera, canister) for camera in found)
    cameras = Cameras(
        lens=lens,
        optics=optics,
        all=found,
        order=_used_frames(found),
        uncertainty=chain.uncertainty(pictures.frames, focus=FOCUS_GIVEN if solved.focal_scale == 1.0 else 0.0),
        markers=_collect_results(pictures.frames, detected, solved, canister, chain),
        warnings=(*solved.warnings, *left_out),
    )
    return _require_views(pictures, cameras)


def _require_markers(pictures: Pictures, single_view: bool) -> None:
    """Raise a UserError if the position of a tank cannot be estimated from the markers of all pictures."""
    if pictures.frames[0].cam_from_canister is not None:
        reason = "the dataset contains camera poses; import the pictures again without --cameras"
    elif pictures.dataset.scene.strip.rows == 0:
        reason = "the scene has no marker strip; take the scan with a strip, or remove the section [tank] if there is no tank"
    elif single_view:
        reason = "this method calibrates each picture alone; use --method ours"
    else:
        return
    raise UserError(
        f"{pictures.dataset.folder}: the position of the tank can only be estimated from the markers of all pictures together, "
        f"but {reason}."
    )


def _require_round_vessel(pictures: Pictures, solved: poses.Poses, lens: model.Camera) -> None:
    """Raise a UserError if the vessel is not round in the pictures from which the transfer curve was determined."""
    keys = tuple(k for k in pictures.measured if solved.views[k].used)
    if pictures.dataset.scene.tank is None:
        views = Cameras(lens=lens, optics=Optics.from_scene(pictures.dataset.scene), all=solved.views, order=keys).views
        refuse_corners(views, [pictures.images[k] for k in keys], pictures.dataset.scene)


def _calibrate_bare(pictures: Pictures, monitor: Monitor) -> Cameras:
    """Calibrate the cameras of a scan without markers."""
    scene = pictures.dataset.scene
    with monitor.stage("canister"):
        bare = bare_canister.find_cameras(pictures.images, scene, _table_deg(pictures))
    cameras = _exact_cameras(pictures, replace(scene.camera, mm_per_px=bare.mm_per_px), bare.cam_from_canister)
    return replace(cameras, bare=bare.uncertainty, warnings=bare.notes(scene))


def _rotate_tank(camera: Camera, canister: CanisterPose | None) -> Camera:
    """Rotate a view's tank by the angle estimated from the canister's edges.

    The view is excluded if the pose of its tank is unknown.
    """
    if camera.cam_from_tank is None:
        return replace(
            camera, used=False, reason=camera.reason or "its table angle could not be determined, so the position of the tank is unknown"
        )
    turn = 0.0 if canister is None else float(np.deg2rad(canister.tank_turn_deg))
    return replace(camera, cam_from_tank=camera.cam_from_tank @ frames.rotation_z(turn))


def _detect_markers(pictures: Pictures, measure: bool, monitor: Monitor) -> list[markers.Markers]:
    """Detect the markers of every picture; reuse markers that were already measured."""
    known: Mapping[int, markers.Markers] = pictures.measured if measure else {}
    strip, lamps_off = pictures.dataset.scene.strip, pictures.dataset.lamps_off

    def find(k: int) -> markers.Markers:
        kept = known.get(k)
        return markers.detect_markers(pictures.images[k], strip, measure=measure, lamps_off=lamps_off) if kept is None else kept

    with monitor.stage("markers"):
        return monitor.each(find, "markers", range(len(pictures.images)))


def _exact_cameras(pictures: Pictures, lens: model.Camera, poses: Sequence[frames.Array]) -> Cameras:
    """Return cameras with exact poses (F, 4, 4) that share one lens."""
    every = tuple(
        Camera(file=frame.file, ring=frame.ring, used=True, cam_from_canister=lens.pinhole_pose(pose), table_deg=frame.table_deg)
        for frame, pose in zip(pictures.frames, poses, strict=True)
    )
    optics = Optics.from_scene(pictures.dataset.scene)
    if pictures.dataset.masks and optics.straight:
        optics = replace(optics, unobstructed=True)  # rendered in air: neither rim nor floor obstructs rays
    return Cameras(lens=lens.as_pinhole(), optics=optics, all=every, order=_used_frames(every))


def _table_deg(pictures: Pictures) -> list[float]:
    """Return the commanded table angles, degrees.

    They are the initial values of the table angles if there are no markers.
    """
    angles = [frame.table_deg for frame in pictures.frames if frame.table_deg is not None]
    if len(angles) < len(pictures.frames) or len({frame.ring for frame in pictures.frames}) != 1:
        raise UserError(
            f"{pictures.dataset.folder}: calibration without markers requires pictures of exactly one ring, each with a table angle. "
            "The plan in the scene must have as many views as there are pictures."
        )
    return angles


def _used_frames(found: Sequence[Camera]) -> tuple[int, ...]:
    return tuple(k for k, view in enumerate(found) if view.used)


def _require_views(pictures: Pictures, cameras: Cameras) -> Cameras:
    """Return the cameras; raise a UserError if too few views have a pose."""
    if len(cameras.order) < LEAST_VIEWS:
        reasons = "; ".join(sorted({f"{view.file}: {view.reason}" for view in cameras.all if view.reason})[:3])
        raise UserError(
            f"{pictures.dataset.folder}: only {len(cameras.order)} of {len(cameras.all)} pictures have a camera pose, but at least "
            f"{LEAST_VIEWS} are required ({reasons or 'take more pictures of the turn'})."
        )
    return cameras


def _find_canister(pictures: Pictures, solved: poses.Poses, lens: model.Camera, settings: CalibrationSettings) -> CanisterPose | None:
    """Estimate the canister's pose in the strip from the used views; None if its edges are not visible."""
    keys = [k for k, view in enumerate(solved.views) if view.used and (view.cam_from_tank is not None or not pictures.dataset.scene.tank)]
    if not keys:
        return None
    poses_found = Cameras(lens=lens, optics=Optics.from_scene(pictures.dataset.scene), all=solved.views, order=tuple(keys))
    views = poses_found.views
    errors = solved.errors.reorder(keys, [None] * len(keys)) if solved.rings else None  # single views are treated as exact
    return find_canister(views, lambda i: pictures.images[keys[i]], pictures.dataset.scene, errors=errors, settings=settings)


def _collect_results(
    captured: Sequence[Frame],
    detected: Sequence[markers.Markers],
    solved: poses.Poses,
    canister: CanisterPose | None,
    chain: StripToCanister,
) -> MarkerCalibration:
    """Collect the results of the calibration of all views."""
    turned = [
        view.table_deg - frame.table_deg
        for frame, view in zip(captured, solved.views, strict=True)
        if view.used and view.table_deg is not None and frame.table_deg is not None
    ]
    blurs = [found.blur_px for found in detected if found.blur_px is not None]
    strip = {one.name: getattr(solved, one.name) for one in fields(StripCalibration)}
    return MarkerCalibration(
        **strip | {"table_from_canister": chain.table_from_canister},
        table_sigma=chain.table_sigma,
        table_correction_deg=float(np.std(turned)) if turned else None,
        blur_px=float(np.median(np.concatenate(blurs))) if blurs else None,
        refocus_px=_refocus_px(blurs),
        canister=canister,
    )


def _refocus_px(blurs: Sequence[NDArray[np.float64]]) -> float | None:
    """Return the additional blur of the least sharp picture relative to the sharpest, px.

    It is the square root of the difference between the squared blurs of the two pictures. ``blurs`` contains the blur
    of each marker in each picture.
    """
    medians = [float(np.median(one)) for one in blurs if len(one) >= _LEAST_BLURS]
    return float(np.sqrt(max(medians) ** 2 - min(medians) ** 2)) if medians else None
