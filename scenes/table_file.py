"""Reading of tables that people write with a spreadsheet program or an editor (CSV).

Columns are separated by commas, semicolons, tabs or bars. A first line ``sep=;``, as Excel writes and reads it, states
the separator. Cells in quotes may contain line breaks, and lines that start with ``#`` are comments. Decimal commas are
read as decimal points, unless they could separate thousands.
"""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import read_text

_SEPARATORS = ",;\t|"
_STATED = re.compile(r'"?sep=(.)"?[,;\t|]*(?=\n|$)', re.IGNORECASE)
_BREAK = re.compile(r"\s*[\r\n]+\s*")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
"""Number whose mark may be a decimal mark or a separator of thousands."""
_GROUPED = re.compile(r"[+-]?\d[\d.,' \u00a0\u2009\u202f]*")
"""Number with separators of thousands: points, commas, apostrophes, or spaces of any width."""
_TEXTS = frozenset(("result", "plant", "species", "treatment", "date", "notes"))
"""Columns whose cells are not numbers, even if they look like numbers."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Row of a table."""

    where: str
    """File and line number of the row, quoted in error messages."""
    cells: dict[str, str]
    """Texts of the cells, keyed by column name. They are empty for columns for which the row has no cell."""


def read_table(path: Path) -> list[Row]:
    """Read a table with a header. Lines without text in any cell and lines that start with ``#`` are ignored.

    Raises
    ------
    UserError
        If the file cannot be read, is not text, has no rows or duplicate columns, a row has more cells than the header,
        or the decimal mark of its numbers is not clear.
    """
    try:
        text = read_text(path).replace("\r", "\n")
    except UserError as error:
        raise UserError(str(error).replace("save it as UTF-8", "save the table as CSV in UTF-8 (Excel: CSV UTF-8)")) from None
    stated = _STATED.match(text)
    text = text if stated is None else text[stated.end() :]
    separator = max(_SEPARATORS, key=lambda mark: _columns(text, mark)) if stated is None else stated[1]
    try:
        records = list(_records(text, separator))
    except csv.Error as error:
        raise UserError(f"{path} could not be read as a CSV table ({error}); check its quotation marks, or save it again as CSV") from None
    if len(records) < 2:
        raise UserError(f"{path} contains no rows below the header; add one row per plant or scan")
    head = records[0][1]
    twice = sorted({name for name in head if name and head.count(name) > 1})
    if twice:
        raise UserError(f"{path} contains two columns with the name {twice[0]}; rename or remove one of them")
    rows = []
    for number_of_line, cells in records[1:]:
        where = f"{path}, line {number_of_line}"
        if any(cells[len(head) :]):
            raise UserError(f"{where}: the row has {len(cells)} cells, but the header has {len(head)}; replace decimal commas by points")
        rows.append(Row(where=where, cells=dict(zip_longest(head, cells[: len(head)], fillvalue=""))))
    return _with_decimal_points(rows, separator)


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
        what = f"{row.where}: {column} is {text!r}, which is not a number"
        if _GROUPED.fullmatch(text):
            raise UserError(f"{what} with a decimal point; write numbers as 1234.5, without separators of thousands") from None
        raise UserError(f"{what}; write the unit in the column name") from None
    if not abs(value) < float("inf"):
        raise UserError(f"{row.where}: {column} is {text!r}, which is not a finite number; correct it, or leave the cell empty")
    return value


class _Lines:
    """Lines of a table for `csv.reader`. Comments and blank lines are skipped between rows, but not inside quotes."""

    def __init__(self, text: str) -> None:
        self._lines = enumerate(io.StringIO(text), start=1)
        self.between = True
        """Whether the next line begins a row."""
        self.start = 1
        """Line number at which the current row begins."""

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        for position, line in self._lines:
            if self.between and (line.startswith("#") or not line.strip(f' "\n{_SEPARATORS}')):
                continue
            self.start = position if self.between else self.start
            self.between = False
            return line
        raise StopIteration


def _records(text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of each row."""
    lines = _Lines(text)
    for row in csv.reader(lines, delimiter=separator, strict=True):
        yield lines.start, [_BREAK.sub(" ", cell).strip() for cell in row]
        lines.between = True


def _columns(text: str, separator: str) -> int:
    """Return the number of columns in the header for a separator."""
    try:
        return len(next(_records(text, separator), (0, ()))[1])
    except csv.Error:
        return 0


def _with_decimal_points(rows: Sequence[Row], separator: str) -> list[Row]:
    """Replace decimal commas by points.

    A number such as 1,234 may be a fraction or have a separator of thousands. The other numbers of the table decide.

    Raises
    ------
    UserError
        If the table contains a number such as 1.234, and other numbers have decimal commas, or no other number decides
        and columns are separated by semicolons, which spreadsheets write together with decimal commas.
    """
    numbers = [(row.where, name, cell) for row in rows for name, cell in row.cells.items() if _is_number(name, cell)]
    sure = {mark for _, _, cell in numbers for mark in ".," if mark in cell and not _THOUSANDS.fullmatch(cell)}
    if "." in sure or (separator != ";" and "," not in sure):
        return list(rows)  # `number` rejects numbers with commas
    for where, name, cell in numbers:
        if "." in cell:
            raise UserError(
                f"{where}: {name} is {cell}, which may be a fraction or {cell.replace('.', '')}; write the numbers of the table with "
                "decimal points and without separators of thousands, and separate the columns by commas"
            )
    if "," not in sure:
        return list(rows)
    return [
        replace(row, cells={name: cell.replace(",", ".") if _is_number(name, cell) else cell for name, cell in row.cells.items()})
        for row in rows
    ]


def _is_number(column: str, cell: str) -> bool:
    return column not in _TEXTS and _NUMBER.fullmatch(cell) is not None
