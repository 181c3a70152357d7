"""Creation of a dataset from existing pictures, with cameras from a file or estimated later from the markers."""

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
"""Fraction of pixels at full scale above which a picture is overexposed, as in the checks before a scan
(`rig.scanning.preflight`)."""
MASK_MARGIN = 0.1
"""Tolerance of black and white in silhouettes, as a fraction of the grey range."""
MASK_GREYS = 0.05
"""Maximum fraction of a silhouette's pixels that are neither black nor white: the soft edges of its outline."""


@dataclass(frozen=True, kw_only=True)
class Imported:
    """Imported dataset with notes on automatic decisions."""

    dataset: Dataset
    notes: tuple[str, ...]
    """One sentence for each automatic choice, conversion or exclusion."""


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
        PNG, JPG or TIFF pictures of 8 or 16 bits, or raw pictures (DNG), in natural order of their names (view_2 before
        view_10).
    scene : Scene
        Scene of the rig. The picture size of its camera must match, unless ``cameras`` contains a lens.
    out : Path
        Dataset folder; new or empty. It is written atomically.
    cameras : Path or None
        A transforms.json in nerfstudio's format (see `rhizotwin.nerfstudio`), in the canister frame in mm. Pictures
        without a camera are excluded and listed. None: poses are estimated from the marker strip.
    masks : bool
        The pictures are silhouettes: white root on black. Requires ``cameras``, because they show no markers.
    no_strip : bool
        There is no marker strip: the cameras are estimated from the edges of the canister and from the roots
        (telecentric camera, one ring).
    monitor : Monitor, optional
        Progress monitor.

    Raises
    ------
    UserError
        If a picture is unreadable, damaged or of another size, if rows of a picture without a checksum differ from all
        other pictures, if silhouettes have no cameras or contain greys, or if cameras do not fit.
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
    """Return the number of the view and the band of each picture.

    Where the camera has bands, the names of a view's pictures differ by ``_BAND`` at their end.
    """
    names = [band.name for band in scene.camera.bands]
    if not names:
        return [(number, "") for number in range(len(paths))]
    found, views = [], dict[str, int]()
    for path in paths:
        ends = [name for name in names if path.stem.endswith(f"_{name}")]
        if not ends:
            example = f"{path.stem}_{names[0]}{path.suffix}"
            raise UserError(f"{path}: its name ends with none of the camera's bands: call it {example}, for example")
        band = max(ends, key=len)
        found.append((views.setdefault(path.stem.removesuffix(f"_{band}"), len(views)), band))
    return found


def _refuse_options(scene: Scene, cameras: Path | None, *, masks: bool, no_strip: bool) -> None:
    """Reject combinations of options that exclude each other."""
    if scene.tank is not None and (cameras is not None or no_strip):
        raise UserError(
            f"the pose of the [tank] of scene {scene.name} is estimated from the marker strip; "
            "remove --cameras or --no-strip, or the [tank] section"
        )
    if masks and cameras is None:
        raise UserError("silhouettes (--masks) show no markers, so that the cameras must be given with --cameras JSON")
    if no_strip and cameras is not None:
        raise UserError("--no-strip and --cameras cannot be used together")


def _pictures_in(folder: Path, *, masks: bool) -> tuple[list[Path], bool]:
    """Return the pictures of a folder, and whether they are raw."""
    paths = list_pictures(folder, suffixes=SUFFIXES if masks else (*SUFFIXES, *raw_pictures.SUFFIXES))
    raw = [path for path in paths if raw_pictures.is_raw(path)]
    if raw and len(raw) < len(paths):
        other = next(path for path in paths if path not in raw)
        raise UserError(f"{folder} contains raw pictures ({raw[0].name}) and others ({other.name}); use a separate folder for each kind")
    return paths, bool(raw)


Alike: TypeAlias = tuple[int, str]
"""Ring and band: pictures of one ring in one band are alike."""
Placed: TypeAlias = tuple[int, str, int, float | None]
"""View, band, ring and table angle of a picture."""


