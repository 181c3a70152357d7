"""Read tables of weighed masses with one row per plant.

Columns are ``plant``, optionally ``day``, and any of ``root_fresh_g root_dry_g shoot_fresh_g shoot_dry_g`` (g, mg or
kg, the same unit in the whole table). ``root_foil_g`` and ``root_foil_scraped_g`` (likewise for the shoot) are the mass
of the empty foil, and of the foil after the dry matter was scraped off. Their difference is added to the dry mass
(thesis, section 5.1, steps 1 and 5).
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rhizotwin.scenes import subject, table_file
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject

ORGANS, STATES = ("root", "shoot"), ("fresh", "dry")
KINDS = tuple(f"{organ}_{state}" for organ in ORGANS for state in STATES)
"""Kinds of mass: fresh and dry mass of root and shoot."""
BALANCE_G = 1e-4
"""Readability of the laboratory balance of the thesis, g."""
GRAMS = {"g": 1.0, "mg": 1e-3, "kg": 1e3}
"""Supported units of mass, with their sizes in g."""
COLUMN = re.compile(rf"({'|'.join(ORGANS)})_(fresh|dry|foil_scraped|foil)_(\w+)")
"""Name of a column with masses: organ, kind of mass, and unit."""


@dataclass(frozen=True, kw_only=True)
class Weighed:
    """Masses of one plant."""

    where: str
    """File and line of the table, for error messages."""
    subject: Subject
    """Plant, day and treatment."""
    grams: Mapping[str, float]
    """Masses including the residues on the foil, in g, keyed by the names in `KINDS`."""
    residue_g: Mapping[str, float]
    """Residues on the foil that were added to the dry masses, in g, keyed by the names in `KINDS`."""
    log_sigma: float = 0.0
    """Standard deviation of the logarithm of predicted masses. It is 0 for weighed ones."""


def has_masses(head: Collection[str]) -> bool:
    """Return whether the column names belong to a table of masses."""
    return any((match := COLUMN.fullmatch(column)) is not None and f"{match[1]}_{match[2]}" in KINDS for column in head)


def read_masses(path: Path, *, balance_g: float) -> list[Weighed]:
    """Read a table of masses. Rows without a mass are ignored.

    Parameters
    ----------
    balance_g : float
        Readability of the balance, g. A scraped foil may be lighter than an empty foil by up to twice this value.

    Raises
    ------
    UserError
        If masses have different units, a plant occurs twice on a day, a mass has no plant, a dry mass exceeds the fresh
        mass, or a value is invalid.
    """
    rows = table_file.read_table(path)
    columns = _columns(path, list(rows[0].cells))
    weighed = [one for row in rows if (one := _read_row(row, columns, balance_g)).grams]
    seen: dict[tuple[str, float | None], str] = {}
    for one in weighed:
        key = (one.subject.plant, one.subject.day)
        if key in seen:
            day = "" if key[1] is None else f" on day {key[1]:g}"
            raise UserError(f"{one.where}: plant {key[0]}{day} is listed twice, first in {seen[key]}; remove one of the rows")
        seen[key] = one.where
    return weighed


def _columns(path: Path, head: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return the column name, and the size of its unit in g, for each kind of mass."""
    if "plant" not in head:
        raise UserError(f"{path}: the column 'plant' is missing; add it with the plant names used in the datasets")
    found: dict[str, tuple[str, float]] = {}
    for column in head:
        match = COLUMN.fullmatch(column)
        if match is None:
            continue
        if match[3] not in GRAMS:
            raise UserError(f"{path}: the column {column} has the unknown unit {match[3]!r}; the unit must be g, mg or kg")
        kind = f"{match[1]}_{match[2]}"
        if kind in found:
            raise UserError(f"{path}: the columns {found[kind][0]} and {column} contain the same mass; remove one of them")
        found[kind] = (column, GRAMS[match[3]])
    units = dict(found.values())
    if len(set(units.values())) > 1:
        raise UserError(f"{path}: the columns {', '.join(units)} have different units; convert all masses to the same unit")
    if not set(found) & set(KINDS):
        raise UserError(f"{path} contains no column of masses; add at least one of {', '.join(f'{kind}_g' for kind in KINDS)}")
    return found


def _read_row(row: table_file.Row, columns: Mapping[str, tuple[str, float]], balance_g: float) -> Weighed:
    whose = subject.from_cells(row.cells, row.where)
    given = {kind: (column, table_file.number(row, column), scale) for kind, (column, scale) in columns.items()}
    grams: dict[str, float] = {}
    for kind, (column, value, scale) in given.items():
        if value is not None and not value > 0.0:
            raise UserError(f"{row.where}: {column} is {value:g}; enter a positive number, or leave the cell empty")
        if value is not None:
            grams[kind] = value * scale
    if grams and not whose.plant:
        raise UserError(f"{row.where}: the name of the plant is missing; enter the name used in the dataset")
    residue = {}
    for organ in ORGANS:
        left = _residue(row, organ, grams, balance_g)
        if left is not None:
            residue[f"{organ}_dry"] = left
            grams[f"{organ}_dry"] += left
        fresh, dry = grams.get(f"{organ}_fresh"), grams.get(f"{organ}_dry")
        if fresh is not None and dry is not None and dry > fresh:
            raise UserError(
                f"{row.where}: the dry mass of the {organ} of {whose.plant} ({dry:g} "
                f"g) exceeds its fresh mass ({fresh:g} g); check the units"
            )
    return Weighed(where=row.where, subject=whose, grams={kind: grams[kind] for kind in KINDS if kind in grams}, residue_g=residue)


def _residue(row: table_file.Row, organ: str, grams: Mapping[str, float], balance_g: float) -> float | None:
    """Return the mass of the residue on the foil after scraping, g. It is None if the foil was not weighed."""
    empty, scraped, dry = (grams.get(f"{organ}_{what}") for what in ("foil", "foil_scraped", "dry"))
    if empty is None or scraped is None or dry is None:
        return None
    if scraped < empty - 2.0 * balance_g:
        lost = f"{scraped:g} g after scraping, less than the {empty:g} g of the empty foil"
        raise UserError(f"{row.where}: the foil of the {organ} weighs {lost}; leave both cells empty if the foil was torn")
    return max(scraped - empty, 0.0)
