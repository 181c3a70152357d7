"""Tables of weighed masses: one row per plant, units in the column names, foil residues added to the dry mass.

Columns are ``plant``, optionally ``day``, and any of ``root_fresh_g root_dry_g shoot_fresh_g shoot_dry_g`` (g, mg or
kg, the same unit in the whole table). ``root_foil_g`` and ``root_foil_scraped_g`` (likewise for the shoot) are the mass
of the empty foil and of the foil after scraping off the dry matter; their difference is added to the dry mass (thesis,
section 5.1, steps 1 and 5).
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rhizotwin.experiment import tables
from rhizotwin.scenes import subject
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject

ORGANS, STATES = ("root", "shoot"), ("fresh", "dry")
KINDS = tuple(f"{organ}_{state}" for organ in ORGANS for state in STATES)
BALANCE_G = 1e-4
"""Readability of a laboratory balance, as in the thesis."""
GRAMS = {"g": 1.0, "mg": 1e-3, "kg": 1e3}
_COLUMN = re.compile(rf"({'|'.join(ORGANS)})_(fresh|dry|foil_scraped|foil)_(\w+)")


@dataclass(frozen=True, kw_only=True)
class Weighed:
    """Masses of one plant."""

    where: str
    """File and line, for messages."""
    subject: Subject
    grams: Mapping[str, float]
    """Weighed masses by kind (`KINDS`), including foil residues."""
    residue_g: Mapping[str, float]
    """Added foil residues by kind."""


def has_masses(head: Collection[str]) -> bool:
    """Return whether the column names are those of a table of masses."""
    return any((match := _COLUMN.fullmatch(column)) is not None and f"{match[1]}_{match[2]}" in KINDS for column in head)


def read_masses(path: Path, *, balance_g: float) -> list[Weighed]:
    """Read a table of masses.

    Parameters
    ----------
    balance_g : float
        Readability of the balance; a scraped foil may be lighter than the empty one by twice this value.

    Raises
    ------
    UserError
        If units are mixed, a plant occurs twice, masses have no plant, a dry mass exceeds the fresh mass, or a value is
        invalid.
    """
    rows = tables.read_table(path)
    columns = _columns(path, list(rows[0].cells))
    weighed = [_weighed(row, columns, balance_g) for row in rows]
    seen: dict[tuple[str, float | None], str] = {}
    for one in weighed:
        key = (one.subject.plant, one.subject.day)
        if key in seen:
            day = "" if key[1] is None else f" on day {key[1]:g}"
            raise UserError(f"{one.where}: plant {key[0]}{day} is listed twice, first in {seen[key]}; remove one of the rows")
        seen[key] = one.where
    return weighed


def _columns(path: Path, head: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return the column and the unit in grams of each kind of mass."""
    if "plant" not in head:
        raise UserError(f"{path}: the column plant is missing; it must contain the plant names of the datasets")
    found: dict[str, tuple[str, float]] = {}
    for column in head:
        match = _COLUMN.fullmatch(column)
        if match is None:
            continue
        if match[3] not in GRAMS:
            raise UserError(f"{path}: unknown unit {match[3]!r} in column {column}; use g, mg or kg")
        kind = f"{match[1]}_{match[2]}"
        if kind in found:
            raise UserError(f"{path}: the columns {found[kind][0]} and {column} contain the same mass; remove one of them")
        found[kind] = (column, GRAMS[match[3]])
    units = dict(found.values())
    if len(set(units.values())) > 1:
        raise UserError(f"{path}: the columns {', '.join(units)} have different units; give all masses in the same unit")
    if not set(found) & set(KINDS):
        raise UserError(f"{path} contains no mass column; at least one of {', '.join(f'{kind}_g' for kind in KINDS)} is required")
    return found


def _weighed(row: tables.Row, columns: Mapping[str, tuple[str, float]], balance_g: float) -> Weighed:
    whose = subject.from_cells(row.cells, row.where)
    given = {kind: (column, tables.number(row, column), scale) for kind, (column, scale) in columns.items()}
    grams: dict[str, float] = {}
    for kind, (column, value, scale) in given.items():
        if value is not None and not value > 0.0:
            raise UserError(f"{row.where}: {column} is {value:g}; a mass must be positive, or the cell empty")
        if value is not None:
            grams[kind] = value * scale
    if grams and not whose.plant:
        raise UserError(f"{row.where}: the name of the plant is missing; give the name used in the dataset")
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


def _residue(row: tables.Row, organ: str, grams: Mapping[str, float], balance_g: float) -> float | None:
    """Return the residue on the foil after scraping; None if it was not weighed."""
    empty, scraped, dry = (grams.get(f"{organ}_{what}") for what in ("foil", "foil_scraped", "dry"))
    if empty is None or scraped is None or dry is None:
        return None
    if scraped < empty - 2.0 * balance_g:
        lost = f"{scraped:g} g after scraping but {empty:g} g when empty"
        raise UserError(f"{row.where}: the foil of the {organ} weighs {lost}; if it was torn, leave both cells empty")
    return max(scraped - empty, 0.0)
