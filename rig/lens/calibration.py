"""Camera calibration from pictures of the board: selection of pictures, lens fit, warnings and output files."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.lens.board_corners import BoardView, NoBoard, find_board
from rhizotwin.rig.lens.lens_fit import DROPPED, TERMS, LensFit, fit_lens, residual_rms
from rhizotwin.scenes import frames, toml_text
from rhizotwin.scenes.atomic import write_json, write_text
from rhizotwin.scenes.board import CharucoBoard, check_board
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.orientation import read_orientation
from rhizotwin.scenes.picture_codec import decode_grey
from rhizotwin.scenes.picture_reduction import Picture
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import to_plain

CELLS_WH: Final = (8, 6)
"""Number of columns and rows of cells into which the picture is divided to measure its coverage by corners."""
ENOUGH_PICTURES: Final = 10
COVERAGE: Final = (0.15, 0.6)
"""Minimum fraction of the picture's cells that contain corners. Below the first value a calibration is rejected, and
below the second value a warning is issued."""
TILT_DEG: Final = (8.0, 20.0)
"""Minimum tilt of the most tilted board relative to the image plane, deg. Below the first value a calibration is
rejected, and below the second value a warning is issued."""
ONE_WAY_DEG: Final = 6.0
"""Minimum standard deviation of the board's tilts, deg. It is computed in the direction in which the tilts vary least,
and a warning is issued if it is smaller."""
MOST_RMS_PX: Final = (3.0, 0.5)
"""Maximum root mean square residual, px. Above the first value a calibration is rejected, and above the second value a
warning is issued."""
MOST_FOCAL_STD: Final = 0.001
MOST_BLUR_PX: Final = 3.0
SAME_WAY_DEG, SAME_WAY_SHARE = 4.0, 0.05
"""Differences between two poses of the board, below which both count as the same: angle, deg, and displacement as a
fraction of the distance to the camera."""
ENOUGH_WAYS: Final = 6


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibrated camera, with the data on which it is based, and warnings."""

    camera: Camera
    board: CharucoBoard
    fit: LensFit
    rejected: dict[str, str]
    """Reason why a picture was not used. The keys are the file names of these pictures."""
    warnings: tuple[str, ...]
    coverage: float
    """Fraction of the picture's cells that contain corners."""
    tilts_deg: dict[str, float]
    """Angle between the board and the image plane in each picture, deg. The keys are file names."""


def calibrate(paths: Sequence[Path], board: CharucoBoard, *, monitor: Monitor | None = None) -> Calibration:
    """Calibrate a camera from pictures of the board.

    Parameters
    ----------
    paths : sequence of path
        Pictures (PNG, JPG or TIFF, 8 or 16 bits) from one camera, with constant focus, size and orientation tag.
    board : CharucoBoard
        Printed board. The number of squares and the markers must be correct, whereas the scale does not affect the
        lens. If the pictures show it in the other pattern (`CharucoBoard.legacy_pattern`), that pattern is used.
    monitor : Monitor or None
        Receiver of progress reports.

    Returns
    -------
    Calibration
        Camera, fit and warnings.

    Raises
    ------
    RigError
        If there are too few pictures, the pictures are too similar, the board is tilted too little or covers too little
        of the picture, or no lens model fits.
    UserError
        If the board is invalid.
    """
    check_board(board)
    seen: dict[str, BoardView] = {}
    kinds: dict[str, tuple[int, int, int]] = {}  # width, height and orientation tag
    rejected: dict[str, str] = {}
    common_bits, depth = 0, 8
    monitor = monitor or Monitor()
    with monitor.stage("boards"), monitor.steps("boards", len(paths), "picture") as step:
        for path in paths:
            step()
            data = path.read_bytes()
            try:
                image: Picture = decode_grey(data, where=path.name)
            except UserError as error:
                rejected[path.name] = str(error).removeprefix(f"{path.name}: ")
                continue
            found, board = _find(image, board, try_other=not seen)
            if isinstance(found, NoBoard):
                rejected[path.name] = found.reason
                continue
            seen[path.name], kinds[path.name] = found, (image.shape[1], image.shape[0], read_orientation(data))
            if image.dtype == np.uint16:
                depth, common_bits = 16, common_bits | int(np.bitwise_or.reduce(image, axis=None))
    if not seen:
        raise RigError(_none_usable(rejected, len(paths)))
    most = Counter(kinds.values()).most_common(1)[0][0]
    for name, kind in kinds.items():
        if kind != most:
            del seen[name]
            rejected[name] = (
                f"the picture has {kind[0]}x{kind[1]} pixels and the orientation tag {kind[2]}, but most others {most[0]}x{most[1]} and "
                f"{most[2]}; all pictures must have the same size and tag"
            )
    bits = depth if depth == 8 else depth - _lowest_bit(common_bits)
    return calibrate_views(seen, board, most[:2], bits=bits, rejected=rejected)


