"""Dataset folder, the only interface between producers of pictures (sim, rig, import) and their consumer (recon).

DATASET/  dataset.json   this module's `Dataset`
          images/*       original PNG, JPEG or TIFF files, one per frame, named by the frame
          truth/         only from sim and the rendered twin; see `scenes.truth`
"""

import base64
import hashlib
import html
import re
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from rhizotwin.scenes.atomic import json_bytes, write_bytes
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import check_readable
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey, decode_light
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, read_file
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.transfer import LINEAR, Curve, camera_curve, read_stated_curve
from rhizotwin.scenes.versioned_json import parse_versioned_json

SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Picture, with the commanded and the measured positions of the table and the camera at its exposure."""

    file: str
    """Path of the picture relative to the dataset folder, with forward slashes as separators."""
    sha256: str
    """SHA-256 of the file in hexadecimal. It is empty if it was not recorded."""
    kind: str = "root"
    band: str = ""
    """Name of the camera's band. It is empty if the camera has no bands."""
    view: int | None = None
    """Number of the view. Pictures of a view in several bands have the same number. It is None if each picture is a
    separate view."""
    ring: int = 0
    table_deg: float | None = None
    """Commanded table angle, deg. It is None if unknown, as for imported pictures."""
    table_read_deg: float | None = None
    """Table angle reported by the turntable after its move, deg."""
    placement: int = 0
    """Number of the camera's placement in this ring. It increases whenever the camera is placed, and whenever the zero
    of the table is determined again. Within one placement the camera is static."""
    joints_deg: tuple[float, ...] | None = None
    """Commanded joint angles of the arm in order from the base to the wrist roll, deg."""
    joints_read_deg: tuple[float, ...] | None = None
    exposure_s: float | None = None
    gain: float | None = None
    time_s: float | None = None
    """Time since the start of the scan, s."""
    cam_from_canister: tuple[tuple[float, ...], ...] | None = None
    """Known pose of the camera (four rows of four numbers, OpenCV axes). It is None if the pose is to be determined
    from the markers."""

    @property
    def station(self) -> tuple[int, int]:
        """Ring and placement of the frame. The camera does not move between frames with the same ring and placement."""
        return self.ring, self.placement


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """Scan, which consists of the scene, the frames, and the origin of the pictures."""

    folder: Path
    scene: Scene
    frames: tuple[Frame, ...]
    seed: int | None = None
    masks: bool = False
    """Whether the pictures are masks, in which roots are white."""
    origin: dict[str, Any] = field(default_factory=dict)
    """Program, versions, settings and profile with which the pictures were created."""
    sha256: str = field(default="", compare=False)
    """SHA-256, in hexadecimal, of dataset.json as it was read or written. It is empty if the file does not exist
    yet."""

    @property
    def lamps_off(self) -> tuple[str, ...]:
        """Names of the lamps with level 0, by the rig file that is recorded with a scan, or by the scene."""
        rig = self.origin.get("rig")
        part = rig.get("lights") if isinstance(rig, dict) else None
        part, lights = part if isinstance(part, dict) else {}, self.scene.lights
        levels = {"panel": part.get("panel_level", lights.backlight_level), "front lamp": part.get("front_level", lights.front_level)}
        return tuple(name for name, level in levels.items() if level == 0.0)

    def summary(self) -> dict[str, str]:
        """Return the name, the number of pictures and the origin as texts. The keys are labels for display."""
        width, height = self.scene.camera.image_wh
        rings = len({frame.ring for frame in self.frames})
        kinds = {"root": "pictures", "shoot": "pictures of the shoot"}
        counts = {name: sum(frame.kind == kind for frame in self.frames) for kind, name in kinds.items()}
        described = {"description": self.scene.description} if self.scene.description else {}
        return {
            "folder": str(self.folder),
            "scene": self.scene.name,
            **described,
            "pictures": f"{counts.pop('pictures')}, {width} x {height} px, in {rings} ring{'' if rings == 1 else 's'}",
            **{name: str(count) for name, count in counts.items() if count},
            "content": "silhouettes" if self.masks else "grey images",
            "cameras": "given" if any(frame.cam_from_canister is not None for frame in self.frames) else "from markers",
            "ground truth": "yes" if (self.folder / "truth").is_dir() else "no",
            "origin": str(self.origin.get("program", "unknown")),
        }

    def __repr__(self) -> str:
        """Return a summary of the dataset in a few lines."""
        return "\n".join([f"Dataset of {self.scene.name}", *(f"  {name:<14}{text}" for name, text in self.summary().items())])

    def _repr_html_(self) -> str:
        """Return an HTML representation for notebooks. It consists of the first picture and a table."""
        cells = "".join(
            f"<tr><td>{name}</td><td style='text-align:left'>{html.escape(text)}</td></tr>" for name, text in self.summary().items()
        )
        return f"<div><h4>{html.escape(self.scene.name)}</h4>{self._thumbnail()}<table>{cells}</table></div>"

    def _thumbnail(self) -> str:
        """Return the first picture as an HTML image element with a height of 240 pixels.

        The result is empty if the picture cannot be read.
        """
        import cv2

        try:
            image = read_image(self, self.frames[0])
        except (UserError, IndexError):
            return ""
        grey = image.astype(np.float64) / max(float(image.max()), 1.0)
        shown = np.round(255.0 * (grey if self.masks else grey ** (1.0 / 2.2))).astype(np.uint8)
        small = cv2.resize(shown, (round(240 * shown.shape[1] / shown.shape[0]), 240), interpolation=cv2.INTER_AREA)
        data = base64.b64encode(cv2.imencode(".png", small)[1].tobytes()).decode()
        return f'<img alt="first picture" src="data:image/png;base64,{data}">'


