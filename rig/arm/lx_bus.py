"""Driver of LX bus servos (LX-15D, LX-225, LX-16A ...) on a half-duplex line with 115200 Bd.

Frame: ``55 55 | id | length | command | parameters | checksum``, length = parameters + 3, checksum = ~(sum from id on)
& 0xFF (LewanSoul Bus Servo Communication Protocol). Servos discard damaged frames, so that a wrong position cannot be
commanded. Servos do not acknowledge writes, so that lost writes are detected by reading all written values back.
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
"""Timeouts of the successive attempts to get a reply, s. A servo takes 20 to 30 ms to reply, and a USB adapter delays
bytes by up to 16 ms."""
_WRITE_TRIES = 4


def frame(servo: int, command: int, params: bytes = b"") -> bytes:
    """Build a frame from a servo number, a command and its parameters.

    Parameters
    ----------
    servo : int
        Number of the servo on the bus.
    command : int
        Number of the command.
    params : bytes
        Parameters of the command.

    Returns
    -------
    bytes
        Frame with header, length and checksum.
    """
    body = bytes((servo, len(params) + 3, command)) + params
    return HEADER + body + bytes((~sum(body) & 0xFF,))


def find_reply(heard: bytes, servo: int, command: int, size: int) -> bytes | None:
    """Return the ``size`` parameters of the newest complete, undamaged reply of a servo to a command.

    All other bytes are skipped, such as replies of other servos, truncated frames, and the echo of the request, whose
    length differs from that of the reply. The search continues after every header, so that a truncated frame does not
    hide a complete frame after it.

    Parameters
    ----------
    heard : bytes
        All bytes received since the request.
    servo : int
        Number of the servo on the bus.
    command : int
        Number of the requested command.
    size : int
        Number of parameters.

    Returns
    -------
    bytes or None
        Parameters of the reply; None if no complete reply was received yet.
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
    """Driver of the servo bus.

    The adapter may return an echo of each request, which does not affect the replies, see `find_reply`. Unless ``echo``
    is "yes" or "no", the driver detects from the first reply whether there is an echo. A missing echo distinguishes a
    dead adapter from a dead servo.
    """

    least_move_s = 0.2

    def __init__(self, wire: Wire, *, echo: Literal["auto", "yes", "no"] = "auto") -> None:
        self._wire = wire
        self._echo: bool | None = None if echo == "auto" else echo == "yes"

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        """Start the moves of all given servos simultaneously, and return immediately.

        The target of each servo is first sent as a command that waits for a start signal. All targets are read back, so
        that a servo that does not reply is detected before any motion. One broadcast then starts all servos. It would
        also start other servos whose target was sent in a move that failed, so that a single servo is started by its
        number. Servos that do not report the new command afterwards are started individually.

        Raises
        ------
        UnsafeError
            If a position is outside 0 to 1000 or the duration outside 0 to 30 s; nothing is sent.
        NoAnswerError
            If a servo does not accept its target, or does not start although other servos do.
        """
        check_move(targets, duration_s)
        time_ms = round(duration_s * 1000.0)
        orders = {servo: counts.to_bytes(2, "little") + time_ms.to_bytes(2, "little") for servo, counts in targets.items()}
        for servo, order in orders.items():
            self._write_verified(servo, MOVE_TIME_WAIT_WRITE, order, MOVE_TIME_WAIT_READ)
        late = list(orders)
        receivers = [BROADCAST] if len(late) > 1 else late
        for _ in range(_WRITE_TRIES):
            for receiver in receivers:
                self._wire.write(frame(receiver, MOVE_START))
            receivers = late = [servo for servo in late if self._ask(servo, MOVE_TIME_READ, 4) != orders[servo]]
            if not late:
                return
        # The manual does not state whether a waiting move is reported here. If no servo reports it, the arm verifies
        # their positions.
        if len(late) < len(orders):
            raise NoAnswerError(f"arm: {_servo_names(late)} did not start although the other servos did; check the bus cable")

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        """Read the signed positions of the servos, in counts, keyed by servo number."""
        return {servo: int.from_bytes(self._ask(servo, POS_READ, 2), "little", signed=True) for servo in ids}

    def voltage_v(self, ids: Collection[int]) -> float:
        """Return the lowest supply voltage of these servos.

        With a weak supply, the voltage drops first at the end of the cable.
        """
        return min(int.from_bytes(self._ask(servo, VIN_READ, 2), "little") for servo in ids) / 1000.0

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int]:
        """Read the temperatures of the servos in °C, keyed by servo number."""
        return {servo: self._ask(servo, TEMP_READ, 1)[0] for servo in ids}

    def loaded(self, ids: Collection[int]) -> dict[int, bool]:
        """Read whether the torque of each servo is on.

        If the torque is off unexpectedly, either the supply voltage has dropped and the servo has restarted without
        torque, or the servo has protected itself from overload.
        """
        return {servo: self._ask(servo, LOAD_READ, 1) != b"\x00" for servo in ids}

    def load(self, ids: Collection[int], on: bool) -> None:
        """Switch the torque of the servos on or off, and read back the state of each servo.

        An error is raised only after all servos have been tried.
        """
        failure: NoAnswerError | None = None
        for servo in ids:
            try:
                self._write_verified(servo, LOAD_WRITE, bytes((on,)), LOAD_READ)
            except NoAnswerError as error:
                failure = failure or error
        if failure is not None:
            raise failure

    def stop(self, ids: Collection[int]) -> None:
        """Stop the servos in their present positions. The command is sent twice, because it cannot be verified."""
        for servo in (*ids, *ids):
            self._wire.write(frame(servo, MOVE_STOP))

    def describe(self) -> str:
        """Return the type of the bus, and whether the adapter returns an echo."""
        return "LX servo bus" + {None: "", True: " with echo", False: " without echo"}[self._echo]

    def close(self) -> None:
        """Close the serial line."""
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
        """Write a value and read it back.

        This is repeated until the two values agree.
        """
        for _ in range(_WRITE_TRIES):
            self._wire.write(frame(servo, command, params))
            if self._ask(servo, read_command, len(params)) == params:
                return
        raise NoAnswerError(
            f"arm: servo {servo} replies but does not accept commands; switch the servos' supply off and on, then try again"
        )


def _silence(servo: int, request: bytes, heard: bytes, *, echo: bool | None) -> RigError:
    """Return an error that states the probable cause of a missing reply."""
    if heard.replace(request, b""):
        return NoAnswerError(
            f"arm: servo {servo} does not reply, and only damaged or unrelated bytes are received; check the baud rate and the bus"
            " cable, and connect long chains of servos as two short ones"
        )
    if echo and not heard:
        return NoAnswerError(
            f"arm: servo {servo} does not reply, and the adapter sends no echo; check the adapter, or set echo to 'no' in the rig file"
        )
    return NoAnswerError(f"arm: servo {servo} does not reply; check the servos' supply, the bus cable and the servo's number")


def _servo_names(servos: Collection[int]) -> str:
    return ("servo " if len(servos) == 1 else "servos ") + ", ".join(str(servo) for servo in servos)
