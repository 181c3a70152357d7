"""Metadata of the plant in a canister: name, species, treatment and age, with the corresponding MIAPPE terms.

Reference for MIAPPE 1.1: Papoutsoglou et al. 2020, New Phytologist 227:260.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import date
from typing import Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Metadata of the plant in a scan. Unknown fields are empty."""

    plant: str = ""
    """Name of the plant, which is the same on every day (MIAPPE: observation unit ID)."""
    species: str = ""
    """Latin name of the species, such as Raphanus sativus (MIAPPE: organism)."""
    treatment: str = ""
    """Treatment of the plant, such as "low N" (MIAPPE: observation unit factor value)."""
    day: float | None = field(default=None, metadata={"limits": (0.0, 36500.0)})
    """Number of days since sowing (MIAPPE: time since the event 'sowing')."""
    date: str = ""
    """Date of the scan, such as 2022-10-06 (MIAPPE: observation date)."""
    replicate: int | None = field(default=None, metadata={"limits": (0, 1000000)})
    """Number that distinguishes plants with the same treatment (MIAPPE: replicate of the observation unit)."""
    notes: str = ""
    """Additional notes about the plant."""

    @property
    def known(self) -> dict[str, str]:
        """Known fields as text. The keys are field names."""
        return {name: text for name, text in as_text(self).items() if text}

    def __str__(self) -> str:
        """Return the known fields as readable text. The text is empty if no field is known."""
        told = {"treatment": "treatment {}", "day": "day {}", "date": "{}", "replicate": "replicate {}", "notes": "{}"}
        known = self.known
        who = f"{known['plant']} ({known['species']})" if {"plant", "species"} <= known.keys() else self.plant or self.species
        return ", ".join(filter(None, [who, *(form.format(known[name]) for name, form in told.items() if name in known)]))


NAMES = tuple(f.name for f in fields(Subject))
"""Names of the columns that describe the subject in every table."""


def as_text(subject: Subject) -> dict[str, str]:
    """Return all fields as text for a table. The keys are column names. Unknown fields are empty."""
    values = {name: getattr(subject, name) for name in NAMES}
    return {name: "" if value is None else f"{value:g}" if isinstance(value, float) else str(value) for name, value in values.items()}


def check_subject(subject: Subject, place: Place) -> None:
    """Raise an error if the date is invalid, or if a text cannot be displayed in a table cell.

    Raises
    ------
    UserError
        If a field is invalid; the message states the field, its value and the condition.
    """
    for name in ("plant", "species", "treatment", "notes"):
        text = getattr(subject, name)
        if not text.isprintable():
            raise place.at(name).error("must be one line of printable characters", ascii(text))
        if text.startswith(("=", "@")):
            raise place.at(name).error("must not begin with = or @, which spreadsheets read as a formula", text)
    if subject.date and not _is_date(subject.date):
        raise place.at("date").error("must be a date such as 2022-10-06", subject.date)


def _is_date(text: str) -> bool:
    """Return whether a text is a date in the format YYYY-MM-DD, whose order as text is that in time."""
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def from_summary(summary: Mapping[str, Any], where: str) -> Subject:
    """Return the subject recorded in a ``result.json``.

    It is empty for results of versions that did not record it.

    Raises
    ------
    UserError
        If the entry is invalid.
    """
    place = Place(where).at("subject")
    subject = from_plain(Subject, summary.get("subject") or {}, place)
    check_subject(subject, place)
    return subject


def from_cells(cells: Mapping[str, str], where: str) -> Subject:
    """Return the subject described by a row of a table. Fields without a column are unknown.

    Raises
    ------
    UserError
        If the day or replicate is not a number, or a value is beyond its limits.
    """
    given: dict[str, Any] = {name: cells[name].strip() for name in NAMES if (cells.get(name) or "").strip()}
    for name, read in (("day", float), ("replicate", int)):
        if name in given:
            try:
                given[name] = read(given[name])
            except ValueError:
                raise UserError(f"{where}: the {name} {given[name]!r} is not a {'number' if read is float else 'whole number'}") from None
    place = Place(where)
    subject = from_plain(Subject, given, place)
    check_subject(subject, place)
    return subject
