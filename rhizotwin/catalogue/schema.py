"""Tables of a catalogue file, and how such a file is created and opened.

SQLite is used through the standard library. The file carries an application id and the version of its tables. It may
come from anybody: a file whose tables are not exactly those of this program is rejected, so that it has no triggers or
views of its own.
"""

import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from rhizotwin.scenes.errors import UserError

APPLICATION_ID = 0x52485A54
"""``RHZT``, stored in the header of the file."""
VERSION = 1
SUFFIX = ".rhizotwin"
BUSY_S = 30.0
"""Time to wait for another process that writes to the same file."""
OLDEST_SQLITE = (3, 37, 0)
"""STRICT tables were added in this version (https://www.sqlite.org/stricttables.html)."""

TABLES = """
CREATE TABLE treatments (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;
CREATE TABLE solutions (
    id INTEGER PRIMARY KEY,
    content TEXT NOT NULL UNIQUE
) STRICT;
CREATE TABLE plants (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE CHECK (name <> ''),
    species TEXT NOT NULL DEFAULT '',
    treatment INTEGER REFERENCES treatments (id),
    solution INTEGER REFERENCES solutions (id),
    replicate INTEGER,
    sown TEXT NOT NULL DEFAULT '',
    notes TEXT NOT NULL DEFAULT '',
    phantom INTEGER NOT NULL DEFAULT 0 CHECK (phantom IN (0, 1)),
    dictionary TEXT NOT NULL DEFAULT '',
    first_id INTEGER,
    markers INTEGER,
    UNIQUE (dictionary, first_id)
) STRICT;
CREATE TABLE scans (
    id INTEGER PRIMARY KEY,
    path TEXT NOT NULL UNIQUE,
    sha256 TEXT NOT NULL,
    scene TEXT NOT NULL,
    day REAL,
    date TEXT NOT NULL DEFAULT '',
    solution INTEGER REFERENCES solutions (id),
    pictures INTEGER NOT NULL,
    complete INTEGER NOT NULL CHECK (complete IN (0, 1)),
    sketch INTEGER NOT NULL CHECK (sketch IN (0, 1)),
    added_utc TEXT NOT NULL
) STRICT;
CREATE TABLE scan_plants (
    scan INTEGER NOT NULL REFERENCES scans (id) ON DELETE CASCADE,
    plant INTEGER NOT NULL REFERENCES plants (id),
    PRIMARY KEY (scan, plant)
) STRICT, WITHOUT ROWID;
CREATE TABLE results (
    id INTEGER PRIMARY KEY,
    path TEXT NOT NULL UNIQUE,
    sha256 TEXT NOT NULL,
    scan INTEGER REFERENCES scans (id),
    dataset_sha256 TEXT NOT NULL,
    day REAL,
    date TEXT NOT NULL DEFAULT '',
    trusted INTEGER NOT NULL CHECK (trusted IN (0, 1)),
    verdict TEXT NOT NULL,
    corrected INTEGER NOT NULL CHECK (corrected IN (0, 1)),
    program TEXT NOT NULL,
    added_utc TEXT NOT NULL
) STRICT;
CREATE TABLE traits (
    result INTEGER NOT NULL REFERENCES results (id) ON DELETE CASCADE,
    plant INTEGER REFERENCES plants (id),
    name TEXT NOT NULL,
    value REAL NOT NULL,
    low REAL,
    high REAL,
    verdict TEXT NOT NULL,
    UNIQUE (result, plant, name)
) STRICT;
CREATE TABLE rig_numbers (
    result INTEGER NOT NULL REFERENCES results (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    value REAL NOT NULL,
    PRIMARY KEY (result, name)
) STRICT, WITHOUT ROWID;
CREATE TABLE edits (
    id INTEGER PRIMARY KEY,
    result INTEGER NOT NULL UNIQUE REFERENCES results (id) ON DELETE CASCADE,
    path TEXT NOT NULL UNIQUE,
    sha256 TEXT NOT NULL
) STRICT;
CREATE TABLE tables (
    id INTEGER PRIMARY KEY,
    path TEXT NOT NULL UNIQUE,
    sha256 TEXT NOT NULL
) STRICT;
CREATE TABLE masses (
    id INTEGER PRIMARY KEY,
    plant INTEGER NOT NULL REFERENCES plants (id),
    day REAL,
    kind TEXT NOT NULL,
    grams REAL NOT NULL CHECK (grams > 0.0),
    source INTEGER NOT NULL REFERENCES tables (id) ON DELETE CASCADE
) STRICT;
CREATE UNIQUE INDEX masses_of_plant ON masses (plant, coalesce(day, -1.0), kind);
CREATE TABLE visits (
    id INTEGER PRIMARY KEY,
    plant INTEGER NOT NULL REFERENCES plants (id),
    due_utc TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('due', 'scanning', 'scanned', 'missed')),
    began_utc TEXT NOT NULL DEFAULT '',
    ended_utc TEXT NOT NULL DEFAULT '',
    scan INTEGER REFERENCES scans (id),
    note TEXT NOT NULL DEFAULT '',
    UNIQUE (plant, due_utc)
) STRICT;
"""
"""Tables of version 1. Paths are relative to the folder of the catalogue if the file or folder is below it, with
forward slashes, and absolute otherwise. Times are UTC as ISO 8601. ``tables`` holds the CSV files of masses, and
``visits`` the scans that a time-lapse experiment plans."""
_STATEMENTS = [statement for statement in TABLES.split(";") if statement.strip()]


