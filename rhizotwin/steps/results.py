"""Python interface for saved results, which the command line uses as well.

`import rhizotwin as rt` provides the functions as ``rt.traits``, ``rt.write_report`` and ``rt.edit``.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import recover
from rhizotwin.steps.calls import Progress, dataset_folder, require_each, watch
from rhizotwin.steps.front_door import load_result

if TYPE_CHECKING:
    from rhizotwin.recon.results.parts import Json
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.scenes.traits import Traits
    from rhizotwin.stored.save import Result

Paths = str | Path | Sequence[str | Path]
EDIT_SHARES = {"corrections": 2.0, "measure": 3.0}
"""Relative durations of the stages of `edit`."""
_TEXTS = ("result", "scene", "plant", "species", "treatment", "against", "notes")
"""Columns of tables that contain names, which are text even if they look like a number or a missing value."""


@dataclass(frozen=True)
class ResultTraits:
    """Traits of a saved result."""

    folder: Path
    name: str
    """Name of the result, which is unique among the results of a table."""
    summary: Json
    traits: Traits
    mass_g: float | None
    """Fresh mass of the roots, g, or None if it is unknown."""


def traits(results: Paths, *, mass_g: float | Sequence[float] | None = None) -> Any:
    """Return the traits of saved results as a table.

    The traits of a result in memory are `Result.traits`.

    Parameters
    ----------
    results : path or sequence of path
        Result folders, folders of results, or catalogues (.rhizotwin).
    mass_g : float or sequence of float, optional
        Fresh mass of the roots in each result, g; default: as given to `reconstruct`.

    Returns
    -------
    pandas.DataFrame
        One row per result, or per plant of a shared canister, and one column per trait, followed by intervals, verdicts
        and reasons.

    Raises
    ------
    UserError
        If a result cannot be read, or the number of masses differs from the number of results.
    """
    masses = None if mass_g is None else [float(mass) for mass in ([mass_g] if isinstance(mass_g, int | float) else mass_g)]
    from rhizotwin.stored import stored_traits

    found = read_traits([Path(path) for path in require_each("results", results, "path")], masses)
    return read_table(io.StringIO(stored_traits.spreadsheet([(one.name, one.summary, one.traits) for one in found])))


def read_traits(results: Sequence[Path], mass_g: Sequence[float] | None) -> list[ResultTraits]:
    """Read the traits of results, folders of results and catalogues, with one mass for each result or none."""
    from rhizotwin.catalogue import sources
    from rhizotwin.stored import result_files, result_names, stored_traits

    folders = result_files.results_in(sources.expand_results(results))
    if mass_g is not None and len(mass_g) != len(folders):
        raise UserError(f"--mass-g has {len(mass_g)} values for {len(folders)} results; give one value per result, in the same order")
    given = mass_g or (None,) * len(folders)
    found = []
    for folder, name, mass in zip(folders, result_names.names_of(folders), given, strict=True):
        summary = result_files.read_summary(folder)
        chosen = summary.get("mass_g") if mass is None else mass
        found.append(ResultTraits(folder, name, summary, stored_traits.read(folder, mass_g=chosen), chosen))
    return found


def write_report(
    results: Paths,
    output: str | Path | None = None,
    *,
    dataset: Dataset | str | Path | None = None,
    figures: Literal["png", "svg", "pdf"] | None = None,
) -> Path:
    """Write the report of a saved result, or one report of several results.

    Parameters
    ----------
    results : path or sequence of path
        Result folders, or folders of results.
    output : path, optional
        HTML file; default: ``report.html`` in the folder of a single result.
    dataset : Dataset or path, optional
        Dataset of a single result; required only if its folder was moved.
    figures : {"png", "svg", "pdf"}, optional
        Also write figures for documents in this format to the folder ``pictures`` of a single result.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    UserError
        If a result cannot be read, or the options cannot be used with several results.
    """
    given = [Path(path) for path in require_each("results", results, "path")]
    page = None if output is None else Path(output)
    if page is None or figures is not None:
        recover(given[0])
    from rhizotwin.stored import result_files

    folders = result_files.results_in(given)
    if page is None and len(folders) > 1:
        raise UserError("a report of several results needs a file name; add -o FILE.html")
    for option, is_given in {"--dataset": dataset is not None, "--figures": figures is not None}.items():
        if is_given and len(folders) > 1:
            raise UserError(f"{option} can be used with one result only; remove {option}")
    from rhizotwin.report import page as pages
    from rhizotwin.report.report_data import ReportData
    from rhizotwin.report.result_pictures import write_pictures

    if page is not None and len(folders) > 1:
        return pages.write_many(folders, page)
    found = ReportData.read(folders[0], dataset_folder(dataset))
    if figures is not None:
        write_pictures(found, figures=figures)
    return pages.write(found, output=page)


def edit(
    result: str | Path,
    edits: str | Path,
    output: str | Path,
    *,
    dataset: Dataset | str | Path | None = None,
    monitor: Progress = None,
) -> Result:
    """Apply saved corrections to a saved result, and write the corrected result to another folder.

    Parameters
    ----------
    result : path
        Result folder.
    edits : path
        Corrections that were saved in the viewer (``edits.json`` in the result folder).
    output : path
        Folder for the corrected result: new, empty, or an earlier result, which is replaced.
    dataset : Dataset or path, optional
        Dataset of the result; required only if its folder was moved.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    Result
        Corrected result.

    Raises
    ------
    UserError
        If a folder or the file cannot be used, or the corrections do not belong to the result.
    """
    source, goal = Path(result), Path(output)
    if goal.resolve() == source.resolve():
        raise UserError(f"the corrected result would overwrite the original result {goal}; choose another folder")
    from rhizotwin.stored import save

    save.check_place(goal, source)
    from rhizotwin.corrections import corrected, log, refit
    from rhizotwin.corrections.session import Session
    from rhizotwin.report import page
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.stored import result_files

    made, fit, pictures = log.read(Path(edits), source), None, dataset_folder(dataset)
    if any(entry.do == "fit" for entry in made.edits):
        old = result_files.read_summary(source)
        found = load_dataset(pictures or Path(str(old["dataset"])))
        result_files.check_same_scan(old["dataset_sha256"], old["scene"], source, found)
        fit = refit.fitter(source, found)
    with watch(monitor, EDIT_SHARES) as bar:
        with bar.stage("corrections"):
            session = Session(source, log=made, refit=fit)
        with bar.stage("measure"):
            corrected.write(session, goal, dataset=pictures, last=lambda folder: page.write(folder, dataset=pictures))
    return load_result(goal)


def read_table(file: Path | io.StringIO) -> Any:
    """Read a table (.csv), in which names such as 001 and NA remain text. Empty cells are missing values."""
    import pandas as pd

    table = pd.read_csv(file, dtype=str, keep_default_na=False, na_values=[""])
    for name in table.columns.difference(_TEXTS):
        with suppress(ValueError):  # other columns of text, such as verdicts
            table[name] = pd.to_numeric(table[name])
    return table
