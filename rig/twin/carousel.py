"""Emulated carousel, which moves in virtual time.

It can be blocked, or contain canisters in wrong places.
"""

from collections.abc import Callable

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.errors import UnsafeError

LIFT_S = 4.0
"""Time for lifting a canister onto the turntable or off it, s."""
STEP_S = 1.5
"""Time for rotating the carousel by one place, s."""


class TwinCarousel:
    """Emulated canister changer.

    It implements `rig.devices.Carousel`.

    Parameters
    ----------
    clock
        Clock of the twin, which movements advance.
    canisters
        Number of the canister in each place, beginning with place 1; 0 for an empty place.
    put
        Function that is called with the number of the canister placed on the turntable, or 0 for an empty turntable.
    """

    def __init__(self, clock: Clock, canisters: list[int], put: Callable[[int], object]) -> None:
        self._clock = clock
        self._canisters = canisters
        self._put = put
        self._at = 1
        self._loaded = 0
        self.blocked = False
        """Whether the carousel is blocked. A blocked carousel raises an error when it has to rotate."""

    def describe(self) -> str:
        """Return a short description with the number of places."""
        return f"emulated carousel with {len(self._canisters)} places"

    def prepare(self) -> None:
        """Rotate the carousel to place 1."""
        self._turn(1)

    def load(self, place: int) -> None:
        """Move the canister from the given place to the turntable.

        Raises
        ------
        UnsafeError
            If the carousel is blocked, the place does not exist, or the place is empty.
        """
        if self._loaded == place:
            return
        self.unload()
        if not 1 <= place <= len(self._canisters):
            raise UnsafeError(f"carousel: there is no place {place}, only places 1 to {len(self._canisters)}; correct the experiment file")
        self._turn(place)
        if not self._canisters[place - 1]:
            raise UnsafeError(f"carousel: place {place} is empty; put the canister there and continue")
        self._clock.sleep(LIFT_S)
        self._loaded = place
        self._put(self._canisters[place - 1])

    def unload(self) -> None:
        """Return the canister on the turntable to its place."""
        if self._loaded:
            self._turn(self._loaded)
            self._clock.sleep(LIFT_S)
            self._loaded = 0
            self._put(0)

    def close(self) -> None:
        """Do nothing, because there is no port to close."""

    def _turn(self, place: int) -> None:
        if self.blocked:
            raise UnsafeError("carousel: the carousel does not rotate; remove the obstacle and continue")
        self._clock.sleep(STEP_S * abs(place - self._at))
        self._at = place
