"""Conversion of catalogue rows to plants, merging of plant data, and detection of conflicts."""

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.solution import Solution, check_solution
from rhizotwin.scenes.subject import Subject, check_subject

KEPT = ("notes", "solution")
"""Fields in which a new entry of a plant may differ from the existing one. New notes replace the existing notes. The
existing nutrient solution is kept, because each scan stores its own solution."""


def solution_text(solution: Solution) -> str:
    """Return a nutrient solution as JSON text for the catalogue.

    The text is empty if the solution is unknown.
    """
    return json.dumps(to_plain(solution), sort_keys=True) if solution.known else ""


def plant_of(row: sqlite3.Row, *, where: str) -> Plant:
    """Convert a database row to a plant.

    ``where`` is the name of the catalogue in error messages.

    Raises
    ------
    UserError
        If the stored text, date or nutrient solution is damaged.
    """
    whose = Place(f"{where}, plant {row['name']!r}")
    about = Subject(plant=row["name"], species=row["species"], treatment=row["treated"] or "", date=row["sown"], notes=row["notes"])
    check_subject(about, whose)
    place = whose.at("solution")
    solution = Solution()
    if row["content"] is not None:
        try:
            plain = json.loads(row["content"])
        except (ValueError, RecursionError):
            raise place.error("must be valid JSON") from None
        solution = from_plain(Solution, plain, place)
        check_solution(solution, place)
    tag = None
    if row["first_id"] is not None and row["markers"] is not None:
        tag = Tag(dictionary=row["dictionary"], first_id=row["first_id"], markers=row["markers"])
    return Plant(
        name=row["name"],
        species=row["species"],
        treatment=row["treated"] or "",
        replicate=row["replicate"],
        sown=row["sown"],
        notes=row["notes"],
        solution=solution,
        tag=tag,
        phantom=bool(row["phantom"]),
    )


def merge(before: Plant, now: Plant, *, where: str, replaces: bool = False) -> Plant:
    """Merge the existing and the new entry of a plant.

    Parameters
    ----------
    before, now : Plant
        Existing and new entry.
    where : str
        Name of the catalogue in error messages.
    replaces : bool
        Whether known values of the new entry replace those of the existing one.

    Raises
    ------
    UserError
        If the values of a field differ, and are not to be replaced.
    """
    changed: dict[str, Any] = {}
    for field in fields(Plant):
        old, new = getattr(before, field.name), getattr(now, field.name)
        has_old, has_new = (_is_known(one) for one in (old, new))
        if not has_new or new == old:
            continue
        if has_old and not replaces and field.name not in KEPT:
            raise UserError(
                f"{where}: the {field.name} of plant {now.name} is {old} in the catalogue, but {new} in the new entry; "
                "correct the new entry, or the catalogue with `rhizotwin catalogue plant --replace`"
            )
        if replaces or not has_old or field.name == "notes":
            changed[field.name] = new
    return replace(before, **changed)


def refuse_tag(plant: Plant, others: Sequence[Plant], *, where: str) -> None:
    """Raise UserError if the marker strips of two plants have a marker in common.

    Parameters
    ----------
    plant : Plant
        Plant to be added.
    others : sequence of Plant
        Plants of the catalogue.
    where : str
        Name of the catalogue in messages.

    Raises
    ------
    UserError
        If two strips have a common marker.
    """
    for other in others:
        if plant.tag is not None and other.tag is not None and other.name != plant.name and plant.tag.overlaps(other.tag):
            raise UserError(
                f"{where}: the marker strips of the plants {plant.name} ({plant.tag}) and {other.name} ({other.tag}) have common markers; "
                "print strips with different numbers with `rhizotwin markers SCENE --labels N`"
            )


def _is_known(value: Any) -> bool:
    """Return whether a field of a plant has been filled in.

    A replicate of 0 counts as filled in.
    """
    return value.known if isinstance(value, Solution) else not (value is None or value is False or value == "")
