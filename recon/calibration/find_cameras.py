"""The stage that gives every picture its camera: taken as given, or found from the markers and the canister's edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration import bare_canister, markers, poses
from rhizotwin.recon.calibration.cameras import Camera, Cameras, MarkerCalibration, StripCalibration
from rhizotwin.recon.calibration.canister_pose import CanisterPose, find_canister
from rhizotwin.recon.calibration.chain import Chain
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.pictures import Pictures
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames, model
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor

LEAST_VIEWS = 3
"""Two silhouettes bound no shape."""
FOCUS_GIVEN = 1e-4
"""How far a calibrated lens may be off (`docs/calibration.md`: 0.009 %)."""

_LEAST_BLURS = 3
"""Markers of a picture that tell its blur: one alone may have a highlight on it."""


def find_cameras(
    pictures: Pictures,
    *,
    settings: CalibrationSettings = CalibrationSettings(),
    monitor: Monitor,
    measure: bool = True,
    single_view: bool = False,
) -> Cameras:
    """Take the given cameras, or find every camera from the markers.

    Parameters
    ----------
    settings : CalibrationSettings
        Which views are left out, and what is known of the rig beforehand.
    measure, single_view : bool
        As in `markers.detect_markers` and `poses.find_poses`; ``single_view`` also trusts the strip.

    Returns
    -------
    Cameras
        In the order of the frames.

    Raises
    ------
    UserError
        Where too few pictures have a camera.
    """
    scene, optics = pictures.dataset.scene, Optics.of(pictures.dataset.scene)
    if scene.tank is not None and (scene.strip.rows == 0 or single_view or pictures.frames[0].cam_from_canister is not None):
        raise UserError(
            f"{pictures.dataset.folder}: how the tank stands is found from the markers of all views together: "
            "it needs the strip, and neither given cameras nor single views"
        )
    if all(frame.cam_from_canister is not None for frame in pictures.frames):
        poses_given = [np.array(frame.cam_from_canister) for frame in pictures.frames]
        return _usable(pictures, _exact(pictures, scene.camera, poses_given))
    if scene.strip.rows == 0:
        with monitor.stage("canister"):
            bare = bare_canister.find_cameras(pictures.images, scene, _table_deg(pictures))
        lens = replace(scene.camera, mm_per_px=bare.mm_per_px)
        return _usable(pictures, replace(_exact(pictures, lens, bare.cam_from_canister), bare=bare.uncertainty, warnings=bare.notes(scene)))
    detected = _markers(pictures, measure, monitor)
    with monitor.stage("poses"):
        solved = poses.find_poses(detected, scene, pictures.frames, settings=settings, single_view=single_view)
    lens = scene.camera.focused(solved.focal_scale)
    left_out = tuple(f"{view.file} is left out: {view.reason}" for view in solved.views if not view.used)
    with monitor.stage("canister"):
        canister = None if single_view else _canister(pictures, solved, lens, settings)
    chain = Chain.of(solved, canister)
    found = tuple(_in_tank(chain.camera(k, view), canister) if scene.tank else chain.camera(k, view) for k, view in enumerate(solved.views))
    cameras = Cameras(
        lens=lens,
        optics=optics,
        all=found,
        order=_used(found),
        uncertainty=chain.uncertainty(pictures.frames, focus=FOCUS_GIVEN if solved.focal_scale == 1.0 else 0.0),
        markers=_calibration(pictures.frames, detected, solved, canister, chain),
        warnings=(*solved.warnings, *left_out),
    )
    return _usable(pictures, cameras)


def _in_tank(camera: Camera, canister: CanisterPose | None) -> Camera:
    """Turn a view's tank as the canister's edges tell; leave the view out where nobody knows how its tank stands."""
    if camera.cam_from_tank is None:
        return replace(camera, used=False, reason=camera.reason or "its table angle is not known, and so not how the tank stands to it")
    turn = 0.0 if canister is None else float(np.deg2rad(canister.tank_turn_deg))
    return replace(camera, cam_from_tank=camera.cam_from_tank @ frames.rotation_z(turn))


def _markers(pictures: Pictures, measure: bool, monitor: Monitor) -> list[markers.Markers]:
    """Find every picture's markers, but for those that were measured already."""
    known: Mapping[int, markers.Markers] = pictures.measured if measure else {}

    def find(k: int) -> markers.Markers:
        kept = known.get(k)
        return markers.detect_markers(pictures.images[k], pictures.dataset.scene.strip, measure=measure) if kept is None else kept

    with monitor.stage("markers"):
        return monitor.each(find, "markers", range(len(pictures.images)))


