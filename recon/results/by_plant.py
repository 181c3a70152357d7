"""Results of the individual plants in a canister with several plants."""

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
    """Result of one of several plants in a canister."""

    subject: Subject
    """Plant and its treatment."""
    at_mm: Pair
    """Position of the plant in the grid of the net pot, as given in the scene, mm."""
    volume_mm3: float
    """Volume assigned to the plant, mm3."""
    volume_interval_mm3: Pair
    """90 % interval of the volume, mm3, which includes the volume that may be part of another plant (see
    `recon.uncertainty.budget.part_interval`)."""
    open_mm: float
    """Length of the plant's roots that may be part of another plant, mm."""
    traits: Traits

    def plain(self) -> Json:
        """Convert the result to values that the json module can write."""
        plain: Json = to_plain(self)
        return plain


def from_summary(summary: Json, where: str) -> tuple[PlantResult, ...]:
    """Return the results of the plants in a ``result.json``.

    The tuple is empty for a single plant, and for results of earlier versions.

    Raises
    ------
    UserError
        If the entries of the plants are invalid.
    """
    place = Place(where).at("plants")
    found = from_plain(_Plants, {"plants": summary.get("plants") or []}, Place(where)).plants
    for number, one in enumerate(found):
        subject.check_subject(one.subject, place.at(number, "subject"))
    return found


@dataclass(frozen=True, kw_only=True)
class _Plants:
    plants: tuple[PlantResult, ...]
