"""Interface of both servo protocols, with limits of commands and reading with time-outs."""

from collections.abc import Callable, Collection, Mapping
from typing import Protocol, TypeVar

from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.serial_line.port import Wire

HEADER = b"\x55\x55"
MIN_COUNTS = 0
MAX_COUNTS = 1000
MAX_MOVE_S = 30.0
"""Maximum duration of a move command; longer moves must be divided."""
_FLOOD_BYTES = 4096
_LAST_ID = 253

Found = TypeVar("Found")


class ServoBus(Protocol):
    """Servos by number, positions in counts of 0.24 degrees.

    All methods raise `NoAnswerError` when their retries are exhausted.
    """

    least_move_s: float
    """Minimum recommended duration of a move."""

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start all these servos together, each at a uniform speed; return immediately.

        Torque is switched on if it was off.

        Raises
        ------
        UnsafeError
            For a position outside 0 to 1000 or a duration outside 0 to 30 s, before anything is sent.
        """

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read positions: signed, and possibly beyond 0 to 1000 if a servo was rotated by hand."""

    def voltage_v(self, ids: Collection[int]) -> float:
        """Return the lowest supply voltage measured by these servos."""

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int] | None:
        """Read temperatures; None if the protocol does not report them."""

    def loaded(self, ids: Collection[int]) -> dict[int, bool] | None:
        """Read whether torque is on; None if the protocol does not report it."""

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch torque on or off; all servos are tried before an error is raised."""

    def stop(self, ids: Collection[int]) -> None:
        """Stop the servos in their present positions, with torque on."""

    def describe(self) -> str:
        """Return a short description of the bus."""

    def close(self) -> None:
        """Close the line."""


def check_move(targets: Mapping[int, int], duration_s: float) -> None:
    """Raise an error for a command beyond the limits of the servos."""
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
    """Collect bytes until ``find`` succeeds or the time is over; return its result and all received bytes.

    Reading also ends after a few thousand bytes, so that it returns on a line that never stops sending.

    Parameters
    ----------
    wire : Wire
        Line to read from.
    patience_s : float
        Time-out.
    find : callable
        Function of all bytes received so far; returns None to continue.

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
