"""The emulated carousel: it moves in virtual time, may be blocked, and may hold canisters in the wrong places."""

from collections.abc import Callable

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.errors import UnsafeError

LIFT_S = 4.0
"""Time to lift a canister onto the turntable, or off it."""
STEP_S = 1.5
"""Time to turn the carousel by one place."""


class TwinCarousel:
    """A `rig.devices.Carousel` without hardware.

    Parameters
    ----------
    clock
        Whose time its movements take.
    canisters
        Number of the canister in each place, from place 1; 0: the place is empty.
    put
        Called with the number of the canister that has been put on the turntable; 0: it is empty.
    """

    def __init__(self, clock: Clock, canisters: list[int], put: Callable[[int], object]) -> None:
        self._clock = clock
        self._canisters = canisters
        self._put = put
        self._at = 1
        self._loaded = 0
        self.blocked = False
        """Whether something is in its way."""

    def describe(self) -> str:
        """Return a short description."""
        return f"emulated carousel with {len(self._canisters)} places"

    def prepare(self) -> None:
        """Turn to place 1."""
        self._turn(1)

    def load(self, place: int) -> None:
        """Put the canister of a place on the turntable.

        Raises
        ------
        UnsafeError
            When it is blocked, or has no such place, or the place is empty.
        """
        if self._loaded == place:
            return
        self.unload()
        if not 1 <= place <= len(self._canisters):
            raise UnsafeError(f"carousel: has no place {place}, only 1 to {len(self._canisters)}; correct the experiment file")
        self._turn(place)
        if not self._canisters[place - 1]:
            raise UnsafeError(f"carousel: place {place} is empty; put the canister there and go on")
        self._clock.sleep(LIFT_S)
        self._loaded = place
        self._put(self._canisters[place - 1])

    def unload(self) -> None:
        """Put the canister on the turntable back to its place."""
        if self._loaded:
            self._turn(self._loaded)
            self._clock.sleep(LIFT_S)
            self._loaded = 0
            self._put(0)

    def close(self) -> None:
        """Do nothing."""

    def _turn(self, place: int) -> None:
        if self.blocked:
            raise UnsafeError("carousel: does not turn; remove what blocks it and go on")
        self._clock.sleep(STEP_S * abs(place - self._at))
        self._at = place
