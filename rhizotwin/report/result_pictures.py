"""Write the figures of a result to its folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from rhizotwin.report import sides, words
from rhizotwin.report.report_data import ReportData
from rhizotwin.scenes import atomic
from rhizotwin.scenes.figures import FigureFormat, encode
from rhizotwin.stored import result_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 250
"""Resolution of the figures, dots per inch, at which a figure is as wide as a large screen."""


def write_pictures(report: ReportData, *, figures: FigureFormat | None = None) -> list[Path]:
    """Write the picture of a result's shape to its folder (``pictures/shape.png``), and the figures if requested.

    Parameters
    ----------
    report : ReportData
        Result, with its dataset if figures are requested.
    figures : {"png", "svg", "pdf"}, optional
        Also write figures for documents in this format: the roots by order and diameter (``roots``), pictures of the
        dataset above their silhouettes (``inputs``), and for simulated data the comparison with the true shape
        (``shape_and_truth``). Pictures of the dataset that cannot be read are left out.

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
    if figures is not None:
        drawn |= {f"{name}.{figures}": encode(one, figures, dpi=DPI) for name, one in _figures(report).items() if one is not None}
    folder = report.folder / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in drawn.items():
        atomic.write_bytes(folder / name, data)
    return [folder / name for name in drawn]


def _figures(report: ReportData) -> "Mapping[str, Figure | None]":
    """Draw the figures for documents, keyed by name."""
    from rhizotwin.report import figures  # loads matplotlib

    drawn = {"roots": figures.roots_close_up(report.roots) if report.roots else None}
    if report.dataset is None:
        return drawn
    drawn["inputs"] = figures.inputs_and_silhouettes(report.summary, report.folder, report.dataset)
    truth_mesh = report.dataset.folder / "truth" / "specimen.ply"
    if truth_mesh.is_file():
        truth = result_files.read_mesh(truth_mesh)
        drawn["shape_and_truth"] = figures.shape_and_truth(report.full_surface, truth, title=words.title(report.name))
    return drawn
