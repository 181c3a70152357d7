"""Compare each view with the truth: where the camera was, and what the silhouette should have been."""

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
"""Half coverage, a little less: sampled coverage is often exactly one half, and rounding must not decide."""


@dataclass(frozen=True, kw_only=True)
class PoseScore:
    """Camera poses in the canister frame against the true ones, over the views that were used."""

    used: int
    left_out: int
    median_mm: float
    """Distance of the camera centres."""
    max_mm: float
    median_deg: float
    """Angle between the orientations."""
    max_deg: float
    common_mm: float
    """What all views share, as a shift of the specimen's centre: the canister's frame is off, not the cameras."""
    common_deg: float
    """What all views share, as a turn of the canister's frame."""
    own_mm: float
    """Median shift of the specimen's centre that is left when the common part is taken out."""
    per_view: dict[str, tuple[float, float]]
    """(mm, degrees) by file."""


@dataclass(frozen=True, kw_only=True)
class MaskScore:
    """Silhouettes against the true coverage, in what each picture was able to see; medians over the used views."""

    mean_abs: float
    """Mean absolute error of the coverage, relative to the mean true coverage (0 is perfect)."""
    iou: float
    """At half coverage."""
    area_error: float
    """Signed: covered area found over true, minus 1."""
    unseen: float
    """Share of the true covered area that lies where the picture was taken to say nothing."""
    per_view: dict[str, tuple[float, float, float, float]]
    """The same four numbers by file."""


def compare_poses(cameras: Sequence[Camera], truth: Truth, lens: model.Camera, *, centre_mm: frames.Array) -> PoseScore | None:
    """Return the pose errors of the used views of a result; None where no view was used.

    ``centre_mm`` is the specimen's centre (3,) in the canister frame, where shifts of the frame are stated.

    Parameters
    ----------
    cameras : sequence of Camera
        Of the result.
    truth : Truth
        Poses of the same files.
    lens : model.Camera
        To see a telecentric camera as a pinhole.
    centre_mm : (3,) array
        The specimen's centre in the canister frame, where shifts of the frame are stated.

    Returns
    -------
    PoseScore or None
        Shifts and turns, of all and of each.
    """
    true_poses = {view.file: lens.pinhole_pose(np.array(view.cam_from_canister)) for view in truth.views}
    poses = {view.file: view.cam_from_canister for view in cameras if view.used and view.cam_from_canister is not None}
    unknown = [file for file in poses if file not in true_poses]
    if unknown:
        raise UserError(f"truth/truth.json has no camera for {unknown[0]}; simulate the dataset again.")
    if not poses:
        return None
    found, true = list(poses.values()), [true_poses[file] for file in poses]
    errors = {file: frames.pose_error(a, b) for file, a, b in zip(poses, found, true, strict=True)}
    mm, deg = np.array(list(errors.values())).T

    # Each view by itself says where the found canister frame lies in the true one; their mean is the common part.
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
    """Return the silhouette errors of the used views; None where the result holds no silhouettes."""
    errors: dict[str, tuple[float, float, float, float]] = {}
    for file, found in silhouettes.items():
        true = read_grey(picture_path(masks_folder, file), image_wh=image_wh)
        errors[file] = mask_errors(found.coverage, true, found.usable)
    if not errors:
        return None
    middle = np.nanmedian(np.array(list(errors.values())), axis=0)
    return MaskScore(mean_abs=float(middle[0]), iou=float(middle[1]), area_error=float(middle[2]), unseen=float(middle[3]), per_view=errors)


def mask_errors(found: Image, true: Image, seen: Mask) -> tuple[float, float, float, float]:
    """Return (mean_abs, iou, area_error, unseen) of one view; all pictures (H, W), coverage 0..1 and seen boolean."""
    area = float(true[seen].sum(dtype=np.float64))
    total = float(true.sum(dtype=np.float64))
    found_area = float(found[seen].sum(dtype=np.float64))
    difference = float(np.abs(found - true)[seen].sum(dtype=np.float64))
    either = int(((found >= HALF) | (true >= HALF))[seen].sum())
    both = int(((found >= HALF) & (true >= HALF))[seen].sum())
    unseen = 1.0 - area / total if total > 0.0 else 0.0
    if area == 0.0:  # nothing to see: anything found is wrong without bound, nothing found is perfect
        return (0.0, 1.0, 0.0, unseen) if found_area == 0.0 else (float("inf"), 0.0, float("inf"), unseen)
    return difference / area, both / either if either else 1.0, found_area / area - 1.0, unseen
