"""Write the figures of a result to its folder."""

from pathlib import Path

from matplotlib.figure import Figure

from rhizotwin.report import figures, root_figures
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.figures import png
from rhizotwin.stored import result_files, stored_traits

DPI = 130
"""Resolution of the figures, dots per inch. Characters of 9 pt are 16 pixels high."""


def write_pictures(result_folder: Path, dataset: Path | Dataset, *, truth_mesh: Path | None = None) -> list[Path]:
    """Write the figures of a result to ``pictures/*.png`` in its folder, and return the paths of the files.

    Pictures of the dataset that cannot be read are left out of the figures.

    Parameters
    ----------
    dataset : Path or Dataset
        Dataset of the result, or the dataset's folder.
    truth_mesh : Path or None
        Mesh file of the true shape of simulated data, drawn beside the reconstructed shape (``shape_and_truth.png``).

    Returns
    -------
    list of Path
        Paths of the written files.

    Raises
    ------
    UserError
        If a file is missing, or the dataset is not that of the result.
    """
    result_folder = Path(result_folder)
    summary = result_files.read_summary(result_folder)
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    result_files.check_same_scan(summary["dataset_sha256"], summary["scene"], result_folder, dataset)
    shape = result_files.read_mesh(result_folder / "shape.ply")

    written: list[Path] = []
    inputs = figures.inputs_and_silhouettes(summary, result_folder, dataset)
    if inputs is not None:
        written.append(_save(inputs, result_folder, "inputs.png"))
    written.append(_save(figures.camera_ring(summary, dataset), result_folder, "cameras.png"))
    written.append(_save(figures.shape_near(shape, dataset.scene, title=str(summary["scene"])), result_folder, "shape.png"))
    if truth_mesh is not None:
        truth = result_files.read_mesh(Path(truth_mesh))
        both = figures.shape_and_truth(shape, truth, dataset.scene, title=str(summary["scene"]))
        written.append(_save(both, result_folder, "shape_and_truth.png"))
    roots = result_files.read_roots(result_folder)
    if roots:
        traits = stored_traits.of_summary(summary, shape, roots)
        written.append(_save(root_figures.roots_and_inputs(roots, summary, dataset), result_folder, "roots.png"))
        written.append(_save(root_figures.length_plots(traits), result_folder, "lengths.png"))
    return written


def _save(drawn: Figure, result_folder: Path, name: str) -> Path:
    path = result_folder / "pictures" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic.write_bytes(path, png(drawn, dpi=DPI))
    return path
