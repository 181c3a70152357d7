"""Several plants in one canister: who they are and where each hangs through the net pot's grid."""

from dataclasses import dataclass, replace

from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.specimens import GrownSpecimen, PlacedFile, Specimen, SphereSpecimen
from rhizotwin.scenes.subject import Subject, check_subject

APART_MM = 2.0
"""Least distance between two plants: nearer ones share their hole in the net pot's grid, and no base tells them
apart."""

NAMELESS = "plant"
"""What RSML files call a plant without a name (`scenes.rsml`)."""


@dataclass(frozen=True, kw_only=True)
class Plant:
    """One of several plants in the canister."""

    plant: str = ""
    """Name of the plant, the same on every day; each has one of its own."""
    species: str = ""
    """Latin name; empty: as in [subject]."""
    treatment: str = ""
    """Treatment of this plant; empty: that of [subject]."""
    at_mm: tuple[float, float] = bounded((0.0, 0.0), -500.0, 500.0)
    """Where it hangs through the net pot's grid: x and y in the canister frame, whose x axis runs through the strip's
    seam."""
    specimen: Specimen | None = None
    """What the twin grows there, as in [specimen], moved sideways by `at_mm`; None: not known, as on a real rig and in
    every dataset."""

    def placed(self) -> Specimen | None:
        """Return the specimen where the plant hangs."""
        x, y = self.at_mm
        one = self.specimen
        if isinstance(one, GrownSpecimen):
            ox, oy, oz = one.origin_mm
            return replace(one, origin_mm=(ox + x, oy + y, oz))
        if isinstance(one, SphereSpecimen):
            ox, oy, oz = one.centre_mm
            return replace(one, centre_mm=(ox + x, oy + y, oz))
        if isinstance(one, PlacedFile):
            ox, oy, oz = one.shift_mm
            return replace(one, shift_mm=(ox + x, oy + y, oz))
        return None

    def subject(self, whole: Subject) -> Subject:
        """Return whose roots they are: name, species and treatment of the plant, the rest as of the whole canister."""
        own = {name: getattr(self, name) for name in ("species", "treatment") if getattr(self, name)}
        return replace(whole, plant=self.plant, **own)


def check_plants(plants: tuple[Plant, ...], subject: Subject, *, radius_mm: float, place: Place) -> None:
    """Refuse plants that cannot be told apart or do not stand in the canister.

    Parameters
    ----------
    plants : tuple of Plant
        Of a scene; none: there is one plant, or none that is named.
    subject : Subject
        Of the scene.
    radius_mm : float
        Of the water.
    place : Place
        Of the scene.

    Raises
    ------
    UserError
        With the plant, its value and what it must be.
    """
    if plants and subject.plant:
        raise place.at("subject", "plant").error("must be left out where [[plants]] name the plants", subject.plant)
    for number, one in enumerate(plants):
        here, before = place.at("plants", number), plants[:number]
        check_subject(one.subject(subject), here)
        if not one.plant:
            raise here.at("plant").error("must name the plant: roots, tables and files are told apart by it", one.plant)
        if one.plant == NAMELESS:
            raise here.at("plant").error("is what files call a plant without a name; give it one of its own", one.plant)
        if any(other.plant == one.plant for other in before):
            raise here.at("plant").error("is the name of another plant of this scene; each needs one of its own", one.plant)
        x, y = one.at_mm
        if x * x + y * y >= radius_mm**2:
            raise here.at("at_mm").error(f"must be within {radius_mm:g} mm of the axis, inside the canister's wall", [x, y])
        near = [other for other in before if (other.at_mm[0] - x) ** 2 + (other.at_mm[1] - y) ** 2 < APART_MM**2]
        if near:
            must = f"must be {APART_MM:g} mm or more from {near[0].plant}, or nobody can tell their bases apart"
            raise here.at("at_mm").error(must, [x, y])
