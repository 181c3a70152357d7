"""List the plants, scans, results and masses of an experiment in one file.

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
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rhizotwin.arguments import Flag, OutputFolder, SceneName, list_of, option, output, read_date, read_integer, with_metavar
from rhizotwin.commands.phantom import WIRES_MM, read_wire_mm
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable

if TYPE_CHECKING:
    from rhizotwin.catalogue.adding import Added
    from rhizotwin.catalogue.export import Table

CatalogueFile = Annotated[Path, with_metavar("CATALOGUE")]
Sources = Annotated[list[Path], with_metavar("FOLDERS")]
Name = Literal["plants", "scans", "results", "traits", "rig_numbers", "masses", "visits"]
WIDEST = 48
"""Most characters of a cell in a terminal."""


def add(catalogue: CatalogueFile, folders: Sources, /) -> None:
    """Add datasets, results and tables of masses to a catalogue.

    The catalogue is created if there is none. Folders are searched at any depth. The files stay where they are: the
    catalogue holds their paths, relative to its own folder if they are below it, and their SHA-256. Plants and
    treatments come from the datasets. Entries that exist are updated.

    Parameters
    ----------
    catalogue : Path
        The catalogue, a file that ends in .rhizotwin.
    folders : list of Path
        Datasets, results, tables of masses (.csv), or folders that contain any of these.

    Examples
    --------
    rhizotwin catalogue add my.rhizotwin my_scans my_results my_masses.csv
    """
    from rhizotwin.catalogue.adding import add_all
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.open_or_create(catalogue) as opened:
        _report(catalogue, add_all(opened, folders))


def plant(
    catalogue: CatalogueFile,
    name: Annotated[str, with_metavar("NAME")],
    /,
    *,
    canister: Annotated[int | None, option(lambda text: read_integer(text, 1, 500, "give 1 to 500"), "N")] = None,
    scene: SceneName | None = None,
    species: Annotated[str, with_metavar("NAME")] = "",
    treatment: Annotated[str, with_metavar("NAME")] = "",
    sown: Annotated[str, option(read_date, "DATE")] = "",
    replicate: Annotated[int | None, option(lambda text: read_integer(text, 0, 1000000, "give 0 or a positive whole number"), "N")] = None,
) -> None:
    """Add a plant to a catalogue, with the number of its canister.

    'rhizotwin scan --catalogue' then recognises it by the strip. The plants of a time-lapse experiment are added by
    'rhizotwin timelapse run'.

    Parameters
    ----------
    catalogue : Path
        The catalogue; created if there is none.
    name : str
        Name of the plant, the same on every day.
    canister : int, optional
        Number of its strip, as 'rhizotwin markers SCENE --labels N' writes it; needs --scene.
    scene : str, optional
        Scene of the rig, with the strip.
    species : str
        Latin name, such as 'Raphanus sativus'.
    treatment : str
        Treatment, for example 'low N'.
    sown : str
        Sowing date, such as 2026-11-26.
    replicate : int, optional
        Which of the plants that were treated alike.

    Examples
    --------
    rhizotwin catalogue plant my.rhizotwin P3 --canister 3 --scene my_scene.toml --treatment control --sown 2026-11-26
    """
    from rhizotwin.catalogue.identity import strip_for_canister
    from rhizotwin.catalogue.records import Plant, Tag
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.scenes.files import load_scene

    if (canister is None) != (scene is None):
        raise UserError("--canister and --scene belong together: the scene has the strip whose numbers are used")
    tag = None if canister is None or scene is None else Tag.of_strip(strip_for_canister(load_scene(scene).strip, canister))
    with Catalogue.open_or_create(catalogue) as opened:
        opened.add_plant(Plant(name=name, species=species, treatment=treatment, sown=sown, replicate=replicate, tag=tag))
    print(f"{catalogue}: plant {name}{f', {tag}' if tag else ''}")


def rebuild(catalogue: CatalogueFile, folders: Sources, /) -> None:
    """Create a catalogue again from its datasets, results and tables of masses.

    For a catalogue that was lost or damaged. Plants that were never scanned, and scans that were planned or missed,
    are not in the datasets: the next 'rhizotwin timelapse run' adds them. Strips that were used for one plant only
    become that plant's tag.

    Parameters
    ----------
    catalogue : Path
        The catalogue to create; must not exist yet.
    folders : list of Path
        Datasets, results, tables of masses (.csv), or folders that contain any of these.

    Examples
    --------
    rhizotwin catalogue rebuild my_new.rhizotwin my_scans my_results my_masses.csv
    """
    from rhizotwin.catalogue.adding import add_all, set_tags
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.create(catalogue) as opened:
        made = add_all(opened, folders)
        if tagged := set_tags(opened):
            print(f"tags from the strips of the scans: {', '.join(tagged)}")
        _report(catalogue, made)


def list_(
    catalogue: CatalogueFile,
    table: Annotated[Name | None, with_metavar("TABLE")] = None,
    /,
    *,
    plant: Annotated[str | None, with_metavar("NAME")] = None,
    csv: Annotated[Path | None, output("FILE")] = None,
) -> None:
    """List a table of a catalogue, or the number of entries of each.

    Parameters
    ----------
    catalogue : Path
        The catalogue.
    table : str, optional
        plants, scans, results, traits, rig_numbers, masses, or visits, which are the scans that a time-lapse
        experiment plans; default: the number of entries of each.
    plant : str, optional
        Rows of this plant only.
    csv : Path, optional
        Table to write (.csv); must not exist yet.

    Examples
    --------
    rhizotwin catalogue list my.rhizotwin
    rhizotwin catalogue list my.rhizotwin plants
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
            raise UserError("name the table to write, for example: rhizotwin catalogue list CATALOGUE traits -o FILE")
        for name in exported.VIEWS:
            print(f"{name:<12} {len(exported.table(opened, name, plant=plant).rows)}")


