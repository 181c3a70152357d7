"""Write the figures of a result to its folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from rhizotwin.report import sides
from rhizotwin.report.report_data import ReportData
from rhizotwin.scenes import atomic
from rhizotwin.stored import result_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 130
"""Resolution of the figures, dots per inch. Characters of 9 pt are 16 pixels high."""


def write_pictures(report: ReportData, *, figures: bool = False) -> list[Path]:
    """Write the picture of a result's shape to its folder (``pictures/shape.png``), and the figures if requested.

    Parameters
    ----------
    report : ReportData
        Result, with its dataset if figures are requested.
    figures : bool
        Also write figures for documents: centre lines by diameter and order (``roots.png``), pictures of the dataset
        above their silhouettes (``inputs.png``), and for simulated data the comparison with the true shape
        (``shape_and_truth.png``). Pictures of the dataset that cannot be read are left out.

    Returns
    -------
    list of Path
        Paths of the written files.

    Raises
    ------
    UserError
        If a file is missing.
    """
    drawn = {}
    if report.renderings:
        drawn["shape.png"] = bytes(cv2.imencode(".png", sides.overview(report.renderings)[..., ::-1])[1])
    if figures:
        drawn |= _figures(report)
    folder = report.folder / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in drawn.items():
        atomic.write_bytes(folder / name, data)
    return [folder / name for name in drawn]


def _figures(report: ReportData) -> dict[str, bytes]:
    """Draw the figures for documents as PNG files, keyed by name."""
    from rhizotwin.report import figures, root_figures  # they load matplotlib

    drawn = {"roots.png": root_figures.draw_roots(report.roots) if report.roots else None}
    if report.dataset is None:
        return _as_png(drawn)
    drawn["inputs.png"] = figures.inputs_and_silhouettes(report.summary, report.folder, report.dataset)
    truth_mesh = report.dataset.folder / "truth" / "specimen.ply"
    if truth_mesh.is_file():
        truth = result_files.read_mesh(truth_mesh)
        drawn["shape_and_truth.png"] = figures.shape_and_truth(report.full_surface, truth, title=str(report.summary["scene"]))
    return _as_png(drawn)


def _as_png(drawn: "Mapping[str, Figure | None]") -> dict[str, bytes]:
    from rhizotwin.scenes.figures import png  # loads matplotlib

    return {name: png(figure, dpi=DPI) for name, figure in drawn.items() if figure is not None}
