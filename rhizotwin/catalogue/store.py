"""Access to a catalogue file: entries are written in transactions, and read as frozen dataclasses."""

import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from rhizotwin.catalogue import plant_rows, schema
from rhizotwin.catalogue.records import Mass, Plant, Scan, StoredResult
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.subject import Subject, check_subject

MOST_LISTED = 5
SCAN_OF_RESULT = "coalesce({0}.scan, nullif({0}.dataset_sha256, ''))"
"""SQL expression that is equal for all results of a scan, also if the scan is not in the catalogue. It is NULL if the
scan is unknown."""


class Catalogue:
    """Open catalogue, for use as a context manager or until `close` is called.

    Each method that writes is a transaction, which is stored on the disk when the method returns. An instance can be
    used by several threads, and a file by several processes.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path.resolve() if path.is_symlink() else path
        """Path of the catalogue file, in which symbolic links are resolved. Stored paths are relative to the folder of
        this file."""
        self.connection = connection
        """Connection to the file. Only the methods of this class should write through it."""
        self.lock = threading.RLock()
        """Lock that a thread must acquire while it uses the connection."""

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = False, busy_s: float = schema.BUSY_S) -> "Catalogue":
        """Open an existing catalogue.

        Parameters
        ----------
        path : path
            Catalogue file.
        read_only : bool
            Reject changes.
        busy_s : float
            Maximum time to wait for another process that is writing to the file, s.

        Raises
        ------
        UserError
            If the file does not exist, is not a catalogue, is damaged, or was written by another version of the
            program.
        """
        path = Path(path)
        return cls(path, schema.open_file(path, read_only=read_only, busy_s=busy_s))

    @classmethod
    def create(cls, path: Path | str) -> "Catalogue":
        """Create an empty catalogue.

        Raises
        ------
        UserError
            If the file already exists, the name does not end with ``.rhizotwin``, or the file cannot be written.
        """
        path = Path(path)
        return cls(path, schema.create(path))

    @classmethod
    def open_or_create(cls, path: Path | str) -> "Catalogue":
        """Open a catalogue, or create an empty one if the file does not exist."""
        path = Path(path)
        return cls(path, schema.create(path, exist_ok=True))

    def close(self) -> None:
        """Close the catalogue file."""
        self.connection.close()

    def __enter__(self) -> "Catalogue":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Begin a transaction, and yield the connection.

        The transaction is rolled back if the block raises an exception.

        Raises
        ------
        UserError
            If SQLite reports an error, such as a full disk.
        """
        with self.lock:
            nested = self.connection.in_transaction
            try:
                if not nested:
                    self.connection.execute("BEGIN IMMEDIATE")
                yield self.connection
                if not nested:
                    self.connection.execute("COMMIT")
            except BaseException as error:
                if not nested and self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                if isinstance(error, schema.ERRORS):
                    raise schema.explained(error, self.path) from error
                raise

    def rows(self, sql: str, values: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """Return the rows of a SELECT statement.

        ``values`` are bound to the placeholders of the statement.

        Raises
        ------
        UserError
            If the file is damaged.
        """
        return self.select(sql, values)[1]

    def select(self, sql: str, values: Sequence[Any] = ()) -> tuple[tuple[str, ...], list[sqlite3.Row]]:
        """Return the column names and the rows of a SELECT statement.

        ``values`` are bound to the placeholders of the statement.
        """
        with self.lock:
            try:
                cursor = self.connection.execute(sql, values)
                return tuple(column[0] for column in cursor.description), cursor.fetchall()
            except schema.ERRORS as error:
                raise schema.explained(error, self.path) from error

    def stored_path(self, path: Path | str) -> str:
        """Convert a path to the form in which it is stored.

        A path below the catalogue's folder is stored relative to this folder, with forward slashes. Any other path is
        stored as an absolute path.
        """
        whole = Path(path).resolve()
        base = self.path.parent.resolve()
        return whole.relative_to(base).as_posix() if whole.is_relative_to(base) and whole != base else whole.as_posix()

    def full_path(self, stored: str) -> Path:
        """Convert a stored path to a path that can be opened from the working folder of this process.

        Raises
        ------
        UserError
            If the stored path contains a null character.
        """
        if "\0" in stored:
            raise schema.damaged(self.path, f"invalid path {stored!r}")
        return self.path.parent / stored

    # plants

    def add_plant(self, plant: Plant, *, replaces: bool = False) -> None:
        """Add a plant, or add missing data to the existing entry.

        Parameters
        ----------
        plant : Plant
            Plant with its known data.
        replaces : bool
            Whether the known data replace those of the existing entry.

        Raises
        ------
        UserError
            If the name is empty, a value differs from the existing entry and is not to be replaced, or the tag overlaps
            with another plant's tag.
        """
        check_subject(Subject(plant=plant.name, species=plant.species, treatment=plant.treatment, notes=plant.notes), self._place(plant))
        check_subject(Subject(date=plant.sown), self._place(plant))
        if not plant.name:
            raise UserError(f"{self.path}: the name of a plant must not be empty")
        with self.writing():
            known = self.plants()
            before = next((one for one in known if one.name == plant.name), None)
            merged = plant if before is None else plant_rows.merge(before, plant, where=str(self.path), replaces=replaces)
            plant_rows.refuse_tag(merged, known, where=str(self.path))
            tag = merged.tag
            values = (
                merged.species,
                self._id_of("treatments", "name", merged.treatment),
                self.solution_id(merged.solution),
                merged.replicate,
                merged.sown,
                merged.notes,
                int(merged.phantom),
                *(("", None, None) if tag is None else (tag.dictionary, tag.first_id, tag.markers)),
                merged.name,
            )
            self.connection.execute("INSERT INTO plants (name) VALUES (?) ON CONFLICT DO NOTHING", (merged.name,))
            self.connection.execute(
                "UPDATE plants SET species = ?, treatment = ?, solution = ?, replicate = ?, sown = ?, notes = ?, phantom = ?,"
                " dictionary = ?, first_id = ?, markers = ? WHERE name = ?",
                values,
            )

    def plants(self) -> list[Plant]:
        """Return all plants, sorted by name."""
        found = self.rows(
            "SELECT p.*, t.name AS treated, s.content FROM plants p LEFT JOIN treatments t ON t.id = p.treatment"
            " LEFT JOIN solutions s ON s.id = p.solution ORDER BY p.name"
        )
        return [plant_rows.plant_of(row, where=str(self.path)) for row in found]

    def plant(self, name: str) -> Plant:
        """Return the plant with the given name.

        Raises
        ------
        UserError
            If the catalogue has no plant with this name.
        """
        known = self.plants()
        for one in known:
            if one.name == name:
                return one
        names = ", ".join(one.name for one in known[:MOST_LISTED]) or "none"
        raise UserError(f"{self.path}: no plant is named {name!r}; known plants: {names}{', ...' if len(known) > MOST_LISTED else ''}")

    # scans, results, masses

    def scans(self, *, plant: str | None = None, treatment: str | None = None, day: float | None = None) -> list[Scan]:
        """Return the scans that match all given criteria, sorted by day and path."""
        where, values = _selection(plant, treatment, day, plants="SELECT plant FROM scan_plants WHERE scan = x.id")
        found = self.rows(f"SELECT * FROM scans x{where} ORDER BY x.day, x.path", values)
        named = self._names("SELECT sp.scan, p.name FROM scan_plants sp JOIN plants p ON p.id = sp.plant ORDER BY p.name")
        return [
            Scan(
                path=self.full_path(row["path"]),
                sha256=row["sha256"],
                plants=named.get(row["id"], ()),
                scene=row["scene"],
                day=row["day"],
                date=row["date"],
                pictures=row["pictures"],
                complete=bool(row["complete"]),
                sketch=bool(row["sketch"]),
            )
            for row in found
        ]

    def results(self, *, plant: str | None = None, treatment: str | None = None, day: float | None = None) -> list[StoredResult]:
        """Return the results that match all given criteria, sorted by day and path."""
        where, values = _selection(plant, treatment, day, plants="SELECT plant FROM traits WHERE result = x.id")
        found = self.rows(
            "SELECT x.*, s.path AS scanned, e.path AS edited FROM results x LEFT JOIN scans s ON s.id = x.scan"
            f" LEFT JOIN edits e ON e.result = x.id{where} ORDER BY x.day, x.path",
            values,
        )
        named = self._names("SELECT DISTINCT t.result, p.name FROM traits t JOIN plants p ON p.id = t.plant ORDER BY p.name")
        numbers: dict[int, dict[str, float]] = {}
        for result, name, value in self.rows("SELECT result, name, value FROM rig_numbers"):
            numbers.setdefault(result, {})[name] = value
        return [
            StoredResult(
                path=self.full_path(row["path"]),
                sha256=row["sha256"],
                scan=None if row["scanned"] is None else self.full_path(row["scanned"]),
                plants=named.get(row["id"], ()),
                day=row["day"],
                trusted=bool(row["trusted"]),
                verdict=row["verdict"],
                corrected=bool(row["corrected"]),
                edits=None if row["edited"] is None else self.full_path(row["edited"]),
                rig_numbers=numbers.get(row["id"], {}),
            )
            for row in found
        ]

    def chosen_results(self) -> list[StoredResult]:
        """Return one result for each scan.

        It is the corrected result that was added last, or the result that was added last if none is corrected.
        """
        rows = self.rows(f"SELECT x.path, {SCAN_OF_RESULT.format('x')} AS scanned FROM results x ORDER BY x.corrected, x.id")
        last = {row["path"] if row["scanned"] is None else row["scanned"]: self.full_path(row["path"]) for row in rows}
        chosen = set(last.values())
        return [one for one in self.results() if one.path in chosen]

    def masses(self, *, plant: str | None = None) -> list[Mass]:
        """Return the weighed masses of all plants or of one plant, sorted by plant, day and kind."""
        found = self.rows(
            "SELECT p.name, m.day, m.kind, m.grams, t.path FROM masses m JOIN plants p ON p.id = m.plant"
            " JOIN tables t ON t.id = m.source WHERE ?1 IS NULL OR p.name = ?1 ORDER BY p.name, m.day, m.kind",
            (plant,),
        )
        return [Mass(plant=name, day=day, kind=kind, grams=grams, source=self.full_path(path)) for name, day, kind, grams, path in found]

    def tables(self, *, masses: bool = False) -> list[Path]:
        """Return the paths of the CSV tables of masses and readings, or only of those with masses."""
        found = self.rows("SELECT path FROM tables WHERE NOT ?1 OR id IN (SELECT source FROM masses) ORDER BY path", (masses,))
        return [self.full_path(row["path"]) for row in found]

    # row numbers

    def scan_id(self, folder: Path) -> int:
        """Return the row number of a dataset.

        Raises
        ------
        UserError
            If the dataset is not in the catalogue.
        """
        found = self.rows("SELECT id FROM scans WHERE path = ?", (self.stored_path(folder),))
        if not found:
            raise UserError(f"{folder}: the dataset is not in {self.path}; add it with `rhizotwin catalogue add`")
        return int(found[0][0])

    def solution_id(self, solution: Solution) -> int | None:
        """Return the row number of a nutrient solution.

        If the solution is new, a row is added. The result is None if the solution is unknown.
        """
        return self._id_of("solutions", "content", plant_rows.solution_text(solution))

    def _place(self, plant: Plant) -> Place:
        return Place(f"{self.path}, plant {plant.name!r}")

    def _id_of(self, table: str, column: str, value: str) -> int | None:
        """Return the row number of a text in a table in which each text occurs once.

        If the text is new, a row is added. The result is None if the text is empty. ``table`` and ``column`` must be
        constants, because they are formatted into the SQL statement.
        """
        if not value:
            return None
        self.connection.execute(f"INSERT INTO {table} ({column}) VALUES (?) ON CONFLICT DO NOTHING", (value,))
        return int(self.connection.execute(f"SELECT id FROM {table} WHERE {column} = ?", (value,)).fetchone()[0])

    def _names(self, sql: str) -> Mapping[int, tuple[str, ...]]:
        found: dict[int, tuple[str, ...]] = {}
        for number, name in self.rows(sql):
            found[number] = (*found.get(number, ()), name)
        return found


def now_utc() -> str:
    """Return the current time as text in the format of the catalogue: UTC, ISO 8601, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _selection(plant: str | None, treatment: str | None, day: float | None, *, plants: str) -> tuple[str, list[Any]]:
    """Return an SQL WHERE clause for the given criteria, and the values to bind to its placeholders.

    ``x`` is the name of the selected row in the statement, and ``plants`` is a SELECT statement that returns the plants
    of this row.
    """
    conditions = []
    values = list[Any]()
    if plant is not None:
        conditions.append(f"EXISTS (SELECT 1 FROM plants p WHERE p.id IN ({plants}) AND p.name = ?)")
        values.append(plant)
    if treatment is not None:
        conditions.append(
            f"EXISTS (SELECT 1 FROM plants p JOIN treatments t ON t.id = p.treatment WHERE p.id IN ({plants}) AND t.name = ?)"
        )
        values.append(treatment)
    if day is not None:
        conditions.append("x.day = ?")
        values.append(day)
    return f" WHERE {' AND '.join(conditions)}" if conditions else "", values
