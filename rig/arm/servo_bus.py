"""Common interface of the two servo protocols, with checks of commands and reading with timeouts."""

from collections.abc import Callable, Collection, Mapping
from typing import Protocol, TypeVar

from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.serial_line.port import Wire

HEADER = b"\x55\x55"
MIN_COUNTS = 0
MAX_COUNTS = 1000
MAX_MOVE_S = 30.0
"""Maximum duration of a move command, s. Longer moves must be divided."""
_FLOOD_BYTES = 4096
_LAST_ID = 253

Found = TypeVar("Found")


class ServoBus(Protocol):
    """Servos that are addressed by number.

    Positions are in counts of 0.24 deg. All methods raise `NoAnswerError` when their retries are exhausted.
    """

    least_move_s: float
    """Minimum recommended duration of a move, s."""

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start the moves of all given servos at the same time, and return immediately.

        Each servo moves at uniform speed. The torque is switched on if it was off.

        Raises
        ------
        UnsafeError
            If a position is outside 0 to 1000 or the duration outside 0 to 30 s; nothing is sent.
        """

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read the positions of the servos, in counts, keyed by servo number.

        They are signed, and can be outside the range of 0 to 1000 if a servo was rotated by hand.
        """

    def voltage_v(self, ids: Collection[int]) -> float:
        """Return the lowest supply voltage measured by these servos, V."""

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int] | None:
        """Read the temperatures of the servos in °C, keyed by servo number.

        The result is None if the protocol does not report temperatures.
        """

    def loaded(self, ids: Collection[int]) -> dict[int, bool] | None:
        """Read whether the torque of each servo is on.

        The result is None if the protocol does not report the torque.
        """

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch the torque of the servos on or off.

        An error is raised only after all servos have been tried.
        """

    def stop(self, ids: Collection[int]) -> None:
        """Stop the servos in their present positions.

        The torque remains on.
        """

    def describe(self) -> str:
        """Return a short description of the bus."""

    def close(self) -> None:
        """Close the serial line."""


def check_move(targets: Mapping[int, int], duration_s: float) -> None:
    """Raise an error if the duration, a servo number or a position of a move command is outside its limits."""
    if not 0.0 <= duration_s <= MAX_MOVE_S:
        raise UnsafeError(f"arm: a move of {duration_s:g} s is outside 0 to {MAX_MOVE_S:g} s and was not sent; split it")
    for servo, counts in targets.items():
        if not 0 <= servo <= _LAST_ID:
            raise UnsafeError(f"arm: servo number {servo} is outside 0 to {_LAST_ID} and was not commanded; correct the rig file")
        if not MIN_COUNTS <= counts <= MAX_COUNTS:
            raise UnsafeError(
                f"arm: position {counts} of servo {servo} is outside {MIN_COUNTS} to {MAX_COUNTS} counts and was not sent;"
                " check the joint's limits and zero_counts in the rig file"
            )


def listen(wire: Wire, patience_s: float, find: Callable[[bytes], Found | None]) -> tuple[Found | None, bytes]:
    """Collect bytes until ``find`` returns a result or the timeout expires.

    Return this result, or None if there is none, and all received bytes. Reading also ends after a few thousand bytes,
    so that the function returns even if the line never stops sending.

    Parameters
    ----------
    wire : Wire
        Line to read from.
    patience_s : float
        Timeout, s.
    find : callable
        Function of all bytes received so far; it returns None to continue reading.

    Returns
    -------
    (Found or None), bytes
        Result of ``find``, and all received bytes.
    """
    clock = wire.clock
    deadline_s = clock.now_s() + patience_s
    heard = b""
    while (left_s := deadline_s - clock.now_s()) > 0.0 and len(heard) < _FLOOD_BYTES:
        chunk = wire.read(left_s)
        if not chunk:
            break
        heard += chunk
        found = find(heard)
        if found is not None:
            return found, heard
    return None, heard
