"""Identity of the plant on the table, by the markers of the strip on its pot.

Each pot has a strip with marker numbers of its own, so that every picture of a scan shows which plant it is.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.markers import get_dictionary
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.picture_codec import Grey

LEAST_MARKERS = 4
"""Markers of one strip that a picture must show; a misread marker has any number, but four do not agree by accident."""


class WrongPlantError(UserError):
    """Another plant than expected is on the table, or none that is known."""

    def __init__(self, text: str, *, found: str = "") -> None:
        super().__init__(text)
        self.found = found
        """Name of the plant on the table; empty: not known."""


def strip_for_canister(strip: MarkerStrip, canister: int) -> MarkerStrip:
    """Return the strip of a numbered canister: canister 1 has the strip as given, the next one the numbers after it.

    Raises
    ------
    UserError
        If the dictionary has too few markers for this number.
    """
    count = strip.rows * strip.columns
    if not count:
        raise UserError(f"canister {canister}: a scene without a marker strip (strip.rows = 0) cannot identify plants")
    first = strip.first_id + (canister - 1) * count
    capacity = len(get_dictionary(strip.dictionary).bytesList)
    most = (capacity - strip.first_id) // count
    if not 1 <= canister <= most:
        raise UserError(
            f"canister {canister}: {strip.dictionary} has {capacity} markers, enough for {most} strips of {count}; "
            "use a larger dictionary such as 6X6_1000 in [strip]"
        )
    return replace(strip, first_id=first)


def tag_in(ids: Iterable[int], tags: Sequence[Tag]) -> Tag | None:
    """Return the tag that the markers in a picture belong to.

    Parameters
    ----------
    ids : iterable of int
        Marker numbers of one dictionary.
    tags : sequence of Tag
        The tags of that dictionary.

    Returns
    -------
    Tag or None
        None if fewer than `LEAST_MARKERS` belong to one tag, or no fewer belong to another strip.
    """
    numbers = set(ids)
    counts = {tag: sum(tag.first_id <= one <= tag.last_id for one in numbers) for tag in tags}
    best = max(counts, key=lambda tag: counts[tag], default=None)
    if best is None or counts[best] < LEAST_MARKERS or len(numbers) - counts[best] >= counts[best]:
        return None
    return best


def identify(image: Grey, plants: Sequence[Plant], strip: MarkerStrip) -> Plant:
    """Return the plant whose strip a picture shows.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture of the canister on the table.
    plants : sequence of Plant
        The plants of the catalogue.
    strip : MarkerStrip
        Strip of the rig's scene; its dictionary is read first.

    Raises
    ------
    WrongPlantError
        If no strip can be read, or it is that of no plant.
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
            "the strip of the canister on the table cannot be read: put a canister on the table, and see that its strip is lit, "
            "in the picture and in focus"
        )
    raise WrongPlantError(
        f"the canister on the table is that of no plant in the catalogue ({dictionary} markers {ids[0]} to {ids[-1]}): "
        "put the right canister on the table, or add the plant with its canister's number"
    )


def check_plant(expected: Plant, plants: Sequence[Plant], strip: MarkerStrip) -> Callable[[Grey], None]:
    """Return the check of a scan's first picture, for `rig.scanning.observers.Observers.identify`.

    Parameters
    ----------
    expected : Plant
        Plant that is to be scanned.
    plants : sequence of Plant
        The plants of the catalogue.
    strip : MarkerStrip
        Strip of the rig's scene.
    """

    def check(image: Grey) -> None:
        found = identify(image, plants, strip)
        if found.name != expected.name:
            raise WrongPlantError(
                f"the canister on the table is that of plant {found.name}, not {expected.name}: put {expected.name} on the table",
                found=found.name,
            )

    return check
