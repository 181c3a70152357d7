"""Reader of camera poses and lens parameters in the format transforms.json of nerfstudio and instant-ngp.

In nerfstudio (docs.nerf.studio, "Data conventions"), ``transform_matrix`` is camera-to-world with OpenGL axes (x right,
y up, z backward), and pixel coordinates have their origin at the corner of the first pixel, whose centre is (0.5, 0.5).
This project uses OpenCV's conventions: x right, y down, z forward, and pixel centres at integers. The world of the
file is the canister frame, in millimetres.

Lens parameters are at the top of the file or in the frames. The two programs read them differently: nerfstudio 1.1.5
ignores those of a frame if they are also at the top, and instant-ngp ignores those at the top. instant-ngp reads
``is_fisheye``, nerfstudio only in its parser for files of instant-ngp, and ``camera_model`` in its own. A file that
they read differently is rejected.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.importer.given_cameras import LARGEST, GivenCameras, GivenPicture, collect_cameras
from rhizotwin.importer.given_lens import COEFFICIENTS, MODELS, Lens
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError, parser_message
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.reading import read_text

SAME_ANGLE = 0.01
"""Maximum relative difference between a focal length and the one that follows from the angle of view. Both are often
written. A larger difference shows that only one of them was changed, for example when pictures were made smaller."""
_ANGLES = {"camera_angle_x": 1.0, "camera_angle_y": 1.0, "x_fov": np.pi / 180.0, "y_fov": np.pi / 180.0}
"""Keys of the angle of view, with the size of their unit in radians."""
_LENS_KEYS = ("camera_model", "is_fisheye", "fl_x", "fl_y", "cx", "cy", "w", "h", *COEFFICIENTS, "distortion_params", *_ANGLES)
_REFUSED = {
    "ftheta_p0": "an f-theta lens",
    "latlong": "a panorama",
    "equirectangular": "a panorama",
    "orthographic": "an orthographic camera",
    "omega": "COLMAP's FOV lens",
    "sk_x": "a skew of the pixels",
    "sk_y": "a skew of the pixels",
    "b1": "a skew of the pixels",
    "b2": "a skew of the pixels",
    "rolling_shutter": "a rolling shutter",
    "transform_matrix_start": "a camera that moves during the exposure",
    "transform_matrix_end": "a camera that moves during the exposure",
    "normal_mts_args": "Mitsuba's axes",
}
"""Keys of the file or of a frame that this project cannot follow unless they are 0 or false, with their meaning."""
_HARMLESS = {
    *("frames", "note", "applied_transform", "applied_scale", "ply_file_path", "orientation_override", "auto_scale_poses_override"),
    *("train_filenames", "val_filenames", "test_filenames", "aabb", "aabb_scale", "render_aabb", "scale", "offset", "up", "sharpen"),
    *("file_path", "transform_matrix", "colmap_im_id", "rotation", "sharpness", "depth_file_path", "depth_path", "enable_depth_loading"),
}
"""Keys without an effect on the cameras, or read elsewhere in this module."""
_GIVE = "give a transforms.json in nerfstudio's format, or the folder of a COLMAP model"


def read_cameras(path: Path, camera: Camera) -> GivenCameras:
    """Read a file transforms.json.

    Parameters
    ----------
    path : Path
        File to read.
    camera : Camera
        Source of the properties that the format does not include, such as the bit depth, and of the picture size if the
        file does not include it.

    Returns
    -------
    GivenCameras
        Lenses and poses.

    Raises
    ------
    UserError
        If the file is missing or damaged, a lens or another property of the cameras is not supported or is ambiguous,
        or a matrix is not a rigid transform.
    """
    try:
        given = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not JSON ({parser_message(error)}); {_GIVE}") from error
    if not isinstance(given, dict) or not isinstance(given.get("frames"), list) or not given["frames"]:
        raise UserError(f"{path}: the list 'frames' is missing or empty; {_GIVE}")
    _refuse(given, where=str(path))
    notes: dict[str, None] = {}  # a set with an order
    found = collect_cameras(_pictures(given, camera.image_wh, path, notes), camera)
    if unused := _unused([given, *given["frames"]]):
        notes[f"keys of {path} that were not used: {', '.join(unused)}"] = None
    return replace(found, notes=tuple(notes))


def _pictures(
    given: dict[str, Any], scene_wh: tuple[int, int], path: Path, notes: dict[str, None]
) -> Iterator[tuple[str, str, GivenPicture]]:
    """Yield the arguments of `collect_cameras`, and add notes about assumed values."""
    canister_from_world = _canister_from_world(given, path)
    for index, frame in enumerate(given["frames"]):
        where = f"{path}, frames[{index}]"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise UserError(f"{where}: file_path is missing; add the file name of the picture")
        _refuse(frame, where=where)
        world_from_gl = _matrix(frame.get("transform_matrix"), where=f"{where}: transform_matrix")
        pose = frames.invert(canister_from_world @ world_from_gl @ frames.OPENCV_FROM_OPENGL)
        own = {key: frame[key] for key in _LENS_KEYS if frame.get(key) is not None}
        _check_levels(given, own, where=where)
        lens = _read_lens({**given, **own}, scene_wh, where if own else str(path), notes)
        yield frame["file_path"], where, GivenPicture(lens=lens, cam_from_canister=pose)


def _refuse(given: Mapping[str, Any], *, where: str) -> None:
    """Raise UserError if the file or a frame has a property that this project cannot follow."""
    for key, meaning in _REFUSED.items():
        value = given.get(key)
        if value and not (isinstance(value, list) and not np.any(np.array(value, object))):
            raise UserError(
                f"{where}: {key} means {meaning}, which is not supported; undistort the pictures, and describe them by a pinhole camera"
            )


def _unused(levels: Iterable[Mapping[str, Any]]) -> list[str]:
    known = {*_LENS_KEYS, *_REFUSED, *_HARMLESS}
    return sorted({key for level in levels for key in level if key not in known})


def _check_levels(given: Mapping[str, Any], own: Mapping[str, Any], *, where: str) -> None:
    """Raise UserError if lens parameters of a frame differ from those at the top of the file."""
    distorted = any(given.get(key) for key in (*COEFFICIENTS, "distortion_params"))
    for key, value in own.items():
        at_top = given.get(key, 0.0 if distorted and key in COEFFICIENTS else None)
        if at_top is not None and at_top != value:
            raise UserError(
                f"{where}: {key} is {str(value)[:40]}, but {str(at_top)[:40]} at the top of the file, which nerfstudio reads instead; "
                "remove one of them"
            )


def _read_lens(given: Mapping[str, Any], scene_wh: tuple[int, int], where: str, notes: dict[str, None]) -> Lens:
    """Return the lens that the keys of a frame, or of the file, describe, and add notes about assumed values."""
    model, is_fisheye = _model(given, where)
    coefficients = _coefficients(given, model, where)
    if given.get("w") is None and given.get("h") is None:
        notes[f"the camera file states no picture size (w, h), so that of the scene was assumed: {scene_wh[0]}x{scene_wh[1]}"] = None
        given = {**given, "w": scene_wh[0], "h": scene_wh[1]}
    width, height = _number(given, "w", where), _number(given, "h", where)
    if not (width >= 16 and height >= 16 and width == int(width) and height == int(height)):
        raise UserError(f"{where}: w and h must be whole numbers of at least 16, but they are {width:g} and {height:g}")
    focal_x, focal_y = (_focal(given, axis, side, where, is_fisheye=is_fisheye) for axis, side in (("x", width), ("y", height)))
    if focal_x is None and focal_y is None:
        raise UserError(f"{where}: fl_x is missing; {_GIVE} that contains the lens")
    if given.get("cx") is None and given.get("cy") is None:
        notes["the camera file states no principal point (cx, cy), so the centre of the picture was assumed"] = None
        given = {**given, "cx": width / 2.0, "cy": height / 2.0}
    return Lens(
        image_wh=(int(width), int(height)),
        focal_px=(focal_x or focal_y or 0.0, focal_y or focal_x or 0.0),
        principal_px=(_number(given, "cx", where) - 0.5, _number(given, "cy", where) - 0.5),
        distortion=coefficients,
        is_fisheye=is_fisheye,
    )


def _model(given: Mapping[str, Any], where: str) -> tuple[str, bool]:
    """Return the name of the lens model, and whether it is a fisheye model."""
    flag = given.get("is_fisheye")
    if flag not in (None, True, False):
        raise UserError(f"{where}: is_fisheye must be true or false, but it is {str(flag)[:40]}")
    model = given.get("camera_model") or ("OPENCV_FISHEYE" if flag else "OPENCV")
    if not isinstance(model, str) or model not in MODELS:
        raise UserError(
            f"{where}: camera_model {str(model)[:40]!r} is not supported; undistort the pictures, and use one of {', '.join(MODELS)}"
        )
    if flag is not None and flag != MODELS[model].is_fisheye:
        raise UserError(f"{where}: camera_model is {model}, but is_fisheye is {str(flag).lower()}; remove the wrong one")
    return model, MODELS[model].is_fisheye


def _coefficients(given: Mapping[str, Any], model: str, where: str) -> tuple[float, ...]:
    """Return the distortion coefficients in the order of `COEFFICIENTS`."""
    listed = given.get("distortion_params")
    if listed is not None:
        names = ("k1", "k2", "k3", "k4", "p1", "p2")  # nerfstudio.cameras.camera_utils.get_distortion_params
        if not isinstance(listed, list) or len(listed) != len(names):
            raise UserError(f"{where}: distortion_params must be the six numbers {', '.join(names)}")
        if any(given.get(name) is not None for name in names):
            raise UserError(f"{where}: distortion_params and single coefficients are given; remove one of them")
        given = {**given, **dict(zip(names, listed, strict=True))}
    values = {name: _number(given, name, where, default=0.0) for name in COEFFICIENTS}
    used = (*MODELS[model].coefficients, *(("k3",) if model == "OPENCV" else ()))
    for name, value in values.items():
        if value != 0.0 and name not in used:
            why = "nerfstudio and OpenCV define it differently; " if name == "k4" and model == "OPENCV" else ""
            raise UserError(
                f"{where}: the distortion coefficient {name} is not supported for camera_model {model}; {why}undistort the pictures first"
            )
    return tuple(values.values())


def _focal(given: Mapping[str, Any], axis: str, side: float, where: str, *, is_fisheye: bool) -> float | None:
    """Return the focal length along an axis, px, from itself or from the angle of view; None if the file has neither.

    The angle of view of a fisheye lens is ambiguous, and is not used.
    """
    key = f"fl_{axis}"
    found = {} if given.get(key) is None else {key: _number(given, key, where)}
    for angle in (f"camera_angle_{axis}", f"{axis}_fov"):
        if given.get(angle) is not None and not is_fisheye:
            full_rad = _number(given, angle, where) * _ANGLES[angle]
            if not 0.0 < full_rad < np.pi:
                raise UserError(f"{where}: {angle} must be between 0 and 180 degrees, but it is {given[angle]:g}")
            found[angle] = side / 2.0 / float(np.tan(full_rad / 2.0))
    if not found:
        return None
    if not min(found.values()) > 0.0:
        raise UserError(f"{where}: fl_x and fl_y must be positive, but {key} is {found[key]:g}")
    if max(found.values()) > (1.0 + SAME_ANGLE) * min(found.values()):
        both = ", but ".join(f"{name} means {value:g} px" for name, value in found.items())
        raise UserError(f"{where}: the focal lengths differ: {both}; remove the wrong one")
    return next(iter(found.values()))


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


def _number(given: Mapping[str, Any], key: str, where: Path | str, *, default: float | None = None) -> float:
    value = given.get(key, default)
    if value is None:
        raise UserError(f"{where}: {key} is missing; {_GIVE} that contains the lens")
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise UserError(f"{where}: {key} must be a number below {LARGEST:g}, but it is {str(value)[:40]}")
    return float(value)