@dataclass(frozen=True, kw_only=True)
class _Manifest:
    """Content of dataset.json."""

    schema_version: int
    scene: Scene
    frames: tuple[Frame, ...]
    seed: int | None = None
    masks: bool = False
    origin: dict[str, Any] = field(default_factory=dict)


def load_dataset(folder: Path | str) -> Dataset:
    """Load and check the manifest of a dataset. The pictures are read by `read_image`.

    Raises
    ------
    UserError
        If the folder is missing, or its dataset.json is missing, damaged, invalid or has an unsupported version.
    """
    folder = Path(folder)
    path = folder / "dataset.json"
    if not folder.is_dir():
        raise UserError(f"{folder}: there is no such folder; create a dataset with `rhizotwin simulate` or `rhizotwin import`")
    if not path.is_file():
        check_readable(folder, deep=False)
        raise UserError(
            f"{folder}: the folder is not a complete dataset, because it has no dataset.json; create one with `rhizotwin simulate` or "
            "`rhizotwin import`"
        )
    check_readable(folder)
    data = read_file(path)
    mapping = parse_versioned_json(data, path, SCHEMA_VERSION)
    place = Place(str(path))
    manifest = from_plain(_Manifest, mapping, place)
    check_scene(manifest.scene, where=f"{path}, scene")
    if not manifest.frames:
        raise place.at("frames").error("must have at least one frame")
    for i, frame in enumerate(manifest.frames):
        _check_frame(frame, len(manifest.scene.plan.rings), place.at("frames", i))
        _check_band(frame, manifest, place.at("frames", i))
    _check_names(manifest.frames, place)
    _check_views(manifest.frames, place)
    _check_poses(manifest.frames, place)
    return Dataset(
        folder=folder,
        scene=manifest.scene,
        frames=manifest.frames,
        seed=manifest.seed,
        masks=manifest.masks,
        origin=manifest.origin,
        sha256=hashlib.sha256(data).hexdigest(),
    )


