"""Tables of a catalogue file, and functions that create, open and validate the file.

The file is an SQLite database with an application id and a version of its tables. A file from an untrusted source could
contain triggers or views, so a file is rejected unless its tables are exactly those of this program.
"""

import re
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import LEAST_FREE_MIB
from rhizotwin.scenes.formatting import printable

APPLICATION_ID = 0x52485A54
"""SQLite application id (``RHZT``), stored in the header of the file."""
VERSION = 1
SUFFIX = ".rhizotwin"
BUSY_S = 30.0
"""Maximum time, in seconds, to wait for access to a file that another process is writing."""
ERRORS = (sqlite3.Error, UnicodeDecodeError)
"""Errors that damaged files and full disks cause. Python decodes messages of SQLite, which contain text of the file."""
OLDEST_SQLITE = (3, 37, 0)
"""Minimum version of SQLite. STRICT tables were introduced in this version
(https://www.sqlite.org/stricttables.html)."""

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
CREATE TABLE readings (
    id INTEGER PRIMARY KEY,
    plant INTEGER NOT NULL REFERENCES plants (id),
    day REAL NOT NULL,
    renewed INTEGER NOT NULL CHECK (renewed IN (0, 1)),
    quantity TEXT NOT NULL,
    unit TEXT NOT NULL,
    value REAL NOT NULL CHECK (value >= 0.0),
    sd REAL CHECK (sd >= 0.0),
    source INTEGER NOT NULL REFERENCES tables (id) ON DELETE CASCADE,
    UNIQUE (plant, day, renewed, quantity)
) STRICT;
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
"""SQL definition of the tables, version 1.

A path below the folder of the catalogue is stored relative to this folder with forward slashes, and any other path as
an absolute path. Times are UTC (ISO 8601). The table ``tables`` lists the CSV files of masses and of readings of
the nutrient solution, and ``visits`` the planned scans of a time-lapse experiment.
"""
_STATEMENTS = [statement for statement in TABLES.split(";") if statement.strip()]


def create(path: Path, *, exist_ok: bool = False) -> sqlite3.Connection:
    """Create a catalogue file with empty tables, and connect to it.

    An empty file, which remains if an earlier call was killed, is replaced.

    Parameters
    ----------
    path : Path
        File to create.
    exist_ok : bool
        Open the file if it is an existing catalogue.

    Returns
    -------
    sqlite3.Connection
        Connection to the file.

    Raises
    ------
    UserError
        If the file already exists (with ``exist_ok``, if it is not a catalogue), the name does not end in
        ``.rhizotwin``, or the file cannot be written.
    """
    if path.exists() and not is_empty(path):
        if exist_ok or path.is_dir():
            return open_file(path)
        raise UserError(f"{path} already exists; choose another name")
    if path.suffix != SUFFIX:
        raise UserError(f"{path}: the name of a catalogue must end with {SUFFIX}")
    if not path.parent.is_dir():
        raise UserError(f"{path.parent}: the folder does not exist; create the folder first")
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
    """Return whether a file is a database without tables.

    Such a file remains if the program is killed while it creates a catalogue.
    """
    try:
        with closing(_connect(path)) as connection:
            return not _has_tables(connection)
    except ERRORS:
        return False


def open_file(path: Path, *, read_only: bool = False, busy_s: float = BUSY_S) -> sqlite3.Connection:
    """Connect to an existing catalogue file, and check that its tables are those of this program.

    Parameters
    ----------
    path : Path
        Catalogue file.
    read_only : bool
        Reject changes through the connection.
    busy_s : float
        Maximum time to wait for another process that is writing to the file, s.

    Returns
    -------
    sqlite3.Connection
        Connection to the file.

    Raises
    ------
    UserError
        If the file does not exist, is not a catalogue, is damaged, or was written by another version of the program.
    """
    if path.is_dir():
        raise UserError(f"{path} is a folder; give a catalogue file, whose name ends with {SUFFIX}")
    if not path.is_file():
        raise UserError(f"{path}: the file does not exist; create a catalogue with `rhizotwin catalogue add`")
    with _connecting(path, busy_s=busy_s) as connection:
        _check(connection, path)
        _use_write_ahead_log(connection)
        if read_only:
            connection.execute("PRAGMA query_only = 1")
    return connection


