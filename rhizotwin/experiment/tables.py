"""Tables that people keep: CSV files with a head and comments behind ``#``.

The thesis's own tables come with the program.
"""

import csv
import io
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import read_file

SHIPPED = ("kliman_2022_masses.csv", "kliman_2022_volumes.csv")
"""Tables A.1 and 4.1 of the thesis; each names its source in its first lines."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A line of a table."""

    where: str
    """File and line, for messages."""
    cells: dict[str, str]
    """By the head's names; empty where the line has nothing."""


def read_table(path: Path) -> list[Row]:
    """Read a CSV file with a head; empty lines and lines that begin with ``#`` are left out.

    Raises
    ------
    UserError
        When it cannot be read, is no text, has no rows, names a column twice, or a line has more cells than the head.
    """
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UserError(f"{path}: is no text in UTF-8; save the table as CSV") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        raise UserError(f"{path}: has no rows below its head")
    try:
        rows = [next(csv.reader(io.StringIO(line), strict=True)) for _, line in lines]
    except csv.Error as error:
        raise UserError(f"{path}: is no CSV table ({error})") from None
    head = [name.strip() for name in rows[0]]
    twice = sorted({name for name in head if name and head.count(name) > 1})
    if twice:
        raise UserError(f"{path}: has the column {twice[0]} twice")
    made = []
    for (number, _), cells in zip(lines[1:], rows[1:], strict=True):
        where = f"{path}, line {number}"
        if len(cells) > len(head):
            raise UserError(f"{where}: has {len(cells)} cells, the head has {len(head)}; decimals are written with a point")
        made.append(Row(where=where, cells=dict(zip(head, [cell.strip() for cell in cells], strict=False))))
    return made


def number(row: Row, column: str) -> float | None:
    """Return a cell's number; None where it is empty or the column is missing.

    Raises
    ------
    UserError
        For anything that is no finite number, such as one with its unit.
    """
    text = row.cells.get(column, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        raise UserError(f"{row.where}: {column} is {text!r}, which is no number; units stand in the head, for the whole column") from None
    if not abs(value) < float("inf"):
        raise UserError(f"{row.where}: {column} is {text!r}, which is no finite number")
    return value


def shipped(name: str) -> Path:
    """Return the file of one of the thesis's tables (`SHIPPED`)."""
    return Path(str(files(__package__).joinpath("data", name)))


def write_shipped(folder: Path) -> list[Path]:
    """Write the thesis's tables into a folder; files that are there are not replaced."""
    written = []
    for name in SHIPPED:
        atomic.write_text(folder / name, shipped(name).read_text(encoding="utf-8"), new=True)
        written.append(folder / name)
    return written
