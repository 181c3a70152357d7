"""Python interface of each step, which the command line calls as well. The device is chosen on first use.

`import rhizotwin as rt` provides these functions as ``rt.load_scene``, ``rt.simulate``, ``rt.reconstruct``,
``rt.load_result``, ``rt.score`` and ``rt.score_file``.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

from rhizotwin import engine, scene_changes
from rhizotwin.arguments import MASS_LIMITS_G
from rhizotwin.calls import SHARES, Progress, require, watch
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
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


class SceneChanges(TypedDict, total=False):
    """Settings of a scene that `simulate` changes; None keeps the scene's."""

    profile: str | None
    views: int | None
    image_wh: tuple[int, int] | None


Device = Literal["auto", "cpu", "cuda"]
Method = Literal["ours", "thesis", "regularised", "hull"]
FileKind = Literal["mesh", "voxels", "points", "rsml", "traits"]


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
    """Load a scene and change some of its settings.

    Parameters
    ----------
    scene : str or path
        Name of a scene that ``rhizotwin scenes`` lists, or a scene file (TOML).
    profile : str, optional
        Disturbances of the rig: ``clean``, ``bench``, ``camera``, ``harsh``, ``real`` or a file; default: the scene's.
    specimen : path, optional
        Closed mesh (PLY, STL, OBJ) or traced roots (RSML) that replaces the scene's root, canister frame, mm.
    specimen_unit : str, optional
        Unit of the coordinates in an RSML file that does not state it.
    specimen_diameter_mm : float, optional
        Diameter of roots without diameters in an RSML file.
    placing : Placing, optional
        Position of a specimen from a file: ``Placing(place="auto")`` moves it below the grid of the net pot; ``flip``,
        ``scale``, ``shift_mm``.
    views : int, optional
        Number of pictures in each ring; default: the scene's.
    image_wh : tuple of int, optional
        Width and height of the pictures, px; default: the scene's.

    Raises
    ------
    UserError
        If the scene does not exist or is not valid.
    """
    require("scene", scene, "path")
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
    seed: int = 0,
    fidelity: Literal["backlit", "path"] = "backlit",
    samples: int | None = None,
    device: Device = "auto",
    monitor: Progress = None,
    **changes: Unpack[SceneChanges],
) -> Dataset:
    """Render all views of a scene into a dataset folder with ground truth; continue an interrupted rendering.

    Parameters
    ----------
    scene : Scene, str or path
        A scene, its name, or a scene file.
    folder : path
        Folder of the dataset: new, empty, or that of an interrupted rendering of the same scene.
    seed : int
        Random seed for all simulated errors and noise.
    fidelity : {"backlit", "path"}
        backlit: fast, without sampling noise; path: path tracing with all reflections.
    samples : int, optional
        Light paths per pixel; default: depends on the fidelity.
    device : {"auto", "cpu", "cuda"}
        Device for the computation; auto: the current one, or an NVIDIA GPU if available.
    monitor : Monitor, tqdm class, callable or None
        Progress; a monitor can also cancel the work.
    **changes : SceneChanges
        ``profile`` (``clean``, ``bench``, ``camera``, ``harsh``, ``real`` or a file), ``views`` and ``image_wh``, as in
        `load_scene`.

    Raises
    ------
    UserError
        If the scene, folder or device cannot be used.
    Cancelled
        After `Monitor.cancel`.
    """
    require("scene", scene, "Scene", "path")
    require("folder", folder, "path")
    require("seed", seed, "whole number")
    rendered = scene if isinstance(scene, Scene) else files.load_scene(scene)
    if changes:
        rendered = scene_changes.change_scene(rendered, **changes)
    _choose(device)
    from rhizotwin.sim.simulate import simulate as render

    named = changes.get("profile") or "scene"
    with watch(monitor, {"render": 1.0}) as bar:
        return render(rendered, Path(folder), profile_name=named, seed=seed, fidelity=fidelity, samples=samples, monitor=bar)


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
    """Reconstruct the shape and volume of roots from the pictures of a dataset.

    The result is in memory; `Result.save` writes it. The ground truth of a simulated dataset is not used.

    Parameters
    ----------
    dataset : Dataset or path
        A dataset or its folder.
    voxel_mm : float, optional
        Edge of the smallest voxels; overrides the settings.
    mass_g : float, optional
        Mass of the roots, for specific root length and tissue density.
    settings : Settings, optional
        Settings of all stages.
    keep_stages : path, optional
        Folder for intermediate results of each stage, as JSON and NPZ files.
    method : {"ours", "thesis", "regularised", "hull"}
        thesis: the method of the thesis of 2022; regularised: the regularised visual hull of Zheng et al. (2011); hull:
        the untrimmed visual hull. The volumes of these baselines are never trusted.
    device : {"auto", "cpu", "cuda"}
        Device for the computation; auto: the current one, or an NVIDIA GPU if available.
    monitor : Monitor, tqdm class, callable or None
        Progress; a monitor can also cancel the work.

    Raises
    ------
    UserError
        If the pictures or the device cannot be used, or ``mass_g`` or ``keep_stages`` is combined with a baseline.
    Cancelled
        After `Monitor.cancel`.
    """
    require("dataset", dataset, "Dataset", "path")
    _check_options(voxel_mm, mass_g, settings)
    _choose(device)
    from rhizotwin.recon.reconstruct import reconstruct as find
    from rhizotwin.recon.settings import Settings

    if voxel_mm is not None:
        checked = from_plain(Settings, {"voxel_mm": voxel_mm}, Place("the call of reconstruct"))
        settings = replace(settings or checked, voxel_mm=checked.voxel_mm)
    with watch(monitor, SHARES) as bar:
        if method == "ours":
            return _for_notebooks(find(dataset, settings=settings, mass_g=mass_g, keep_stages=keep_stages, monitor=bar))
        from rhizotwin.baselines import reconstruct_baseline

        if keep_stages is not None or mass_g is not None:
            raise UserError(f"--method {method} keeps no stages and has no traits of mass; leave out --keep-stages and --mass-g")
        return _for_notebooks(reconstruct_baseline(dataset, method, settings=settings, monitor=bar))