def create(path: Path, *, exist_ok: bool = False) -> sqlite3.Connection:
    """Create a catalogue file with empty tables; a file that a killed run left empty is completed.

    Parameters
    ----------
    path : Path
        The file.
    exist_ok : bool
        Whether a catalogue that exists is opened.

    Raises
    ------
    UserError
        If the file holds anything (with ``exist_ok``, anything but a catalogue), its name does not end in
        ``.rhizotwin``, or it cannot be written.
    """
    if path.exists() and not is_empty(path):
        if exist_ok:
            return open_file(path)
        raise UserError(f"{path} already exists; choose another name")
    if path.suffix != SUFFIX:
        raise UserError(f"{path}: the name of a catalogue must end in {SUFFIX}")
    if not path.parent.is_dir():
        raise UserError(f"{path.parent}: there is no such folder; create it first")
    with _connecting(path) as connection:
        connection.execute("BEGIN IMMEDIATE")
        if not _has_tables(connection):
            for statement in _STATEMENTS:
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.execute("COMMIT")
        _use_write_ahead_log(connection)
    return connection


def is_empty(path: Path) -> bool:
    """Return whether a file is a database without tables, as a run leaves it that was killed while it created one."""
    try:
        with closing(_connect(path)) as connection:
            return not _has_tables(connection)
    except sqlite3.Error:
        return False


def open_file(path: Path, *, read_only: bool = False) -> sqlite3.Connection:
    """Open a catalogue file and check that its tables are those of this program.

    Parameters
    ----------
    path : Path
        The file.
    read_only : bool
        Nothing can be written through the connection.

    Raises
    ------
    UserError
        If there is no such file, it is not a catalogue, is damaged, or was written by another version.
    """
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; create a catalogue with `rhizotwin catalogue add`")
    with _connecting(path) as connection:
        _check(connection, path)
        _use_write_ahead_log(connection)
        if read_only:
            connection.execute("PRAGMA query_only = 1")
    return connection


def explained(error: sqlite3.Error, path: Path) -> UserError:
    """Return a message for an error of SQLite."""
    if "malformed" in str(error) or "not a database" in str(error):
        return damaged(path, error)
    if "locked" in str(error):
        return UserError(f"{path}: another program is writing to it for more than {BUSY_S:g} s; end that program and try again")
    if "no space" in str(error) or "disk is full" in str(error):
        return UserError(f"{path}: the disk is full; free some space and try again")
    return UserError(f"{path}: cannot be used as a catalogue ({error})")


@contextmanager
def _connecting(path: Path) -> Iterator[sqlite3.Connection]:
    """Connect to a file; the connection stays open unless an exception leaves the block."""
    try:
        connection = _connect(path)
        try:
            yield connection
        except BaseException:
            connection.close()
            raise
    except sqlite3.Error as error:
        raise explained(error, path) from error


def damaged(path: Path, reason: object) -> UserError:
    """Return a message for a file that is damaged."""
    return UserError(f"{path}: is damaged or no catalogue ({reason}); create it again with `rhizotwin catalogue rebuild`")


def _connect(path: Path) -> sqlite3.Connection:
    """Connect without a change of the file; each commit is flushed to the disk so that it survives a power cut."""
    if sqlite3.sqlite_version_info < OLDEST_SQLITE:
        oldest = ".".join(str(part) for part in OLDEST_SQLITE)
        raise UserError(f"a catalogue needs SQLite {oldest} or newer, this Python has {sqlite3.sqlite_version}; use another Python")
    connection = sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "foreign_keys = ON", "synchronous = FULL"):
        connection.execute(f"PRAGMA {pragma}")
    connection.row_factory = sqlite3.Row
    return connection


def _use_write_ahead_log(connection: sqlite3.Connection) -> None:
    """Set the mode, which the file keeps; if another process is using a new file, the next opening sets it."""
    with suppress(sqlite3.OperationalError):
        connection.execute("PRAGMA journal_mode = WAL")


def _has_tables(connection: sqlite3.Connection) -> bool:
    return connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0] > 0


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Reject a file of another program, another version, or with other tables."""
    if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise UserError(f"{path}: is a SQLite file, but not a catalogue of rhizotwin")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != VERSION:
        raise UserError(
            f"{path}: has the tables of version {version}, this program reads version {VERSION}; rebuild it or update rhizotwin"
        )
    found = {_normal(row[0]) for row in connection.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL")}
    if found != {_normal(statement) for statement in _STATEMENTS}:
        raise UserError(f"{path}: has other tables than a catalogue of version {VERSION}; rebuild it with `rhizotwin catalogue rebuild`")


def _normal(statement: str) -> str:
    return re.sub(r"\s+", " ", statement).strip()
