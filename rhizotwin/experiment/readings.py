"""Read tables of the measured nutrient solution with one row per plant and day.

Columns are ``plant``, ``day``, ``renewed`` (yes, if the row was measured after the solution was renewed or supplemented
with nutrients) and any of ``pH``, ``EC_mS_per_cm``, ``volume_ml`` and the concentrations of ions, such as
``K_mmol_per_l`` or ``NO3_mg_N_per_l``. Columns such as ``K_sd_mmol_per_l`` contain standard deviations.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import inf
from pathlib import Path

from rhizotwin.experiment import masses
from rhizotwin.scenes import compounds, subject, table_file
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.name_suggestion import most_similar
from rhizotwin.scenes.solution import UNIT
from rhizotwin.scenes.subject import Subject

UNITS: Mapping[str, Mapping[str, float]] = {
    "pH": {"": 1.0},
    "EC": {"mS_per_cm": 1.0, "uS_per_cm": 1e-3, "dS_per_m": 1.0},
    "volume": {"ml": 1e-3, "l": 1.0},
}
"""Supported units of each quantity, apart from concentrations, with their sizes in the unit in which it is stored."""
STORED_UNITS = {"pH": "", "EC": "mS/cm", "volume": "l"}
"""Unit in which each quantity is stored. Concentrations are stored in mmol/l."""
LIMITS = {"pH": (0.0, 14.0), "EC": (0.0, 250.0)}
"""Minimum and maximum of quantities. A saturated solution of sodium chloride has about 250 mS/cm at 25 °C."""
_GROUPS = [name for name, (ion, _, _) in compounds.GROUPS.items() if ion]
_COLUMN = re.compile(rf"({'|'.join([*UNITS, *_GROUPS])})(_sd)?(?:_(\w+))?")
_OTHERS = ("renewed", *(one.name for one in fields(Subject)))


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Measured nutrient solution of one plant."""

    where: str
    """File and line of the table, for error messages."""
    subject: Subject
    """Plant, day and treatment."""
    renewed: bool
    """Whether the solution was renewed, or supplemented with nutrients, since the preceding reading."""
    values: Mapping[str, float]
    """Measured values. The keys are pH, EC (mS/cm), volume (l), and ions (mmol/l)."""
    sds: Mapping[str, float]
    """Standard deviations of the values, with the same keys and units. They contain only known ones."""


@dataclass(frozen=True)
class _Column:
    name: str
    quantity: str
    is_sd: bool
    size: float
    """Size of the unit."""


def unit_of(quantity: str) -> str:
    """Return the unit in which a quantity is stored, such as mmol/l. It is empty for the pH."""
    return STORED_UNITS.get(quantity, UNIT)


def has_readings(head: Collection[str]) -> bool:
    """Return whether the column names belong to a table of the nutrient solution."""
    return any((match := _COLUMN.fullmatch(column)) is not None and match[1] != "volume" and not match[2] for column in head)


def is_of_readings(path: Path) -> bool:
    """Return whether a file is a table of the nutrient solution."""
    return path.suffix.lower() == ".csv" and has_readings(table_file.read_table(path)[0].cells)


def read_readings(path: Path) -> list[Reading]:
    """Read a table of the nutrient solution. Rows without a value are ignored.

    Raises
    ------
    UserError
        If a column or unit is unknown, a plant or day is missing, or a value is invalid.
    """
    rows = table_file.read_table(path)
    columns = _columns(path, list(rows[0].cells))
    return [one for row in rows if (one := _read_row(row, columns)).values]


def merge(readings: Sequence[Reading], treatments: Mapping[str, str] | None = None) -> list[Reading]:
    """Merge readings of the same plant and day, for example those of a laboratory and of a pH meter.

    Parameters
    ----------
    readings : sequence of Reading
        Readings of one or several tables.
    treatments : mapping of str to str, optional
        Treatments that are known from results, keyed by plant name.

    Returns
    -------
    list of Reading
        Readings, sorted by plant and day. On the same day, the reading after a renewal follows the one before.

    Raises
    ------
    UserError
        If a quantity is listed twice, or a plant has two treatments.
    """
    known = {plant: name for plant, name in (treatments or {}).items() if name}
    found: dict[tuple[str, float, bool], Reading] = {}
    for one in readings:
        plant = one.subject.plant
        day = one.subject.day or 0.0
        treatment = one.subject.treatment
        if treatment and known.setdefault(plant, treatment) != treatment:
            raise UserError(f"{one.where}: plant {plant} has two treatments, {known[plant]!r} and {treatment!r}; correct one of them")
        before = found.get((plant, day, one.renewed))
        if before is not None and (twice := sorted(before.values.keys() & one.values)):
            raise UserError(
                f"{one.where}: the {twice[0]} of plant {plant} on day {day:g} is listed twice, first in {before.where}; remove one of the "
                "rows, or enter 'yes' in the column 'renewed' of the row that was measured after the solution was renewed"
            )
        if before is not None:
            one = replace(before, values={**before.values, **one.values}, sds={**before.sds, **one.sds})
        found[plant, day, one.renewed] = one
    return [replace(one, subject=replace(one.subject, treatment=known.get(key[0], ""))) for key, one in sorted(found.items())]


