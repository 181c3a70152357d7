"""Conversion of existing pictures to a dataset.

The camera poses are read from a file, or are estimated later from the markers.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np

from rhizotwin import raw_pictures
from rhizotwin.nerfstudio import GivenCameras, read_cameras
from rhizotwin.picture_files import SUFFIXES, list_pictures
from rhizotwin.scenes import files, frames, plan, transfer
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.picture_codec import Grey, decode_grey, encode_light_png
from rhizotwin.scenes.picture_damage import is_sealed
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, read_file
from rhizotwin.unlike_rows import LEAST, Turn

MOST_CLIPPED = 0.05
"""Maximum fraction of saturated pixels in a picture. A picture with more saturated pixels is reported as overexposed,
as in `rig.scanning.preflight`."""
MASK_MARGIN = 0.1
"""Tolerance for black and white pixels in a silhouette, as a fraction of the grey range. A pixel that differs more from
both black and white is grey."""
MASK_GREYS = 0.05
"""Maximum fraction of grey pixels in a silhouette. The pixels along a soft outline are grey."""


@dataclass(frozen=True, kw_only=True)
class Imported:
    """Dataset that was imported, and notes about decisions that the import has made automatically."""

    dataset: Dataset
    notes: tuple[str, ...]
    """Sentences for the user about automatic decisions, conversions and excluded pictures."""


def import_pictures(
    folder: Path,
    scene: Scene,
    out: Path,
    *,
    cameras: Path | None = None,
    masks: bool = False,
    no_strip: bool = False,
    monitor: Monitor | None = None,
) -> Imported:
    """Copy a folder of pictures to a new dataset.

    Parameters
    ----------
    folder : Path
        Folder of PNG, JPG or TIFF pictures (8 or 16 bits) or raw pictures (DNG), read in the natural order of names.
    scene : Scene
        Scene of the rig. The picture size of its camera must match, unless ``cameras`` contains a lens.
    out : Path
        New or empty dataset folder, which is written atomically.
    cameras : Path or None
        File in nerfstudio's format transforms.json, in the canister frame, mm (see `rhizotwin.nerfstudio`). Pictures
        without a camera are excluded and listed in a note. None: poses are estimated from the marker strip.
    masks : bool
        The pictures are silhouettes with white roots on black; requires ``cameras``.
    no_strip : bool
        The pictures show no marker strip; the cameras are estimated from the edges of the canister and from the roots
        (telecentric camera, one ring).
    monitor : Monitor, optional
        Receiver of the progress.

    Raises
    ------
    UserError
        If a picture is unreadable, damaged or of another size, if silhouettes contain grey areas, or if cameras and
        pictures do not correspond.
    """
    _refuse_options(scene, cameras, masks=masks, no_strip=no_strip)
    scene = replace(scene, strip=replace(scene.strip, rows=0)) if no_strip else scene
    paths, raw = _pictures_in(folder, masks=masks)
    notes: list[str] = []
    given: GivenCameras | None = None
    if cameras is not None:
        scene, given = _given(scene, cameras)
        paths = _with_cameras(paths, given, cameras, notes)
    bands = _bands_of(paths, scene)
    angles = _table_angles(scene, 1 + max(view for view, _ in bands), given, notes)
    table = [(view, band, *angles[view]) for view, band in bands]
    white = _white_level(paths, scene) if masks else None
    notes += [_curve_note(paths, scene, raw=raw)] if white is None else []
    origin: dict[str, Any] = {"program": "rhizotwin import", "pictures": str(folder), "cameras": cameras and str(cameras)}
    with new_folder(out) as building:
        copying = _Copying(scene, building, raw=raw, white=white, given=given)
        frames = copying.copied(paths, table, monitor or Monitor())
        origin |= {"clipped": copying.clipped, "versions": versions()}
        dataset = save_dataset(Dataset(folder=building, scene=scene, frames=frames, masks=masks, origin=origin))
    return Imported(dataset=replace(dataset, folder=out), notes=(*notes, *copying.notes()))


def _bands_of(paths: list[Path], scene: Scene) -> list[tuple[int, str]]:
    """Return the view number and the spectral band of each picture.

    If the camera has bands, the file name ends with ``_BAND``, and the pictures of one view have the same name before
    this suffix. Without bands, each picture is a view with the band "".
    """
    names = [band.name for band in scene.camera.bands]
    if not names:
        return [(number, "") for number in range(len(paths))]
    found, views = [], dict[str, int]()
    for path in paths:
        ends = [name for name in names if path.stem.endswith(f"_{name}")]
        if not ends:
            example = f"{path.stem}_{names[0]}{path.suffix}"
            raise UserError(f"{path}: the file name does not end with one of the camera's bands; rename the file, for example to {example}")
        band = max(ends, key=len)
        found.append((views.setdefault(path.stem.removesuffix(f"_{band}"), len(views)), band))
    return found


def _refuse_options(scene: Scene, cameras: Path | None, *, masks: bool, no_strip: bool) -> None:
    """Raise UserError if options were given that cannot be combined."""
    if scene.tank is not None and (cameras is not None or no_strip):
        raise UserError(
            f"scene {scene.name} has a tank, whose pose is estimated from the marker strip; "
            "remove --cameras or --no-strip, or the [tank] section of the scene"
        )
    if masks and cameras is None:
        raise UserError("silhouettes (--masks) show no markers from which the cameras could be estimated; give --cameras JSON")
    if no_strip and cameras is not None:
        raise UserError("--no-strip and --cameras cannot be used together; remove one of them")


def _pictures_in(folder: Path, *, masks: bool) -> tuple[list[Path], bool]:
    """Return the paths of the pictures in a folder, and whether they are raw pictures."""
    paths = list_pictures(folder, suffixes=SUFFIXES if masks else (*SUFFIXES, *raw_pictures.SUFFIXES))
    raw = [path for path in paths if raw_pictures.is_raw(path)]
    if raw and len(raw) < len(paths):
        other = next(path for path in paths if path not in raw)
        raise UserError(
            f"{folder} contains raw pictures ({raw[0].name}) and other pictures ({other.name}); use a separate folder for each type"
        )
    return paths, bool(raw)


Alike: TypeAlias = tuple[int, str]
"""Ring and band of a picture. Pictures that have the same ring and band are similar, and are compared with each
other."""
Placed: TypeAlias = tuple[int, str, int, float | None]
"""View, band, ring and table angle of a picture."""


class _Copying:
    """Copies pictures to a dataset and collects notes about them.

    Parameters
    ----------
    scene : Scene
        Scene whose camera has the size of the pictures.
    folder : Path
        Dataset folder.
    raw : bool
        Whether the pictures are raw pictures (DNG).
    white : int or None
        Grey value of white in silhouettes; None for photographs.
    given : GivenCameras or None
        Cameras from a file; None if they are estimated from the markers.
    """

    def __init__(self, scene: Scene, folder: Path, *, raw: bool, white: int | None, given: GivenCameras | None) -> None:
        self._scene, self._folder = scene, folder
        self._raw, self._white, self._given = raw, white, given
        self._gains: tuple[float, float] | None = None
        self._turns = _Turns()
        self._count = 0
        self.clipped: dict[str, float] = {}
        """Fraction of saturated pixels in each overexposed picture, keyed by file name."""

    def copied(self, paths: list[Path], table: list[Placed], monitor: Monitor) -> tuple[Frame, ...]:
        """Copy all pictures to the dataset, and raise UserError if a picture is damaged.

        ``table`` contains the view, band, ring and table angle of each picture.
        """
        found = []
        with monitor.stage("copy"), monitor.steps("copy", len(paths), "picture") as step:
            for path, placed in zip(paths, table, strict=True):
                found.append(self._copy(path, placed))
                step()
        self._turns.refuse_damaged()
        self._count = len(found)
        return tuple(found)

    def _copy(self, path: Path, placed: Placed) -> Frame:
        """Write one picture to the dataset, and check its exposure."""
        view, band, ring, table_deg = placed
        if self._raw:
            light, self._gains = raw_pictures.read_raw(path, image_wh=self._scene.camera.image_wh, gains=self._gains)
            data = encode_light_png(light)
        else:
            data = _data_of(path, self._scene, white=self._white)
        name = f"images/{path.stem}{'.png' if self._raw or self._white is not None else path.suffix.lower()}"
        write_bytes(self._folder / name, data)
        if self._white is None:
            grey = decode_grey(data, where=str(path))
            self._turns.add(path, (ring, band), grey, sealed=self._raw or is_sealed(data))
            if (share := _clipped(grey)) > MOST_CLIPPED:
                self.clipped[name] = round(share, 4)
        pose = None if self._given is None else _pose_of(path, self._given)
        return Frame(
            file=name,
            sha256=file_sha256(self._folder / name),
            kind=self._scene.plan.rings[ring].kind,
            band=band,
            view=view if band else None,
            ring=ring,
            table_deg=table_deg,
            cam_from_canister=None if pose is None else tuple(tuple(float(value) for value in row) for row in pose),
        )

    def notes(self) -> list[str]:
        """Return notes about overexposed pictures and about pictures that could not be checked for damage."""
        if not self.clipped:
            return self._turns.notes()
        worst = max(self.clipped, key=lambda name: self.clipped[name])
        return [
            *self._turns.notes(),
            f"warning: {len(self.clipped)} of {self._count} pictures are overexposed; the worst is {worst} with "
            f"{100.0 * self.clipped[worst]:.0f} % of its pixels at full scale, where the light absorbed by roots cannot be measured. "
            "Reduce the exposure so that the panel is at 80 % of full scale",
        ]


def _pose_of(path: Path, given: GivenCameras) -> frames.Array | None:
    """Return the pose cam_from_canister of a picture from the camera file.

    The file name of the picture may be written without its suffix in the camera file. The result is None if the camera
    file does not contain the picture.
    """
    return given.cam_from_canister.get(path.name, given.cam_from_canister.get(path.stem))


def _given(scene: Scene, cameras: Path) -> tuple[Scene, GivenCameras]:
    """Read a camera file.

    The result is a copy of the scene with the lens of the file, and the cameras.
    """
    given = read_cameras(cameras, scene.camera)
    changed = replace(scene, camera=given.camera)
    scene = files.scene_from_dict(files.scene_to_dict(changed), where=f"scene {scene.name} with the lens of {cameras}")
    _check_cameras(given, scene, cameras)
    return scene, given


def _with_cameras(paths: list[Path], given: GivenCameras, cameras: Path, notes: list[str]) -> list[Path]:
    """Return the pictures for which a camera is given.

    If there are other pictures, a note about them is added to ``notes``.

    Raises
    ------
    UserError
        If the picture of a camera is missing.
    """
    kept = [path for path in paths if _pose_of(path, given) is not None]
    names = {path.name for path in paths} | {path.stem for path in paths}
    missing = [name for name in given.cam_from_canister if name not in names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise UserError(
            f"{cameras} has a camera for {missing[0]}{more}, but this picture is missing in {paths[0].parent}; "
            "add the picture or remove the camera"
        )
    without = [path.name for path in paths if path not in kept]
    if without:
        notes.append(f"pictures that were not imported, because {cameras} has no camera for them: {', '.join(without)}")
    return kept


def _check_cameras(given: GivenCameras, scene: Scene, cameras: Path) -> None:
    """Raise UserError if a camera is inside the canister, which indicates a wrong unit or coordinate frame."""
    for name, cam_from_canister in given.cam_from_canister.items():
        centre_mm = frames.invert(cam_from_canister)[:3, 3]
        inside = np.hypot(centre_mm[0], centre_mm[1]) < scene.canister.outer_radius_mm
        if inside and scene.water.n_water > 1.0 and -scene.canister.height_mm < centre_mm[2] < 0.0:
            x, y, z = centre_mm
            raise UserError(
                f"{cameras}: the camera of {name} is inside the canister, at ({x:.3g}, {y:.3g}, {z:.3g}) mm; "
                "coordinates must be given in the canister frame in millimetres"
            )


def _table_angles(scene: Scene, count: int, given: GivenCameras | None, notes: list[str]) -> list[tuple[int, float | None]]:
    """Return the ring and the table angle of each view, and add a note about their source.

    They are read from the capture plan of the scene. If the plan has a different number of views than the folder, or if
    the cameras are given, all views are in ring 0, and their angle is None.
    """
    if given is not None:
        return [(0, None)] * count
    views = plan.views(scene)
    if len(views) == count:
        notes.append(f"table angles were copied from the capture plan of the scene ({count} views), in the order of the file names")
        return [(view.ring, view.table_deg) for view in views]
    notes.append(
        f"table angles will be estimated from the markers, because there are {count} pictures but the capture plan has {len(views)} views"
    )
    return [(0, None)] * count


def _curve_note(paths: list[Path], scene: Scene, *, raw: bool) -> str:
    """Return a note about the response curve with which the pictures are read."""
    if raw:
        return (
            "raw pictures were converted: each block of pixels was averaged to one grey pixel with linear values, with "
            "the white balance of the first picture"
        )
    stated = transfer.camera_curve(scene.camera)
    words = {word.name for path in paths if (word := transfer.read_stated_curve(path)) is not None}
    if not words:
        return f"response curve: {stated.name}, as in the scene's camera, because the pictures do not state their response curve"
    return f"response curve: {', '.join(sorted(words))}, as stated in the pictures"


def _data_of(path: Path, scene: Scene, *, white: int | None) -> bytes:
    """Return the file content to be stored for a picture.

    Photographs are stored unchanged. Silhouettes are scaled to 0..255 and stored as PNG.
    """
    data, grey = _read(path, scene)
    if white is None:
        return data
    _check_mask(grey, white, path)
    grey = np.round(grey * (255.0 / white)).astype(np.uint8)
    done, encoded = cv2.imencode(".png", grey)
    if not done:
        raise UserError(f"{path} could not be converted to PNG; convert it with another program")
    return bytes(encoded.tobytes())


class _Turns:
    """Detects damage in pictures whose file format has no checksum.

    Each picture is compared with the other pictures of the same ring.
    """

    def __init__(self) -> None:
        self._turns: dict[Alike, Turn] = {}
        self._open: dict[str, Alike] = {}  # pictures without a checksum, with their ring and band
        self._folder = Path()

    def add(self, path: Path, ring: Alike, grey: Grey, *, sealed: bool) -> None:
        """Add a picture to the pictures of its ring.

        If ``sealed`` is true, the file format has a checksum, and damage would already have been detected.
        """
        self._folder = path.parent
        self._turns.setdefault(ring, Turn()).add(path.name, grey)
        if not sealed:
            self._open[path.name] = ring

    def refuse_damaged(self) -> None:
        """Raise UserError if rows of a picture without a checksum differ from those of all other pictures."""
        for ring in sorted(set(self._open.values())):
            for found in self._turns[ring].unlike():
                if found.name in self._open:
                    raise UserError(
                        f"{self._folder / found.name}: rows {found.first} to {found.last} differ from all other pictures, which "
                        "indicates damage. Copy or take the picture again, or remove it; if the picture is correct, convert it to "
                        "PNG, whose checksum replaces this test"
                    )

    def notes(self) -> list[str]:
        """Return notes about pictures that could not be checked for damage."""
        if not self._open:
            return []
        apart = sum(not self._turns[ring].enough for ring in self._open.values())
        but = "damage of less than a fifth of a row cannot be detected"
        if apart:
            but += f", and {apart} of them could not be compared, because their ring has fewer than {LEAST} pictures"
        return [
            f"{len(self._open)} pictures have a format without a checksum (JPEG, TIFF with LZW, PackBits or no compression), so {but}. "
            "In PNG, and in TIFF with Deflate, any damage is detected"
        ]


def _clipped(grey: Grey) -> float:
    """Return the fraction of saturated pixels in a picture.

    The bit depth of the picture may be smaller than that of the file, such as 12 bits in a 16-bit file.
    """
    largest = int(grey.max())
    # full scale of 8, 10, 12, 14 and 16 bits, and of 10, 12 and 14 bits shifted to 16 bits
    full = {255, 1023, 4095, 16383, 65535, 65472, 65520, 65532}
    return float((grey == largest).mean()) if largest in full else 0.0


def _read(path: Path, scene: Scene) -> tuple[bytes, Grey]:
    """Return the content of a picture file, and the decoded grey picture.

    A UserError is raised if the picture is incomplete, or if its size is not that of the camera.
    """
    data = read_file(path, most_mib=MOST_PICTURE_MIB)
    return data, decode_grey(data, where=str(path), image_wh=scene.camera.image_wh)


def _white_level(paths: list[Path], scene: Scene) -> int:
    """Return the grey value of white pixels in a set of silhouettes.

    It is the largest value in all of them, because some programs write 1 instead of 255.
    """
    white = max(int(_read(path, scene)[1].max()) for path in paths)
    if white == 0:
        raise UserError(f"{paths[0].parent}: all silhouettes are completely black; roots must be white")
    return white


def _check_mask(grey: Grey, white: int, path: Path) -> None:
    """Raise UserError if a silhouette has too many grey pixels.

    The maximum is `MASK_GREYS`.
    """
    level = grey / white
    between = float(np.mean((level > MASK_MARGIN) & (level < 1.0 - MASK_MARGIN)))
    if between > MASK_GREYS:
        raise UserError(
            f"{path} is not a silhouette: {100.0 * between:.0f} % of its pixels are neither black nor white "
            f"(maximum {100.0 * MASK_GREYS:.0f} %). "
            "Use black and white silhouettes, or remove --masks"
        )
