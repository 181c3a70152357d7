"""Python interface for the display of results: ``rt.plot`` and ``rt.view`` of `import rhizotwin as rt`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.calls import dataset_folder, require_each, result_folder
from rhizotwin.steps.front_door import load_result
from rhizotwin.viewer import private_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.stored.save import Result
    from rhizotwin.viewer.app import Viewer


Colouring = Literal["order", "diameter", "depth", "uncertainty", "tip visibility"]


def plot(result: Result | str | Path, *, by: Colouring = "order") -> Figure:
    """Draw the reconstructed surface from the front and from the side.

    Parameters
    ----------
    result : Result or path
        Result, or folder of a saved result.
    by : {"order", "diameter", "depth", "uncertainty", "tip visibility"}
        Root property that determines the colour of the surface around each root.

    Returns
    -------
    matplotlib.figure.Figure
        Figure with both drawings; notebooks display it, and its method ``savefig`` writes it to a file.
    """
    from rhizotwin.report import figures, words
    from rhizotwin.scenes.figures import png

    loaded = load_result(result) if isinstance(result, str | Path) else result
    if not len(loaded.solid.surface.faces):
        raise UserError(f"the result of {loaded.scene} has no surface to plot")
    drawn: Any = figures.shape_close_up(loaded.solid.surface, loaded.roots, by=by)
    drawn.suptitle(words.title(loaded.scene), fontsize=figures.TEXT_PT, parse_math=False)
    drawn._repr_png_ = lambda: png(drawn, dpi=90)  # notebooks need this method for figures that pyplot did not create
    return drawn


class View:
    """Viewer that is running, with its address and a method to stop it."""

    def __init__(self, viewer: Viewer, temporary: ExitStack) -> None:
        self._viewer, self._temporary = viewer, temporary
        self.address: str = viewer.served.address

    def close(self) -> None:
        """Stop the viewer. Unsaved corrections are lost."""
        self._viewer.served.stop()
        self._temporary.close()

    def __repr__(self) -> str:
        """Return a short description that contains the address of the viewer."""
        return f"View at {self.address}"

    def _repr_html_(self) -> str:
        """Return the address as an HTML link, for notebooks."""
        return f'<a href="{self.address}" target="_blank">{self.address}</a>'


def view(
    result: Result | str | Path | Sequence[Result | str | Path],
    dataset: Dataset | str | Path | None = None,
    *,
    port: int = 8080,
    open_browser: bool = True,
) -> View:
    """Show results with their pictures in a browser, where they can be corrected manually.

    Parameters
    ----------
    result : Result, path, or sequence of these
        One or more results or result folders; the page shows one result at a time. Corrections can be saved only in
        result folders.
    dataset : Dataset or path, optional
        Dataset with the pictures; default: the dataset recorded in the result.
    port : int
        Port of the page; if the port is in use, the next free port is used.
    open_browser : bool
        Open the page in a browser.

    Returns
    -------
    View
        Running viewer; keep a reference to it while the page is in use.
    """
    from rhizotwin.viewer import app

    with ExitStack() as stack:
        given = require_each("result", result, "Result", "path")
        folders = [stack.enter_context(result_folder(item)) for item in given]
        temporary = [folder for folder, item in zip(folders, given, strict=True) if not isinstance(item, str | Path)]
        shown = View(app.start(folders, dataset_folder(dataset), temporary=temporary, port=port), stack.pop_all())
    if open_browser:
        private_page.open_page(shown.address)
    return shown
