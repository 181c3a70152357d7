"""Read CSV tables with a header.

Lines that start with ``#`` are comments. Tables A.1 and 4.1 of Kliman's thesis (2022) are part of the package.
"""

import csv
import io
from dataclasses import dataclass
from importlib.resources import files
from itertools import zip_longest
from pathlib import Path

from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import read_file

SHIPPED = ("kliman_2022_masses.csv", "kliman_2022_volumes.csv")
"""Names of the files with tables A.1 and 4.1 of Kliman's thesis. The first lines of each file state its source."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Row of a CSV table."""

    where: str
    """File and line number of the row, quoted in error messages."""
    cells: dict[str, str]
    """Texts of the cells, keyed by column name. They are empty for columns for which the row has no cell."""


def read_table(path: Path) -> list[Row]:
    """Read a CSV file with a header. Lines without text in any cell and lines that start with ``#`` are ignored.

    Raises
    ------
    UserError
        If the file cannot be read, is not text, has no rows, duplicate columns or other separators than commas, or a
        row has more cells than the header.
    """
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UserError(f"{path} is not a text file in UTF-8; save the table as CSV") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip(' \t,"') and not line.startswith("#")]
    if len(lines) < 2:
        raise UserError(f"{path} contains no rows below the header; add one row per plant or scan")
    try:
        rows = [next(csv.reader(io.StringIO(line), strict=True)) for _, line in lines]
    except csv.Error as error:
        raise UserError(f"{path} could not be read as a CSV table ({error}); save the table again as CSV") from None
    head = [name.strip() for name in rows[0]]
    if len(head) == 1 and any(mark in head[0] for mark in ";\t"):
        raise UserError(f"{path}: the columns must be separated by commas, not by semicolons or tabs; save the table again as CSV")
    twice = sorted({name for name in head if name and head.count(name) > 1})
    if twice:
        raise UserError(f"{path} contains two columns with the name {twice[0]}; rename or remove one of them")
    made = []
    for (number, _), cells in zip(lines[1:], rows[1:], strict=True):
        where = f"{path}, line {number}"
        if len(cells) > len(head):
            raise UserError(f"{where}: the row has {len(cells)} cells, but the header has {len(head)}; replace decimal commas by points")
        made.append(Row(where=where, cells=dict(zip_longest(head, [cell.strip() for cell in cells], fillvalue=""))))
    return made


def number(row: Row, column: str) -> float | None:
    """Return the number in a cell. It is None if the cell is empty or the column is missing.

    Raises
    ------
    UserError
        If the cell does not contain a finite number, for example because it includes a unit.
    """
    text = row.cells.get(column, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        raise UserError(f"{row.where}: {column} is {text!r}, which is not a number; write the unit in the column name") from None
    if not abs(value) < float("inf"):
        raise UserError(f"{row.where}: {column} is {text!r}, which is not a finite number; correct it, or leave the cell empty")
    return value


def shipped(name: str) -> Path:
    """Return the path of one of the thesis's tables (`SHIPPED`)."""
    return Path(str(files(__package__).joinpath("data", name)))


def write_shipped(folder: Path) -> list[Path]:
    """Write the thesis's tables to a folder and return their paths. Existing files are not replaced."""
    written = []
    for name in SHIPPED:
        atomic.write_text(folder / name, shipped(name).read_text(encoding="utf-8"), new=True)
        written.append(folder / name)
    return written
