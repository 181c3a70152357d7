"""Results for each of several plants in a canister."""

from __future__ import annotations

from dataclasses import dataclass

from rhizotwin.recon.results.parts import Json
from rhizotwin.scenes import subject
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PlantResult:
    """Result for one of several plants."""

    subject: Subject
    """Subject of the plant."""
    at_mm: Pair
    """Given attachment point in the net pot's grid."""
    volume_mm3: float
    """Volume of the plant's roots."""
    volume_interval_mm3: Pair
    """90 % interval of the volume, which combines that of the total volume with the volume of uncertain assignment."""
    open_mm: float
    """Length of its roots that may belong to another plant."""
    traits: Traits

    def plain(self) -> Json:
        """Return the values as a JSON object."""
        plain: Json = to_plain(self)
        return plain


def from_summary(summary: Json, where: str) -> tuple[PlantResult, ...]:
    """Return the plants of a ``result.json``; empty for a single plant and in results of earlier versions.

    Raises
    ------
    UserError
        If the entry is damaged.
    """
    place = Place(where).at("plants")
    found = from_plain(_Plants, {"plants": summary.get("plants") or []}, Place(where)).plants
    for number, one in enumerate(found):
        subject.check_subject(one.subject, place.at(number, "subject"))
    return found


@dataclass(frozen=True, kw_only=True)
class _Plants:
    plants: tuple[PlantResult, ...]
