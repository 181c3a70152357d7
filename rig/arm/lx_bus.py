"""LX bus servos (LX-15D, LX-225, LX-16A ...) on their half-duplex wire.

115200 Bd, a checksum in each frame, no answer to writes.

Frame: ``55 55 | id | length | command | parameters | checksum``, length = parameters + 3, checksum = ~(sum from id on)
& 0xFF (LewanSoul Bus Servo Communication Protocol). A damaged frame is dropped by whoever receives it, so that a wrong
position cannot be commanded; a lost write is noticed because everything written is read back.
"""

from collections.abc import Collection, Mapping
from typing import Literal

from rhizotwin.rig.arm.servo_bus import HEADER, check_move, listen
from rhizotwin.rig.errors import NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Wire

BROADCAST = 254
MOVE_TIME_READ = 2
MOVE_TIME_WAIT_WRITE = 7
MOVE_TIME_WAIT_READ = 8
MOVE_START = 11
MOVE_STOP = 12
TEMP_READ = 26
VIN_READ = 27
POS_READ = 28
LOAD_WRITE = 31
LOAD_READ = 32

_PATIENCE_S = (0.06, 0.06, 0.12, 0.25, 0.5)
"""A servo needs 20 to 30 ms for a reply, and a USB adapter holds data for up to 16 ms; retries allow more."""
_WRITE_TRIES = 4


def frame(servo: int, command: int, params: bytes = b"") -> bytes:
    """Build a frame.

    Parameters
    ----------
    servo : int
        Its number on the bus.
    command : int
        Number of the command.
    params : bytes
        Its bytes.

    Returns
    -------
    bytes
        With head, length and checksum.
    """
    body = bytes((servo, len(params) + 3, command)) + params
    return HEADER + body + bytes((~sum(body) & 0xFF,))


def find_reply(heard: bytes, servo: int, command: int, size: int) -> bytes | None:
    """Return the ``size`` parameters of the newest complete, undamaged reply of this servo to this command.

    Whatever else was heard is passed over: garbage, other servos, cut frames, and the echo of the request, whose length
    differs from its reply's. The search looks behind every header, so a cut frame never swallows the whole one that
    follows it.

    Parameters
    ----------
    heard : bytes
        All bytes since the question.
    servo : int
        Its number on the bus.
    command : int
        Number of the command that was asked.
    size : int
        Number of parameters.

    Returns
    -------
    bytes or None
        None while there is none.
    """
    head = HEADER + bytes((servo, size + 3, command))
    at = heard.rfind(head)
    while at >= 0:
        params = heard[at + len(head) : at + len(head) + size]
        if heard[at : at + len(head) + size + 1] == frame(servo, command, params):
            return params
        at = heard.rfind(head, 0, at + len(head) - 1)
    return None