def _columns(path: Path, head: Sequence[str]) -> list[_Column]:
    found: list[_Column] = []
    for column in head:
        match = _COLUMN.fullmatch(column)
        if match is None and column and column not in _OTHERS and not masses.COLUMN.fullmatch(column):
            near = most_similar(column, [*_OTHERS, "pH", "EC_mS_per_cm", "volume_ml", *(f"{name}_mmol_per_l" for name in _GROUPS)])
            hint = f" (did you mean {near!r}?)" if near else ""
            raise UserError(f"{path}: the column {column!r} is unknown{hint}; rename or remove it, or enter the text as 'notes'")
        if match is not None:
            one = _read_column(path, column, match[1], bool(match[2]), match[3] or "")
            if twice := [other for other in found if (other.quantity, other.is_sd) == (one.quantity, one.is_sd)]:
                raise UserError(f"{path}: the columns {twice[0].name} and {column} contain the same quantity; remove one of them")
            found.append(one)
    for one in found:
        if one.is_sd and not any(other.quantity == one.quantity and not other.is_sd for other in found):
            raise UserError(f"{path}: the column {one.name} has no column with the values of {one.quantity}; add it")
    if not has_readings(head):
        raise UserError(
            f"{path} contains no readings of a nutrient solution; add at least one column such as pH, EC_mS_per_cm, K_mmol_per_l"
        )
    return found


def _read_column(path: Path, column: str, name: str, is_sd: bool, unit: str) -> _Column:
    if name in UNITS:
        if unit not in UNITS[name]:
            units = ", ".join(filter(None, UNITS[name])) or "omitted"
            raise UserError(f"{path}: the unit of the column {column} must be {units}")
        return _Column(column, name, is_sd, UNITS[name][unit])
    try:
        amount, per, volume = unit.rpartition("_per_")
        if (per, volume) != ("_per_", "l"):
            raise UserError("the unit must be an amount or mass per litre, such as mmol_per_l")
        return _Column(column, compounds.GROUPS[name][0], is_sd, compounds.mmol_per_unit(name, amount))
    except UserError as error:
        raise UserError(f"{path}: the column {column}: {error}") from None


def _read_row(row: table_file.Row, columns: Sequence[_Column]) -> Reading:
    whose = subject.from_cells(row.cells, row.where)
    values: dict[str, float] = {}
    sds: dict[str, float] = {}
    for column in columns:
        value = table_file.number(row, column.name)
        if value is None:
            continue
        size = value * column.size
        low, high = LIMITS.get(column.quantity, (0.0, inf)) if not column.is_sd else (0.0, inf)
        is_empty = column.quantity == "volume" and not column.is_sd and size == 0.0
        if not low <= size <= high or is_empty:
            limits = f"between {low / column.size:g} and {high / column.size:g}" if high < inf else "above 0" if is_empty else "at least 0"
            raise UserError(f"{row.where}: {column.name} is {value:g}, but must be {limits}; correct it, or leave the cell empty")
        (sds if column.is_sd else values)[column.quantity] = size
    for missing, name in ((not whose.plant, "plant"), (whose.day is None, "day")):
        if values and missing:
            raise UserError(f"{row.where}: the {name} is missing; enter it in the column '{name}'")
    renewed = row.cells.get("renewed", "").lower() or "no"
    if renewed not in ("yes", "no"):
        raise UserError(f"{row.where}: renewed is {row.cells['renewed']!r}, but must be yes or no")
    known_sds = {name: sd for name, sd in sds.items() if name in values}
    return Reading(where=row.where, subject=whose, renewed=renewed == "yes", values=values, sds=known_sds)