def _find(image: Picture, board: CharucoBoard, *, try_other: bool) -> tuple[BoardView | NoBoard, CharucoBoard]:
    """Find the board in a picture, also in its other pattern if ``try_other``, and return the board that was found."""
    found, other = find_board(image, board), board.other_pattern if try_other else None
    if isinstance(found, BoardView) or other is None:
        return found, board
    again = find_board(image, other)
    return (again, other) if isinstance(again, BoardView) else (found, board)


def calibrate_views(
    views: dict[str, BoardView], board: CharucoBoard, image_wh: tuple[int, int], *, bits: int = 8, rejected: dict[str, str] | None = None
) -> Calibration:
    """Calibrate a camera from the corners detected in its pictures.

    Parameters
    ----------
    views : dict of BoardView
        Corners by file name.
    board : CharucoBoard
        Dimensions and dictionary of the printed board.
    image_wh : tuple of int
        Width and height of the pictures, px.
    bits : int
        Bit depth of the camera's converter.
    rejected : dict of str or None
        Reason for rejection of each picture excluded before this call, by file name.

    Returns
    -------
    Calibration
        Camera, fit and warnings.

    Raises
    ------
    RigError
        If the corners are insufficient, see `calibrate`.
    """
    fit = fit_lens(views, board, image_wh)
    made = Calibration(
        camera=Camera(image_wh=image_wh, focal_px=fit.focal_px, principal_px=fit.principal_px, distortion=fit.distortion, bits=bits),
        board=board,
        fit=fit,
        rejected=dict(sorted(((rejected or {}) | fit.rejected).items())),
        warnings=(),
        coverage=float(np.mean(covered_cells(fit, image_wh))),
        tilts_deg={name: _tilt_deg(pose) for name, pose in fit.cam_from_board.items()},
    )
    _check_pictures(made)
    return replace(made, warnings=tuple(_warnings(made)))


def covered_cells(fit: LensFit, image_wh: tuple[int, int]) -> Array:
    """Return an array (rows, columns) with one value per cell of the picture.

    It is 1 if the cell contains corners, and otherwise 0.
    """
    columns, rows = CELLS_WH
    corners = np.concatenate([view.corners_px for view in fit.views.values()])
    counts, _, _ = np.histogram2d(
        corners[:, 1], corners[:, 0], bins=(rows, columns), range=((-0.5, image_wh[1] - 0.5), (-0.5, image_wh[0] - 0.5))
    )
    return np.asarray(counts > 0, np.float64)


def write_calibration(made: Calibration, folder: Path) -> list[Path]:
    """Write ``camera.toml`` and ``calibration.json`` into a folder, and return their paths."""
    camera_path, numbers_path = folder / "camera.toml", folder / "calibration.json"
    write_text(camera_path, _camera_text(made))
    write_json(numbers_path, numbers(made))
    return [camera_path, numbers_path]


