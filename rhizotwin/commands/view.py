"""Command `rhizotwin view`."""

import time
from pathlib import Path
from typing import Annotated

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import check_readable
from rhizotwin.scenes.formatting import count, was
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import Page, with_metavar


def view(
    paths: Annotated[list[Path], with_metavar("RESULT")],
    /,
    *,
    page: Page = Page(),
) -> None:
    """Inspect and correct results in a browser.

    The viewer shows roots, surface, voxels, canister and cameras in 3D, and the pictures with the projected
    reconstruction. Corrections can be undone, and are saved to edits.json in the result folder without changing the
    result itself. Of several results, such as the days of one plant, one can be selected at a time. The page can be
    opened only with the complete printed address. Press Ctrl-C to stop.

    Parameters
    ----------
    paths : list of Path
        Result folders, written by 'rhizotwin reconstruct', and the dataset if its folder was moved.
    page : Page
        Address of the page.

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
        raise UserError(f"{strange[0]} is neither a result nor a dataset; give a folder written by 'rhizotwin reconstruct'")
    if not results or len(datasets) > 1:
        raise UserError(
            f"{count(len(results), 'result')} and {count(len(datasets), 'dataset')} given; give at least one result and at most one dataset"
        )
    from rhizotwin.viewer import guard

    served = guard.serve(host=page.host, port=page.port)
    command_steps.open_page(served.address, served.port, page)  # the browser starts while the results are read
    from rhizotwin.viewer import app

    viewer = app.show(served, results, datasets[0] if datasets else None)
    print("press Ctrl-C to stop", flush=True)
    try:
        while served.is_running:
            time.sleep(1.0)
        raise RuntimeError("the web server of the viewer has ended")
    finally:
        if lost := viewer.unsaved():
            print(f"{count(lost, 'correction')} {was(lost)} not saved", flush=True)
