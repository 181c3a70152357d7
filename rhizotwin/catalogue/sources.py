"""Replacement of catalogues among the arguments of a command by the datasets, results or tables that they list."""

from collections.abc import Sequence
from pathlib import Path

from rhizotwin.catalogue.schema import SUFFIX
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes.errors import UserError


def is_catalogue(path: Path | str) -> bool:
    """Return whether a path has the suffix of a catalogue and is not a folder or an address."""
    return str(path).endswith(SUFFIX) and "://" not in str(path) and not Path(path).is_dir()


def expand_scans(sources: Sequence[str]) -> list[str]:
    """Replace each catalogue among the sources of a batch by the scans that it lists.

    Interrupted scans are omitted, and so are sketches, which do not show the plant. Other sources are not changed.

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
            raise UserError(
                f"{source}: the catalogue has no complete scan that can be reconstructed; add scans with `rhizotwin catalogue add`"
            )
        found += scans
    return found


def expand_results(sources: Sequence[Path], *, tables: bool = False, phantoms: bool = True) -> list[Path]:
    """Replace each catalogue among the sources by the results that it lists.

    Parameters
    ----------
    sources : sequence of Path
        Results, folders of results, tables and catalogues.
    tables : bool
        Include the tables of masses and of the nutrient solution of catalogues.
    phantoms : bool
        Include the results of phantoms.

    Raises
    ------
    UserError
        If a catalogue has neither results nor requested tables.
    """
    found: list[Path] = []
    for source in sources:
        if not is_catalogue(source):
            found.append(source)
            continue
        with Catalogue.open(source, read_only=True) as catalogue:
            hidden = set() if phantoms else {one.name for one in catalogue.plants() if one.phantom}
            own = [one.path for one in catalogue.chosen_results() if not hidden.intersection(one.plants)]
            own += catalogue.tables() if tables else []
        if not own:
            raise UserError(
                f"{source}: the catalogue has no results{' and no tables' if tables else ''}; add them with `rhizotwin catalogue add`"
            )
        found += own
    return found


def mass_tables(source: Path) -> list[Path]:
    """Return the paths of the mass tables of a catalogue.

    Raises
    ------
    UserError
        If the catalogue has no mass table.
    """
    with Catalogue.open(source, read_only=True) as catalogue:
        found = catalogue.tables(masses=True)
    if not found:
        raise UserError(f"{source}: the catalogue has no masses; add a mass table with `rhizotwin catalogue add`")
    return found
