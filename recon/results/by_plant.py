"""Results of each of several plants in the canister."""

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
    """One of several plants in a result."""

    subject: Subject
    """Plant and its treatment."""
    at_mm: Pair
    """Position in the grid of the net pot, as given."""
    volume_mm3: float
    """Volume assigned to the plant."""
    volume_interval_mm3: Pair
    """90 % interval, see `recon.uncertainty.budget.part_interval`; it includes the volume that could belong to another
    plant."""
    open_mm: float
    """Length of its roots that could belong to another plant."""
    traits: Traits

    def plain(self) -> Json:
        """Convert to JSON values."""
        plain: Json = to_plain(self)
        return plain


def from_summary(summary: Json, where: str) -> tuple[PlantResult, ...]:
    """Return the plants in a ``result.json``; empty for a single plant and for results of earlier versions.

    Raises
    ------
    UserError
        If the data are damaged.
    """
    place = Place(where).at("plants")
    found = from_plain(_Plants, {"plants": summary.get("plants") or []}, Place(where)).plants
    for number, one in enumerate(found):
        subject.check_subject(one.subject, place.at(number, "subject"))
    return found


@dataclass(frozen=True, kw_only=True)
class _Plants:
    plants: tuple[PlantResult, ...]
