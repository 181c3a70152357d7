"""Masses that were weighed: a table with a row a plant, its units in the head, and what stuck to the foil added back.

Columns: ``plant``, where wanted ``day``, and of ``root_fresh_g root_dry_g shoot_fresh_g shoot_dry_g`` those that were
weighed (g, mg or kg, the same in the whole table). With ``root_foil_g`` and ``root_foil_scraped_g`` (the same of the
shoot), the masses of the empty foil and of the foil after the dry matter was scraped off it, what was left on it is
added to the dry mass (thesis, section 5.1, steps 1 and 5).
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
"""Readability of a laboratory balance, as the thesis's."""
GRAMS = {"g": 1.0, "mg": 1e-3, "kg": 1e3}
_COLUMN = re.compile(rf"({'|'.join(ORGANS)})_(fresh|dry|foil_scraped|foil)_(\w+)")


@dataclass(frozen=True, kw_only=True)
class Weighed:
    """The masses of one plant."""

    where: str
    """File and line, for messages."""
    subject: Subject
    grams: Mapping[str, float]
    """By kind (`KINDS`), those that were weighed, foil residue added."""
    residue_g: Mapping[str, float]
    """What was added of foil residue, by kind."""


def has_masses(head: Collection[str]) -> bool:
    """Return whether columns are those of a table of masses."""
    return any((match := _COLUMN.fullmatch(column)) is not None and f"{match[1]}_{match[2]}" in KINDS for column in head)


def read_masses(path: Path, *, balance_g: float) -> list[Weighed]:
    """Read a table of masses.

    Parameters
    ----------
    balance_g : float
        Readability of the balance; a foil may be lighter after scraping by so much, twice.

    Raises
    ------
    UserError
        For mixed units, a plant that is listed twice, masses without a plant, dry above fresh mass, or anything that is
        no mass.
    """
    rows = tables.read_table(path)
    columns = _columns(path, list(rows[0].cells))
    weighed = [_weighed(row, columns, balance_g) for row in rows]
    seen: dict[tuple[str, float | None], str] = {}
    for one in weighed:
        key = (one.subject.plant, one.subject.day)
        if key in seen:
            day = "" if key[1] is None else f" on day {key[1]:g}"
            raise UserError(f"{one.where}: plant {key[0]}{day} is listed twice, first in {seen[key]}; leave one out")
        seen[key] = one.where
    return weighed


def _columns(path: Path, head: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return column and grams of its unit for each kind of mass."""
    if "plant" not in head:
        raise UserError(f"{path}: has no column plant; name the plants as the datasets do")
    found: dict[str, tuple[str, float]] = {}
    for column in head:
        match = _COLUMN.fullmatch(column)
        if match is None:
            continue
        if match[3] not in GRAMS:
            raise UserError(f"{path}: {column} has the unit {match[3]!r}; masses are in g, mg or kg")
        kind = f"{match[1]}_{match[2]}"
        if kind in found:
            raise UserError(f"{path}: has the columns {found[kind][0]} and {column}; keep one of them")
        found[kind] = (column, GRAMS[match[3]])
    units = dict(found.values())
    if len(set(units.values())) > 1:
        raise UserError(f"{path}: mixes units in {', '.join(units)}; give all masses in one unit")
    if not set(found) & set(KINDS):
        raise UserError(f"{path}: has no masses; it needs one of the columns {', '.join(f'{kind}_g' for kind in KINDS)}")
    return found


def _weighed(row: tables.Row, columns: Mapping[str, tuple[str, float]], balance_g: float) -> Weighed:
    whose = subject.from_cells(row.cells, row.where)
    given = {kind: (column, tables.number(row, column), scale) for kind, (column, scale) in columns.items()}
    grams: dict[str, float] = {}
    for kind, (column, value, scale) in given.items():
        if value is not None and not value > 0.0:
            raise UserError(f"{row.where}: {column} is {value:g}; a mass must be above 0, or the cell empty")
        if value is not None:
            grams[kind] = value * scale
    if grams and not whose.plant:
        raise UserError(f"{row.where}: has masses but no plant; name it as the datasets do")
    residue = {}
    for organ in ORGANS:
        left = _residue(row, organ, grams, balance_g)
        if left is not None:
            residue[f"{organ}_dry"] = left
            grams[f"{organ}_dry"] += left
        fresh, dry = grams.get(f"{organ}_fresh"), grams.get(f"{organ}_dry")
        if fresh is not None and dry is not None and dry > fresh:
            raise UserError(
                f"{row.where}: the {organ} of {whose.plant} is heavier dry ({dry:g} g) than fresh ({fresh:g} g); look at the units"
            )
    return Weighed(where=row.where, subject=whose, grams={kind: grams[kind] for kind in KINDS if kind in grams}, residue_g=residue)


def _residue(row: tables.Row, organ: str, grams: Mapping[str, float], balance_g: float) -> float | None:
    """Return what is left on the foil after scraping; None where that was not weighed."""
    empty, scraped, dry = (grams.get(f"{organ}_{what}") for what in ("foil", "foil_scraped", "dry"))
    if empty is None or scraped is None or dry is None:
        return None
    if scraped < empty - 2.0 * balance_g:
        lost = f"{scraped:g} g after scraping and {empty:g} g before"
        raise UserError(f"{row.where}: the {organ}'s foil has {lost}: it was torn, so leave its two cells empty")
    return max(scraped - empty, 0.0)