class _Copying:
    """Pictures that are being copied to a dataset.

    Parameters
    ----------
    scene : Scene
        Scene whose camera has the size of the pictures.
    folder : Path
        Dataset folder.
    raw : bool
        Whether the pictures are raw.
    white : int or None
        Grey value of white in silhouettes; None for pictures.
    given : GivenCameras or None
        Given cameras, if any.
    """

    def __init__(self, scene: Scene, folder: Path, *, raw: bool, white: int | None, given: GivenCameras | None) -> None:
        self._scene, self._folder = scene, folder
        self._raw, self._white, self._given = raw, white, given
        self._gains: tuple[float, float] | None = None
        self._turns = _Turns()
        self._count = 0
        self.clipped: dict[str, float] = {}
        """Fraction of saturated pixels of the overexposed pictures."""

    def copied(self, paths: list[Path], table: list[Placed], monitor: Monitor) -> tuple[Frame, ...]:
        """Copy all pictures with view, band, ring and table angle; reject damaged pictures."""
        found = []
        with monitor.stage("copy"), monitor.steps("copy", len(paths), "picture") as step:
            for path, placed in zip(paths, table, strict=True):
                found.append(self._copy(path, placed))
                step()
        self._turns.refuse_damaged()
        self._count = len(found)
        return tuple(found)

    def _copy(self, path: Path, placed: Placed) -> Frame:
        """Write a picture to the dataset and check it."""
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
        """Return notes on unchecked properties and overexposed pictures."""
        if not self.clipped:
            return self._turns.notes()
        worst = max(self.clipped, key=lambda name: self.clipped[name])
        return [
            *self._turns.notes(),
            f"warning: {len(self.clipped)} of {self._count} pictures are overexposed; the worst is {worst} with "
            f"{100.0 * self.clipped[worst]:.0f} % of its pixels at full scale. The light absorbed by roots cannot be measured there; "
            "reduce the exposure so that the panel is at 80 % of full scale",
        ]


def _pose_of(path: Path, given: GivenCameras) -> frames.Array | None:
    """Return the given pose of a picture, by its name or by its name without suffix, as some programs write it."""
    return given.cam_from_canister.get(path.name, given.cam_from_canister.get(path.stem))


def _given(scene: Scene, cameras: Path) -> tuple[Scene, GivenCameras]:
    """Read the cameras of a file, and the scene with their lens."""
    given = read_cameras(cameras, scene.camera)
    changed = replace(scene, camera=given.camera)
    scene = files.scene_from_dict(files.scene_to_dict(changed), where=f"scene {scene.name} with the lens of {cameras}")
    _check_cameras(given, scene, cameras)
    return scene, given


