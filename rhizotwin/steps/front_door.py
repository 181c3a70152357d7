"""Python interface for scenes, simulation, reconstruction and scoring, which the command line uses as well.

`import rhizotwin as rt` provides these functions as ``rt.load_scene``, ``rt.simulate``, ``rt.reconstruct``,
``rt.load_result``, ``rt.score`` and ``rt.score_file``. The first function that computes selects the CPU or the GPU.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from rhizotwin import engine
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import HEADS
from rhizotwin.scenes.model import Scene
from rhizotwin.steps import arguments, scene_changes
from rhizotwin.steps.calls import SHARES, Progress, watch

if TYPE_CHECKING:
    from rhizotwin.recon.results import result as reconstructed
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.scoring.score import Score
    from rhizotwin.scoring.score_file import FileScore
    from rhizotwin.scoring.score_pictures import PictureScore
    from rhizotwin.scoring.score_solid import SolidScore, VolumeScore
    from rhizotwin.steps.arguments import Placing
    from rhizotwin.steps.illustrated import Result

log = logging.getLogger("rhizotwin")


class SceneChanges(TypedDict, total=False):
    """Options of `load_scene` and `simulate` that change properties of the scene.

    If an option is None, the property is not changed.
    """

    profile: str | None
    specimen: str | Path | None
    specimen_unit: str | None
    specimen_diameter_mm: float | None
    placing: Placing | None
    views: int | None
    image_wh: tuple[int, int] | None


Device = Literal["auto", "cpu", "cuda"]
Method = Literal["ours", "thesis", "regularised", "hull"]
FileKind = Literal["mesh", "voxels", "points", "rsml", "traits"]


def load_scene(scene: str | Path, **changes: Unpack[SceneChanges]) -> Scene:
    """Load a scene, and optionally change some of its properties.

    Parameters
    ----------
    scene : str or path
        Name of a scene from the list of ``rhizotwin scenes``, or a scene file (TOML).
    **changes : SceneChanges
        Changes; the default of each is the value in the scene.

        ``profile``: simulated imperfections of the rig: ``clean``, ``bench``, ``camera``, ``harsh``, ``real`` or a
        file.

        ``specimen``: file with a closed mesh (PLY, STL, OBJ) or traced roots (RSML) that replaces the scene's roots,
        canister frame, mm.

        ``specimen_unit``: unit of the coordinates in an RSML file that does not specify a unit.

        ``specimen_diameter_mm``: diameter of roots for which the RSML file has no diameter, mm.

        ``placing``: `Placing` of a specimen from a file, with the fields ``place``, ``vertical_axis``, ``flip``,
        ``scale`` and ``shift_mm``; ``Placing(place="auto")`` moves the specimen below the grid of the net pot.

        ``views``: number of pictures in each ring.

        ``image_wh``: width and height of the pictures, px.

    Raises
    ------
    UserError
        If the scene does not exist or is invalid.
    """
    return _changed(files.load_scene(scene), changes)


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
    """Render all views of a scene to a dataset folder with ground truth, or continue an interrupted rendering.

    Parameters
    ----------
    scene : Scene, str or path
        Scene, scene name or scene file.
    folder : path
        Folder for the dataset: new, empty, or with an interrupted rendering of the same scene.
    seed : int
        Random seed for all simulated errors and noise.
    fidelity : {"backlit", "path"}
        Rendering method: ``backlit`` is fast and free of sampling noise, ``path`` is path tracing with all reflections.
    samples : int, optional
        Number of light paths per pixel; default: depends on the fidelity.
    device : {"auto", "cpu", "cuda"}
        Device for the computation; ``auto`` is the device in use, or otherwise an NVIDIA GPU if available.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress; a monitor can also cancel the rendering.
    **changes : SceneChanges
        Changes of the scene, see `load_scene`, such as ``views``, ``image_wh`` and ``profile`` (``clean``, ``bench``,
        ``camera``, ``harsh``, ``real`` or a file).

    Returns
    -------
    Dataset
        Dataset with the rendered pictures.

    Raises
    ------
    UserError
        If the scene, folder or device cannot be used.
    Cancelled
        After `Monitor.cancel`.
    """
    rendered = scene if isinstance(scene, Scene) else files.load_scene(scene)
    if changes:
        rendered = _changed(rendered, changes)
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

    Parameters
    ----------
    dataset : Dataset or path
        Dataset or its folder; the ground truth of a simulated dataset is not used.
    voxel_mm : float, optional
        Edge length of the smallest voxels, mm; overrides the settings.
    mass_g : float, optional
        Weighed mass of the roots, g, from which specific root length and tissue density are computed.
    settings : Settings, optional
        Settings of all stages.
    keep_stages : path, optional
        Folder for the intermediate results of each stage, as JSON and NPZ files.
    method : {"ours", "thesis", "regularised", "hull"}
        ``ours`` is the full method. The other methods are baselines, see `rhizotwin.scoring.baselines`.
    device : {"auto", "cpu", "cuda"}
        Device for the computation; ``auto`` is the device in use, or otherwise an NVIDIA GPU if available.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress; a monitor can also cancel the reconstruction, which then raises ``Cancelled``.

    Returns
    -------
    Result
        Result in memory; `Result.save` writes the result folder.

    Raises
    ------
    UserError
        If the pictures, the device or the combination of options cannot be used.
    """
    if keep_stages is not None and (heads := [name for name in HEADS if (Path(keep_stages) / name).is_file()]):
        raise UserError(f"--keep-stages: {keep_stages} contains {heads[0]}; choose a new folder for the intermediate results")
    if method != "ours" and (keep_stages, mass_g) != (None, None):
        raise UserError(f"--keep-stages and --mass-g are not supported by --method {method}; remove these options")
    from rhizotwin.scenes.dataset import load_dataset

    given = load_dataset(dataset) if isinstance(dataset, str | Path) else dataset
    _choose(device)
    from rhizotwin.recon.reconstruct import reconstruct as find
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scoring import baselines

    if voxel_mm is not None:
        settings = replace(settings or Settings(), voxel_mm=float(voxel_mm))
    with watch(monitor, SHARES) as bar:
        if method == "ours":
            return _guarded(find(given, settings=settings, mass_g=mass_g, keep_stages=keep_stages, monitor=bar))
        return _guarded(baselines.reconstruct_baseline(given, method, settings=settings, monitor=bar))


