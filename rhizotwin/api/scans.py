"""Python interface for import of pictures and for scans."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

from rhizotwin.api.command_calls import log, logged
from rhizotwin.scenes.model import Scene
from rhizotwin.steps.calls import Progress, watch
from rhizotwin.steps.front_door import Device, load_scene

if TYPE_CHECKING:
    from rhizotwin.scenes.dataset import Dataset

Fidelity = Literal["render", "sketch"]


class TwinOptions(TypedDict, total=False):
    """Options of `scan` for the emulated rig."""

    profile: str
    seed: int
    fidelity: Fidelity
    device: Device


def import_pictures(
    folder: str | Path,
    output: str | Path,
    *,
    scene: Scene | str | Path,
    cameras: str | Path | None = None,
    masks: bool = False,
    no_strip: bool = False,
    monitor: Progress = None,
) -> Dataset:
    """Convert a folder of pictures to a dataset.

    Decisions that the import has made automatically are logged.

    Parameters
    ----------
    folder : path
        Folder of pictures (PNG, JPG, TIFF, or raw pictures such as DNG), which are read in the natural order of their
        names.
    output : path
        New or empty folder for the dataset.
    scene : Scene, str or path
        Scene, or its name or file: canister, water, marker strip and camera.
    cameras : path, optional
        File of camera poses (canister frame, mm) and lens parameters, in nerfstudio's format transforms.json, or folder
        of a COLMAP model.
    masks : bool
        The pictures are silhouettes with white roots on black; requires ``cameras``.
    no_strip : bool
        The pictures show no marker strip, see `docs/without-markers.md`.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    Dataset
        Imported dataset.
    """
    from rhizotwin.importer import picture_import

    given = scene if isinstance(scene, Scene) else load_scene(scene)
    with watch(monitor, {"copy": 1.0}) as bar:
        kind = picture_import.PictureKind(cameras=None if cameras is None else Path(cameras), masks=masks, no_strip=no_strip)
        imported = picture_import.import_pictures(Path(folder), given, Path(output), kind=kind, monitor=bar)
    for note in imported.notes:
        log.info(note)
    return imported.dataset


def scan(
    rig: str | Path,
    output: str | Path,
    *,
    scene: str | Path | None = None,
    plan: str | None = None,
    resume: bool = False,
    table_angle_deg: float | None = None,
    **twin: Unpack[TwinOptions],
) -> Dataset:
    """Take all planned pictures of a canister on a real or an emulated rig.

    Parameters
    ----------
    rig : path or "twin"
        Rig file, or ``"twin"`` for the emulated rig.
    output : path
        New or empty folder for the dataset; with ``resume`` the folder of the interrupted scan.
    scene : str or path, optional
        Name or file of the scene on the rig. Required with a rig file; the emulated rig uses ``printed_8ml`` by
        default.
    plan : str, optional
        Capture plan file, or scene, whose rings (turns at one camera height and tilt) replace the rings of the scene.
    resume : bool
        Continue an interrupted scan.
    table_angle_deg : float, optional
        Initial angle of the turntable, deg; required only if no marker can be detected at the start.
    **twin : TwinOptions
        Options of the emulated rig: ``profile`` (``clean``, ``bench``, ``camera``, ``harsh``, ``real`` or a file;
        default ``bench``), ``seed``, ``fidelity`` (``render``, or ``sketch`` to draw only the marker strip) and
        ``device``.

    Returns
    -------
    Dataset
        Dataset with the pictures of the scan.
    """
    from rhizotwin.commands.scan import ScanOptions
    from rhizotwin.commands.scan import scan as run
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.steps import rigs
    from rhizotwin.steps.arguments import Progress as Bars

    named = None if scene is None else str(scene)
    options = ScanOptions(scene=named, plan=plan, resume=resume, table_angle_deg=table_angle_deg)
    with logged():
        run(rig=str(rig), output=Path(output), options=options, twin=rigs.TwinPictures(**twin), progress=Bars(quiet=True))
    return load_dataset(output)
