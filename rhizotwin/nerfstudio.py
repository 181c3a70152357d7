"""Reader of camera poses and lens parameters in nerfstudio's format transforms.json.

In nerfstudio (docs.nerf.studio, "Data conventions"), ``transform_matrix`` is camera-to-world with OpenGL axes (x right,
y up, z backward), and pixel coordinates have their origin at the corner of the first pixel, whose centre is (0.5, 0.5).
This project uses OpenCV's conventions: x right, y down, z forward, and pixel centres at integers. The world of the
file is the canister frame, in millimetres.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.reading import read_file

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")
_LENS_KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x", "camera_angle_y")


LARGEST = 1e9
"""Upper limit of the numbers in a file, whether they are in pixels or in mm."""


@dataclass(frozen=True, kw_only=True)
class GivenCameras:
    """Lens and camera poses of a file transforms.json."""

    camera: Camera
    cam_from_canister: dict[str, frames.Array]
    """Pose (4, 4) of each picture with OpenCV axes, in mm. The key is the file name of the picture as written in the
    file, with or without its suffix."""


def read_cameras(path: Path, camera: Camera) -> GivenCameras:
    """Read a file transforms.json.

    Parameters
    ----------
    path : Path
        File to read.
    camera : Camera
        Source of the properties that the format does not include, such as the bit depth.

    Returns
    -------
    GivenCameras
        Lens and poses.

    Raises
    ------
    UserError
        If the file is missing or damaged, the lens model is not OpenCV's, frames have different lenses, or a matrix is
        not a rigid transform.
    """
    try:
        text = read_file(path).decode()
    except UnicodeDecodeError as error:
        raise UserError(f"{path} cannot be read; give a transforms.json in nerfstudio's format") from error
    try:
        given = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not JSON ({error}); give a transforms.json in nerfstudio's format") from error
    if not isinstance(given, dict) or not isinstance(given.get("frames"), list) or not given["frames"]:
        raise UserError(f"{path}: the list 'frames' is missing or empty; give a transforms.json in nerfstudio's format")
    canister_from_world = _canister_from_world(given, path)
    poses: dict[str, frames.Array] = {}
    for index, frame in enumerate(given["frames"]):
        name, cam_from_canister = _read_frame(frame, canister_from_world, where=f"{path}, frames[{index}]")
        if name in poses:
            raise UserError(f"{path}, frames[{index}]: the picture {name} has two cameras; each picture name must be unique")
        poses[name] = cam_from_canister
    return GivenCameras(camera=_read_lens(given, camera, path), cam_from_canister=poses)


def _read_lens(given: dict[str, Any], camera: Camera, path: Path) -> Camera:
    model = given.get("camera_model", "OPENCV")
    if model not in MODELS:
        raise UserError(
            f"{path}: camera_model {model!r} is not supported; undistort the pictures, and use one of {', '.join(MODELS)} for them"
        )
    focal_x = _number(given, "fl_x", path)
    focal_y = _number(given, "fl_y", path, default=focal_x)
    width, height = _number(given, "w", path), _number(given, "h", path)
    if not (focal_x > 0.0 and focal_y > 0.0):
        raise UserError(f"{path}: fl_x and fl_y must be positive, but they are {focal_x:g} and {focal_y:g}")
    if not (width >= 16 and height >= 16 and width == int(width) and height == int(height)):
        raise UserError(f"{path}: w and h must be whole numbers of at least 16, but they are {width:g} and {height:g}")
    if _number(given, "k4", path, default=0.0) != 0.0:
        raise UserError(f"{path}: the distortion coefficient k4 is not supported; undistort the pictures first")
    k1, k2, p1, p2, k3 = (_number(given, key, path, default=0.0) for key in ("k1", "k2", "p1", "p2", "k3"))
    return replace(
        camera,
        image_wh=(int(width), int(height)),
        focal_px=(focal_x, focal_y),
        principal_px=(_number(given, "cx", path) - 0.5, _number(given, "cy", path) - 0.5),
        distortion=(k1, k2, p1, p2, k3),
    )


def _read_frame(frame: Any, canister_from_world: frames.Array, *, where: str) -> tuple[str, frames.Array]:
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise UserError(f"{where}: file_path is missing; add the file name of the picture")
    own = [key for key in _LENS_KEYS if key in frame]
    if own:
        raise UserError(f"{where}: {own[0]} is set for a single picture; all pictures must share the lens at the top of the file")
    world_from_gl = _matrix(frame.get("transform_matrix"), where=f"{where}: transform_matrix")
    canister_from_cam = canister_from_world @ world_from_gl @ OPENCV_FROM_OPENGL
    name = PurePosixPath(frame["file_path"].replace("\\", "/")).name
    return name, frames.invert(canister_from_cam)


def _canister_from_world(given: dict[str, Any], path: Path) -> frames.Array:
    """Return the inverse (4, 4) of the transform that nerfstudio applied to the poses (``applied_transform``).

    Without ``applied_transform`` the matrix is the identity.
    """
    if _number(given, "applied_scale", path, default=1.0) != 1.0:
        raise UserError(f"{path}: applied_scale must be 1, because the coordinates must be in the canister frame in millimetres")
    applied = given.get("applied_transform")
    return np.eye(4) if applied is None else frames.invert(_matrix(applied, where=f"{path}: applied_transform"))


def _matrix(rows: Any, *, where: str) -> frames.Array:
    """Convert 3 or 4 rows of 4 numbers to a rigid transform (4, 4) with an exactly orthonormal rotation."""
    try:
        matrix = np.array(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise UserError(f"{where} must have 3 or 4 rows of 4 numbers")
    rotation = matrix[:3, :3]
    if np.abs(rotation).max() > 1.1 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0.0:
        raise UserError(f"{where} is not a rigid transform; remove scale, shear and mirroring")
    if matrix.shape == (4, 4) and np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise UserError(f"{where} must end with the row 0 0 0 1")
    left, _, right = np.linalg.svd(rotation)
    return frames.from_rotation_translation(left @ right, matrix[:3, 3])


def _number(given: dict[str, Any], key: str, path: Path, *, default: float | None = None) -> float:
    value = given.get(key, default)
    if value is None:
        raise UserError(f"{path}: {key} is missing; give a transforms.json in nerfstudio's format with the lens at the top of the file")
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise UserError(f"{path}: {key} must be a number below {LARGEST:g}, but it is {str(value)[:40]}")
    return float(value)