def numbers(made: Calibration) -> dict[str, Any]:
    """Return all numerical results of a calibration as a JSON object."""
    fit = made.fit
    return {
        "program": "rhizotwin calibrate camera",
        "camera": to_plain(made.camera),
        "standard_deviations": {
            "focal_px": list(fit.focal_std_px),
            "principal_px": list(fit.principal_std_px),
            "distortion": list(fit.distortion_std),
        },
        "left_out": list(fit.left_out),
        "with_all_terms": {term: {"value": value, "std": std} for term, (value, std) in fit.full.items()},
        "rms_px": fit.rms_px,
        "corners": fit.corners,
        "dropped_corners": fit.dropped_corners,
        "coverage": made.coverage,
        "board": to_plain(made.board),
        "pictures": [
            {
                "file": name,
                "rms_px": residual_rms(fit.residuals_px[name]),
                "corners": len(view.ids),
                "tilt_deg": made.tilts_deg[name],
                "blur_px": view.blur_px,
                "corner_sigma_px": view.sigma_px,
                "cam_from_board": fit.cam_from_board[name].tolist(),
            }
            for name, view in fit.views.items()
        ],
        "rejected": [{"file": name, "reason": reason} for name, reason in made.rejected.items()],
        "warnings": list(made.warnings),
        "versions": versions(("opencv-python-headless", "numpy", "scipy")),
        "opencv": cv2.__version__,
    }


def model_text(fit: LensFit) -> str:
    """Return a text that describes the lens model and the omitted terms."""
    terms = [term for term in TERMS if not any(term in gone.split(", ") for gone in fit.left_out)]
    focal = "one focal length" if "fx / fy" in fit.left_out else "two focal lengths (fx, fy)"
    text = f"{focal}, principal point, {'distortion ' + ' '.join(terms) if terms else 'no distortion'}"
    gone = [term for term in DROPPED if term in fit.left_out]
    return f"{text}; terms omitted because the pictures do not support them: {'; '.join(gone)}" if gone else text


def _camera_text(made: Calibration) -> str:
    fit = made.fit
    std = ", ".join(f"{value:.2g}" for value in (*fit.focal_std_px, *fit.principal_std_px))
    head = (
        f"# Fitted to {fit.corners} corners in {len(fit.views)} pictures; residual {fit.rms_px:.3f} px rms. {model_text(fit)}.\n"
        f"# Standard deviations of focal_px and principal_px: {std} px.\n"
        "# Copy these lines to the section [camera] of the scene file, in place of the lines with the same names.\n"
    )
    camera = to_plain(made.camera)
    lens = {name: camera[name] for name in ("kind", "image_wh", "focal_px", "principal_px", "distortion")}
    return head + toml_text.dumps({"camera": lens})


def _none_usable(rejected: dict[str, str], pictures: int) -> str:
    if not rejected:
        return "there are no pictures for the calibration; specify the folder that contains pictures of the board"
    kinds = {name: re.sub("[0-9]+", "#", reason) for name, reason in rejected.items()}
    kind, count = Counter(kinds.values()).most_common(1)[0]
    name = next(name for name in rejected if kinds[name] == kind)
    others = f" (same reason for {count - 1} other pictures)" if count > 1 else ""
    return f"none of the {pictures} pictures can be used; {name}: {rejected[name]}{others}"


def _lowest_bit(value: int) -> int:
    """Return the number of lowest bits that are 0 in all pixel values, at most 8.

    It is 4 for values of 12 bits that are left-aligned in 16 bits. ``value`` is the bitwise OR of all pixel values.
    """
    return min(8, (value & -value).bit_length() - 1) if value else 8


def _tilt_deg(cam_from_board: Array) -> float:
    return float(np.rad2deg(np.arccos(np.clip(abs(_normal(cam_from_board)[2]), 0.0, 1.0))))


def _normal(cam_from_board: Array) -> Array:
    """Return the unit normal (3,) of the board in the camera's frame, pointing away from the camera."""
    return cam_from_board[:3, 2]


