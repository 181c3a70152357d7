"""Conversion of existing pictures to a dataset.

The camera poses are read from a file, or are estimated later from the markers.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rhizotwin.importer import raw_pictures
from rhizotwin.importer.camera_file import lens_notes, read_camera_file, with_cameras
from rhizotwin.importer.given_cameras import GivenCameras
from rhizotwin.importer.picture_copy import PictureCopier
from rhizotwin.importer.picture_files import SUFFIXES, check_pictures, list_pictures
from rhizotwin.importer.response import with_response
from rhizotwin.importer.silhouettes import read_levels
from rhizotwin.rig.cameras import raw_files
from rhizotwin.scenes import plan, transfer
from rhizotwin.scenes.dataset import Dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.orientation import TURNS
from rhizotwin.scenes.picture_codec import Grey, decode_light
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, read_file
from rhizotwin.scenes.unsupported import refuse_dark_ground, refuse_scene

_RAW_NOTE = (
    "raw pictures were converted: each block of pixels was averaged to one grey pixel with linear values, with the white "
    "balance of the first picture"
)


@dataclass(frozen=True, kw_only=True)
class Imported:
    """Dataset that was imported, and notes about decisions that the import has made automatically."""

    dataset: Dataset
    notes: tuple[str, ...]
    """Sentences for the user about automatic decisions, conversions and excluded pictures."""


@dataclass(frozen=True, kw_only=True)
class PictureKind:
    """Kind of pictures, and source of their cameras."""

    cameras: Path | None = None
    """File in nerfstudio's format transforms.json, or folder of a COLMAP model, in the canister frame, mm. Pictures
    without a camera are excluded and listed in a note, and those with another lens are resampled. None: poses are
    estimated from the marker strip."""
    masks: bool = False
    """The pictures are silhouettes with white roots on black; requires ``cameras``."""
    no_strip: bool = False
    """The pictures show no marker strip; the cameras are estimated from the edges of the canister and from the roots
    (telecentric camera, one ring)."""


def import_pictures(
    folder: Path, scene: Scene, out: Path, *, kind: PictureKind = PictureKind(), monitor: Monitor | None = None
) -> Imported:
    """Copy a folder of pictures to a new dataset.

    Parameters
    ----------
    folder : Path
        Folder of PNG, JPG or TIFF pictures (8 or 16 bits) or raw pictures, read in the natural order of names.
    scene : Scene
        Scene of the rig. The picture size of its camera must match, unless the camera file contains a lens.
    out : Path
        New or empty dataset folder, which is written atomically.
    kind : PictureKind
        Kind of the pictures, and source of their cameras.
    monitor : Monitor, optional
        Receiver of the progress.

    Raises
    ------
    UserError
        If the scene's vessel or light is not supported, or the roots are bright on dark ground; if a picture is
        unreadable, damaged, of another size or an impossible silhouette, or has no camera.
    """
    refuse_scene(scene)
    _refuse_options(scene, kind)
    masks = kind.masks
    scene = replace(scene, strip=replace(scene.strip, rows=0)) if kind.no_strip else scene
    paths, raw = _pictures_in(folder, masks=masks)
    scene, given, paths, notes = _given_cameras(scene, kind.cameras, paths)
    bands = _bands_of(paths, scene)
    angles = _table_angles(scene, 1 + max(view for view, _ in bands), given, notes)
    table = [(view, band, *angles[view]) for view, band in bands]
    picture_wh = scene.camera.image_wh if given is None else given.picture_wh
    if raw:
        notes.append(_RAW_NOTE)
    else:
        notes += _orientation_notes(check_pictures(paths, image_wh=picture_wh))
    if not raw and not masks:
        scene, note = with_response(scene, paths, verified=given is None and not kind.no_strip)
        notes.append(note)
    if not masks:
        refuse_dark_ground(_some_pictures(scene, paths, bands, picture_wh))
    levels = read_levels(paths, image_wh=picture_wh) if masks else None
    origin: dict[str, Any] = {"program": "rhizotwin import", "pictures": str(folder), "cameras": kind.cameras and str(kind.cameras)}
    with new_folder(out) as building:
        copier = PictureCopier(scene, building, raw=raw, levels=levels, given=given)
        frames = copier.copy(paths, table, monitor or Monitor())
        origin |= {"clipped": copier.clipped, "versions": versions()}
        dataset = save_dataset(Dataset(folder=building, scene=scene, frames=frames, masks=masks, origin=origin))
    return Imported(dataset=replace(dataset, folder=out), notes=(*notes, *copier.notes()))


def _some_pictures(
    scene: Scene, paths: list[Path], bands: list[tuple[int, str]], picture_wh: tuple[int, int]
) -> Iterator[tuple[str, Grey]]:
    """Return the names and the light of a few pictures in whose band the panel is lit."""
    lit = [path for path, (_, band) in zip(paths, bands, strict=True) if not band or scene.is_lit(band)]
    for path in lit[:: max(1, len(lit) // 3)]:
        if raw_pictures.is_raw(path):
            light, _ = raw_pictures.read_raw(path, image_wh=picture_wh)
        else:
            curve = transfer.read_stated_curve(path) or transfer.camera_curve(scene.camera)
            light = decode_light(read_file(path, most_mib=MOST_PICTURE_MIB), curve, where=str(path))
        yield str(path), light


def _given_cameras(scene: Scene, cameras: Path | None, paths: list[Path]) -> tuple[Scene, GivenCameras | None, list[Path], list[str]]:
    """Return the scene with the lens of the camera file, its cameras, the pictures that have one, and notes."""
    if cameras is None:
        return scene, None, paths, []
    notes: list[str] = []
    scene, given = read_camera_file(scene, cameras)
    paths = with_cameras(paths, given, cameras, notes)
    return scene, given, paths, [*notes, *lens_notes(given)]


def _bands_of(paths: list[Path], scene: Scene) -> list[tuple[int, str]]:
    """Return the view number and the spectral band of each picture.

    If the camera has bands, the file name ends with ``_BAND``, and the pictures of one view have the same name before
    this suffix. Without bands, each picture is a view with the band "".
    """
    names = [band.name for band in scene.camera.bands]
    if not names:
        return [(number, "") for number in range(len(paths))]
    found = []
    views = dict[str, int]()
    for path in paths:
        ends = [name for name in names if path.stem.endswith(f"_{name}")]
        if not ends:
            example = f"{path.stem}_{names[0]}{path.suffix}"
            raise UserError(f"{path}: the file name does not end with one of the camera's bands; rename the file, for example to {example}")
        band = max(ends, key=len)
        found.append((views.setdefault(path.stem.removesuffix(f"_{band}"), len(views)), band))
    return found


def _refuse_options(scene: Scene, kind: PictureKind) -> None:
    """Raise UserError if options were given that cannot be combined."""
    if scene.tank is not None and (kind.cameras is not None or kind.no_strip):
        raise UserError(
            f"scene {scene.name} has a tank, whose pose is estimated from the marker strip; "
            "remove --cameras or --no-strip, or the [tank] section of the scene"
        )
    if kind.masks and kind.cameras is None:
        raise UserError("silhouettes (--masks) show no markers from which the cameras could be estimated; give --cameras JSON")
    if kind.no_strip and kind.cameras is not None:
        raise UserError("--no-strip and --cameras cannot be used together; remove one of them")


def _pictures_in(folder: Path, *, masks: bool) -> tuple[list[Path], bool]:
    """Return the paths of the pictures in a folder, and whether they are raw pictures."""
    paths = list_pictures(folder, suffixes=SUFFIXES if masks else (*SUFFIXES, *raw_files.SUFFIXES))
    raw = [path for path in paths if raw_pictures.is_raw(path)]
    if raw and len(raw) < len(paths):
        other = next(path for path in paths if path not in raw)
        raise UserError(
            f"{folder} contains raw pictures ({raw[0].name}) and other pictures ({other.name}); use a separate folder for each type"
        )
    return paths, bool(raw)


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


def _orientation_notes(orientations: list[int]) -> list[str]:
    """Return a note about pictures that are turned as their orientation tag states."""
    tags = sorted(set(orientations))
    if tags == [1]:
        return []
    turned = "; ".join(f"{tag}: {count(orientations.count(tag), 'picture')}, {TURNS[tag]}" for tag in tags)
    differ = (
        ". The tags differ; if the camera was not turned between the pictures, set the same tag in all of them" if len(tags) > 1 else ""
    )
    return [f"pictures are turned as their orientation tags state ({turned}){differ}"]
