"""Plants in a canister that contains several plants, with their names and attachment points.

They are attached in the grid of the net pot.
"""

from dataclasses import dataclass, replace

from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.specimens import GrownSpecimen, PlacedFile, Specimen, SphereSpecimen
from rhizotwin.scenes.subject import Subject, check_subject

APART_MM = 2.0
"""Minimum distance between two plants, mm. Closer plants are in the same hole of the net pot's grid, and their bases
cannot be distinguished."""

NAMELESS = "plant"
"""Name used in RSML files for a plant without a name (`scenes.rsml`)."""


@dataclass(frozen=True, kw_only=True)
class Plant:
    """Plant in a canister with several plants."""

    plant: str = ""
    """Name of the plant. It must be unique in the scene and the same on every day."""
    species: str = ""
    """Latin name of the species. If it is empty, the species in [subject] is used."""
    treatment: str = ""
    """Treatment of this plant. If it is empty, the treatment in [subject] is used."""
    at_mm: tuple[float, float] = bounded((0.0, 0.0), -500.0, 500.0)
    """Attachment point (x, y) in the net pot's grid, in the canister frame. The x axis of this frame passes through the
    seam of the strip."""
    specimen: Specimen | None = None
    """Specimen in the twin, as in [specimen], displaced horizontally by `at_mm`. It is None if it is unknown, as on a
    real rig and in every dataset."""

    def placed(self) -> Specimen | None:
        """Return the specimen displaced to the attachment point of the plant, or None if it is unknown."""
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
        """Return the canister's subject with the name, species and treatment of this plant."""
        own = {name: getattr(self, name) for name in ("species", "treatment") if getattr(self, name)}
        return replace(whole, plant=self.plant, **own)


def check_plants(plants: tuple[Plant, ...], subject: Subject, *, radius_mm: float, place: Place) -> None:
    """Raise an error if plants cannot be distinguished or are outside the canister.

    Parameters
    ----------
    plants : tuple of Plant
        Plants of a scene; empty for a single or unnamed plant.
    subject : Subject
        Subject of the scene.
    radius_mm : float
        Radius of the water column.
    place : Place
        Place of the scene in its file, used in messages.

    Raises
    ------
    UserError
        If a value is invalid; the message states the plant, the value and the condition.
    """
    if plants and subject.plant:
        raise place.at("subject", "plant").error("must be omitted if there are [[plants]], which have their own names", subject.plant)
    for number, one in enumerate(plants):
        here, before = place.at("plants", number), plants[:number]
        check_subject(one.subject(subject), here)
        if not one.plant:
            raise here.at("plant").error("must not be empty, because roots, tables and files are identified by the plant's name", one.plant)
        if one.plant == NAMELESS:
            raise here.at("plant").error("is reserved for plants without a name; choose another name", one.plant)
        if any(other.plant == one.plant for other in before):
            raise here.at("plant").error(
                "is already the name of another plant in this scene; each plant must have a unique name", one.plant
            )
        x, y = one.at_mm
        if x * x + y * y >= radius_mm**2:
            raise here.at("at_mm").error(f"must be within {radius_mm:g} mm of the axis, inside the canister's wall", [x, y])
        near = [other for other in before if (other.at_mm[0] - x) ** 2 + (other.at_mm[1] - y) ** 2 < APART_MM**2]
        if near:
            must = f"must be at least {APART_MM:g} mm from {near[0].plant}, so that the bases of the plants can be distinguished"
            raise here.at("at_mm").error(must, [x, y])