def _ways(fit: LensFit) -> int:
    """Return the number of poses of the board that differ clearly from each other.

    Two poses differ clearly if their angle exceeds `SAME_WAY_DEG`, or their distance exceeds `SAME_WAY_SHARE`.
    """
    different: list[Array] = []
    for pose in fit.cam_from_board.values():
        for other in different:
            distance_mm, _ = frames.pose_error(frames.invert(pose), frames.invert(other))
            turned_deg = float(np.rad2deg(np.linalg.norm(frames.to_rotvec(pose @ frames.invert(other)))))
            if turned_deg < SAME_WAY_DEG and distance_mm < SAME_WAY_SHARE * float(np.linalg.norm(pose[:3, 3])):
                break
        else:
            different.append(pose)
    return len(different)


def _check_pictures(made: Calibration) -> None:
    """Raise an error if the pictures are insufficient for a useful calibration."""
    fit = made.fit
    if fit.rms_px > MOST_RMS_PX[0]:
        raise RigError(
            f"no lens model fits the pictures: the residual is {fit.rms_px:.1f} px rms, but should be below about 0.3 px; "
            "check that focus and zoom were constant, that the board is flat, and that --squares is correct"
        )
    tilt_deg = max(made.tilts_deg.values())
    if tilt_deg < TILT_DEG[0]:
        raise RigError(
            f"the board was tilted by at most {tilt_deg:.0f} degrees, so that focal length and distance cannot be distinguished; "
            "take pictures with the board tilted by 20 to 45 degrees in all directions"
        )
    if made.coverage < COVERAGE[0]:
        raise RigError(
            f"the board's corners cover only {made.coverage:.0%} of the picture; show the board in all parts of the picture, including "
            "its corners"
        )
    if (ways := _ways(fit)) < 3:
        raise RigError(
            f"the board was shown in only {ways} different orientations; take about 20 pictures, each with a different orientation of the "
            "board"
        )


def _warnings(made: Calibration) -> list[str]:
    """Return warnings. Each of them is a sentence about a reason why the lens parameters are less accurate."""
    fit, said = made.fit, []
    if len(fit.views) < ENOUGH_PICTURES:
        said.append(f"only {len(fit.views)} pictures were used; take about 20 pictures")
    if (ways := _ways(fit)) < ENOUGH_WAYS:
        said.append(f"the board was shown in only {ways} different orientations; change the orientation for each picture")
    tilt_deg = max(made.tilts_deg.values())
    if tilt_deg < TILT_DEG[1]:
        said.append(f"the board was tilted by at most {tilt_deg:.0f} degrees; tilt it by 20 to 45 degrees for an accurate focal length")
    else:
        normals = np.array([_normal(pose) / np.sign(_normal(pose)[2]) for pose in fit.cam_from_board.values()])[:, :2]
        least_deg = float(np.rad2deg(np.linalg.svd(normals, compute_uv=False)[1] / np.sqrt(len(normals))))
        if least_deg < ONE_WAY_DEG:
            said.append("the board was tilted mostly about one axis; tilt it left, right, forward and backward")
    if made.coverage < COVERAGE[1]:
        said.append(f"the corners cover {made.coverage:.0%} of the picture; the distortion is extrapolated elsewhere")
    if fit.rms_px > MOST_RMS_PX[1]:
        said.append(
            f"the residual of {fit.rms_px:.2f} px rms is high; check that the board is flat, the focus constant, and the board at rest in "
            "each picture"
        )
    focal = fit.focal_std_px[0] / fit.focal_px[0]
    if focal > MOST_FOCAL_STD:
        said.append(
            f"the standard deviation of the focal length is {focal:.2%}; take more pictures with a tilted board and from a shorter distance"
        )
    blur_px = float(np.median([view.blur_px for view in fit.views.values()]))
    if blur_px > MOST_BLUR_PX:
        said.append(f"the pictures are blurred by {blur_px:.1f} px; focus on the position of the canister, and keep the board still")
    if fit.dropped_corners > 0.02 * (fit.corners + fit.dropped_corners):
        said.append(f"{fit.dropped_corners} corners were excluded as outliers; check for glare, dirt or a bent board")
    return said
