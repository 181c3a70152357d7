"""Driver of the LSC servo controller board, which is part of the xArm 1S.

The serial line has 9600 Bd, and the protocol has no checksums and no acknowledgements. Frame: ``55 55 | length |
command | parameters``, length = parameters + 2 (Hiwonder, LSC communication protocol). The board may send unsolicited
frames at any time.

Because checksums are missing, a damaged reading may appear valid. Therefore a reading is accepted only if a second
reading agrees, and if it contains exactly the requested servos.

The board also executes a damaged command with a valid header and length, and the protocol offers no way to verify a
command before the servos move. Sending a command twice does not help, because the second copy may be damaged. The
countermeasures are as follows. A frame is sent in one piece immediately after two readings on the same line have
agreed. No move is shorter than `LscBoard.least_move_s`, so that a wrong target is not reached at full speed.
`rig.arm.arm` compares every position with the commanded position at the end of each move, and stops with an error if
they differ.

The remaining risks are motion toward a wrong position until the end of a move, and a damaged duration that makes the
joints move faster. For unattended work the servo bus (protocol "lx"), which has checksums, is preferable.
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
"""Timeouts of the successive attempts to get a reply, s. Some boards take up to 450 ms to read all positions."""
_AGREE_TRIES = 8
_REST = bytes(100)
"""Zeros that are sent if the board does not reply. The board may have received a damaged length and may be waiting for
the rest of that frame."""
_AGREE_COUNTS = 1
_AGREE_V = 0.2
_HOLD_S = 1.0


def frame(command: int, params: bytes = b"") -> bytes:
    """Build the frame of a command with its parameters."""
    return HEADER + bytes((len(params) + 2, command)) + params


def find_frames(heard: bytes, command: int) -> Iterator[bytes]:
    """Yield the parameters of every complete frame with this command, newest first.

    Frames of other commands and invalid bytes are skipped.
    """
    at = heard.rfind(HEADER)
    while at >= 0:
        body = heard[at + 2 :]
        if len(body) >= 2 and body[1] == command and 2 <= body[0] <= len(body):
            yield body[2 : body[0]]
        at = heard.rfind(HEADER, 0, at + 1)


def find_positions(heard: bytes, ids: Collection[int]) -> dict[int, int] | None:
    """Return the positions in the newest reply that contains all of these servos and no others.

    They are in counts, keyed by servo number. The board may omit a servo that does not reply to it.
    """
    for params in find_frames(heard, MULT_SERVO_POS_READ):
        positions = _positions(params)
        if positions is not None and positions.keys() == set(ids):
            return positions
    return None


class LscBoard:
    """Driver of the servo controller board, which is connected through its TTL serial header.

    No requests should be sent while the arm moves, because they make the motion jerky.
    """

    least_move_s = 2.0

    def __init__(self, wire: Wire) -> None:
        self._wire = wire

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start the moves of all given servos with one frame, and return immediately.

        The move cannot be verified before it ends.

        Raises
        ------
        UnsafeError
            If a position is outside 0 to 1000 or the duration outside 0 to 30 s; nothing is sent.
        """
        check_move(targets, duration_s)
        params = bytes((len(targets),)) + round(duration_s * 1000.0).to_bytes(2, "little")
        for servo, counts in targets.items():
            params += bytes((servo,)) + counts.to_bytes(2, "little")
        self._wire.write(frame(SERVO_MOVE, params))

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read the signed positions repeatedly until two successive readings agree, and return them in counts.

        Raises
        ------
        NoAnswerError
            If the board does not reply or omits a servo, or if no two successive readings agree.
        """
        before = self._positions_once(ids)
        for _ in range(_AGREE_TRIES):
            now = self._positions_once(ids)
            if all(abs(now[servo] - before[servo]) <= _AGREE_COUNTS for servo in ids):
                return now
            before = now
        raise NoAnswerError(
            "arm: repeated readings of the positions differ; check that the arm is at rest, and check the line to its board"
        )

    def voltage_v(self, ids: Collection[int]) -> float:  # noqa: ARG002 - for the servo bus
        """Read the board's supply voltage until two successive readings agree. All servos share this supply."""
        before_v = self._voltage_once()
        for _ in range(_AGREE_TRIES):
            now_v = self._voltage_once()
            if abs(now_v - before_v) <= _AGREE_V:
                return now_v
            before_v = now_v
        raise NoAnswerError("arm: repeated readings of the voltage differ; check the supply and the line to the board")

    def temperatures_c(self, ids: Collection[int]) -> None:  # noqa: ARG002 - for the servo bus
        """Return None, because this board does not report temperatures."""
        return

    def loaded(self, ids: Collection[int]) -> None:  # noqa: ARG002 - for the servo bus
        """Return None, because this board does not report the torque."""
        return

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch the torque off, or switch it on by commanding a move to the measured positions."""
        if on:
            self.move(self.positions(ids), _HOLD_S)
            return
        unload = frame(MULT_SERVO_UNLOAD, bytes((len(ids), *ids)))
        # the board does not acknowledge this command, and repeating it is harmless
        for _ in range(2):
            self._wire.write(unload)

    def stop(self, ids: Collection[int]) -> None:
        """Stop the servos by commanding their present positions, since the board has no stop command.

        The median of three readings is a position on the path, even if the arm moves and one reading is damaged.
        """
        readings = [self._positions_once(ids) for _ in range(3)]
        places = {servo: median(reading[servo] for reading in readings) for servo in ids}
        self.move({servo: min(max(round(place), MIN_COUNTS), MAX_COUNTS) for servo, place in places.items()}, _HOLD_S)

    def describe(self) -> str:
        """Return the name of the board."""
        return "LSC servo board"

    def close(self) -> None:
        """Close the serial line."""
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
                    f"arm: the board reports no position for servo {', '.join(map(str, missing))}; check the servo's cable and number"
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
        """Send a request repeatedly until a valid reply is found.

        Return the result of ``find``, or None if all attempts have failed, and all received bytes.
        """
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
    """Parse parameters that consist of a number n and n pairs of a servo id and a position.

    Return None if the length is inconsistent or an id is repeated.
    """
    if not params or len(params) != 1 + 3 * params[0]:
        return None
    triples = [params[at : at + 3] for at in range(1, len(params), 3)]
    positions = {triple[0]: int.from_bytes(triple[1:], "little", signed=True) for triple in triples}
    return positions if len(positions) == len(triples) else None


def _silence(heard: bytes) -> NoAnswerError:
    if heard:
        return NoAnswerError(f"arm: the replies of the board are invalid; check the cable, and that the line runs at {BAUD} Bd")
    return NoAnswerError("arm: the board does not reply; check that it is switched on and that TX and RX are not swapped")
