"""Command `rhizotwin report`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.scenes.figures import FigureFormat
from rhizotwin.steps.arguments import Flag, Progress, output, with_metavar
from rhizotwin.steps.results import write_report


def report(
    results: Annotated[list[Path], with_metavar("RESULT")],
    /,
    *,
    page: Annotated[Path | None, output("FILE")] = None,
    figures: Flag = False,
    figure_format: FigureFormat = "png",
    dataset: Annotated[Path | None, with_metavar("DATASET")] = None,
    progress: Progress = Progress(),
) -> None:
    """Write the report of a result again, or one report for several results.

    The report is a single HTML file that can be opened without an internet connection. It contains the volume with its
    90 % interval and reliability, the shape in 3D, pictures with the outline of the reconstruction, the traits, and a
    description of the method. By default it is written to report.html in the result folder.

    Parameters
    ----------
    results : list of Path
        Result folders, or folders that contain results, such as the output of 'rhizotwin batch'.
    page : Path, optional
        HTML file to write; required for several results.
    figures : bool
        Also draw figures for documents, 7 inches wide, in the folder pictures of the result and in the report: centre
        lines, pictures above their silhouettes, and the comparison with the true roots of a simulated dataset.
    figure_format : str
        File format of these figures: png, svg or pdf.
    dataset : Path, optional
        Dataset of one result; needed only if its folder was moved.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin report my_result --figures --figure-format pdf
    rhizotwin report day_1 day_2 day_3 -o plant.html
    """
    with progress.bar(page=1.0) as bar, bar.stage("page"):
        written = write_report(list(results), page, dataset=dataset, figures=figure_format if figures else None)
    print(f"wrote {written} ({written.stat().st_size / 1e6:.1f} MB); open it in a browser")
