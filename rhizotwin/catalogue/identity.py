"""Identification of the plant on the turntable from the marker strip on its net pot.

Each net pot has a strip with unique marker numbers, so the plant can be identified in every picture of a scan.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.markers import get_dictionary
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.picture_codec import Grey

LEAST_MARKERS = 4
"""Minimum number of detected markers that must belong to a strip before it is identified. Misread markers have random
numbers, so that four of them are unlikely to belong to the same strip."""


class WrongPlantError(UserError):
    """Error raised if the turntable has a plant other than the expected one, or no known plant."""

    def __init__(self, text: str, *, found: str = "") -> None:
        super().__init__(text)
        self.found = found
        """Name of the plant on the turntable. It is empty if the plant is unknown."""


def strip_for_canister(strip: MarkerStrip, canister: int) -> MarkerStrip:
    """Return the marker strip of the canister with a given number.

    Canister 1 has the strip of the scene. The strip of each further canister has the next marker numbers.

    Raises
    ------
    UserError
        If the dictionary has too few markers for this number.
    """
    count = strip.rows * strip.columns
    if not count:
        raise UserError(
            f"canister {canister}: the scene has no marker strip (strip.rows = 0) by which plants could be identified; add a strip"
        )
    first = strip.first_id + (canister - 1) * count
    capacity = len(get_dictionary(strip.dictionary).bytesList)
    most = (capacity - strip.first_id) // count
    if not 1 <= canister <= most:
        raise UserError(
            f"canister {canister}: the marker dictionary {strip.dictionary} has {capacity} markers, enough for {most} strips of "
            f"{count} markers; use a larger dictionary in [strip], such as 6X6_1000"
        )
    return replace(strip, first_id=first)


def tag_in(ids: Iterable[int], tags: Sequence[Tag]) -> Tag | None:
    """Return the tag that matches the markers detected in a picture.

    Parameters
    ----------
    ids : iterable of int
        Numbers of detected markers from one dictionary.
    tags : sequence of Tag
        Candidate tags with the same dictionary.

    Returns
    -------
    Tag or None
        Tag whose range includes most markers; None if the range includes fewer than `LEAST_MARKERS` markers or at most
        half of all detected markers.
    """
    numbers = set(ids)
    counts = {tag: sum(tag.first_id <= one <= tag.last_id for one in numbers) for tag in tags}
    best = max(counts, key=lambda tag: counts[tag], default=None)
    if best is None or counts[best] < LEAST_MARKERS or len(numbers) - counts[best] >= counts[best]:
        return None
    return best


def identify(image: Grey, plants: Sequence[Plant], strip: MarkerStrip) -> Plant:
    """Identify the plant in a picture from the markers on the marker strip of its net pot.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture of the canister on the turntable.
    plants : sequence of Plant
        Plants of the catalogue.
    strip : MarkerStrip
        Strip of the rig's scene, whose marker dictionary is searched first.

    Raises
    ------
    WrongPlantError
        If no strip can be read, or no plant has this strip.
    """
    from rhizotwin.rig.scanning.markers import read_ids

    found: dict[str, tuple[int, ...]] = {}
    for dictionary in dict.fromkeys([strip.dictionary, *(one.tag.dictionary for one in plants if one.tag is not None)]):
        ids = found[dictionary] = read_ids(image, MarkerStrip(dictionary=dictionary, columns=4, rows=1))
        tag = tag_in(ids, [one.tag for one in plants if one.tag is not None and one.tag.dictionary == dictionary])
        if tag is not None:
            return next(one for one in plants if one.tag == tag)
    dictionary, ids = max(found.items(), key=lambda item: len(item[1]))
    if len(ids) < LEAST_MARKERS:
        raise WrongPlantError(
            "the markers on the canister could not be read; put a canister on the turntable, and check that its marker strip is "
            "lit, inside the picture and in focus"
        )
    raise WrongPlantError(
        f"the canister on the turntable ({dictionary} markers {ids[0]} to {ids[-1]}) matches no plant in the catalogue; "
        "put the right canister on the turntable, or add the plant with the number of its canister"
    )


def check_plant(expected: Plant, plants: Sequence[Plant], strip: MarkerStrip) -> Callable[[Grey], None]:
    """Return a function that checks in the first picture of a scan whether the turntable has the expected plant.

    The function is passed to a scan as `rig.scanning.observers.Observers.identify`. It raises WrongPlantError if the
    picture does not show the expected plant.

    Parameters
    ----------
    expected : Plant
        Plant to be scanned.
    plants : sequence of Plant
        Plants of the catalogue.
    strip : MarkerStrip
        Marker strip of the rig's scene.
    """

    def check(image: Grey) -> None:
        found = identify(image, plants, strip)
        if found.name != expected.name:
            raise WrongPlantError(
                f"the plant on the turntable is {found.name} instead of {expected.name}; put {expected.name} on the turntable",
                found=found.name,
            )

    return check
