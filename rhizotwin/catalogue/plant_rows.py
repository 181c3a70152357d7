"""Plants as rows of a catalogue: read, completed, and checked against each other."""

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.solution import Solution, check_solution

KEPT = ("notes", "solution")
"""Fields that may differ: notes are replaced, and the first nutrient solution is kept (each scan has its own)."""


def solution_text(solution: Solution) -> str:
    """Return a nutrient solution as it is stored; empty if nothing is known."""
    return json.dumps(to_plain(solution), sort_keys=True) if solution.known else ""


def plant_of(row: sqlite3.Row, *, where: str) -> Plant:
    """Return the plant of a row; ``where`` is the catalogue, for messages.

    Raises
    ------
    UserError
        If its nutrient solution is damaged.
    """
    place = Place(f"{where}, plant {row['name']!r}").at("solution")
    solution = Solution()
    if row["content"] is not None:
        try:
            plain = json.loads(row["content"])
        except (ValueError, RecursionError):
            raise place.error("is no readable JSON") from None
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


def merge(before: Plant, now: Plant, *, where: str) -> Plant:
    """Return a plant with what either entry knows; ``where`` is the catalogue, for messages.

    Raises
    ------
    UserError
        If the two contradict each other.
    """
    changed: dict[str, Any] = {}
    for field in fields(Plant):
        old, new = getattr(before, field.name), getattr(now, field.name)
        has_old, has_new = (_is_known(one) for one in (old, new))
        if not has_new or new == old:
            continue
        if has_old and field.name not in KEPT:
            raise UserError(f"{where}: plant {now.name} has the {field.name} {old}, not {new}; correct one of them")
        if not has_old or field.name == "notes":
            changed[field.name] = new
    return replace(before, **changed)


def refuse_tag(plant: Plant, others: Sequence[Plant], *, where: str) -> None:
    """Reject a strip that shares markers with that of another plant.

    Parameters
    ----------
    plant : Plant
        The plant that is added.
    others : sequence of Plant
        The plants of the catalogue.
    where : str
        The catalogue, for messages.

    Raises
    ------
    UserError
        With both strips.
    """
    for other in others:
        if plant.tag is not None and other.tag is not None and other.name != plant.name and plant.tag.overlaps(other.tag):
            raise UserError(
                f"{where}: the strip of plant {plant.name} ({plant.tag}) shares markers with that of {other.name} ({other.tag}); "
                "print a strip with other numbers with `rhizotwin markers SCENE --labels N`"
            )


def _is_known(value: Any) -> bool:
    """Return whether the value of a field states anything; replicate 0 does."""
    return value.known if isinstance(value, Solution) else not (value is None or value is False or value == "")
