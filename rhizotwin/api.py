"""Python interface of tasks beyond the single steps: display, import, batches, growth, biomass, export and scans.

`import rhizotwin as rt` provides these functions as ``rt.plot``, ``rt.view``, ``rt.import_pictures``, ``rt.batch``,
``rt.growth``, ``rt.biomass``, ``rt.export`` and ``rt.scan``. What the commands of the same names print is logged.
"""

from __future__ import annotations

import io
import logging
import tempfile
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rhizotwin.calls import Progress, require, watch
from rhizotwin.front_door import Device, load_result, load_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rhizotwin.experiment.biomass import Model
    from rhizotwin.recon.results.result import Result
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.viewer.app import Viewer

log = logging.getLogger("rhizotwin")

Paths = str | Path | Sequence[str | Path]


def plot(result: Result | str | Path, *, by: str = "order") -> Figure:
    """Draw the reconstructed surface from the front and from the side.

    Parameters
    ----------
    result : Result or path
        A result or its folder.
    by : {"order", "diameter", "depth", "uncertainty", "tip visibility"}
        Property of the nearest root that colours the surface.

    Returns
    -------
    matplotlib.figure.Figure
        Notebooks show it; ``savefig`` writes it.
    """
    from rhizotwin import root_colours
    from rhizotwin.report import figures
    from rhizotwin.scenes.figures import png

    require("result", result, "Result", "path")
    if by not in root_colours.CHOICES:
        raise UserError(f"by must be one of {', '.join(root_colours.CHOICES)}, not {by!r}")
    found = load_result(result) if isinstance(result, str | Path) else result
    if not len(found.solid.surface.faces):
        raise UserError(f"the result of {found.scene} has no surface to plot")
    drawn: Any = figures.shape_close_up(found.solid.surface, found.roots, by=by)
    drawn.suptitle(found.scene, fontsize=11)
    drawn._repr_png_ = lambda: png(drawn, dpi=90)  # notebooks show figures that pyplot does not know by this only
    return drawn


class View:
    """A running viewer: its address, and `close` to stop it."""

    def __init__(self, viewer: Viewer, temporary: ExitStack) -> None:
        self._viewer, self._temporary = viewer, temporary
        self.address: str = viewer.served.address

    def close(self) -> None:
        """Stop the viewer; corrections that were not saved are lost."""
        self._viewer.served.stop()
        self._temporary.close()

    def __repr__(self) -> str:
        """Return the address."""
        return f"View at {self.address}"

    def _repr_html_(self) -> str:
        """Return a link for notebooks."""
        return f'<a href="{self.address}" target="_blank">{self.address}</a>'