def _with_cameras(paths: list[Path], given: GivenCameras, cameras: Path, notes: list[str]) -> list[Path]:
    """Return the pictures with a camera; note the others; reject cameras without a picture."""
    kept = [path for path in paths if _pose_of(path, given) is not None]
    names = {path.name for path in paths} | {path.stem for path in paths}
    missing = [name for name in given.cam_from_canister if name not in names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise UserError(
            f"{cameras} has a camera for {missing[0]}{more}, but this picture is missing in {paths[0].parent}; add it or remove the camera"
        )
    without = [path.name for path in paths if path not in kept]
    if without:
        notes.append(f"not imported, because {cameras} has no camera for them: {', '.join(without)}")
    return kept


def _check_cameras(given: GivenCameras, scene: Scene, cameras: Path) -> None:
    """Reject cameras inside the canister, which indicate another unit or another frame."""
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
    """Return ring and table angle of each picture: as planned if the counts agree, else ring 0 without angle."""
    if given is not None:
        return [(0, None)] * count
    views = plan.views(scene)
    if len(views) == count:
        notes.append(f"table angles: taken from the capture plan of the scene ({count} views), in the order of the file names")
        return [(view.ring, view.table_deg) for view in views]
    notes.append(
        f"table angles: none, because there are {count} pictures but the capture plan "
        f"has {len(views)} views; they are estimated from the markers"
    )
    return [(0, None)] * count


def _curve_note(paths: list[Path], scene: Scene, *, raw: bool) -> str:
    """Return a note on the response curve used for the pictures."""
    if raw:
        return (
            "raw pictures: each block of pixels was averaged to one grey pixel with "
            "the white balance of the first picture; values are linear"
        )
    stated = transfer.camera_curve(scene.camera)
    words = {word.name for path in paths if (word := transfer.read_stated_curve(path)) is not None}
    if not words:
        return f"response curve: {stated.name}, as given by the camera of the scene, because the pictures contain no information"
    return f"response curve: {', '.join(sorted(words))}, as stated in the pictures"


def _data_of(path: Path, scene: Scene, *, white: int | None) -> bytes:
    """Return the data to be stored for a picture.

    Pictures are stored unchanged, with the stated response curve; silhouettes as PNG, scaled to 0..255.
    """
    data, grey = _read(path, scene)
    if white is None:
        return data
    _check_mask(grey, white, path)
    grey = np.round(grey * (255.0 / white)).astype(np.uint8)
    done, encoded = cv2.imencode(".png", grey)
    if not done:
        raise UserError(f"{path} cannot be converted to PNG; convert it with another program")
    return bytes(encoded.tobytes())


class _Turns:
    """Pictures of each ring; damage in those without a checksum is detected by comparison with their neighbours."""

    def __init__(self) -> None:
        self._turns: dict[Alike, Turn] = {}
        self._open: dict[str, Alike] = {}  # pictures without a checksum, with their ring and band
        self._folder = Path()

    def add(self, path: Path, ring: Alike, grey: Grey, *, sealed: bool) -> None:
        """Add a picture."""
        self._folder = path.parent
        self._turns.setdefault(ring, Turn()).add(path.name, grey)
        if not sealed:
            self._open[path.name] = ring

    def refuse_damaged(self) -> None:
        """Reject a picture without a checksum in which rows differ from all other pictures."""
        for ring in sorted(set(self._open.values())):
            for found in self._turns[ring].unlike():
                if found.name in self._open:
                    raise UserError(
                        f"{self._folder / found.name}: rows {found.first} to {found.last} differ from all other pictures, which "
                        "indicates damage; copy or take the picture again or remove it. If it is correct, convert it to PNG, "
                        "because its format has no "
                        "checksum that could prove this"
                    )

    def notes(self) -> list[str]:
        """Return notes on what was not checked."""
        if not self._open:
            return []
        apart = sum(not self._turns[ring].enough for ring in self._open.values())
        but = "damage of less than a fifth of a row cannot be detected"
        if apart:
            but += f"; {apart} of them could not be compared with others of their ring, which requires {LEAST} pictures"
        return [
            f"{len(self._open)} pictures have formats without a checksum (JPEG, TIFF with LZW, PackBits or no compression): {but}; "
            "damage of PNG, or of TIFF with Deflate, is always detected"
        ]


def _clipped(grey: Grey) -> float:
    """Return the fraction of a picture's pixels at the maximum of its bit depth.

    The bit depth may be smaller than that of the file (12 bits in 16).
    """
    largest = int(grey.max())
    # as integers, and 10, 12 and 14 bits shifted up to 16
    full = {255, 1023, 4095, 16383, 65535, 65472, 65520, 65532}
    return float((grey == largest).mean()) if largest in full else 0.0


def _read(path: Path, scene: Scene) -> tuple[bytes, Grey]:
    """Read the bytes and the grey picture of a file, which must be complete and of the camera's size."""
    data = read_file(path, most_mib=MOST_PICTURE_MIB)
    return data, decode_grey(data, where=str(path), image_wh=scene.camera.image_wh)


def _white_level(paths: list[Path], scene: Scene) -> int:
    """Return the grey value of white in a set of silhouettes.

    It is the largest value in use, because some programs write 0 and 1.
    """
    white = max(int(_read(path, scene)[1].max()) for path in paths)
    if white == 0:
        raise UserError(f"{paths[0].parent}: all silhouettes are empty (black); roots must be white")
    return white


def _check_mask(grey: Grey, white: int, path: Path) -> None:
    """Reject a silhouette with grey values other than soft edges."""
    level = grey / white
    between = float(np.mean((level > MASK_MARGIN) & (level < 1.0 - MASK_MARGIN)))
    if between > MASK_GREYS:
        raise UserError(
            f"{path} is not a silhouette: {100.0 * between:.0f} % of its pixels are neither black nor white "
            f"(maximum {100.0 * MASK_GREYS:.0f} %); "
            "give silhouettes, or remove --masks"
        )