def explained(error: Exception, path: Path) -> UserError:
    """Convert one of `ERRORS` to a UserError that advises the user what to do."""
    text = str(error)
    if is_damage(error):
        return damaged(path, printable(text))
    if "locked" in text:
        return UserError(f"{path}: another program has been writing to the file for a long time; end that program and try again")
    if "no space" in text or "is full" in text or _is_full(path):
        return UserError(f"{path}: the disk is full; free some space and try again")
    return UserError(f"{path}: the file cannot be used as a catalogue ({printable(text)}); check the path and its permissions")


def is_damage(error: Exception) -> bool:
    """Return whether an error states that a file is damaged."""
    return isinstance(error, UnicodeDecodeError) or any(words in str(error) for words in ("malformed", "not a database", "decode to UTF-8"))


def _is_full(path: Path) -> bool:
    """Return whether the disk of a file has no free space.

    SQLite then also reports "disk I/O error", if it cannot create its file with the suffix -shm (SQLite 3.40).
    """
    try:
        return shutil.disk_usage(path.parent).free < LEAST_FREE_MIB * 2**20
    except OSError:
        return False


@contextmanager
def _connecting(path: Path, *, busy_s: float = BUSY_S) -> Iterator[sqlite3.Connection]:
    """Connect to a file for a block of statements.

    The connection is closed only if the block raises an exception.
    """
    try:
        connection = _connect(path, busy_s=busy_s)
        try:
            yield connection
        except BaseException:
            connection.close()
            raise
    except ERRORS as error:
        raise explained(error, path) from error


def damaged(path: Path, reason: object) -> UserError:
    """Return a UserError for a damaged catalogue file."""
    return UserError(f"{path}: the file is damaged or not a catalogue ({reason}); create it again with `rhizotwin catalogue rebuild`")


def _connect(path: Path, *, busy_s: float = BUSY_S) -> sqlite3.Connection:
    """Connect to a file without changing it.

    The connection writes each commit to the disk before it continues, so that the data survive a power failure.
    """
    if sqlite3.sqlite_version_info < OLDEST_SQLITE:
        oldest = ".".join(str(part) for part in OLDEST_SQLITE)
        raise UserError(
            f"a catalogue needs SQLite {oldest} or newer, but this Python has version {sqlite3.sqlite_version}; use a newer Python"
        )
    connection = sqlite3.connect(path, timeout=busy_s, isolation_level=None, check_same_thread=False)
    for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "foreign_keys = ON", "synchronous = FULL"):
        connection.execute(f"PRAGMA {pragma}")
    connection.row_factory = sqlite3.Row
    return connection


def _use_write_ahead_log(connection: sqlite3.Connection) -> None:
    """Set the journal mode of the file to WAL (write-ahead log).

    The mode remains unchanged if another process is using the file.
    """
    with suppress(sqlite3.OperationalError):
        connection.execute("PRAGMA journal_mode = WAL")


def _has_tables(connection: sqlite3.Connection) -> bool:
    return connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0] > 0


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Raise UserError if a file was not written by this version of the program, or has different tables."""
    if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise UserError(f"{path}: the file is an SQLite database, but not a catalogue of rhizotwin; give another file")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != VERSION:
        raise UserError(
            f"{path}: the catalogue has version {version}, but this program reads version {VERSION}; "
            "update rhizotwin, or create the catalogue again with `rhizotwin catalogue rebuild`"
        )
    found = {_normal(row[0]) for row in connection.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL")}
    if found != {_normal(statement) for statement in _STATEMENTS}:
        raise UserError(
            f"{path}: the tables differ from those of a catalogue of version {VERSION}; create it again with `rhizotwin catalogue rebuild`"
        )


def _normal(statement: str) -> str:
    return re.sub(r"\s+", " ", statement).strip()