def view(
    result: Result | str | Path | Sequence[Result | str | Path],
    dataset: Dataset | str | Path | None = None,
    *,
    port: int = 8080,
    open_browser: bool = True,
) -> View:
    """Show results in a browser, with their pictures and tools for corrections.

    Parameters
    ----------
    result : Result, path, or sequence of these
        One result or several, which are shown one after the other.
    dataset : Dataset or path, optional
        Dataset with the pictures; default: the one that the result names.
    port : int
        Port of the page, or the next free one.
    open_browser : bool
        Open a browser window.

    Returns
    -------
    View
        Keep it as long as the page is used.
    """
    from rhizotwin.viewer import app

    require("port", port, "whole number")
    require("dataset", dataset, "Dataset", "path", "None")
    with ExitStack() as stack:
        folders = [stack.enter_context(_saved(one)) for one in _several("result", result, "Result", "path")]
        shown = View(app.start(folders, _folder_of(dataset), port=port), stack.pop_all())
    if open_browser:
        webbrowser.open(shown.address)
    return shown


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
    """Import a folder of pictures as a dataset; choices of the import are logged.

    Parameters
    ----------
    folder : path
        Pictures (PNG, JPG, TIFF or DNG), in the natural order of their names.
    output : path
        Folder of the dataset: new or empty.
    scene : Scene, str or path
        Canister, water, marker strip and camera.
    cameras : path, optional
        Camera poses and lens (transforms.json of nerfstudio), canister frame, mm.
    masks : bool
        The pictures are silhouettes, white root on black; needs ``cameras``.
    no_strip : bool
        There is no marker strip; see `docs/without-markers.md`.
    monitor : Monitor, tqdm class, callable or None
        Progress.
    """
    from rhizotwin import importer

    require("folder", folder, "path")
    require("output", output, "path")
    require("scene", scene, "Scene", "path")
    given = scene if isinstance(scene, Scene) else load_scene(scene)
    with watch(monitor, {"copy": 1.0}) as bar:
        poses = None if cameras is None else Path(cameras)
        made = importer.import_pictures(Path(folder), given, Path(output), cameras=poses, masks=masks, no_strip=no_strip, monitor=bar)
    for note in made.notes:
        log.info(note)
    return made.dataset


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
    """Reconstruct many datasets; finished ones are kept.

    Parameters
    ----------
    datasets : path or sequence of path
        Datasets, folders that contain datasets, or patterns such as ``scans/day_*``.
    output : path
        Folder of the results, with ``traits.csv`` and ``overview.html``.
    voxel_mm : float, optional
        Edge of the smallest voxels.
    settings : path, optional
        Settings file (TOML).
    workers : int, optional
        Number of processes; default: one per processor, limited by memory.
    cluster : str, optional
        Address of a Dask scheduler, or ``slurm``.
    device : {"auto", "cpu", "cuda"}
        Device for the computation.

    Returns
    -------
    pandas.DataFrame
        The content of ``traits.csv``: one row for each result.

    Raises
    ------
    UserError
        If a dataset failed, after all others were reconstructed.
    """
    from rhizotwin.commands.batch import Workforce
    from rhizotwin.commands.batch import batch as run

    scans = [str(path) for path in _paths("datasets", datasets)]
    require("output", output, "path")
    require("voxel_mm", voxel_mm, "number", "None")
    work = Workforce(workers=workers, cluster=cluster, device=device)
    with _logged():
        run(scans, output=str(output), voxel_mm=voxel_mm, settings=None if settings is None else Path(settings), work=work)
    return _table(Path(output) / "traits.csv")


def growth(results: Paths, output: str | Path) -> dict[str, Any]:
    """Track plants and roots over days, and compare treatments.

    Parameters
    ----------
    results : path or sequence of path
        Results, folders of results, tables of traits (.csv), or tables of masses (.csv).
    output : path
        Folder of the tables, figures and the page ``growth.html``: new or empty.

    Returns
    -------
    dict of str to pandas.DataFrame
        The tables by name: ``traits``, ``roots``, ``treatments``, and others where they apply.
    """
    from rhizotwin.commands.growth import growth as run

    require("output", output, "path")
    with _logged():
        run(_paths("results", results), output=Path(output))
    return {path.stem: _table(path) for path in sorted(Path(output).glob("*.csv"))}


def biomass(results: Paths, *, masses: str | Path | None = None, model: str | Path | None = None, output: str | Path) -> Model | Any:
    """Fit a model of plant masses (give ``masses``), or predict masses with it (give ``model``).

    Parameters
    ----------
    results : path or sequence of path
        Results, folders of results, or tables of traits (.csv).
    masses : path, optional
        Table of weighed masses (.csv): fits a model.
    model : path, optional
        A fitted model (.json): predicts masses.
    output : path
        File to write: the model (.json), or the table of predictions (.csv).

    Returns
    -------
    Model or pandas.DataFrame
        The model, or the predictions with 90 % intervals.
    """
    from rhizotwin.commands import biomass as commands

    require("output", output, "path")
    if (masses is None) == (model is None):
        raise UserError("give either masses, to fit a model, or model, to predict masses")
    found = _paths("results", results)
    with _logged():
        if masses is not None:
            commands.fit([*found, Path(masses)], output=Path(output))
        else:
            commands.predict(found, model=Path(str(model)), table=Path(output))
    if model is not None:
        return _table(Path(output))
    from rhizotwin.experiment import model_file

    return model_file.load_model(Path(output))


