"""`rhizotwin report`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import Progress, named, output
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import recover


def report(
    results: Annotated[list[Path], named("RESULT")],
    /,
    *,
    page: Annotated[Path | None, output("FILE")] = None,
    dataset: Annotated[Path | None, named("DATASET")] = None,
    progress: Progress = Progress(),
) -> None:
    """Write the page of a result again, or one page for many results.

    The page is one file with everything inside: the volume with its interval, whether it can be used and what to do,
    the shape in 3D, pictures with the reconstruction's outline, traits, methods. It opens from disk without a network.
    Without -o it becomes report.html in the result's folder.

    Parameters
    ----------
    results : list of Path
        Folders made by 'rhizotwin reconstruct', or that hold some, as of 'rhizotwin batch'.
    page : Path, optional
        Where to write the page; needed for more than one result.
    dataset : Path, optional
        Where the pictures are, if they have moved; for one result.
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin report my_result
    rhizotwin report day_1 day_2 day_3 -o plant.html
    """
    if page is None:
        recover(results[0])
    from rhizotwin.stored import result_files

    results = result_files.results_in(results)
    if page is None and len(results) > 1:
        raise UserError("one page for many results needs a name: give it with -o FILE.html")
    if dataset is not None and len(results) > 1:
        raise UserError("--dataset is for one result; leave it out")
    from rhizotwin.report import page as pages

    with progress.bar(page=1.0) as bar, bar.stage("page"):
        if len(results) == 1:
            written = pages.write(results[0], dataset=dataset, output=page)
        elif page is not None:
            written = pages.write_many(results, page)
    print(f"wrote {written} ({written.stat().st_size / 1e6:.1f} MB); open it in a browser")
