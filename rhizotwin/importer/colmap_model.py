"""Reader of cameras from a COLMAP model, in text or binary format.

The formats are described at colmap.github.io/format.html. In all versions, also with the files ``rigs`` and ``frames``
of 3.12 and later, ``images`` contains the complete pose cam_from_world of each picture, with OpenCV axes. Pixel
coordinates have their origin at the corner of the first pixel. The world of the model is the canister frame, in mm.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rhizotwin.importer.given_cameras import LARGEST, GivenCameras, GivenPicture, collect_cameras
from rhizotwin.importer.given_lens import COEFFICIENTS, MODELS, Lens
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.reading import decode_text, read_file

MOST_MIB = 512
"""Maximum size of ``images``, MiB. It contains the feature points, about 24 bytes each: 200 pictures with 100,000
points have 460 MiB."""
_POSE, _POINT = struct.Struct("<I7dI"), 24
"""Picture number, quaternion (w, x, y, z), translation and camera number in ``images.bin``, and size of a point."""
_CAMERA = struct.Struct("<IiQQ")
"""Camera number, model number, width and height in ``cameras.bin``."""


def read_colmap(folder: Path, camera: Camera) -> GivenCameras:
    """Read a COLMAP model.

    Parameters
    ----------
    folder : Path
        Folder with the files cameras and images, both with the suffix .bin or .txt. If both formats are present,
        the binary files are read, as COLMAP does.
    camera : Camera
        See `rhizotwin.importer.given_cameras.collect_cameras`.

    Raises
    ------
    UserError
        If files are missing or damaged, a lens model is not supported, or see `collect_cameras`.
    """
    kind = next((kind for kind in ("bin", "txt") if all((folder / f"{name}.{kind}").is_file() for name in ("cameras", "images"))), None)
    if kind is None:
        raise UserError(f"{folder}: {_hint(folder)}")
    cameras, images = folder / f"cameras.{kind}", folder / f"images.{kind}"
    try:
        lenses = dict(_lenses_in_binary(cameras) if kind == "bin" else _lenses_in_text(cameras))
        found = list(_images_in_binary(images) if kind == "bin" else _images_in_text(images))
    except (struct.error, UnicodeDecodeError) as error:
        raise UserError(f"{folder}: cameras.bin or images.bin is truncated or damaged; write the model again") from error
    if not found:
        raise UserError(f"{images} contains no picture; give a COLMAP model with registered pictures")
    if unknown := [image for image in found if image[1] not in lenses]:
        name, number, _ = unknown[0]
        raise UserError(f"{images}: the picture {name} refers to camera {number}, which {cameras} does not contain")
    given = ((name, str(images), GivenPicture(lens=lenses[number], cam_from_canister=pose)) for name, number, pose in found)
    both = kind == "bin" and (folder / "images.txt").is_file()
    notes = (f"{folder} contains a binary and a text model; the binary model was read",) if both else ()
    return replace(collect_cameras(given, camera), notes=notes)


def _hint(folder: Path) -> str:
    """Return a sentence about a folder that is not a COLMAP model."""
    for inner in ("sparse/0", "sparse", "0", "colmap", "transforms.json"):
        if (folder / inner / "images.bin").is_file() or (folder / inner / "images.txt").is_file() or (folder / inner).is_file():
            return f"give {folder / inner} instead"
    return "the folder contains no COLMAP model (cameras.bin and images.bin, or cameras.txt and images.txt); give a folder that does"


def _lens(name: str, width: int, height: int, numbers: tuple[float, ...], where: str) -> Lens:
    """Return the lens with the parameters of a COLMAP camera."""
    model = MODELS[name]
    if len(numbers) != model.focal_lengths + 2 + len(model.coefficients):
        raise UserError(f"{where}: {name} has {model.focal_lengths + 2 + len(model.coefficients)} parameters, but {len(numbers)} are given")
    *focal, cx, cy = numbers[: model.focal_lengths + 2]
    if not (all(abs(number) < LARGEST for number in numbers) and min(focal) > 0.0 and min(width, height) >= 16):
        raise UserError(f"{where}: focal lengths must be positive, sizes at least 16 px, and all numbers below {LARGEST:g}")
    bent = dict(zip(model.coefficients, numbers[model.focal_lengths + 2 :], strict=True))
    return Lens(
        image_wh=(width, height),
        focal_px=(focal[0], focal[-1]),
        principal_px=(cx - 0.5, cy - 0.5),
        distortion=tuple(bent.get(coefficient, 0.0) for coefficient in COEFFICIENTS),
        is_fisheye=model.is_fisheye,
    )


def _unsupported(model: str, where: str) -> UserError:
    return UserError(
        f"{where}: the lens model {model} is not supported; undistort the pictures with COLMAP, or use one of {', '.join(MODELS)}"
    )


def _pose(numbers: Sequence[float], where: str) -> frames.Array:
    """Return the pose cam_from_world (4, 4) from a quaternion (w, x, y, z) and a translation."""
    w, x, y, z, *shift = numbers
    if not (all(abs(number) < LARGEST for number in numbers) and abs(np.linalg.norm([w, x, y, z]) - 1.0) < 1e-3):
        raise UserError(f"{where} is not a unit quaternion and a translation below {LARGEST:g}")
    return frames.from_rotation_translation(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(shift))


def _lenses_in_binary(path: Path) -> Iterator[tuple[int, Lens]]:
    data = read_file(path)
    names = {model.number: name for name, model in MODELS.items()}
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        number, model, width, height = _CAMERA.unpack_from(data, at)
        if model not in names:
            raise _unsupported(f"with the number {model}", f"{path}, camera {number}")
        parameters = struct.Struct(f"<{MODELS[names[model]].focal_lengths + 2 + len(MODELS[names[model]].coefficients)}d")
        yield number, _lens(names[model], width, height, parameters.unpack_from(data, at + _CAMERA.size), f"{path}, camera {number}")
        at += _CAMERA.size + parameters.size
    if at != len(data):
        raise UserError(f"{path}: {len(data) - at} bytes follow the last camera; write the model again")


def _images_in_binary(path: Path) -> Iterator[tuple[str, int, frames.Array]]:
    """Yield the path, the number of the camera and the pose of each picture."""
    data = read_file(path, most_mib=MOST_MIB)
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        _, *numbers, camera = _POSE.unpack_from(data, at)
        end = data.find(b"\0", at + _POSE.size)
        (points,) = struct.unpack_from("<Q", data, end + 1) if end > 0 else (2**63,)
        name = data[at + _POSE.size : end].decode()
        yield name, camera, _pose(numbers, f"{path}: the pose of {name}")
        at = end + 9 + _POINT * points
        if at > len(data):
            raise struct.error
    if at != len(data):
        raise UserError(f"{path}: {len(data) - at} bytes follow the last picture; write the model again")


def _lenses_in_text(path: Path) -> Iterator[tuple[int, Lens]]:
    for index, line in enumerate(decode_text(read_file(path), path).split("\n"), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}, line {index}"
        if len(words) > 1 and words[1] not in MODELS:
            raise _unsupported(words[1], where)
        try:
            number, width, height = int(words[0]), int(words[2]), int(words[3])
            numbers = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError) as error:
            raise UserError(f"{where}: a line must be CAMERA_ID MODEL WIDTH HEIGHT PARAMS, separated by spaces") from error
        yield number, _lens(words[1], width, height, numbers, where)


def _images_in_text(path: Path) -> Iterator[tuple[str, int, frames.Array]]:
    """Yield the same from lines, each of which is followed by a line of points, which may be empty."""
    lines = enumerate(decode_text(read_file(path, most_mib=MOST_MIB), path).split("\n"), start=1)
    for index, line in lines:
        words = line.split(maxsplit=9)
        if not words or words[0].startswith("#"):
            continue
        try:
            numbers = [float(word) for word in words[1:8]]
            camera = int(words[8])
            name = words[9].strip()
        except (ValueError, IndexError) as error:
            raise UserError(f"{path}, line {index}: a line must be IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME") from error
        yield name, camera, _pose(numbers, f"{path}: the pose of {name}")
        index, line = next(lines, (index + 1, ""))
        if line.count(" ") and not _is_points(line):
            raise UserError(f"{path}, line {index}: this line must list the points of {name} (X Y POINT3D_ID), or be empty")


def _is_points(line: str) -> bool:
    words = line.split()
    try:
        int(words[-1])
    except (ValueError, IndexError):
        return not words
    return len(words) % 3 == 0