def export(
    result: Result | str | Path,
    output: str | Path,
    *,
    dataset: Dataset | str | Path | None = None,
    roots: Literal["order", "diameter"] | None = None,
    undistorted: bool = False,
    monitor: Progress = None,
) -> list[Path]:
    """Write a result in the format of another program, chosen by the suffix of ``output``.

    Parameters
    ----------
    result : Result or path
        A result or its folder.
    output : path
        .ply, .stl or .glb (closed surface), .nrrd (voxels), .rsml (centre lines), .csv (traits), .json (cameras for
        nerfstudio), or a folder (cameras for COLMAP).
    dataset : Dataset or path, optional
        Dataset of the result; needed for cameras.
    roots : {"order", "diameter"}, optional
        Mesh formats only: write roots as tubes with these colours.
    undistorted : bool
        Write pictures without refraction to the folder ``output``, with their cameras.
    monitor : Monitor, tqdm class, callable or None
        Progress.

    Returns
    -------
    list of Path
        Files that were written.
    """
    from rhizotwin import exports

    require("result", result, "Result", "path")
    require("output", output, "path")
    require("dataset", dataset, "Dataset", "path", "None")
    folder = _folder_of(dataset)
    with watch(monitor, {"pictures": 1.0}) as bar, _saved(result) as source:
        return exports.export(source, Path(output), dataset_folder=folder, roots=roots, undistorted=undistorted, monitor=bar)


def scan(
    rig: str | Path,
    output: str | Path,
    *,
    scene: str | Path | None = None,
    plan: str | None = None,
    resume: bool = False,
    table_angle_deg: float | None = None,
    **twin: Any,
) -> Dataset:
    """Take the pictures of a plan on a rig, or on the emulated rig.

    Parameters
    ----------
    rig : path or "twin"
        Rig file, or ``"twin"`` for the emulated rig.
    output : path
        Folder of the dataset: new or empty; with ``resume`` that of an interrupted scan.
    scene : str or path, optional
        Scene of the rig; needed for a rig file, default of the emulated rig: ``printed_8ml``.
    plan : str, optional
        File or scene whose rings replace those of the scene.
    resume : bool
        Continue an interrupted scan.
    table_angle_deg : float, optional
        Angle of the turntable, if the markers cannot be read at the start.
    **twin : any
        Emulated rig: ``profile`` (``clean``, ``bench``, ``camera``, ``harsh``, ``real`` or a file; default ``bench``),
        ``seed``, ``fidelity`` (``render``, or ``sketch`` for the marker strip only) and ``device``.
    """
    from rhizotwin import rigs
    from rhizotwin.arguments import Progress as Bars
    from rhizotwin.commands.scan import ScanOptions
    from rhizotwin.commands.scan import scan as run
    from rhizotwin.scenes.dataset import load_dataset

    require("rig", rig, "path")
    require("output", output, "path")
    options = ScanOptions(plan=plan, resume=resume, table_angle_deg=table_angle_deg)
    emulated = rigs.TwinPictures(**twin)
    with _logged():
        run(
            rig=str(rig),
            output=Path(output),
            scene=None if scene is None else str(scene),
            options=options,
            twin=emulated,
            progress=Bars(quiet=True),
        )
    return load_dataset(output)


def _several(name: str, given: Any, *kinds: str) -> list[Any]:
    """Return one value or a sequence of values as a list, each of one of the kinds that `calls.require` knows."""
    several = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    for one in several:
        require(name, one, *kinds)
    if not several:
        raise UserError(f"{name} is empty; give at least one")
    return several


def _paths(name: str, given: Any) -> list[Path]:
    return [Path(path) for path in _several(name, given, "path")]


def _folder_of(dataset: Dataset | str | Path | None) -> Path | None:
    if dataset is None or isinstance(dataset, str | Path):
        return None if dataset is None else Path(dataset)
    return dataset.folder


@contextmanager
def _saved(result: Result | str | Path) -> Iterator[Path]:
    """Provide the folder of a result; one in memory is saved to a temporary folder."""
    if isinstance(result, str | Path):
        yield Path(result)
        return
    with tempfile.TemporaryDirectory(prefix="rhizotwin-result-") as folder:
        result.save(folder)
        yield Path(folder)


@contextmanager
def _logged() -> Iterator[None]:
    """Log the lines that a command prints, also when it fails."""
    printed = io.StringIO()
    try:
        with redirect_stdout(printed):
            yield
    finally:
        for line in filter(None, printed.getvalue().splitlines()):
            log.info(line)


def _table(path: Path) -> Any:
    import pandas as pd

    return pd.read_csv(path)
