"""The front door for Python: each step as one call, with the device chosen on first use.

`import rhizotwin as rt` gives these functions as ``rt.load_scene``, ``rt.simulate``, ``rt.reconstruct``,
``rt.load_result``, ``rt.score`` and ``rt.score_file``; the command line calls the same.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rhizotwin import engine, scene_changes
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Listener, Monitor
from rhizotwin.scenes.schema import Place, from_plain

if TYPE_CHECKING:
    from rhizotwin.arguments import Placing
    from rhizotwin.recon.results.result import Result
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.scoring.score import Score
    from rhizotwin.scoring.score_file import FileScore
    from rhizotwin.scoring.score_pictures import PictureScore
    from rhizotwin.scoring.score_solid import SolidScore, VolumeScore

log = logging.getLogger("rhizotwin")

Device = Literal["auto", "cpu", "cuda"]
Method = Literal["ours", "thesis", "regularised", "hull"]
FileKind = Literal["mesh", "voxels", "points", "rsml", "traits"]
Progress = Monitor | type[Any] | Listener | None
"""A monitor, a type of tqdm, what is called as ``(stage, done, total)``, or None for silence."""


def load_scene(
    scene: str | Path,
    *,
    profile: str | None = None,
    specimen: str | Path | None = None,
    specimen_unit: str | None = None,
    specimen_diameter_mm: float | None = None,
    placing: Placing | None = None,
    views: int | None = None,
    image_wh: tuple[int, int] | None = None,
) -> Scene:
    """Load a scene, with a few things changed.

    Parameters
    ----------
    scene : str or path
        A name of the library (``rhizotwin scenes`` lists it), or a scene file.
    profile : str, optional
        What the rig gets wrong: ``clean``, ``bench``, ``harsh`` or a file; default: the scene's own.
    specimen : path, optional
        A closed mesh (PLY, STL, OBJ) or traced roots (RSML) in place of the scene's root, canister frame, mm.
    specimen_unit : str, optional
        Unit of an RSML file's coordinates, where the file does not say.
    specimen_diameter_mm : float, optional
        Diameter of the roots for which an RSML file gives none.
    placing : Placing, optional
        Where a specimen's file goes: ``Placing(place="auto")`` hangs it below the net pot's grid; ``flip``, ``scale``,
        ``shift_mm``.
    views : int, optional
        Pictures in every ring; default: the scene's.
    image_wh : tuple of int, optional
        Width and height of the pictures in px; default: the scene's.

    Raises
    ------
    UserError
        For a scene that is not there, or cannot be.
    """
    return scene_changes.change_scene(
        files.load_scene(scene),
        profile=profile,
        specimen=None if specimen is None else Path(specimen),
        specimen_unit=specimen_unit,
        specimen_diameter_mm=specimen_diameter_mm,
        placing=placing,
        views=views,
        image_wh=image_wh,
    )


def simulate(
    scene: Scene | str | Path,
    folder: str | Path,
    *,
    profile: str | None = None,
    seed: int = 0,
    fidelity: Literal["backlit", "path"] = "backlit",
    samples: int | None = None,
    device: Device = "auto",
    monitor: Progress = None,
) -> Dataset:
    """Render every view of a scene's plan into a dataset folder, with its truth; a stopped set is taken up.

    Parameters
    ----------
    scene : Scene, str or path
        As `load_scene` gives it, or what it takes.
    folder : path
        The dataset's: new, empty, or left by the same call when it was stopped.
    profile : str, optional
        What the rig gets wrong: ``clean``, ``bench``, ``harsh`` or a file; default: the scene's own.
    seed : int
        Random seed for all simulated errors and noise.
    fidelity : {"backlit", "path"}
        backlit: fast, without noise of its own; path: full path tracing with all reflections.
    samples : int, optional
        Light paths a pixel; default: as the fidelity needs.
    device : {"auto", "cpu", "cuda"}
        What computes; auto keeps what computes already, and otherwise takes an NVIDIA GPU if there is one.
    monitor : Monitor, type of tqdm, callable or None
        Hears of every view, and may stop the work.

    Raises
    ------
    UserError
        For a scene, folder or device that cannot be used.
    Cancelled
        After `Monitor.cancel`.
    """
    rendered = scene if isinstance(scene, Scene) else files.load_scene(scene)
    if profile is not None:
        rendered = scene_changes.change_scene(rendered, profile=profile)
    _choose(device)
    from rhizotwin.sim.simulate import simulate as render

    named = profile or "scene"
    return render(rendered, Path(folder), profile_name=named, seed=seed, fidelity=fidelity, samples=samples, monitor=monitor)


def reconstruct(
    dataset: Dataset | str | Path,
    *,
    voxel_mm: float | None = None,
    mass_g: float | None = None,
    settings: Settings | None = None,
    keep_stages: Path | str | None = None,
    method: Method = "ours",
    device: Device = "auto",
    monitor: Progress = None,
) -> Result:
    """Find the root's shape and volume in a dataset's pictures, in memory; `Result.save` writes it.

    The truth of a simulated dataset is never read.

    Parameters
    ----------
    dataset : Dataset or path
        As `simulate` or `load_dataset` gives it, or its folder.
    voxel_mm : float, optional
        Edge of the smallest voxels; overrides that of the settings.
    mass_g : float, optional
        Mass of the roots, if weighed: gives specific root length and tissue density.
    settings : Settings, optional
        Every setting, a group for each stage.
    keep_stages : path, optional
        Folder for what each stage made, for study: NAME.json with NAME.npz of cameras, coverage, hull, roots and solid.
    method : {"ours", "thesis", "regularised", "hull"}
        thesis: the method of the thesis of 2022; regularised: the regularised visual hull of Zheng et al. (2011); hull:
        the untrimmed visual hull. These are baselines, whose volume is never trusted.
    device : {"auto", "cpu", "cuda"}
        What computes; auto keeps what computes already, and otherwise takes an NVIDIA GPU if there is one.
    monitor : Monitor, type of tqdm, callable or None
        Hears how far the work is, and may stop it.

    Raises
    ------
    UserError
        Where the pictures or the device cannot be used, or a baseline is given ``mass_g`` or ``keep_stages``.
    Cancelled
        After `Monitor.cancel`.
    """
    _choose(device)
    from rhizotwin.recon.reconstruct import reconstruct as find
    from rhizotwin.recon.settings import Settings

    if voxel_mm is not None:
        checked = from_plain(Settings, {"voxel_mm": voxel_mm}, Place("the call of reconstruct"))
        settings = replace(settings or checked, voxel_mm=checked.voxel_mm)
    if method != "ours":
        from rhizotwin.baselines import reconstruct_baseline

        if keep_stages is not None or mass_g is not None:
            raise UserError(f"--method {method} keeps no stages and has no traits of mass; leave out --keep-stages and --mass-g")
        return _shown(reconstruct_baseline(dataset, method, settings=settings, monitor=monitor))
    return _shown(find(dataset, settings=settings, mass_g=mass_g, keep_stages=keep_stages, monitor=monitor))


def load_result(folder: str | Path) -> Result:
    """Read a result folder; its silhouettes are read when they are looked at.

    Raises
    ------
    UserError
        Where a file is missing or damaged.
    """
    from rhizotwin.stored import load

    return _shown(load.load_result(folder))


def score(
    result: Result | str | Path,
    dataset: Dataset | str | Path | None = None,
    *,
    truth: str | Path | None = None,
    volume_ml: float | None = None,
    pictures: Dataset | str | Path | None = None,
    progress: Progress = None,
) -> Score | SolidScore | VolumeScore | PictureScore:
    """Compare a result with what is known of the specimen: give one of the four.

    Parameters
    ----------
    result : Result or path
        As `reconstruct` or `load_result` gives it, or its folder.
    dataset : Dataset or path, optional
        The simulated dataset that the result was made from, as `simulate` or `load_dataset` gives it, or its folder.
    truth : path, optional
        A closed mesh (PLY, STL, OBJ) of the part that was scanned, in mm, anywhere and turned anyhow: it is laid onto
        the result.
    volume_ml : float, optional
        The specimen's volume, as it was measured by displacement or weight.
    pictures : Dataset or path, optional
        A dataset with pictures that the result was not made from, of the same plant on the same rig.
    progress : Monitor, type of tqdm, callable or None
        Hears how far the work is; only pictures take a while.

    Returns
    -------
    Score, SolidScore, VolumeScore or PictureScore
        Of dataset, mesh, volume or pictures: each has ``table()`` and ``to_dict()``.

    Raises
    ------
    UserError
        If none or several of the four are given, the dataset has no truth, the result is of another dataset, or a file
        is missing or damaged.
    """
    if sum(given is not None for given in (dataset, truth, volume_ml, pictures)) != 1:
        raise UserError(
            "give one thing to score against: a simulated dataset, the solid that was scanned (--truth), its volume (--volume-ml) "
            "or pictures that were not used (--pictures)"
        )
    if pictures is not None:
        _choose("auto")
        from rhizotwin.scoring.score_pictures import score_pictures

        return score_pictures(result, pictures, monitor=Monitor.of(progress))
    with Monitor.of(progress).stage("score"):
        if dataset is not None:
            from rhizotwin.scoring.score import score as compare

            return compare(result, dataset)
        if volume_ml is not None:
            from rhizotwin.scoring.score_solid import score_volume

            return score_volume(result, 1000.0 * volume_ml)
        return _score_part(result, Path(str(truth)))


def score_file(
    file: str | Path,
    dataset: Dataset | str | Path,
    *,
    kind: FileKind,
    registered: bool = False,
    progress: Progress = None,
) -> FileScore:
    """Compare a file of another method with the truth of a simulated dataset.

    Parameters
    ----------
    file : path
        In the canister's frame, mm (GLB: metres, y up).
    dataset : Dataset or path
        The simulated dataset.
    kind : {"mesh", "voxels", "points", "rsml", "traits"}
        What the file holds.
    registered : bool
        Lay a mesh onto the truth first, by a turn and a shift.
    progress : Monitor, type of tqdm, callable or None
        Hears how far the work is.

    Raises
    ------
    UserError
        If the file is missing, damaged or of another kind, or the dataset has no truth.
    """
    from rhizotwin.scoring import score_file as of

    if registered and kind != "mesh":
        raise UserError(f"--registered is for meshes, and {file} is given as {kind}")
    with Monitor.of(progress).stage("score"):
        if kind == "mesh":
            return of.score_mesh(file, dataset, registered=registered)
        return {"voxels": of.score_voxels, "points": of.score_points, "rsml": of.score_rsml, "traits": of.score_traits}[kind](file, dataset)


def _score_part(result: Result | str | Path, file: Path) -> SolidScore:
    """Lay the part that was scanned onto a result and compare them."""
    from rhizotwin.recon.results.parts import Mesh
    from rhizotwin.scoring.score_solid import score_solid
    from rhizotwin.sim import meshes, solids

    solid, notes = meshes.load_solid(file)
    for note in notes:
        log.info(note)
    vertices, faces = solids.to_surface(solid)
    shape = Mesh(vertices_mm=vertices, faces=faces.astype("int64"))
    return score_solid(result, shape, volume_mm3=float(solid.volume()))


def _shown(result: Result) -> Result:
    """Return a result that a notebook draws."""
    from rhizotwin.report import notebook

    return replace(result, notebook=notebook.html)


def _choose(device: Device) -> None:
    """Start the engine unless it computes already on what is asked for."""
    chosen = engine.ensure(device)
    if chosen is not None:
        log.info(chosen)
