"""The whole way from a dataset to a result: read, cameras, silhouettes, shape, write."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.recon import drawing, shaping
from rhizotwin.recon.calibration import markers, poses
from rhizotwin.recon.calibration.canister_seat import CanisterSeat, find_seat
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results import calibrated, result
from rhizotwin.recon.run import Run
from rhizotwin.recon.tubes.root_calibration import RigDoubt
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import sha256_of
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.provenance import peak_memory_mib, versions

LEAST_VIEWS = 3
SEAT_UNSEEN = np.array([0.1, 0.1, 0.2, 0.2])
"""How askew (degrees, mm) a canister may stand in the strip where its edges were not seen."""
FOCUS_GIVEN = 1e-4
"""How far a calibrated lens may be off (`docs/calibration.md`: 0.009 %)."""
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh")


def reconstruct(
    dataset_folder: Path, result_folder: Path, *, voxel_mm: float = 0.27, mass_g: float | None = None, progress: bool = True
) -> result.Result:
    """Reconstruct a dataset and write a result folder.

    Parameters
    ----------
    voxel_mm : edge of the voxels that are written; measuring inside them is finer (`recon.shaping.FINEST_MM`).
    mass_g : mass of the roots, if they were weighed; for the traits only.

    Raises
    ------
    UserError
        Where the pictures cannot be used; the message names the file and what to do.
    """
    run = Run.of(Path(dataset_folder), progress=progress)
    found, rig = find_cameras(run)
    views = usable(run, found)
    optics = Optics.of(run.dataset.scene)
    drawn = drawing.draw(run, views, optics)
    shape = shaping.build(run, drawn, views, optics, voxel_mm=voxel_mm)
    if rig or run.asked_roots is not None:
        rig |= calibrated.of_roots(run.asked_roots, optics, rig.get("focal_scale", 1.0))
    settings = {"voxel_mm": voxel_mm, "slack_px": shaping.SLACK_PX}
    return finish(run, _corrected(run, found), rig, drawn, shape, Path(result_folder), settings=settings, mass_g=mass_g)


def find_cameras(run: Run, *, measure: bool = True, single_view: bool = False) -> tuple[list[result.ViewResult], dict[str, Any]]:
    """Take the given cameras, or find every camera from the markers.

    Parameters
    ----------
    measure, single_view : as in `markers.detect_markers` and `poses.find_poses`; ``single_view`` also trusts the strip.

    Returns
    -------
    views : what became of each picture, in the order of the frames.
    rig : what all views together gave, for ``result.json``.
    """
    if all(frame.cam_from_canister is not None for frame in run.frames):
        given = [
            result.ViewResult(
                file=frame.file,
                ring=frame.ring,
                used=True,
                cam_from_canister=[list(row) for row in frame.cam_from_canister or ()],
                table_deg=frame.table_deg,
            )
            for frame in run.frames
        ]
        return given, {}
    strip = run.dataset.scene.strip
    with run.stage("markers"):
        detected = run.each(
            lambda k: markers.detect_markers(run.images[k], strip, measure=measure), "markers", list(range(len(run.images)))
        )
    with run.stage("poses"):
        solved = poses.find_poses(detected, run.dataset.scene, run.frames, single_view=single_view)
    found = [
        result.ViewResult(
            file=frame.file,
            ring=frame.ring,
            used=view.used,
            reason=view.reason,
            cam_from_canister=None if view.cam_from_canister is None else view.cam_from_canister.tolist(),
            reprojection_px=view.reprojection_px,
            position_sigma_mm=view.position_sigma_mm,
            rotation_sigma_deg=view.rotation_sigma_deg,
            markers=view.markers,
            table_deg=view.table_deg,
        )
        for frame, view in zip(run.frames, solved.views, strict=True)
    ]
    run.camera = run.camera.focused(solved.focal_scale)
    run.warnings += solved.warnings
    run.warnings += [f"{view.file} is left out: {view.reason}" for view in found if not view.used]
    with run.stage("seat"):
        seat = None if single_view else _seat(run, found)
    run.doubt = _doubt(run, solved, seat)
    strip_from_canister = np.eye(4) if seat is None else frames.invert(seat.canister_from_strip)
    found = [
        view
        if view.cam_from_canister is None
        else replace(view, cam_from_canister=(np.array(view.cam_from_canister) @ strip_from_canister).tolist())
        for view in found
    ]
    turned = [
        view.table_deg - frame.table_deg
        for frame, view in zip(run.frames, found, strict=True)
        if view.used and view.table_deg is not None and frame.table_deg is not None
    ]
    return found, _rig(solved, seat, strip_from_canister) | {"table_correction_deg": float(np.std(turned)) if turned else None}


def _corrected(run: Run, found: list[result.ViewResult]) -> list[result.ViewResult]:
    """Return the views with the cameras as the roots corrected them, where they did."""
    asked, found = run.asked_roots, list(found)
    if asked is not None and asked.believed:
        for k, view in zip(asked.sights.frames, asked.sights.views, strict=True):
            found[k] = replace(found[k], cam_from_canister=view.cam_from_canister.tolist())
    return found


def _doubt(run: Run, solved: poses.Poses, seat: CanisterSeat | None) -> RigDoubt:
    """Return how well markers and edges know the rig; a view of no station is a station of its own."""
    stations = [(ring.ring, ring.placement) for ring in solved.rings]
    camera = [ring.covariance for ring in solved.rings]
    number = []
    for frame, view in zip(run.frames, solved.views, strict=True):
        if frame.station not in stations and view.covariance is not None:
            number.append(len(camera))
            camera.append(view.covariance)
        else:
            number.append(stations.index(frame.station) if frame.station in stations else 0)
    sigma = SEAT_UNSEEN if seat is None else seat.sigma
    focus = solved.focal_sigma if solved.focal_scale != 1.0 and solved.focal_sigma is not None else FOCUS_GIVEN
    return RigDoubt(np.array(number), np.array(camera), np.concatenate([np.deg2rad(sigma[:2]), sigma[2:]]), focus)


def _seat(run: Run, found: list[result.ViewResult]) -> CanisterSeat | None:
    """Find how the canister stands in the strip, from the views that are used; None where its edges are not seen."""
    used = {k: View(camera=run.camera, cam_from_canister=np.array(view.cam_from_canister)) for k, view in enumerate(found) if view.used}
    keys = list(used)
    return find_seat([used[k] for k in keys], lambda i: run.images[keys[i]], run.dataset.scene)


def _rig(solved: poses.Poses, seat: CanisterSeat | None, strip_from_canister: frames.Array) -> dict[str, Any]:
    """Return what all views together gave as JSON values."""
    table_from_strip = solved.table_from_canister
    return {
        "canister_from_strip": None if seat is None else seat.canister_from_strip.tolist(),
        "canister_from_strip_sigma": None if seat is None else seat.sigma.tolist(),
        "canister_edges": None
        if seat is None
        else {"count": seat.edges, "before_mm": seat.before_mm, "after_mm": seat.after_mm, "radius_excess_mm": seat.radius_excess_mm},
        "reprojection_before_px": solved.before_px,
        "reprojection_after_px": solved.after_px,
        "table_from_canister": None if table_from_strip is None else (table_from_strip @ strip_from_canister).tolist(),
        "table_from_canister_sigma": None if solved.seat_sigma is None else solved.seat_sigma.tolist(),
        "marker_inset_px": solved.inset_px,
        "focal_scale": solved.focal_scale,
        "focal_scale_found": solved.focal_found,
        "focal_scale_sigma": solved.focal_sigma,
        "rings": [
            {
                "ring": ring.ring,
                "placement": ring.placement,
                "cam_from_rig": ring.cam_from_rig.tolist(),
                "covariance": ring.covariance.tolist(),
                "own_movement_mm": ring.own_mm,
                "own_movement_deg": ring.own_deg,
            }
            for ring in solved.rings
        ],
    }


def usable(run: Run, found: list[result.ViewResult]) -> dict[int, View]:
    """Return the cameras of the views that can be used, by index of the frame.

    Raises
    ------
    UserError
        Where they are too few.
    """
    views = {k: View(camera=run.camera, cam_from_canister=np.array(view.cam_from_canister)) for k, view in enumerate(found) if view.used}
    if len(views) < LEAST_VIEWS:
        reasons = "; ".join(sorted({f"{view.file}: {view.reason}" for view in found if view.reason})[:3])
        raise UserError(
            f"{run.dataset.folder}: only {len(views)} of {len(found)} pictures have a camera pose and at least {LEAST_VIEWS} are needed "
            f"({reasons})."
        )
    return views


def finish(
    run: Run,
    found: list[result.ViewResult],
    rig: dict[str, Any],
    drawn: dict[int, Silhouette],
    shape: result.Shape,
    result_folder: Path,
    *,
    settings: dict[str, Any],
    mass_g: float | None = None,
) -> result.Result:
    """Put a result together and write its folder."""
    filled = list(found)
    for k, silhouette in drawn.items():
        filled[k] = replace(found[k], fill=float((silhouette.coverage[silhouette.seen] > 0.5).mean()))
    made = result.Result(
        dataset=str(run.dataset.folder),
        dataset_sha256=sha256_of(run.dataset.folder / "dataset.json"),
        scene=run.dataset.scene.name,
        shape=shape,
        mass_g=mass_g,
        views=tuple(filled),
        rig=rig,
        warnings=tuple(run.warnings),
        timings_s=run.timings_s,
        peak_memory_mib=peak_memory_mib(),
        settings={**settings, "finest_mm": shape.finest_mm},
        versions=versions(_VERSIONED),
        silhouettes={run.frames[k].file: silhouette for k, silhouette in drawn.items()},
    )
    result.write(made, result_folder)
    return made
