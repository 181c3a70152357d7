"""Manage the list of an experiment's plants, scans, results and weighed masses in one file.

A catalogue is a file with the suffix .rhizotwin. Datasets (pictures of a scan), results (reconstructed roots) and mass
tables remain separate files and folders, and the catalogue stores their paths.

Examples
--------
rhizotwin catalogue add my.rhizotwin my_scans my_results my_masses.csv
rhizotwin catalogue plant my.rhizotwin P3 --canister 3 --scene my_scene.toml --treatment control --sown 2026-11-26
rhizotwin catalogue list my.rhizotwin
rhizotwin catalogue list my.rhizotwin scans --plant P3
rhizotwin catalogue query my.rhizotwin "SELECT name, sown FROM plants"
rhizotwin catalogue check my.rhizotwin
rhizotwin catalogue report my.rhizotwin -o my_report
rhizotwin catalogue export my.rhizotwin -o my_tables
rhizotwin catalogue rebuild my_new.rhizotwin my_scans my_results
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from rhizotwin.commands.phantom import WIRES_MM, read_wire_mm
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count, printable
from rhizotwin.steps.arguments import (
    Flag,
    OutputFolder,
    Replicate,
    SceneName,
    check_new_file,
    list_of,
    option,
    output,
    read_date,
    read_integer,
    with_metavar,
)

if TYPE_CHECKING:
    from rhizotwin.catalogue.adding import Added
    from rhizotwin.catalogue.export import Table

CatalogueFile = Annotated[Path, with_metavar("CATALOGUE")]
Sources = Annotated[list[Path], with_metavar("FOLDERS")]
Name = Literal["plants", "scans", "results", "traits", "rig_numbers", "masses", "readings", "visits"]
WIDEST = 48
"""Maximum number of characters of a table cell printed on the terminal."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """Options that describe a plant."""

    species: Annotated[str, with_metavar("NAME")] = ""
    """Species of the plant, such as 'Raphanus sativus'."""
    treatment: Annotated[str, with_metavar("NAME")] = ""
    """Treatment of the plant, such as 'low N'."""
    sown: Annotated[str, option(read_date, "DATE")] = ""
    """Sowing date, such as 2026-11-26."""
    replicate: Replicate | None = None
    """Number of the replicate within its treatment."""


def add(catalogue: CatalogueFile, folders: Sources, /) -> None:
    """Add datasets, results, and tables of masses or of the nutrient solution to a catalogue.

    The catalogue is created if it does not exist. Folders are searched with all their subfolders. Files are not moved;
    the catalogue stores their paths and checksums. Plants and treatments are read from the datasets. Existing entries
    are updated.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin).
    folders : list of Path
        Datasets, results, tables of masses or of the nutrient solution (.csv), or folders that contain any of these.

    Examples
    --------
    rhizotwin catalogue add my.rhizotwin my_scans my_results my_masses.csv
    rhizotwin catalogue add my.rhizotwin my_solution.csv
    """
    from rhizotwin.catalogue.adding import add_all, find_all
    from rhizotwin.catalogue.store import Catalogue

    found = find_all(folders)  # before the file is created, so that a wrong folder leaves no empty catalogue
    with Catalogue.open_or_create(catalogue) as opened:
        _report(catalogue, add_all(opened, found))


def plant(
    catalogue: CatalogueFile,
    name: Annotated[str, with_metavar("NAME")],
    /,
    *,
    canister: Annotated[int | None, option(lambda text: read_integer(text, 1, 500, "give 1 to 500"), "N")] = None,
    scene: SceneName | None = None,
    about: PlantOptions = PlantOptions(),
    replace: Flag = False,
) -> None:
    """Add a plant to a catalogue, with the number of its canister.

    Each canister has a strip of printed markers with different numbers, by which 'rhizotwin scan --catalogue'
    recognises the plant. For a time-lapse experiment this command is not needed, because 'rhizotwin timelapse run' adds
    the plants.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin), which is created if it does not exist.
    name : str
        Name of the plant; use the same name for all scans of the plant.
    canister : int, optional
        Number of the canister's marker strip, printed by 'rhizotwin markers SCENE --labels N'; requires --scene.
    scene : str, optional
        Scene of the rig (name or file), which describes the marker strip.
    about : PlantOptions
        Description of the plant.
    replace : bool
        Replace values of the plant that are already in the catalogue. Datasets keep their values.

    Examples
    --------
    rhizotwin catalogue plant my.rhizotwin P3 --canister 3 --scene my_scene.toml --treatment control --sown 2026-11-26
    rhizotwin catalogue plant my.rhizotwin P3 --treatment "low N" --replace
    """
    from rhizotwin.catalogue.identity import strip_for_canister
    from rhizotwin.catalogue.records import Plant, Tag
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.scenes.files import load_scene

    if (canister is None) != (scene is None):
        raise UserError("--canister and --scene must be given together, because the scene describes the marker strips of the canisters")
    tag = None if canister is None or scene is None else Tag.of_strip(strip_for_canister(load_scene(scene).strip, canister))
    with Catalogue.open_or_create(catalogue) as opened:
        opened.add_plant(Plant(name=name, tag=tag, **vars(about)), replaces=replace)
    print(f"{catalogue}: plant {name}{f', {tag}' if tag else ''}")


def rebuild(catalogue: CatalogueFile, folders: Sources, /) -> None:
    """Create a lost catalogue again from its datasets, results and tables.

    Plants that were never scanned, and scans that were planned or missed, cannot be recovered from these files; the
    next 'rhizotwin timelapse run' adds them. A marker strip that was used for a single plant is assigned to this plant.

    Parameters
    ----------
    catalogue : Path
        Catalogue file to create (.rhizotwin); must not exist yet.
    folders : list of Path
        Datasets, results, tables of masses or of the nutrient solution (.csv), or folders that contain any of these.

    Examples
    --------
    rhizotwin catalogue rebuild my_new.rhizotwin my_scans my_results my_masses.csv
    """
    from rhizotwin.catalogue.adding import add_all, find_all, set_tags
    from rhizotwin.catalogue.store import Catalogue

    found = find_all(folders)  # before the file is created, so that a wrong folder leaves no empty catalogue
    with Catalogue.create(catalogue) as opened:
        made = add_all(opened, found)
        if tagged := set_tags(opened):
            print(f"marker strips were assigned to the plants {', '.join(tagged)}")
        _report(catalogue, made)


def list_(
    catalogue: CatalogueFile,
    table: Annotated[Name | None, with_metavar("TABLE")] = None,
    /,
    *,
    plant: Annotated[str | None, with_metavar("NAME")] = None,
    csv: Annotated[Path | None, output("FILE")] = None,
) -> None:
    """Print a table of a catalogue, or the number of entries in each table.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin).
    table : str, optional
        Table to print: plants, scans, results, traits, rig_numbers (measured parameters of the rig), masses, readings
        (of the nutrient solution), or visits (planned scans of a time-lapse experiment); default: number of entries in
        each table.
    plant : str, optional
        Name of a plant, to which the rows are restricted.
    csv : Path, optional
        CSV file to write instead of printing; must not exist yet.

    Examples
    --------
    rhizotwin catalogue list my.rhizotwin
    rhizotwin catalogue list my.rhizotwin plants
    rhizotwin catalogue list my.rhizotwin readings --plant P3
    rhizotwin catalogue list my.rhizotwin traits --plant P3 -o p3.csv
    """
    from rhizotwin.catalogue import export as exported
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.open(catalogue, read_only=True) as opened:
        if plant is not None:
            opened.plant(plant)
        if table is not None:
            _show(exported.table(opened, table, plant=plant), csv)
            return
        if csv is not None:
            raise UserError("-o needs the name of a table, for example: rhizotwin catalogue list CATALOGUE traits -o FILE")
        for name in exported.VIEWS:
            print(f"{name:<12} {len(exported.table(opened, name, plant=plant).rows)}")


def query(
    catalogue: CatalogueFile, sql: Annotated[str, with_metavar("SQL")], /, *, csv: Annotated[Path | None, output("FILE")] = None
) -> None:
    """Run a read-only SQL query on a catalogue.

    A catalogue is an SQLite database, whose tables are described in docs/catalogue.md. Statements that change the
    catalogue are rejected.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin).
    sql : str
        SELECT statement, in quotes.
    csv : Path, optional
        CSV file to write instead of printing; must not exist yet.

    Examples
    --------
    rhizotwin catalogue query my.rhizotwin "SELECT path, day FROM scans WHERE complete = 0"
    """
    from rhizotwin.catalogue import export as exported
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.open(catalogue, read_only=True) as opened:
        _show(exported.query(opened, sql), csv)


def check(catalogue: CatalogueFile, /, *, quick: Flag = False) -> int:
    """Find files of a catalogue that are missing, changed, damaged or not listed.

    The exit code is 1 if a difference is found.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin).
    quick : bool
        Only check that the pictures exist, without reading them.

    Examples
    --------
    rhizotwin catalogue check my.rhizotwin
    """
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.catalogue.verify import check as compare

    with Catalogue.open(catalogue, read_only=True) as opened:
        problems = compare(opened, pictures=not quick)
        entries = len(opened.scans()) + len(opened.results()) + len(opened.tables())
    for one in problems:
        print(f"{one.kind:<10} {one.path}: {one.text}")
    print(
        f"{catalogue}: {count(entries, 'entry', 'entries')} checked, {count(len(problems), 'difference') if problems else 'no difference'}"
    )
    return int(bool(problems))


def export(catalogue: CatalogueFile, /, *, output: OutputFolder) -> None:
    """Write all tables of a catalogue as CSV files.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin).
    output : Path
        New output folder.

    Examples
    --------
    rhizotwin catalogue export my.rhizotwin -o my_tables
    """
    from rhizotwin.catalogue import export as exported
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.open(catalogue, read_only=True) as opened:
        for path in exported.export(opened, output):
            print(f"wrote {path}")


def report(
    catalogue: CatalogueFile,
    /,
    *,
    output: OutputFolder,
    phantom: Annotated[str | None, with_metavar("NAME")] = None,
    wires_mm: Annotated[tuple[float, ...], option(list_of(read_wire_mm), "MM,MM,...")] = WIRES_MM,
) -> None:
    """Write a page with the plants, missed scans, and control charts of the rig.

    The control charts show the parameters of the rig that each reconstruction measures, such as focal length, tilt of
    the canister, blur and attenuation of the roots. Points outside the control limits reveal a change of the rig before
    it affects results.

    Parameters
    ----------
    catalogue : Path
        Catalogue file (.rhizotwin).
    output : Path
        New output folder for catalogue.html and drift.csv.
    phantom : str, optional
        Name of a wire phantom (copper wires instead of roots) in the list of plants; the measured cross-section of each
        wire is charted as well.
    wires_mm : tuple of float
        Diameters of the phantom's wires in mm, separated by commas.

    Examples
    --------
    rhizotwin catalogue report my.rhizotwin -o my_report
    rhizotwin catalogue report my.rhizotwin -o my_report --phantom wires
    """
    from rhizotwin.catalogue.report import write
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.open(catalogue, read_only=True) as opened:
        for sentence in write(opened, output, phantom=phantom, wires_mm=wires_mm):
            print(sentence)
    print(f"report: {output / 'catalogue.html'}")


def _report(catalogue: Path, made: "Added") -> None:
    """Print the number of added entries, and the messages about entries that could not be added."""
    for sentence in made.failed:
        print(f"not added: {sentence}")
    scans, results, tables = len(made.scans), len(made.results), len(made.tables)
    print(f"{catalogue}: added {count(scans, 'dataset')}, {count(results, 'result')} and {count(tables, 'table')}")
    if made.failed:
        raise UserError(f"{count(len(made.failed), 'entry', 'entries')} could not be added to {catalogue}, for the reasons printed above")


def _show(table: "Table", csv: Path | None) -> None:
    """Print a table with aligned columns, or write it to a CSV file."""
    from rhizotwin.scenes import atomic

    if csv is not None:
        check_new_file(csv, ".csv")
        atomic.write_text(csv, table.csv(), new=True)
        print(f"wrote {count(len(table.rows), 'row')} to {csv}")
        return
    rows: list[Sequence[str]] = [table.head, *([_cell(value) for value in row] for row in table.rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(table.head))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    print(count(len(table.rows), "row"))


def _cell(value: object) -> str:
    text = "-" if value is None or value == "" else f"{value:.6g}" if isinstance(value, float) else printable(str(value))
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."
