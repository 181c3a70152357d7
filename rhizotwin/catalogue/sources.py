"""A catalogue in place of folders: the datasets, results and tables of masses that it lists."""

from collections.abc import Sequence
from pathlib import Path

from rhizotwin.catalogue.schema import SUFFIX
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes.errors import UserError


def is_catalogue(path: Path | str) -> bool:
    """Return whether a path is named like a catalogue and is no folder."""
    return str(path).endswith(SUFFIX) and "://" not in str(path) and not Path(path).is_dir()


def expand_scans(sources: Sequence[str]) -> list[str]:
    """Return the sources of a batch with each catalogue replaced by its complete scans; sketches are left out.

    Raises
    ------
    UserError
        If a catalogue has no scan that can be reconstructed.
    """
    found: list[str] = []
    for source in sources:
        if not is_catalogue(source):
            found.append(source)
            continue
        with Catalogue.open(source, read_only=True) as catalogue:
            scans = [str(one.path) for one in catalogue.scans() if one.complete and not one.sketch]
        if not scans:
            raise UserError(f"{source}: has no complete scan that can be reconstructed")
        found += scans
    return found


def expand_results(sources: Sequence[Path], *, masses: bool = False, phantoms: bool = True) -> list[Path]:
    """Return sources with each catalogue replaced by its results.

    Parameters
    ----------
    sources : sequence of Path
        Results, folders of results, tables and catalogues.
    masses : bool
        Whether the tables of masses are added.
    phantoms : bool
        Whether results of phantoms are among them.

    Raises
    ------
    UserError
        If a catalogue has no results, or, with ``masses``, no tables of masses either.
    """
    found: list[Path] = []
    for source in sources:
        if not is_catalogue(source):
            found.append(source)
            continue
        with Catalogue.open(source, read_only=True) as catalogue:
            hidden = set() if phantoms else {one.name for one in catalogue.plants() if one.phantom}
            own = [one.path for one in catalogue.chosen_results() if not hidden.intersection(one.plants)]
            own += catalogue.mass_tables() if masses else []
        if not own:
            raise UserError(f"{source}: has no results{' and no masses' if masses else ''}; add some with `rhizotwin catalogue add`")
        found += own
    return found


def mass_tables(source: Path) -> list[Path]:
    """Return the tables of masses of a catalogue.

    Raises
    ------
    UserError
        If it has none.
    """
    with Catalogue.open(source, read_only=True) as catalogue:
        found = catalogue.mass_tables()
    if not found:
        raise UserError(f"{source}: has no masses; add a table with `rhizotwin catalogue add`")
    return found
