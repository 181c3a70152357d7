"""Export of a catalogue's tables as CSV, and read-only SQL queries."""

import sqlite3
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.catalogue import schema
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.trait_table import csv_text

VIEWS = {
    "plants": "SELECT p.name AS plant, p.species, coalesce(t.name, '') AS treatment, p.replicate, p.sown, p.phantom,"
    " p.dictionary AS tag_dictionary, p.first_id AS tag_first_id, p.markers AS tag_markers, coalesce(s.content, '') AS solution, p.notes"
    " FROM plants p LEFT JOIN treatments t ON t.id = p.treatment LEFT JOIN solutions s ON s.id = p.solution ORDER BY p.name",
    "scans": "SELECT coalesce(p.name, '') AS plant, x.day, x.date, x.path, x.pictures, x.complete, x.sketch, x.scene, x.sha256"
    " FROM scans x LEFT JOIN scan_plants sp ON sp.scan = x.id LEFT JOIN plants p ON p.id = sp.plant ORDER BY x.day, x.path, p.name",
    "results": "SELECT x.path, s.path AS scan, x.day, x.date, x.trusted, x.corrected, e.path AS edits, x.program, x.verdict, x.sha256"
    " FROM results x LEFT JOIN scans s ON s.id = x.scan LEFT JOIN edits e ON e.result = x.id ORDER BY x.day, x.path",
    "traits": "SELECT x.path AS result, coalesce(p.name, '') AS plant, coalesce(t.name, '') AS treatment, x.day, r.name AS trait,"
    " r.value, r.low, r.high, r.verdict FROM traits r JOIN results x ON x.id = r.result LEFT JOIN plants p ON p.id = r.plant"
    " LEFT JOIN treatments t ON t.id = p.treatment ORDER BY p.name, x.day, x.path, r.rowid",
    "rig_numbers": "SELECT x.path AS result, x.day, x.date, n.name, n.value FROM rig_numbers n JOIN results x ON x.id = n.result"
    " ORDER BY x.day, x.path, n.name",
    "masses": "SELECT p.name AS plant, m.day, m.kind, m.grams, t.path AS source FROM masses m JOIN plants p ON p.id = m.plant"
    " JOIN tables t ON t.id = m.source ORDER BY p.name, m.day, m.kind",
    "readings": "SELECT p.name AS plant, r.day, r.renewed, r.quantity, r.value, r.sd, r.unit, t.path AS source FROM readings r"
    " JOIN plants p ON p.id = r.plant JOIN tables t ON t.id = r.source ORDER BY p.name, r.day, r.renewed, r.id",
    "visits": "SELECT p.name AS plant, v.due_utc, v.state, v.began_utc, v.ended_utc, coalesce(s.path, '') AS scan, v.note"
    " FROM visits v JOIN plants p ON p.id = v.plant LEFT JOIN scans s ON s.id = v.scan ORDER BY v.due_utc, v.id",
}
"""SQL statement of each exported table. The statement replaces the row numbers of plants and results by their names or
paths. The first column of a table is the plant or the result."""
ALLOWED = frozenset({sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE})
"""SQLite actions that a user's query may perform. They exclude changes to the catalogue, access to other files, and
changes to settings."""
MOST_ROWS = 100_000
"""Maximum number of rows that a query may return."""
MOST_BYTES = 100_000_000
"""Maximum amount of text that a query may return, in bytes. It limits the memory of the query."""
LIMITS = {sqlite3.SQLITE_LIMIT_LENGTH: 1_000_000, sqlite3.SQLITE_LIMIT_LIKE_PATTERN_LENGTH: 1000}
"""Maximum length of a value and of a LIKE pattern in a query, in bytes. A LIKE comparison cannot be interrupted, and
its duration is proportional to the product of both lengths."""
MOST_S = 60.0
"""Maximum duration of a query, in seconds. It ends queries that would not end by themselves, such as an infinite
recursion."""
_STEPS = 10_000