def save_dataset(dataset: Dataset) -> Dataset:
    """Write dataset.json in ``dataset.folder`` atomically. `load_dataset` returns an equal dataset.

    Returns
    -------
    Dataset
        The given dataset with the hash of the written file.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    manifest = _Manifest(
        schema_version=SCHEMA_VERSION,
        scene=dataset.scene,
        frames=dataset.frames,
        seed=dataset.seed,
        masks=dataset.masks,
        origin=dataset.origin,
    )
    data = json_bytes(to_plain(manifest))
    write_bytes(dataset.folder / "dataset.json", data)
    return replace(dataset, sha256=hashlib.sha256(data).hexdigest())


def read_image(dataset: Dataset, frame: Frame, *, curve: Curve | None = None) -> Grey:
    """Read a frame's picture as grey levels that are linear in light.

    Parameters
    ----------
    dataset : Dataset
        Dataset that contains the frame.
    frame : Frame
        Frame to read.
    curve : Curve or None
        Transfer curve from pixel values to light. None for the curve stated in the file or, if there is none, by the
        scene's camera.

    Returns
    -------
    ndarray
        (H, W) array; uint8 or uint16 as in the file if its values are linear in light, otherwise uint16. See
        `scenes.picture_codec.decode_light`.

    Raises
    ------
    UserError
        If the file is missing, truncated or not a picture, if its size differs from that of the scene's camera, or if
        it differs from the recorded picture.
    """
    path = dataset.folder / frame.file
    if not path.exists():
        raise UserError(f"{path}: the picture is missing; restore it, or remove its entry from dataset.json")
    data = read_file(path, most_mib=MOST_PICTURE_MIB)
    if dataset.masks:
        curve = LINEAR
    stated = curve or read_stated_curve(data) or camera_curve(dataset.scene.camera)
    image = decode_light(data, stated, where=str(path), image_wh=dataset.scene.camera.image_wh)
    if frame.sha256 and hashlib.sha256(data).hexdigest() != frame.sha256.lower():
        raise UserError(
            f"{path}: the file differs from the recorded picture (its SHA-256 is not that in dataset.json); restore it, or take the "
            "picture again"
        )
    return image


def file_sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    if not Path(path).is_file():
        raise UserError(f"{path}: the file cannot be read, because it does not exist")
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UserError(f"{path}: the file cannot be read ({error.strerror})") from error


def _check_frame(frame: Frame, rings: int, place: Place) -> None:
    """Check that the values of a frame are consistent with each other and with the plan."""
    file = PurePosixPath(frame.file)
    if not frame.file.isprintable() or not _is_utf8(frame.file):
        raise place.at("file").error("must consist of printable characters in UTF-8", ascii(frame.file))
    if not frame.file or "\\" in frame.file or ":" in frame.file or file.is_absolute() or ".." in file.parts:
        raise place.at("file").error("must be a path inside the dataset folder, with forward slashes", frame.file)
    if frame.sha256 and not re.fullmatch(r"[0-9a-fA-F]{64}", frame.sha256):
        raise place.at("sha256").error("must be 64 hexadecimal digits, or empty", frame.sha256)
    if frame.kind not in ("root", "shoot"):
        raise place.at("kind").error('must be one of "root", "shoot"', frame.kind)
    if not 0 <= frame.ring < rings:
        raise place.at("ring").error(f"must be between 0 and {rings - 1}, because the scene's plan has {rings} rings", frame.ring)
    for name, number in (("placement", frame.placement), ("view", frame.view)):
        if number is not None and number < 0:
            raise place.at(name).error("must be 0 or more", number)
    if frame.cam_from_canister is not None:
        check_rigid(frame.cam_from_canister, place.at("cam_from_canister"))


def _check_band(frame: Frame, manifest: _Manifest, place: Place) -> None:
    """Check that a frame has one of the camera's bands, if the camera has bands."""
    names = [band.name for band in manifest.scene.camera.bands]
    if frame.band not in (names or [""]):
        known = (
            f"must be one of the camera's bands, {', '.join(names)}"
            if names
            else "must be omitted, because the scene's camera has no bands"
        )
        raise place.at("band").error(known, frame.band)
    if names and frame.view is None:
        raise place.at("view").error("is missing, but is required to assign pictures in different bands to a view")
    if names and manifest.masks:
        raise place.at("band").error("must be omitted, because silhouettes have no bands", frame.band)


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _check_names(frames: tuple[Frame, ...], place: Place) -> None:
    """Reject pictures whose names without folder and suffix are equal.

    The names of results are derived from these names.
    """
    by_stem: dict[str, str] = {}
    for i, frame in enumerate(frames):
        stem = PurePosixPath(frame.file).stem
        if by_stem.get(stem) == frame.file:
            raise place.at("frames", i, "file").error("is listed twice", frame.file)
        if stem in by_stem:
            must = (
                f"differs from {by_stem[stem]} only in folder or suffix, so that the results would have the same name; rename one of the "
                "pictures"
            )
            raise place.at("frames", i, "file").error(must, frame.file)
        by_stem[stem] = frame.file


def _check_views(frames: tuple[Frame, ...], place: Place) -> None:
    """Reject a view that has several pictures in the same band."""
    known: dict[tuple[int, str], str] = {}
    for i, frame in enumerate(frames):
        if frame.view is None:
            continue
        if (frame.view, frame.band) in known:
            raise place.at("frames", i, "view").error(
                f"must differ from the view of {known[frame.view, frame.band]}, which has the same band", frame.view
            )
        known[frame.view, frame.band] = frame.file


def _check_poses(frames: tuple[Frame, ...], place: Place) -> None:
    """Reject a dataset in which only some frames have a known pose."""
    without = [i for i, frame in enumerate(frames) if frame.cam_from_canister is None]
    if 0 < len(without) < len(frames):
        given = next(frame.file for frame in frames if frame.cam_from_canister is not None)
        must = f"is missing for {frames[without[0]].file}, but {given} has a pose; specify a pose for every picture or for none"
        raise place.at("frames", without[0], "cam_from_canister").error(must)


def check_rigid(rows: tuple[tuple[float, ...], ...], place: Place) -> None:
    """Reject a matrix that is not a rigid 4x4 transform.

    The rotation must be orthonormal within 1e-4, without reflection.
    """
    if len(rows) != 4 or any(len(row) != 4 for row in rows):
        raise place.error("must have 4 rows of 4 numbers")
    a_from_b = np.array(rows)
    rotation = a_from_b[:3, :3]
    if not np.allclose(a_from_b[3], [0.0, 0.0, 0.0, 1.0], atol=1e-9) or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
        raise place.error("must consist of a rotation and a translation, with 0 0 0 1 as the last row")
    if np.linalg.det(rotation) < 0.0:
        raise place.error("contains a reflection; the axes must be those of OpenCV (x right, y down, z forward)")
