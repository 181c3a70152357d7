"""What a result says of each of several plants in the canister."""

from __future__ import annotations

from dataclasses import dataclass

from rhizotwin.recon.results.parts import Json
from rhizotwin.scenes import subject
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class OfPlant:
    """One of several plants of a result."""

    subject: Subject
    """Whose roots they are."""
    at_mm: Pair
    """Where it hangs through the net pot's grid, as given."""
    volume_mm3: float
    """Its share of the volume."""
    volume_interval_mm3: Pair
    """90 % interval: the whole volume's, and what of its own may be another plant's and the other way round."""
    open_mm: float
    """Length of its roots that may as well be another plant's."""
    traits: Traits

    def plain(self) -> Json:
        """Return it as JSON values."""
        plain: Json = to_plain(self)
        return plain


def of_summary(summary: Json, where: str) -> tuple[OfPlant, ...]:
    """Return the plants that a ``result.json`` tells; none where there is one plant, or in earlier versions.

    Raises
    ------
    UserError
        Where it is damaged.
    """
    place = Place(where).at("plants")
    found = from_plain(_Plants, {"plants": summary.get("plants") or []}, Place(where)).plants
    for number, one in enumerate(found):
        subject.check_subject(one.subject, place.at(number, "subject"))
    return found


@dataclass(frozen=True, kw_only=True)
class _Plants:
    plants: tuple[OfPlant, ...]
