"""Identification of the plant on the turntable from the marker strip on its net pot.

Each net pot has a strip of its own markers, so the plant can be identified in every picture of a scan.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.markers import LARGE_DICTIONARY, MOST_COMMON, strip_count
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.plan import LEAST_MARKERS


class WrongPlantError(UserError):
    """Error raised if the turntable has a plant other than the expected one, or no known plant."""

    def __init__(self, text: str, *, found: str = "") -> None:
        super().__init__(text)
        self.found = found
        """Name of the plant on the turntable. It is empty if the plant is unknown."""


def strip_for_canister(strip: MarkerStrip, canister: int) -> MarkerStrip:
    """Return the marker strip of the canister with a given number.

    Canister 1 has the strip of the scene. The strip of each further canister has the next marker numbers. If the
    dictionary of the scene is too small for a canister, its strip has markers of `LARGE_DICTIONARY`, and is coded if
    that is too small as well (`scenes.markers.marker_ids`).

    Raises
    ------
    UserError
        If the dictionaries are too small for this number.
    """
    count = strip.rows * strip.columns
    if not count:
        raise UserError(
            f"canister {canister}: the scene has no marker strip (strip.rows = 0) by which plants could be identified; add a strip"
        )
    first_id = strip.first_id + (canister - 1) * count
    most = 0
    for dictionary in (strip.dictionary, LARGE_DICTIONARY):
        most = strip_count(dictionary, strip.first_id, count) - strip.first_id // count
        if 1 <= canister <= most:
            return replace(strip, dictionary=dictionary, first_id=first_id)
    raise UserError(
        f"canister {canister}: strips of {count} markers distinguish the canisters 1 to {most} only; reduce the number of columns or "
        "first_id in [strip]"
    )


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
        Tag with most of the markers. None if it has fewer than `LEAST_MARKERS` of them, at most half of them, or less
        than `MOST_COMMON` more than another tag.
    """
    numbers = set(ids)
    counts = sorted(((len(numbers & tag.ids), tag) for tag in tags), key=lambda counted: counted[0], reverse=True)
    (most, best), (others, _) = (*counts, (0, None), (0, None))[:2]
    return best if most >= LEAST_MARKERS and 2 * most > len(numbers) and most >= others + MOST_COMMON else None


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
        f"the canister on the turntable ({dictionary} markers {', '.join(map(str, ids))}) matches no plant in the catalogue, or several; "
        "put the right canister on the turntable, add the plant with the number of its canister, or remove dirt and reflections from "
        "the strip, whose markers may be misread"
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
