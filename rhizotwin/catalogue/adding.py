"""Import of datasets, results, and tables of masses and of the nutrient solution into a catalogue."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.catalogue.store import Catalogue, now_utc
from rhizotwin.experiment import drift, measured
from rhizotwin.experiment.masses import BALANCE_G, Weighed, has_masses, read_masses
from rhizotwin.experiment.readings import Reading, has_readings, merge, read_readings, unit_of
from rhizotwin.scenes.dataset import Dataset, file_sha256, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.table_file import read_table
from rhizotwin.stored import result_files

EDITS = "edits.json"


@dataclass(frozen=True, kw_only=True)
class Added:
    """Files and folders that were added to a catalogue, and failures."""

    scans: tuple[Path, ...]
    results: tuple[Path, ...]
    tables: tuple[Path, ...]
    failed: tuple[str, ...]
    """Message for each dataset, result or table that could not be added."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """Datasets, results, and tables of masses or of the nutrient solution that were found in folders."""

    scans: tuple[Path, ...]
    results: tuple[Path, ...]
    tables: tuple[Path, ...]


def find_all(sources: Sequence[Path]) -> Found:
    """Find datasets, results and tables (.csv). Folders are searched with all their subfolders.

    Raises
    ------
    UserError
        If a source is missing, or contains nothing that can be added to a catalogue.
    """
    found = [_find(source) for source in sources]
    scans, results, tables = (tuple(dict.fromkeys(chain(*(kinds[k] for kinds in found)))) for k in range(3))
    return Found(scans=scans, results=results, tables=tables)


def find_unlisted(catalogue: Catalogue, *folders: Path) -> Found:
    """Find the datasets and results in folders that are not in a catalogue, or have changed since they were added.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    folders : paths
        Folders of datasets and results, without their subfolders.
    """
    listed = {one.path.resolve(): one.sha256 for one in catalogue.scans()}
    listed |= {one.path.resolve(): one.sha256 for one in catalogue.results()}

    def is_new(head: Path) -> bool:
        try:
            return listed.get(head.parent.resolve()) != file_sha256(head)
        except UserError:  # reported when it is added
            return True

    def new(name: str) -> tuple[Path, ...]:
        heads = sorted(path for folder in folders for path in folder.glob(f"[!.]*/{name}"))
        return tuple(head.parent for head in heads if not head.is_symlink() and not head.parent.is_symlink() and is_new(head))

    return Found(scans=new("dataset.json"), results=new("result.json"), tables=())


def add_all(catalogue: Catalogue, found: Found) -> Added:
    """Add datasets, results and tables to a catalogue.

    Entries that already exist are updated. A damaged file does not prevent other files from being added. Datasets are
    added before results, because the brightness of the panel in a scan is stored with the result.
    """
    done: list[list[Path]] = [[], [], []]
    failed = []
    for number, (add, paths) in enumerate(((add_scan, found.scans), (add_result, found.results), (add_table, found.tables))):
        for path in paths:
            try:
                add(catalogue, path)
                done[number].append(path)
            except UserError as error:
                failed.append(str(error))
    return Added(scans=tuple(done[0]), results=tuple(done[1]), tables=tuple(done[2]), failed=tuple(failed))


def add_scan(catalogue: Catalogue, folder: Path) -> None:
    """Add a dataset and its plants to a catalogue, or update the existing entry.

    Raises
    ------
    UserError
        If the dataset is damaged, or inconsistent with the catalogue.
    """
    _insert_scan(catalogue, load_dataset(folder))


def add_result(catalogue: Catalogue, folder: Path) -> None:
    """Add a result to a catalogue, or update its entry.

    Its traits, rig parameters and log of corrections are added too.

    Raises
    ------
    UserError
        If the result is damaged, or inconsistent with the catalogue.
    """
    summary = result_files.read_summary(folder)
    digest = file_sha256(folder / "result.json")
    found = measured.read_all([folder])
    with catalogue.writing() as connection:
        for one in found:
            _add_subject(catalogue, one.subject)
        path = catalogue.stored_path(folder)
        dataset = str(summary.get("dataset_sha256") or "")
        scan = catalogue.rows("SELECT id, path FROM scans WHERE sha256 = ? AND ? <> '' ORDER BY id", (dataset, dataset))
        whose = found[0].subject if found else Subject()
        values = (
            *(path, digest, scan[0][0] if scan else None, dataset, whose.day, whose.date, int(bool(summary["volume_trusted"]))),
            *(str(summary["volume_verdict"]), int(bool(summary.get("edits"))), _program(summary), now_utc()),
        )
        connection.execute("DELETE FROM results WHERE path = ?", (path,))
        number = connection.execute(
            "INSERT INTO results (path, sha256, scan, dataset_sha256, day, date, trusted, verdict, corrected, program, added_utc)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            values,
        ).lastrowid
        for one in found:
            _insert_traits(catalogue, number, one)
        numbers = drift.rig_numbers(summary)
        if numbers and scan:
            numbers |= _panel_level(catalogue.full_path(scan[0][1]))
        connection.executemany("INSERT INTO rig_numbers VALUES (?, ?, ?)", [(number, name, value) for name, value in numbers.items()])
        if (folder / EDITS).is_file():
            edits = (number, catalogue.stored_path(folder / EDITS), file_sha256(folder / EDITS))
            connection.execute("INSERT INTO edits (result, path, sha256) VALUES (?, ?, ?)", edits)


def add_table(catalogue: Catalogue, table: Path) -> None:
    """Add a table of masses or of the nutrient solution, or replace the values that were imported earlier from it.

    Raises
    ------
    UserError
        If the table is damaged, or another table contains the same value.
    """
    head = read_table(table)[0].cells
    if not _is_table(table):
        raise UserError(f"{table} contains neither masses nor readings of a nutrient solution; add a column such as root_fresh_g or pH")
    weighed = read_masses(table, balance_g=BALANCE_G) if has_masses(head) else []
    readings = merge(read_readings(table)) if has_readings(head) else []
    with catalogue.writing() as connection:
        path = catalogue.stored_path(table)
        connection.execute("DELETE FROM tables WHERE path = ?", (path,))
        source = connection.execute("INSERT INTO tables (path, sha256) VALUES (?, ?)", (path, file_sha256(table))).lastrowid
        entries: list[Weighed | Reading] = [*weighed, *readings]
        for one in entries:
            _add_subject(catalogue, one.subject)
            plant = _plant_id(catalogue, one.subject.plant)
            if isinstance(one, Weighed):
                _insert_masses(catalogue, one, plant, source)
            else:
                _insert_reading(catalogue, one, plant, source)


def _insert_masses(catalogue: Catalogue, one: Weighed, plant: int, source: int | None) -> None:
    for kind, grams in one.grams.items():
        before = catalogue.rows(
            "SELECT t.path FROM masses m JOIN tables t ON t.id = m.source"
            " WHERE m.plant = ? AND coalesce(m.day, -1.0) = coalesce(?, -1.0) AND m.kind = ?",
            (plant, one.subject.day, kind),
        )
        _refuse_second(before, one, f"mass {kind}")
        values = (plant, one.subject.day, kind, grams, source)
        catalogue.connection.execute("INSERT INTO masses (plant, day, kind, grams, source) VALUES (?, ?, ?, ?, ?)", values)


def _insert_reading(catalogue: Catalogue, one: Reading, plant: int, source: int | None) -> None:
    for quantity, value in one.values.items():
        key = (plant, one.subject.day, one.renewed, quantity)
        before = catalogue.rows(
            "SELECT t.path FROM readings r JOIN tables t ON t.id = r.source WHERE (plant, day, renewed, quantity) = (?, ?, ?, ?)", key
        )
        _refuse_second(before, one, quantity)
        catalogue.connection.execute(
            "INSERT INTO readings (plant, day, renewed, quantity, unit, value, sd, source) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (*key, unit_of(quantity), value, one.sds.get(quantity), source),
        )


def _refuse_second(before: Sequence[Any], one: Weighed | Reading, what: str) -> None:
    """Raise an error if a value is already in another table."""
    if before:
        raise UserError(f"{one.where}: the {what} of plant {one.subject.plant} is also in {before[0][0]}; remove it from one table")


def set_tags(catalogue: Catalogue) -> list[str]:
    """Set the tags of plants that have none, from the marker strips in their scans.

    A strip that was used for several plants is ignored.

    Returns
    -------
    list of str
        Names of the plants whose tag was set.
    """
    used: dict[Tag, set[str]] = {}
    for scan in catalogue.scans():
        try:
            tag = Tag.of_strip(load_dataset(scan.path).scene.strip)
        except UserError:
            continue
        if tag is not None and len(scan.plants) == 1:
            used.setdefault(tag, set()).update(scan.plants)
    found = []
    for tag, names in used.items():
        (name, *others) = sorted(names)
        clash = any(tag.overlaps(other) for other in used if other != tag)
        if not others and not clash and catalogue.plant(name).tag is None and sum(name in group for group in used.values()) == 1:
            catalogue.add_plant(Plant(name=name, tag=tag))
            found.append(name)
    return found


def is_complete(origin: Mapping[str, Any]) -> bool:
    """Return whether no picture of a dataset with this origin is missing, as only scans record."""
    return origin.get("complete", True) is True


def is_sketch(origin: Mapping[str, Any]) -> bool:
    """Return whether the pictures of a dataset of this origin are sketches, which do not show the plant."""
    settings = origin.get("settings")
    twin = settings.get("twin") if isinstance(settings, dict) else None
    return isinstance(twin, dict) and twin.get("fidelity") == "sketch"


def _find(source: Path) -> tuple[list[Path], list[Path], list[Path]]:
    """Find the datasets, results and tables at a path and in all its subfolders."""
    if source.suffix.lower() == ".csv":
        return [], [], [source]
    if not source.is_dir():
        raise UserError(f"{source}: the folder or table (.csv) does not exist; check the path")
    heads = sorted(path for name in ("dataset.json", "result.json") for path in source.rglob(name) if not _is_hidden(path, source))
    tables = sorted(path for path in source.rglob("*.csv") if not _is_hidden(path, source) and _is_table(path))
    scans = [path.parent for path in heads if path.name == "dataset.json"]
    results = [path.parent for path in heads if path.name == "result.json"]
    if not (scans or results or tables):
        raise UserError(
            f"{source}: the folder contains no dataset, no result and no table of masses or of the nutrient solution; check the path"
        )
    return scans, results, tables


def _is_hidden(path: Path, source: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(source).parts)


def _is_table(path: Path) -> bool:
    try:
        head = read_table(path)[0].cells
        return has_masses(head) or has_readings(head)
    except UserError:
        return False


def _insert_scan(catalogue: Catalogue, dataset: Dataset) -> None:
    scene = dataset.scene
    whose = [one.subject(scene.subject) for one in scene.plants] or [scene.subject]
    with catalogue.writing() as connection:
        for one in whose:
            _add_subject(catalogue, one)
        path = catalogue.stored_path(dataset.folder)
        complete = is_complete(dataset.origin)
        values = (
            *(path, dataset.sha256, scene.name, scene.subject.day, scene.subject.date, catalogue.solution_id(scene.solution)),
            *(len(dataset.frames), int(complete), int(is_sketch(dataset.origin)), now_utc()),
        )
        connection.execute(
            "INSERT INTO scans (path, sha256, scene, day, date, solution, pictures, complete, sketch, added_utc)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (path) DO UPDATE SET sha256 = excluded.sha256, scene = excluded.scene,"
            " day = excluded.day, date = excluded.date, solution = excluded.solution, pictures = excluded.pictures,"
            " complete = excluded.complete, sketch = excluded.sketch",
            values,
        )
        scan = catalogue.scan_id(dataset.folder)
        connection.execute("UPDATE results SET scan = ? WHERE dataset_sha256 = ?", (scan, dataset.sha256))
        connection.execute("DELETE FROM scan_plants WHERE scan = ?", (scan,))
        for one in whose:
            if one.plant:
                connection.execute("INSERT INTO scan_plants VALUES (?, ?)", (scan, _plant_id(catalogue, one.plant)))


def _add_subject(catalogue: Catalogue, one: Subject) -> None:
    """Add the plant of a dataset, result or mass to the catalogue.

    If the plant already exists, only missing data are added to its entry.
    """
    if one.plant:
        catalogue.add_plant(Plant(name=one.plant, species=one.species, treatment=one.treatment, replicate=one.replicate))


def _plant_id(catalogue: Catalogue, name: str) -> int:
    return int(catalogue.rows("SELECT id FROM plants WHERE name = ?", (name,))[0][0])


def _insert_traits(catalogue: Catalogue, result: int | None, one: measured.Measured) -> None:
    plant = _plant_id(catalogue, one.subject.plant) if one.subject.plant else None
    rows: Iterable[Sequence[Any]] = (
        (result, plant, name, value, *(one.assessment(name).interval or (None, None)), one.assessment(name).verdict)
        for name, value in one.traits.items()
    )
    catalogue.connection.executemany("INSERT INTO traits VALUES (?, ?, ?, ?, ?, ?, ?)", rows)


def _panel_level(scan: Path) -> dict[str, float]:
    """Return the brightness of the panel in the pictures of a scan.

    The result is empty if the pictures cannot be read.
    """
    try:
        level = drift.panel_level(load_dataset(scan))
    except UserError:
        return {}
    return {} if level is None else {"panel_level": level}


def _program(summary: dict[str, Any]) -> str:
    versions = summary.get("versions")
    return str(versions.get("rhizotwin", "")) if isinstance(versions, dict) else ""