def _exact(pictures: Pictures, lens: model.Camera, poses: Sequence[frames.Array]) -> Cameras:
    """Return cameras of one lens at poses (F, 4, 4), which count as exact."""
    every = tuple(
        Camera(file=frame.file, ring=frame.ring, used=True, cam_from_canister=lens.pinhole_pose(pose), table_deg=frame.table_deg)
        for frame, pose in zip(pictures.frames, poses, strict=True)
    )
    optics = Optics.of(pictures.dataset.scene)
    if pictures.dataset.masks and optics.straight:
        optics = _nothing_hidden(optics, poses)
    return Cameras(lens=lens.as_pinhole(), optics=optics, all=every, order=_used(every))


def _nothing_hidden(optics: Optics, poses: Sequence[frames.Array]) -> Optics:
    """Return straight optics without rim and floor, which silhouettes made in air do not have.

    A line of sight enters the wall between the camera's height and that of what it sees.
    """
    heights = [float(frames.invert(pose)[2, 3]) for pose in poses]
    low, high = min(heights), max(heights)
    return replace(
        optics,
        floor_z_mm=min(optics.floor_z_mm, low),
        water_z_mm=max(optics.water_z_mm, high),
        bottom_z_mm=min(optics.bottom_z_mm, low),
    )


def _table_deg(pictures: Pictures) -> list[float]:
    """Return the angles that the table was told, which cameras without markers start from."""
    told = [frame.table_deg for frame in pictures.frames if frame.table_deg is not None]
    if len(told) < len(pictures.frames) or len({frame.ring for frame in pictures.frames}) != 1:
        raise UserError(
            f"{pictures.dataset.folder}: without markers, pictures of one ring with their table angles are needed; "
            "give the scene a plan of as many views as there are pictures"
        )
    return told


def _used(found: Sequence[Camera]) -> tuple[int, ...]:
    return tuple(k for k, view in enumerate(found) if view.used)


def _usable(pictures: Pictures, cameras: Cameras) -> Cameras:
    """Return cameras that are enough to go on with."""
    if len(cameras.order) < LEAST_VIEWS:
        reasons = "; ".join(sorted({f"{view.file}: {view.reason}" for view in cameras.all if view.reason})[:3])
        raise UserError(
            f"{pictures.dataset.folder}: only {len(cameras.order)} of {len(cameras.all)} pictures of roots have a camera pose and at least "
            f"{LEAST_VIEWS} are needed ({reasons or 'take more of the turn'})."
        )
    return cameras


def _canister(pictures: Pictures, solved: poses.Poses, lens: model.Camera, settings: CalibrationSettings) -> CanisterPose | None:
    """Find how the canister stands in the strip, from the views that are used; None where its edges are not seen."""
    keys = [k for k, view in enumerate(solved.views) if view.used and (view.cam_from_tank is not None or not pictures.dataset.scene.tank)]
    if not keys:
        return None
    poses_found = Cameras(lens=lens, optics=Optics.of(pictures.dataset.scene), all=solved.views, order=tuple(keys))
    views = poses_found.views
    errors = None if solved.errors is None else solved.errors.of(keys, [None] * len(keys))
    return find_canister(views, lambda i: pictures.images[keys[i]], pictures.dataset.scene, errors=errors, settings=settings)


def _calibration(
    captured: Sequence[Frame],
    detected: Sequence[markers.Markers],
    solved: poses.Poses,
    canister: CanisterPose | None,
    chain: Chain,
) -> MarkerCalibration:
    """Gather what all views together gave."""
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
    """Return how much more the least sharp picture is blurred than the sharpest, by the blurs of each one's markers."""
    medians = [float(np.median(one)) for one in blurs if len(one) >= _LEAST_BLURS]
    return float(np.sqrt(max(medians) ** 2 - min(medians) ** 2)) if medians else None