def query(
    catalogue: CatalogueFile, sql: Annotated[str, with_metavar("SQL")], /, *, csv: Annotated[Path | None, output("FILE")] = None
) -> None:
    """Run a SELECT statement on a catalogue.

    A catalogue is a SQLite file; docs/catalogue.md describes its tables. Statements that do more than read are refused.

    Parameters
    ----------
    catalogue : Path
        The catalogue.
    sql : str
        The statement, in quotes.
    csv : Path, optional
        Table to write (.csv); must not exist yet.

    Examples
    --------
    rhizotwin catalogue query my.rhizotwin "SELECT path, day FROM scans WHERE complete = 0"
    """
    from rhizotwin.catalogue import export as exported
    from rhizotwin.catalogue.store import Catalogue

    with Catalogue.open(catalogue, read_only=True) as opened:
        _show(exported.query(opened, sql), csv)


def check(catalogue: CatalogueFile, /, *, quick: Flag = False) -> int:
    """Compare a catalogue with its files: missing, changed, damaged and unlisted ones.

    The exit code is 1 if anything differs.

    Parameters
    ----------
    catalogue : Path
        The catalogue.
    quick : bool
        Do not read the pictures, only see that they are there.

    Examples
    --------
    rhizotwin catalogue check my.rhizotwin
    """
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.catalogue.verify import check as compare

    with Catalogue.open(catalogue, read_only=True) as opened:
        problems = compare(opened, pictures=not quick)
        entries = len(opened.scans()) + len(opened.results()) + len(opened.mass_tables())
    for one in problems:
        print(f"{one.kind:<10} {one.path}: {one.text}")
    counted = f"{len(problems)} {'difference' if len(problems) == 1 else 'differences'}"
    print(f"{catalogue}: {entries} datasets, results and tables, {counted if problems else 'no difference'}")
    return int(bool(problems))


def export(catalogue: CatalogueFile, /, *, output: OutputFolder) -> None:
    """Write every table of a catalogue as CSV.

    Parameters
    ----------
    catalogue : Path
        The catalogue.
    output : Path
        Folder to make.

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
    """Write a page with the plants, the scans that were missed, and control charts of the rig.

    Each number of the rig that a reconstruction measures (focal length, tilt of the canister, blur, table, attenuation,
    ...) is drawn over time with control limits, so that a change of the rig is seen before it changes a result.

    Parameters
    ----------
    catalogue : Path
        The catalogue.
    output : Path
        Folder to make: catalogue.html and drift.csv.
    phantom : str, optional
        Name of a wire phantom, listed as a plant: the section of each of its wires is drawn as well.
    wires_mm : tuple of float
        Diameters of its wires.

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
    """Print the number of entries, and the sentences of those that could not be added."""
    for sentence in made.failed:
        print(f"not added: {sentence}")
    print(f"{catalogue}: {len(made.scans)} datasets, {len(made.results)} results and {len(made.tables)} tables of masses added")
    if made.failed:
        raise UserError(f"{len(made.failed)} could not be added to {catalogue}; see the lines above")


def _show(table: "Table", csv: Path | None) -> None:
    """Print a table with aligned columns, or write it as CSV."""
    from rhizotwin.scenes import atomic

    if csv is not None:
        if csv.suffix.lower() != ".csv" or csv.exists():
            raise UserError(f"{csv} {'already exists; choose another name' if csv.exists() else 'must end in .csv'}")
        atomic.write_text(csv, table.csv(), new=True)
        print(f"wrote {len(table.rows)} rows to {csv}")
        return
    rows: list[Sequence[str]] = [table.head, *([_cell(value) for value in row] for row in table.rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(table.head))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    print(f"{len(table.rows)} row{'' if len(table.rows) == 1 else 's'}")


def _cell(value: object) -> str:
    text = "-" if value is None or value == "" else f"{value:.6g}" if isinstance(value, float) else printable(str(value))
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."