def load_result(folder: str | Path) -> Result:
    """Load a result from its folder.

    Parameters
    ----------
    folder : path
        Folder of the result.

    Returns
    -------
    Result
        Result, whose silhouettes are read from the folder on first use.

    Raises
    ------
    UserError
        If a file is missing or damaged.
    """
    from rhizotwin.stored import load

    return _guarded(load.load_result(folder))


def score(
    result: Result | str | Path,
    dataset: Dataset | str | Path | None = None,
    *,
    truth: str | Path | None = None,
    volume_ml: float | None = None,
    pictures: Dataset | str | Path | None = None,
    monitor: Progress = None,
) -> Score | SolidScore | VolumeScore | PictureScore:
    """Compute the errors of a result with respect to a dataset, a mesh, a volume or other pictures.

    Parameters
    ----------
    result : Result or path
        Result or its folder.
    dataset : Dataset or path, optional
        Simulated dataset from which the result was computed, or its folder.
    truth : path, optional
        File with a closed mesh (PLY, STL, OBJ) of the scanned part, mm; a mesh in any pose is registered to the result.
    volume_ml : float, optional
        Volume of the specimen, measured by displacement or weight, ml.
    pictures : Dataset or path, optional
        Dataset with other pictures of the same plant on the same rig.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    Score, SolidScore, VolumeScore or PictureScore
        Score with respect to a dataset, mesh, volume or pictures. All have the methods ``table`` and ``to_dict``.

    Raises
    ------
    UserError
        If not exactly one reference is given, or the reference is missing, damaged or from another scan.
    """
    if sum(given is not None for given in (dataset, truth, volume_ml, pictures)) != 1:
        raise UserError(
            "the comparison needs exactly one reference: give a simulated dataset, the mesh of the scanned part (--truth), "
            "its volume (--volume-ml), or pictures that the reconstruction did not use (--pictures)"
        )
    if pictures is not None:
        _choose("auto")
        from rhizotwin.scoring.score_pictures import score_pictures

        with watch(monitor, {"score": 1.0}) as bar:
            return score_pictures(result, pictures, monitor=bar)
    with watch(monitor, {"score": 1.0}) as bar, bar.stage("score"):
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
    monitor: Progress = None,
) -> FileScore:
    """Compute the errors of another program's output file with respect to the ground truth of a simulated dataset.

    Parameters
    ----------
    file : path
        File to score, in the canister frame, mm (GLB: metres, y up).
    dataset : Dataset or path
        Simulated dataset or its folder.
    kind : {"mesh", "voxels", "points", "rsml", "traits"}
        Type of the file's content.
    registered : bool
        Rotate and translate a mesh to fit the ground truth before the comparison.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    FileScore
        Errors of the file.

    Raises
    ------
    UserError
        If the file is missing, damaged or of another type, or the dataset has no ground truth.
    """
    from rhizotwin.scoring import score_file as of

    if registered and kind != "mesh":
        raise UserError(f"--registered can be used with meshes only, but the type of {file} is {kind}; remove --registered")
    with watch(monitor, {"score": 1.0}) as bar, bar.stage("score"):
        if kind == "mesh":
            return of.score_mesh(file, dataset, registered=registered)
        return {"voxels": of.score_voxels, "points": of.score_points, "rsml": of.score_rsml, "traits": of.score_traits}[kind](file, dataset)


def _changed(scene: Scene, changes: SceneChanges) -> Scene:
    """Return a copy of a scene with the given changes."""
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    if "specimen" in given:
        given["specimen"] = Path(given["specimen"])
    return scene_changes.change_scene(scene, arguments.SceneChanges(**given))


def _score_part(result: Result | str | Path, file: Path) -> SolidScore:
    """Compute the errors of a result with respect to the mesh of a part whose shape is known.

    The mesh is first registered to the result.
    """
    from rhizotwin.recon.results.parts import Mesh
    from rhizotwin.scoring.score_solid import score_solid
    from rhizotwin.sim import meshes, solids

    solid, notes = meshes.load_solid(file)
    for note in notes:
        log.info(note)
    vertices, faces = solids.to_surface(solid)
    shape = Mesh(vertices_mm=vertices, faces=faces.astype("int64"))
    return score_solid(result, shape, volume_mm3=float(solid.volume()))


def _guarded(result: reconstructed.Result) -> Result:
    """Return a copy of the result that is saved with its report, and displayed in notebooks as a table."""
    from rhizotwin.report import notebook
    from rhizotwin.steps.illustrated import Result

    return replace(Result.of(result), notebook=notebook.html)


def _choose(device: Device) -> None:
    """Start the compute engine if it is not running on the requested device, and log the selected device."""
    chosen = engine.ensure(device)
    if chosen is not None:
        log.info(chosen)
