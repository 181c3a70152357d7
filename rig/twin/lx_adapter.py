"""Protocol of LX bus servos with binary frames.

The module does not model the physics of the servos, nor the transmission. The echo of requests is part of the
transmission. Source: LewanSoul, "Bus Servo Communication Protocol". Frame: ``55 55 | id | length | command | parameters
| checksum``.
"""

import math
import struct
from collections.abc import Callable

from rhizotwin.rig.twin.adapter import Reply
from rhizotwin.rig.twin.servo import Servo, Supply

THINKING_S = 0.0015
"""Delay between the end of a request and its reply, s."""
BROADCAST = 254
ID_READ = 14
"""Number of the command that reads the id. It is the only broadcast command that has a reply."""
MAX_LENGTH = 10
"""Maximum length of a frame. A larger length is the result of noise."""


class LxAdapter:
    """Emulated LX servos on one bus."""

    def __init__(self, servos: dict[int, Servo], supply: Supply) -> None:
        self._servos = servos
        self._supply = supply
        self._buffer = bytearray()
        # parameters of settings that are only stored, by servo and write command
        self._kept: dict[tuple[int, int], bytes] = {}

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Receive bytes from the host, and return the replies.

        Frames with a wrong checksum are ignored. While the supply is off, all bytes are ignored.
        """
        if not self._supply.up:
            self._buffer.clear()
            return []
        self._buffer += data
        replies: list[Reply] = []
        while (frame := self._frame()) is not None:
            answers = [
                answer for servo in self._addressed_servos(frame[2]) if (answer := self._answer(servo, frame[4], frame[5:-1])) is not None
            ]
            if answers and (frame[2] != BROADCAST or frame[4] == ID_READ):
                replies.append(Reply(now_s + THINKING_S, _merge_collision(answers)))
        return replies

    def next_s(self) -> float:
        """Return infinity, because servos send nothing unsolicited."""
        return math.inf

    def poll(self, _now_s: float) -> list[Reply]:
        """Do nothing, because servos send nothing unsolicited."""
        return []

    def _frame(self) -> bytes | None:
        """Remove the next complete and valid frame from the buffer, and return it."""
        buffer = self._buffer
        while True:
            start = buffer.find(b"\x55\x55")
            if start < 0:
                del buffer[: max(len(buffer) - 1, 0)]
                return None
            del buffer[:start]
            if len(buffer) < 4:
                return None
            length = buffer[3]
            if not 3 <= length <= MAX_LENGTH:
                del buffer[0]
                continue
            if len(buffer) < length + 3:
                return None
            frame = bytes(buffer[: length + 3])
            if frame[-1] == checksum(frame[2:-1]):
                del buffer[: length + 3]
                return frame
            del buffer[0]

    def _addressed_servos(self, number: int) -> list[int]:
        if number == BROADCAST:
            return sorted(self._servos)
        return [number] if number in self._servos else []

    def _answer(self, number: int, command: int, parameters: bytes) -> bytes | None:
        """Execute a command of one servo and return its reply.

        The result is None if the command has no reply.
        """
        servo = self._servos[number]
        if command in _READS:
            return build_frame(number, command, _READS[command](number, servo, self._supply)) if not parameters else None
        if command in _STORED_READS:
            write, default = _STORED_READS[command]
            return build_frame(number, command, self._kept.get((number, write), default)) if not parameters else None
        if command in _STORED_WRITES:
            if len(parameters) == _STORED_WRITES[command]:
                self._kept[number, command] = parameters
            return None
        self._write(number, servo, command, parameters)
        return None

    def _write(self, number: int, servo: Servo, command: int, parameters: bytes) -> None:
        if command in (1, 7) and len(parameters) == 4:
            low, high = struct.unpack("<HH", self._kept.get((number, 20), _ANGLE_LIMITS))
            counts, duration_ms = struct.unpack("<HH", parameters)
            goal = min(max(counts, low), high), min(duration_ms, 30000)
            if command == 1:
                servo.move(*goal)
            else:
                servo.waiting = goal
        elif command == 11 and servo.waiting is not None:
            goal, servo.waiting = servo.waiting, None
            servo.move(*goal)
        elif command == 12:
            servo.stop()
        elif command == 13 and len(parameters) == 1 and parameters[0] < BROADCAST:
            self._servos[parameters[0]] = self._servos.pop(number)
        elif command == 24 and len(parameters) == 1:
            servo.temperature_limit = min(max(parameters[0], 50), 100)
        elif command == 31 and len(parameters) == 1:
            servo.load(parameters[0] == 1)


def checksum(body: bytes) -> int:
    """Return the last byte of a frame.

    It is the inverted sum of the id, length, command and parameters.
    """
    return ~sum(body) & 0xFF


def build_frame(number: int, command: int, parameters: bytes) -> bytes:
    """Build a frame from servo number, command and parameters.

    Parameters
    ----------
    number : int
        Number of the servo.
    command : int
        Number of the command.
    parameters : bytes
        Parameters of the command.

    Returns
    -------
    bytes
        Frame with header, length and checksum.
    """
    body = bytes([number, len(parameters) + 3, command]) + parameters
    return b"\x55\x55" + body + bytes([checksum(body)])


def _merge_collision(frames: list[bytes]) -> bytes:
    """Return the bytes that the host receives if several servos reply simultaneously.

    A bit is 0 if it is 0 in any of the replies.
    """
    heard = bytearray(b"\xff" * max(len(frame) for frame in frames))
    for frame in frames:
        for i, byte in enumerate(frame):
            heard[i] &= byte
    return bytes(heard)


def _u16(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}H", *values)


_ANGLE_LIMITS = _u16(0, 1000)

_READS: dict[int, Callable[[int, Servo, Supply], bytes]] = {
    2: lambda _n, servo, _s: _u16(*servo.command),
    8: lambda _n, servo, _s: _u16(*(servo.waiting or servo.command)),
    ID_READ: lambda number, _servo, _s: bytes([number]),
    25: lambda _n, servo, _s: bytes([servo.temperature_limit]),
    26: lambda _n, servo, _s: bytes([servo.celsius]),
    27: lambda _n, _servo, supply: _u16(supply.millivolt),
    28: lambda _n, servo, _s: struct.pack("<h", servo.counts),
    32: lambda _n, servo, _s: bytes([servo.holds]),
}

# Settings without effect in the emulation that can be read back. Read command: write command and default.
_STORED_READS: dict[int, tuple[int, bytes]] = {
    19: (17, b"\x00"),
    21: (20, _ANGLE_LIMITS),
    23: (22, _u16(6500, 12000)),
    30: (29, b"\x00\x00\x00\x00"),
    34: (33, b"\x00"),
    36: (35, b"\x07"),
}
_STORED_WRITES = {write: len(default) for write, default in _STORED_READS.values()} | {18: 0}
