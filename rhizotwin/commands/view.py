"""`rhizotwin view`."""

import time
from pathlib import Path
from typing import Annotated

from rhizotwin import command_steps
from rhizotwin.arguments import Page, named
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import check_readable


def view(
    paths: Annotated[list[Path], named("RESULT")],
    /,
    *,
    page: Page = Page(),
) -> None:
    """Look at results in a browser, and correct them.

    Roots, surface, voxels, canister and cameras in 3D; the pictures with the reconstruction drawn over them through the
    water; corrections with undo, saved as edits.json beside the result, which stays as it is. Several results are shown
    one after another, such as the days of one plant. Only who has the printed address with its token gets an answer.
    Ctrl-C ends it.

    Parameters
    ----------
    paths : list of Path
        Folders made by 'rhizotwin reconstruct'; a dataset among them is where the pictures are, if they have moved.
    page : Page
        Where the page is served.

    Examples
    --------
    rhizotwin view my_result
    rhizotwin view my_result my_dataset
    rhizotwin view day_1 day_2 day_3
    """
    results = [path for path in paths if (path / "result.json").is_file()]
    datasets = [path for path in paths if path not in results and (path / "dataset.json").is_file()]
    strange = [path for path in paths if path not in results and path not in datasets]
    if strange:
        check_readable(strange[0], deep=False)
        raise UserError(f"{strange[0]} is neither a result nor a dataset; give the folder that `rhizotwin reconstruct` wrote")
    if not results or len(datasets) > 1:
        raise UserError(f"{len(results)} results and {len(datasets)} datasets given; give one result or more, and at most one dataset")
    from rhizotwin.viewer import guard

    served = guard.serve(host=page.host, port=page.port)
    command_steps.open_page(served.address, served.port, page)  # a browser takes as long to begin as the results to be read
    from rhizotwin.viewer import app

    viewer = app.show(served, results, datasets[0] if datasets else None)
    print("Ctrl-C ends it", flush=True)
    try:
        while True:
            time.sleep(1.0)
    finally:
        if lost := viewer.unsaved():
            print(f"not saved: {lost} correction{'s' if lost > 1 else ''}", flush=True)
