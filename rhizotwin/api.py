"""Python interface for picture import, batches, growth curves, biomass, export, publication, benchmarks and scans.

`import rhizotwin as rt` provides these functions as ``rt.import_pictures``, ``rt.batch``, ``rt.growth``,
``rt.biomass``, ``rt.export``, ``rt.publish``, ``rt.benchmark`` and ``rt.scan``. Text that the command of the same name
prints is logged.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.steps.calls import Progress, dataset_folder, require_each, result_folder, watch
from rhizotwin.steps.front_door import Device, load_scene
from rhizotwin.steps.results import Paths, read_table

if TYPE_CHECKING:
    from rhizotwin.experiment.biomass import Model
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.stored.save import Result

log = logging.getLogger("rhizotwin")

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
        Folder of pictures (PNG, JPG, TIFF or DNG), which are read in the natural order of their names.
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


def batch(
    datasets: Paths,
    output: str | Path,
    *,
    voxel_mm: float | None = None,
    settings: str | Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    device: Device = "auto",
) -> Any:
    """Reconstruct many datasets.

    Datasets that an earlier call has already reconstructed are not reconstructed again.

    Parameters
    ----------
    datasets : path or sequence of path
        Datasets, folders of datasets, or patterns such as ``scans/day_*``.
    output : path
        Folder for the results, ``traits.csv`` and ``overview.html``.
    voxel_mm : float, optional
        Edge length of the smallest voxels, mm.
    settings : path, optional
        File with settings of the reconstruction (TOML).
    workers : int, optional
        Number of worker processes; default: number of processors, limited by the available memory.
    cluster : str, optional
        Address of a Dask scheduler, or ``slurm`` to start the workers as Slurm jobs.
    device : {"auto", "cpu", "cuda"}
        Device for the computation.

    Returns
    -------
    pandas.DataFrame
        Content of ``traits.csv``, one row per result.

    Raises
    ------
    UserError
        If an argument is invalid, or, after all other datasets were reconstructed, if the reconstruction of one failed.
    """
    from rhizotwin.batches.places import is_address
    from rhizotwin.commands.batch import Workforce
    from rhizotwin.commands.batch import batch as run

    scans = [str(path) for path in _paths("datasets", datasets)]
    if is_address(str(output)):
        raise UserError(f"output must be a folder, not the address {output}; use the command: rhizotwin batch")
    work = Workforce(workers=workers, cluster=cluster, device=device)
    with _logged():
        run(scans, output=str(output), voxel_mm=voxel_mm, settings=None if settings is None else Path(settings), work=work)
    return read_table(Path(output) / "traits.csv")


def growth(results: Paths, output: str | Path) -> dict[str, Any]:
    """Compute growth curves of plants and roots from scans of several days, and compare treatments.

    Parameters
    ----------
    results : path or sequence of path
        Results, folders of results, trait tables (.csv), or tables of masses or of the nutrient solution (.csv).
    output : path
        New or empty folder for the tables, the figures and the page ``growth.html``.

    Returns
    -------
    dict of str to pandas.DataFrame
        Tables by name: ``traits``, ``roots``, ``treatments``, and further tables that depend on the data.
    """
    paths = _existing("results", results)
    from rhizotwin.commands.growth import growth as run

    with _logged():
        run(paths, output=Path(output))
    return {path.stem: read_table(path) for path in sorted(Path(output).glob("*.csv"))}


def biomass(results: Paths, *, masses: str | Path | None = None, model: str | Path | None = None, output: str | Path) -> Model | Any:
    """Fit a model of plant mass to weighed plants, or predict the mass of plants with a fitted model.

    Exactly one of ``masses`` and ``model`` must be given.

    Parameters
    ----------
    results : path or sequence of path
        Results, folders of results, or trait tables (.csv).
    masses : path, optional
        Table of weighed masses (.csv), to which a model is fitted.
    model : path, optional
        Fitted model (.json), with which masses are predicted.
    output : path
        Output file: the fitted model (.json) or the table of predicted masses (.csv).

    Returns
    -------
    Model or pandas.DataFrame
        Fitted model, or predicted masses with 90 % intervals.
    """
    if (masses is None) == (model is None):
        raise UserError("exactly one of masses and model is needed; give masses to fit a model, or model to predict masses")
    paths = _existing("results", results)
    from rhizotwin.commands import biomass as commands

    with _logged():
        if masses is not None:
            commands.fit([*paths, Path(masses)], output=Path(output))
        else:
            commands.predict(paths, model=Path(str(model)), table=Path(output))
    if model is not None:
        return read_table(Path(output))
    from rhizotwin.experiment import model_file

    return model_file.load_model(Path(output))


def export(
    result: Result | str | Path,
    output: str | Path,
    *,
    dataset: Dataset | str | Path | None = None,
    roots: Literal["order", "diameter"] | None = None,
    undistorted: bool = False,
    rays: bool = False,
    monitor: Progress = None,
) -> list[Path]:
    """Write a result in a file format of other programs.

    The suffix of ``output`` selects the format.

    Parameters
    ----------
    result : Result or path
        Result, or folder of a saved result.
    output : path
        Output file with the suffix .ply, .stl or .glb (closed surface), .nrrd (voxels), .rsml (centre lines),
        .csv (traits) or .json (cameras for nerfstudio), or output folder (cameras for COLMAP).
    dataset : Dataset or path, optional
        Dataset of the result; required for the export of cameras.
    roots : {"order", "diameter"}, optional
        Mesh formats only: write the roots as tubes, coloured by this property.
    undistorted : bool
        Write the pictures with refraction removed, and their cameras, to the folder ``output``.
    rays : bool
        Write the line of sight in the water of each pixel to the folder ``output``.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    list of Path
        Written files.
    """
    from rhizotwin.exporter import exports

    pictures = dataset_folder(dataset)
    refraction = exports.choose(undistorted=undistorted, rays=rays)
    with watch(monitor, {"pictures": 1.0}) as bar, result_folder(result) as source:
        return exports.export(source, Path(output), dataset_folder=pictures, roots=roots, refraction=refraction, monitor=bar)


def publish(sources: Paths, output: str | Path, *, study: str | Path, monitor: Progress = None) -> Path:
    """Copy datasets and results to a folder for a data repository, with metadata and checksums.

    Parameters
    ----------
    sources : path or sequence of path
        Datasets and results, or folders of these.
    output : path
        New or empty folder for the publication.
    study : path
        File (TOML) with title, description, licence and authors, see `docs/publishing.md`.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    Path
        Folder of the publication.
    """
    from rhizotwin.publishing.publish import publish as write
    from rhizotwin.publishing.study import read_study

    paths, described = _paths("sources", sources), read_study(Path(study))
    with watch(monitor, {"copy": 1.0}) as bar:
        for note in write(paths, Path(output), described, monitor=bar):
            log.info(note)
    return Path(output)


def benchmark(
    name: str,
    folder: str | Path,
    *,
    method: str,
    output: str | Path,
    cases: Sequence[str] = (),
    cameras: Literal["estimated", "true"] = "estimated",
    device: Device = "auto",
) -> Any:
    """Run a method on each case of a benchmark, and score its output.

    Datasets that are missing in ``folder`` are rendered first. Cases that an earlier call has finished are not
    repeated.

    Parameters
    ----------
    name : str
        Name of the benchmark, see ``rhizotwin bench list``.
    folder : path
        Folder for the datasets of the benchmark.
    method : str
        Command line of the method, in which ``{dataset}`` and ``{output}`` are replaced by folders, or ``ours``,
        ``thesis``, ``regularised`` or ``hull``.
    output : path
        File for the results (JSON).
    cases : sequence of str
        Names of the cases; default: all.
    cameras : {"estimated", "true"}
        Cameras in the method's input: estimated from the markers, or those of the simulation.
    device : {"auto", "cpu", "cuda"}
        Device for the computation.

    Returns
    -------
    pandas.DataFrame
        One row per case, with the state of the run and one column per quantity. Relative errors are fractions.
    """
    import pandas as pd

    from rhizotwin.bench import results
    from rhizotwin.commands import bench as commands
    from rhizotwin.steps.arguments import Computing

    computing = Computing(device=device, quiet=True)
    options = commands.RunOptions(cases=tuple(cases), cameras=cameras)
    with _logged():
        commands.make(name, output=Path(folder), cases=options.cases, computing=computing)
        commands.run(name, Path(folder), method=method, output=Path(output), options=options, computing=computing)
    rows = results.read(Path(output)).rows
    numbers = {case: {one.name: results.value(row, one) for one in results.QUANTITIES} for case, row in rows.items()}
    return pd.DataFrame([{"case": case, "state": row["state"], **numbers[case]} for case, row in rows.items()])


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
    with _logged():
        run(rig=str(rig), output=Path(output), options=options, twin=rigs.TwinPictures(**twin), progress=Bars(quiet=True))
    return load_dataset(output)


def _paths(name: str, given: Any) -> list[Path]:
    return [Path(path) for path in require_each(name, given, "path")]


def _existing(name: str, given: Any) -> list[Path]:
    """Return paths, after it was checked that they exist, before slow libraries are imported."""
    paths = _paths(name, given)
    missing = [path for path in paths if not path.exists()]
    if missing:
        raise UserError(f"{name}: {missing[0]} does not exist; check the path")
    return paths


@contextmanager
def _logged() -> Iterator[None]:
    """Replace the standard output of a command by log messages.

    The output is logged even if the command fails.
    """
    printed = io.StringIO()
    try:
        with redirect_stdout(printed):
            yield
    finally:
        for line in filter(None, printed.getvalue().splitlines()):
            log.info(line)
