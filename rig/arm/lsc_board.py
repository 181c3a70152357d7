"""The servo controller board (LSC, as in the xArm 1S).

9600 Bd, no checksum, no answer to commands, frames of its own at any time.

Frame: ``55 55 | length | command | parameters``, length = parameters + 2 (Hiwonder, LSC communication protocol).

What a missing checksum means. *Readings*: a damaged one may look whole, so a reading counts only when a second one
agrees with it, and only with exactly the servos that were asked for. *Commands*: the board obeys a damaged frame whose
header and length survived, and nothing in the protocol lets the host ask what it understood before the servos move;
sending twice would not help, since the second copy can be the damaged one. What is done about it: a frame goes out in
one piece right after a reading of the same line agreed with itself; no move is commanded to be shorter than
`LscBoard.least_move_s`, so that a wrong target is at least not reached in one swing; `rig.arm.arm` compares every
position with the commanded one as soon as the move's time is over, stops there and says so. What remains: the way to a
wrong place, until that moment, and a damaged time that makes the joints run faster. For unattended work prefer the
servo bus (protocol "lx"), which has checksums.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from statistics import median

from rhizotwin.rig.arm.servo_bus import HEADER, MAX_COUNTS, MIN_COUNTS, Found, check_move, listen
from rhizotwin.rig.errors import NoAnswerError
from rhizotwin.rig.serial_line.port import Wire

BAUD = 9600
SERVO_MOVE = 3
GET_BATTERY_VOLTAGE = 15
MULT_SERVO_UNLOAD = 20
MULT_SERVO_POS_READ = 21

_PATIENCE_S = (0.6, 0.6, 0.8, 1.0)
"""A reading of all positions takes up to 450 ms on some boards."""
_AGREE_TRIES = 8
_REST = bytes(100)
"""Zeros for a silent board: it may wait for the rest of a frame whose length was damaged on the way."""
_AGREE_COUNTS = 1
_AGREE_V = 0.2
_HOLD_S = 1.0


def frame(command: int, params: bytes = b"") -> bytes:
    """Build a frame."""
    return HEADER + bytes((len(params) + 2, command)) + params


def find_frames(heard: bytes, command: int) -> Iterator[bytes]:
    """Yield the parameters of every complete frame with this command, newest first.

    The board's own frames and garbage are passed over.
    """
    at = heard.rfind(HEADER)
    while at >= 0:
        body = heard[at + 2 :]
        if len(body) >= 2 and body[1] == command and 2 <= body[0] <= len(body):
            yield body[2 : body[0]]
        at = heard.rfind(HEADER, 0, at + 1)


def find_positions(heard: bytes, ids: Collection[int]) -> dict[int, int] | None:
    """Return the newest reading with exactly these servos: a board may omit one that does not reply."""
    for params in find_frames(heard, MULT_SERVO_POS_READ):
        positions = _positions(params)
        if positions is not None and positions.keys() == set(ids):
            return positions
    return None


class LscBoard:
    """The controller board on its TTL serial header.

    Never ask it anything while the arm moves: the motion gets jerky.
    """

    least_move_s = 2.0

    def __init__(self, wire: Wire) -> None:
        self._wire = wire

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start all servos simultaneously with one frame; return immediately.

        It cannot be verified before its time is over.

        Raises
        ------
        UnsafeError
            For a position outside 0 to 1000 or a duration outside 0 to 30 s, before anything is sent.
        """
        check_move(targets, duration_s)
        params = bytes((len(targets),)) + round(duration_s * 1000.0).to_bytes(2, "little")
        for servo, counts in targets.items():
            params += bytes((servo,)) + counts.to_bytes(2, "little")
        self._wire.write(frame(SERVO_MOVE, params))

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read positions, signed, until two consecutive readings agree.

        Raises
        ------
        NoAnswerError
            When the board is silent, leaves a servo out, or no two readings agree.
        """
        before = self._positions_once(ids)
        for _ in range(_AGREE_TRIES):
            now = self._positions_once(ids)
            if all(abs(now[servo] - before[servo]) <= _AGREE_COUNTS for servo in ids):
                return now
            before = now
        raise NoAnswerError(
            "arm: repeated readings of the positions differ; the arm is pushed or falls "
            "unpowered, or the connection to its board is disturbed"
        )

    def voltage_v(self, ids: Collection[int]) -> float:  # noqa: ARG002
        """Read the supply voltage of the board, common to all servos, until two consecutive readings agree."""
        before_v = self._voltage_once()
        for _ in range(_AGREE_TRIES):
            now_v = self._voltage_once()
            if abs(now_v - before_v) <= _AGREE_V:
                return now_v
            before_v = now_v
        raise NoAnswerError(
            "arm: repeated readings of the voltage differ; the supply is unstable, or the connection to the board is disturbed"
        )

    def temperatures_c(self, ids: Collection[int]) -> None:  # noqa: ARG002
        """Return None: the board does not report it."""
        return

    def loaded(self, ids: Collection[int]) -> None:  # noqa: ARG002
        """Return None: the board does not report it."""
        return

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch torque off; or on, by a move to the current positions."""
        if on:
            self.move(self.positions(ids), _HOLD_S)
            return
        unload = frame(MULT_SERVO_UNLOAD, bytes((len(ids), *ids)))
        # Nothing tells whether it arrived, and twice does no harm.
        for _ in range(2):
            self._wire.write(unload)

    def stop(self, ids: Collection[int]) -> None:
        """Command the servos to their current positions, because there is no stop command.

        The median of three readings is a place on the way that the servo came, even while it moves and one reading is
        damaged.
        """
        readings = [self._positions_once(ids) for _ in range(3)]
        places = {servo: median(reading[servo] for reading in readings) for servo in ids}
        self.move({servo: min(max(round(place), MIN_COUNTS), MAX_COUNTS) for servo, place in places.items()}, _HOLD_S)

    def describe(self) -> str:
        """Name the controller board."""
        return "LSC servo board"

    def close(self) -> None:
        """Close the line."""
        self._wire.close()

    def _positions_once(self, ids: Collection[int]) -> dict[int, int]:
        request = frame(MULT_SERVO_POS_READ, bytes((len(ids), *ids)))
        found, heard = self._ask(request, lambda heard: find_positions(heard, ids))
        if found is not None:
            return found
        for params in find_frames(heard, MULT_SERVO_POS_READ):
            missing = sorted(set(ids) - (_positions(params) or {}).keys())
            if 0 < len(missing) < len(ids):
                raise NoAnswerError(
                    f"arm: the board reports no position for servo {', '.join(map(str, missing))}; check its cable and its number"
                )
        raise _silence(heard)

    def _voltage_once(self) -> float:
        def find(heard: bytes) -> int | None:
            return next((int.from_bytes(p, "little") for p in find_frames(heard, GET_BATTERY_VOLTAGE) if len(p) == 2), None)

        millivolts, heard = self._ask(frame(GET_BATTERY_VOLTAGE), find)
        if millivolts is None:
            raise _silence(heard)
        return millivolts / 1000.0

    def _ask(self, request: bytes, find: Callable[[bytes], Found | None]) -> tuple[Found | None, bytes]:
        """Repeat a request until a valid reply is found; return it with all received data."""
        heard_all = b""
        for patience_s in _PATIENCE_S:
            self._wire.discard_input()
            self._wire.write(request)
            found, heard = listen(self._wire, patience_s, find)
            heard_all += heard
            if found is not None:
                return found, heard_all
            if not heard:
                self._wire.write(_REST)
        return None, heard_all


def _positions(params: bytes) -> dict[int, int] | None:
    """Parse ``n, n x (id, position)``; None if the numbers are inconsistent."""
    if not params or len(params) != 1 + 3 * params[0]:
        return None
    triples = [params[at : at + 3] for at in range(1, len(params), 3)]
    positions = {triple[0]: int.from_bytes(triple[1:], "little", signed=True) for triple in triples}
    return positions if len(positions) == len(triples) else None


def _silence(heard: bytes) -> NoAnswerError:
    if heard:
        return NoAnswerError(f"arm: the replies of the board are invalid; check the baud rate of {BAUD} Bd, and the cable")
    return NoAnswerError("arm: the board does not reply; check that it is switched on and that TX and RX are not swapped")