class LxBus:
    """Servo bus.

    Whether the adapter echoes what is sent never matters to the reading, see `find_reply`; it is detected, unless
    given, from the first answer, and tells a dead adapter (not even the echo) from a dead servo.
    """

    least_move_s = 0.2

    def __init__(self, wire: Wire, *, echo: Literal["auto", "yes", "no"] = "auto") -> None:
        self._wire = wire
        self._echo: bool | None = None if echo == "auto" else echo == "yes"

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start all servos simultaneously; return immediately.

        Every servo gets its target to wait with, all are read back, and only then one broadcast starts them: a servo
        that cannot be reached is found before anything moves. The broadcast reaches every servo that waits, so
        ``targets`` should always name all servos of the arm. Servos that after it do not report the new command are
        started again by number.

        Raises
        ------
        UnsafeError
            For a position outside 0 to 1000 or a duration outside 0 to 30 s, before anything is sent.
        NoAnswerError
            When a servo does not take its target, or does not start while others do.
        """
        check_move(targets, duration_s)
        time_ms = round(duration_s * 1000.0)
        orders = {servo: counts.to_bytes(2, "little") + time_ms.to_bytes(2, "little") for servo, counts in targets.items()}
        for servo, order in orders.items():
            self._write_verified(servo, MOVE_TIME_WAIT_WRITE, order, MOVE_TIME_WAIT_READ)
        receivers, late = [BROADCAST], list(orders)
        for _ in range(_WRITE_TRIES):
            for receiver in receivers:
                self._wire.write(frame(receiver, MOVE_START))
            receivers = late = [servo for servo in late if self._ask(servo, MOVE_TIME_READ, 4) != orders[servo]]
            if not late:
                return
        # The manual does not say whether a move that waited shows here. When no servo shows it, their positions will
        # tell the arm.
        if len(late) < len(orders):
            raise NoAnswerError(f"arm: {_named(late)} did not start moving with the others; check the bus cable")

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read positions, signed."""
        return {servo: int.from_bytes(self._ask(servo, POS_READ, 2), "little", signed=True) for servo in ids}

    def voltage_v(self, ids: Collection[int]) -> float:
        """Read the lowest supply voltage among these servos, which shows a weak supply first."""
        return min(int.from_bytes(self._ask(servo, VIN_READ, 2), "little") for servo in ids) / 1000.0

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int]:
        """Read temperatures."""
        return {servo: self._ask(servo, TEMP_READ, 1)[0] for servo in ids}

    def loaded(self, ids: Collection[int]) -> dict[int, bool]:
        """Read whether torque is on.

        Off where it should be on: a brown-out (power-up switches it off) or the servo protects itself.
        """
        return {servo: self._ask(servo, LOAD_READ, 1) != b"\x00" for servo in ids}

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch torque on or off and read it back; every servo is tried before an error is raised."""
        failure: NoAnswerError | None = None
        for servo in ids:
            try:
                self._write_verified(servo, LOAD_WRITE, bytes((on,)), LOAD_READ)
            except NoAnswerError as error:
                failure = failure or error
        if failure is not None:
            raise failure

    def stop(self, ids: Collection[int]) -> None:
        """Stop the servos. There is no reply, so that the command is sent twice."""
        for servo in (*ids, *ids):
            self._wire.write(frame(servo, MOVE_STOP))

    def describe(self) -> str:
        """Name the servo bus, and whether it echoes."""
        return "LX servo bus" + {None: "", True: " with echo", False: " without echo"}[self._echo]

    def close(self) -> None:
        """Close the line."""
        self._wire.close()

    def _ask(self, servo: int, command: int, size: int) -> bytes:
        request = frame(servo, command)
        heard_any = b""
        for patience_s in _PATIENCE_S:
            self._wire.discard_input()
            self._wire.write(request)
            reply, heard = listen(self._wire, patience_s, lambda heard: find_reply(heard, servo, command, size))
            heard_any += heard
            if self._echo is None and (reply is not None or request in heard):
                self._echo = request in heard
            if reply is not None:
                return reply
        raise _silence(servo, request, heard_any, echo=self._echo)

    def _write_verified(self, servo: int, command: int, params: bytes, read_command: int) -> None:
        """Write, read back, and repeat until the values agree."""
        for _ in range(_WRITE_TRIES):
            self._wire.write(frame(servo, command, params))
            if self._ask(servo, read_command, len(params)) == params:
                return
        raise NoAnswerError(f"arm: servo {servo} replies but ignores commands; switch the supply of the servos off and on, then try again")


def _silence(servo: int, request: bytes, heard: bytes, *, echo: bool | None) -> RigError:
    """Describe the kind of missing reply."""
    if heard.replace(request, b""):
        return NoAnswerError(
            f"arm: servo {servo} does not reply; only invalid bytes are received; check the baud rate and the bus cable,"
            " and connect long chains of servos as two short ones"
        )
    if echo and not heard:
        return NoAnswerError(
            f"arm: servo {servo} does not reply, and the adapter sends no echo; check the adapter, or the key echo in the rig file"
        )
    return NoAnswerError(f"arm: servo {servo} does not reply; check the supply of the servos, the bus cable and the servo number")


def _named(servos: Collection[int]) -> str:
    return ("servo " if len(servos) == 1 else "servos ") + ", ".join(str(servo) for servo in servos)