def load_result(folder: str | Path) -> Result:
    """Load a result folder; its silhouettes are read on first use.

    Parameters
    ----------
    folder : path
        Folder of the result.

    Raises
    ------
    UserError
        If a file is missing or damaged.
    """
    require("folder", folder, "path")
    from rhizotwin.stored import load

    return _for_notebooks(load.load_result(folder))


def score(
    result: Result | str | Path,
    dataset: Dataset | str | Path | None = None,
    *,
    truth: str | Path | None = None,
    volume_ml: float | None = None,
    pictures: Dataset | str | Path | None = None,
    progress: Progress = None,
) -> Score | SolidScore | VolumeScore | PictureScore:
    """Compare a result with exactly one reference: ``dataset``, ``truth``, ``volume_ml`` or ``pictures``.

    Parameters
    ----------
    result : Result or path
        A result or its folder.
    dataset : Dataset or path, optional
        The simulated dataset of the result, or its folder.
    truth : path, optional
        Closed mesh (PLY, STL, OBJ) of the scanned part, mm, in any pose: it is registered to the result.
    volume_ml : float, optional
        Volume of the specimen, measured by displacement or weight.
    pictures : Dataset or path, optional
        Dataset with other pictures of the same plant on the same rig.
    progress : Monitor, tqdm class, callable or None
        Progress.

    Returns
    -------
    Score, SolidScore, VolumeScore or PictureScore
        For dataset, mesh, volume or pictures. All have ``table()`` and ``to_dict()``.

    Raises
    ------
    UserError
        If none or several references are given, the dataset has no ground truth, the result belongs to another dataset,
        or a file is missing or damaged.
    """
    require("result", result, "Result", "path")
    require("dataset", dataset, "Dataset", "path", "None")
    if sum(given is not None for given in (dataset, truth, volume_ml, pictures)) != 1:
        raise UserError(
            "give one reference: a simulated dataset, the mesh of the scanned part (--truth), its volume (--volume-ml) "
            "or pictures that were not used (--pictures)"
        )
    if pictures is not None:
        _choose("auto")
        from rhizotwin.scoring.score_pictures import score_pictures

        with watch(progress, {"score": 1.0}) as bar:
            return score_pictures(result, pictures, monitor=bar)
    with watch(progress, {"score": 1.0}) as bar, bar.stage("score"):
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
    """Compare a file of another method with the ground truth of a simulated dataset.

    Parameters
    ----------
    file : path
        File in the canister frame, mm (GLB: metres, y up).
    dataset : Dataset or path
        The simulated dataset.
    kind : {"mesh", "voxels", "points", "rsml", "traits"}
        Content of the file.
    registered : bool
        Register a mesh to the ground truth first (rotation and translation).
    progress : Monitor, tqdm class, callable or None
        Progress.

    Raises
    ------
    UserError
        If the file is missing, damaged or of another kind, or the dataset has no ground truth.
    """
    require("file", file, "path")
    require("dataset", dataset, "Dataset", "path")
    from rhizotwin.scoring import score_file as of

    if registered and kind != "mesh":
        raise UserError(f"--registered is for meshes, and {file} is given as {kind}")
    with watch(progress, {"score": 1.0}) as bar, bar.stage("score"):
        if kind == "mesh":
            return of.score_mesh(file, dataset, registered=registered)
        return {"voxels": of.score_voxels, "points": of.score_points, "rsml": of.score_rsml, "traits": of.score_traits}[kind](file, dataset)


def _score_part(result: Result | str | Path, file: Path) -> SolidScore:
    """Register the mesh of a scanned part to a result and compare them."""
    from rhizotwin.recon.results.parts import Mesh
    from rhizotwin.scoring.score_solid import score_solid
    from rhizotwin.sim import meshes, solids

    solid, notes = meshes.load_solid(file)
    for note in notes:
        log.info(note)
    vertices, faces = solids.to_surface(solid)
    shape = Mesh(vertices_mm=vertices, faces=faces.astype("int64"))
    return score_solid(result, shape, volume_mm3=float(solid.volume()))


def _check_options(voxel_mm: float | None, mass_g: float | None, settings: Settings | None) -> None:
    """Reject options of a wrong type, and a mass out of limits, before the long computation."""
    for name, value, kind in (("voxel_mm", voxel_mm, "number"), ("mass_g", mass_g, "number"), ("settings", settings, "Settings")):
        require(name, value, kind, "None")
    low, high = MASS_LIMITS_G
    if mass_g is not None and not low <= mass_g <= high:
        raise UserError(f"mass_g must be {low:g} to {high:g} g, not {mass_g:g}")


def _for_notebooks(result: Result) -> Result:
    """Return a result that notebooks show with a picture."""
    from rhizotwin.report import notebook

    return replace(result, notebook=notebook.html)


def _choose(device: Device) -> None:
    """Start the engine, unless it is running on the requested device."""
    chosen = engine.ensure(device)
    if chosen is not None:
        log.info(chosen)
