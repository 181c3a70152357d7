"""The emulated carousel: places, time, and what is in its way."""

import pytest

from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.twin.carousel import LIFT_S, STEP_S, TwinCarousel
from rhizotwin.rig.twin.clock import VirtualClock


def test_canisters_are_changed_in_virtual_time():
    clock, table = VirtualClock(), list[int]()
    carousel = TwinCarousel(clock, [1, 7, 0], table.append)
    carousel.prepare()
    carousel.load(2)
    carousel.load(2)
    assert (table, clock.now_s()) == ([7], LIFT_S + STEP_S)
    carousel.load(1)
    carousel.unload()
    carousel.unload()
    assert table == [7, 0, 1, 0]


@pytest.mark.parametrize(("place", "words"), [(3, "place 3 is empty"), (4, "there is no place 4, only places 1 to 3")])
def test_places_without_a_canister(place: int, words: str):
    with pytest.raises(UnsafeError, match=words):
        TwinCarousel(VirtualClock(), [1, 7, 0], lambda _: None).load(place)


def test_blocked():
    carousel = TwinCarousel(VirtualClock(), [1], lambda _: None)
    carousel.blocked = True
    with pytest.raises(UnsafeError, match="remove the obstacle"):
        carousel.prepare()
