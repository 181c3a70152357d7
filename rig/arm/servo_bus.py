"""What both servo protocols offer the arm, and what they share: limits of a command, and listening with patience."""

from collections.abc import Callable, Collection, Mapping
from typing import Protocol, TypeVar

from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.serial_line.port import Wire

HEADER = b"\x55\x55"
MIN_COUNTS = 0
MAX_COUNTS = 1000
MAX_MOVE_S = 30.0
"""The longest duration a move command can carry; what takes longer must be sent in parts."""
_FLOOD_BYTES = 4096
_LAST_ID = 253

Found = TypeVar("Found")


class ServoBus(Protocol):
    """Servos by number, positions in counts of 0.24 degrees.

    Every method raises `NoAnswerError` when its retries are used up.
    """

    least_move_s: float
    """Moves should not be commanded to be shorter than this."""

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start all these servos together, at a uniform speed each; return at once. Torque comes on where it was off.

        Raises
        ------
        UnsafeError
            For a position outside 0 to 1000 or a duration outside 0 to 30 s, before anything is sent.
        """

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read positions: signed, and beyond 0 to 1000 where a servo was turned by hand."""

    def voltage_v(self, ids: Collection[int]) -> float:
        """Read the supply: the lowest that any of these servos sees."""

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int] | None:
        """Read temperatures; None when the protocol cannot tell."""

    def loaded(self, ids: Collection[int]) -> dict[int, bool] | None:
        """Read whether torque is on; None when the protocol cannot tell."""

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch torque on or off; every servo is tried before an error is raised."""

    def stop(self, ids: Collection[int]) -> None:
        """Stop where they are, torque on."""

    def describe(self) -> str:
        """Say in a few words what kind of bus it is."""

    def close(self) -> None:
        """Close the line."""


def check_move(targets: Mapping[int, int], duration_s: float) -> None:
    """Refuse a command that must never reach a servo."""
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
    """Collect bytes until ``find`` finds something in them or patience ends; return that and all that was heard.

    A line that babbles without end is left after a few thousand bytes, so that this returns whatever comes.

    Parameters
    ----------
    wire : Wire
        The line.
    patience_s : float
        How long without a finding.
    find : callable
        Looks at all bytes so far; None: go on.

    Returns
    -------
    (Found or None), bytes
        What was found, and everything heard.
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
