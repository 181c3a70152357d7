"""Comparison of camera poses and silhouettes with the truth, view by view."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.results.parts import picture_path
from rhizotwin.scenes import frames, model
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.truth import Truth
from rhizotwin.stored.result_files import read_grey

HALF = 0.49
"""Minimum coverage of a pixel that counts as covered. It is slightly below one half, because sampled coverages are
often exactly one half, and rounding errors must not decide about these pixels."""


@dataclass(frozen=True, kw_only=True)
class PoseScore:
    """Errors of the camera poses in the canister frame, for the views that the reconstruction used."""

    used: int
    """Number of used views."""
    left_out: int
    """Number of unused views."""
    median_mm: float
    """Median distance between found and true camera centres, mm."""
    max_mm: float
    """Maximum distance between found and true camera centres, mm."""
    median_deg: float
    """Median angle between found and true camera orientations, deg."""
    max_deg: float
    """Maximum angle between found and true camera orientations, deg."""
    common_mm: float
    """Mean shift of all views, evaluated at the centre of the specimen, mm. It is equivalent to an error of the
    canister frame."""
    common_deg: float
    """Mean rotation of all views, deg. It is equivalent to an error of the canister frame."""
    own_mm: float
    """Median of the views' shifts at the centre of the specimen, mm, after subtraction of the mean shift of all
    views."""
    per_view: dict[str, tuple[float, float]]
    """Position error (mm) and orientation error (deg) of each view, keyed by file name."""


@dataclass(frozen=True, kw_only=True)
class MaskScore:
    """Errors of the silhouettes in the usable pixels of each picture. Each value is the median over the used views."""

    mean_abs: float
    """Mean absolute error of the coverage, divided by the mean true coverage."""
    iou: float
    """Intersection over union of the pixels with at least half coverage."""
    area_error: float
    """Relative error of the covered area (found / true - 1)."""
    unseen: float
    """Fraction of the true covered area that lies in unusable pixels."""
    per_view: dict[str, tuple[float, float, float, float]]
    """Values of ``mean_abs``, ``iou``, ``area_error`` and ``unseen`` of each view, keyed by file name."""


def compare_poses(cameras: Sequence[Camera], truth: Truth, lens: model.Camera, *, centre_mm: frames.Array) -> PoseScore | None:
    """Compute the pose errors of the used views of a result. Return None if no view was used.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras of the result.
    truth : Truth
        Ground truth with the poses of the same pictures.
    lens : model.Camera
        Camera model, which converts the pose of a telecentric camera to that of a pinhole camera.
    centre_mm : (3,) array
        Centre of the specimen, mm, canister frame, at which shifts are evaluated.

    Returns
    -------
    PoseScore or None
        Errors of positions and orientations.
    """
    true_poses = {view.file: lens.pinhole_pose(np.array(view.cam_from_canister)) for view in truth.views}
    poses = {view.file: view.cam_from_canister for view in cameras if view.used and view.cam_from_canister is not None}
    unknown = [file for file in poses if file not in true_poses]
    if unknown:
        raise UserError(f"truth/truth.json contains no camera of {unknown[0]}; repeat the simulation")
    if not poses:
        return None
    found = list(poses.values())
    true = [true_poses[file] for file in poses]
    errors = {file: frames.pose_error(a, b) for file, a, b in zip(poses, found, true, strict=True)}
    mm, deg = np.array(list(errors.values())).T

    # each view is an estimate of the transform between found and true canister frame; the mean is the common part
    true_from_found = np.array([frames.invert(b) @ a for a, b in zip(found, true, strict=True)])
    shifts = np.array([frames.apply(pose, centre_mm) for pose in true_from_found]) - centre_mm
    turn = Rotation.from_matrix(true_from_found[:, :3, :3]).mean().magnitude()
    return PoseScore(
        used=len(poses),
        left_out=len(cameras) - len(poses),
        median_mm=float(np.median(mm)),
        max_mm=float(mm.max()),
        median_deg=float(np.median(deg)),
        max_deg=float(deg.max()),
        common_mm=float(np.linalg.norm(shifts.mean(axis=0))),
        common_deg=float(np.rad2deg(turn)),
        own_mm=float(np.median(np.linalg.norm(shifts - shifts.mean(axis=0), axis=1))),
        per_view=errors,
    )


def compare_masks(silhouettes: Mapping[str, Silhouette], masks_folder: Path, *, image_wh: tuple[int, int]) -> MaskScore | None:
    """Compute the silhouette errors of the used views. Return None if the result contains no silhouettes."""
    errors: dict[str, tuple[float, float, float, float]] = {}
    for file, found in silhouettes.items():
        true = read_grey(picture_path(masks_folder, file), image_wh=image_wh)
        errors[file] = mask_errors(found.coverage, true, found.usable)
    if not errors:
        return None
    middle = np.nanmedian(np.array(list(errors.values())), axis=0)
    return MaskScore(mean_abs=float(middle[0]), iou=float(middle[1]), area_error=float(middle[2]), unseen=float(middle[3]), per_view=errors)


def mask_errors(found: Image, true: Image, seen: Mask) -> tuple[float, float, float, float]:
    """Compare found and true coverage (H, W), 0 to 1, in the usable pixels ``seen`` (H, W) of a view.

    Return four measures, which are described in `MaskScore`: mean_abs, iou, area_error and unseen.
    """
    area = float(true[seen].sum(dtype=np.float64))
    total = float(true.sum(dtype=np.float64))
    found_area = float(found[seen].sum(dtype=np.float64))
    difference = float(np.abs(found - true)[seen].sum(dtype=np.float64))
    either = int(((found >= HALF) | (true >= HALF))[seen].sum())
    both = int(((found >= HALF) & (true >= HALF))[seen].sum())
    unseen = 1.0 - area / total if total > 0.0 else 0.0
    if area == 0.0:  # for an empty true silhouette the error is zero if the found silhouette is empty, otherwise infinite
        return (0.0, 1.0, 0.0, unseen) if found_area == 0.0 else (float("inf"), 0.0, float("inf"), unseen)
    return difference / area, both / either if either else 1.0, found_area / area - 1.0, unseen