@dataclass(frozen=True, kw_only=True)
class Table:
    """Result of a query."""

    head: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def csv(self) -> str:
        """Return the table as CSV text, with empty cells for missing values."""
        return csv_text([list(self.head), *([_cell(value) for value in row] for row in self.rows)])


def table(catalogue: Catalogue, name: str, *, plant: str | None = None) -> Table:
    """Return a table of a catalogue.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    name : str
        Name of the table, a key of `VIEWS`.
    plant : str or None
        Name of a plant to which the rows are restricted. The tables ``results`` and ``rig_numbers`` are restricted to
        results that have traits of the plant.
    """
    head, rows = catalogue.select(VIEWS[name])
    if plant is not None and "plant" in head:
        rows = [row for row in rows if row["plant"] == plant]
    elif plant is not None:
        results = {catalogue.stored_path(one.path) for one in catalogue.results(plant=plant)}
        rows = [row for row in rows if row[0] in results]
    return Table(head=head, rows=tuple(tuple(row) for row in rows))


def query(catalogue: Catalogue, sql: str, values: Sequence[Any] = ()) -> Table:
    """Run a user's SELECT statement, which can neither change the catalogue nor open other files.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    sql : str
        Single SQL statement.
    values : sequence
        Values that are bound to the question marks in the statement.

    Raises
    ------
    UserError
        If the statement is invalid, is not read-only, takes too long, or returns too much data.
    """
    with catalogue.lock:
        try:
            return _guarded(catalogue.connection, sql, values)
        except schema.ERRORS as error:
            if schema.is_damage(error):
                raise schema.explained(error, catalogue.path) from error
            raise UserError(f"the query is invalid: {printable(str(error))}") from None


def export(catalogue: Catalogue, folder: Path) -> list[Path]:
    """Write each table as a CSV file to a new folder, and return the paths of the files.

    Raises
    ------
    UserError
        If the folder is not empty or cannot be written.
    """
    with new_folder(folder) as building:
        for name in VIEWS:
            atomic.write_text(building / f"{name}.csv", table(catalogue, name).csv())
    return [folder / f"{name}.csv" for name in VIEWS]


def _guarded(connection: sqlite3.Connection, sql: str, values: Sequence[Any]) -> Table:
    """Run a statement with restricted permissions.

    The duration of the statement and the size of its result are limited.
    """
    begin = time.monotonic()
    before = {limit: connection.setlimit(limit, most) for limit, most in LIMITS.items()}
    connection.set_authorizer(lambda action, *_: sqlite3.SQLITE_OK if action in ALLOWED else sqlite3.SQLITE_DENY)
    connection.set_progress_handler(lambda: int(time.monotonic() - begin > MOST_S), _STEPS)
    try:
        cursor = connection.execute(sql, values)
        rows = []
        size = 0
        for row in cursor:
            rows.append(tuple(row))
            size += sum(len(value) for value in row if isinstance(value, str | bytes))
            if len(rows) > MOST_ROWS or size > MOST_BYTES:
                raise UserError(f"the query returns more than {MOST_ROWS} rows or {MOST_BYTES // 10**6} MB; select less data")
        return Table(head=tuple(column[0] for column in cursor.description or ()), rows=tuple(rows))
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", None)
        if code == sqlite3.SQLITE_AUTH or str(error) == "not authorized":  # load_extension has the error code of a wrong statement
            raise UserError("the query must only read the catalogue; use a SELECT statement") from None
        if code == sqlite3.SQLITE_INTERRUPT:
            raise UserError(f"the query was stopped after {MOST_S:g} s; select less data") from None
        raise
    except (ValueError, OverflowError, sqlite3.Warning) as error:
        if isinstance(error, UnicodeDecodeError):
            raise
        raise UserError(f"the query is invalid: {error}") from None
    finally:
        connection.set_authorizer(None)
        connection.set_progress_handler(None, 0)
        for limit, most in before.items():
            connection.setlimit(limit, most)


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
