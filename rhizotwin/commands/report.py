"""Command `rhizotwin report`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import recover
from rhizotwin.steps.arguments import Flag, Progress, output, with_metavar


def report(
    results: Annotated[list[Path], with_metavar("RESULT")],
    /,
    *,
    page: Annotated[Path | None, output("FILE")] = None,
    figures: Flag = False,
    dataset: Annotated[Path | None, with_metavar("DATASET")] = None,
    progress: Progress = Progress(),
) -> None:
    """Write the report of a result again, or one report for several results.

    The report is a single HTML file that can be opened without an internet connection. It contains the volume with its
    90 % interval and reliability, recommendations, the shape in 3D, the pictures with the outline of the
    reconstruction, the traits, and a description of the method. By default it is written to report.html in the result
    folder.

    Parameters
    ----------
    results : list of Path
        Result folders, or folders that contain results, such as the output of 'rhizotwin batch'.
    page : Path, optional
        HTML file to write; required for more than one result.
    figures : bool
        Also draw figures for documents as PNG files in the folder pictures of the result: centre lines by diameter and
        order, pictures above their silhouettes, and for a simulated dataset the comparison with the true roots. The
        report contains them, too.
    dataset : Path, optional
        Dataset of the result; needed only if its folder was moved. Can be used with one result only.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin report my_result
    rhizotwin report my_result --figures
    rhizotwin report day_1 day_2 day_3 -o plant.html
    """
    if page is None or figures:
        recover(results[0])
    from rhizotwin.stored import result_files

    results = result_files.results_in(results)
    if page is None and len(results) > 1:
        raise UserError("a report of several results needs a file name; add -o FILE.html")
    for option, given in {"--dataset": dataset is not None, "--figures": figures}.items():
        if given and len(results) > 1:
            raise UserError(f"{option} can be used with one result only; remove {option}")
    from rhizotwin.report import page as pages
    from rhizotwin.report.report_data import ReportData
    from rhizotwin.report.result_pictures import write_pictures

    with progress.bar(page=1.0) as bar, bar.stage("page"):
        if len(results) == 1:
            found = ReportData.read(results[0], dataset)
            if figures:
                write_pictures(found, figures=True)
            written = pages.write(found, output=page)
        elif page is not None:
            written = pages.write_many(results, page)
    print(f"wrote {written} ({written.stat().st_size / 1e6:.1f} MB); open it in a browser")
