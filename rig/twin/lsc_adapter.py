"""The LSC controller board's protocol: frames without a checksum, no acknowledgement, frames of its own.

Knows no physics.

After Hiwonder's "Communication Protocol" of its servo controllers. Frame: 55 55 | length | command | parameters, no id.
"""

import math
import struct

from rhizotwin.rig.twin.adapter import Reply
from rhizotwin.rig.twin.servo import Servo, Supply

THINKING_S = 0.003
PER_SERVO_S = 0.004
"""Time in which the board queries one servo."""
MAX_LENGTH = 100
COMPLETED = bytes((0x55, 0x55, 0x05, 0x08, 0x01, 0x01, 0x00))
"""Frame 8, completion of an action group, which boards send unsolicited."""


class LscAdapter:
    """A controller board with its servos."""

    def __init__(self, servos: dict[int, Servo], supply: Supply) -> None:
        self._servos = servos
        self._supply = supply
        self._buffer = bytearray()

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Process bytes from the host; invalid frames are ignored."""
        if not self._supply.up:
            self._buffer.clear()
            return []
        self._buffer += data
        replies: list[Reply] = []
        while (frame := self._frame()) is not None:
            replies += self._answer(frame[3], frame[4:], now_s)
        return replies

    def next_s(self) -> float:
        """Return infinity; unsolicited frames are faults (`rig.twin.faults`)."""
        return math.inf

    def poll(self, _now_s: float) -> list[Reply]:
        """Do nothing."""
        return []

    def _frame(self) -> bytes | None:
        buffer = self._buffer
        while True:
            start = buffer.find(b"\x55\x55")
            if start < 0:
                del buffer[: max(len(buffer) - 1, 0)]
                return None
            del buffer[:start]
            if len(buffer) < 4:
                return None
            if not 2 <= buffer[2] <= MAX_LENGTH:
                del buffer[0]
                continue
            if len(buffer) < buffer[2] + 2:
                return None
            frame = bytes(buffer[: buffer[2] + 2])
            del buffer[: buffer[2] + 2]
            return frame

    def _answer(self, command: int, parameters: bytes, now_s: float) -> list[Reply]:
        if command == 3:
            self._move(parameters)
        elif command == 6 and len(parameters) == 3:
            return [Reply(now_s + THINKING_S, frame_of(6, parameters)), Reply(now_s + 1.0, frame_of(8, parameters))]
        elif command == 15 and not parameters:
            return [Reply(now_s + THINKING_S, frame_of(15, struct.pack("<H", self._supply.millivolt)))]
        elif command in (20, 21) and parameters and len(parameters) == parameters[0] + 1:
            there = [number for number in parameters[1:] if number in self._servos]
            if command == 20:
                for number in there:
                    self._servos[number].load(False)
            else:
                body = b"".join(struct.pack("<Bh", number, self._servos[number].counts) for number in there)
                due_s = now_s + THINKING_S + PER_SERVO_S * len(parameters[1:])
                return [Reply(due_s, frame_of(21, bytes([len(there)]) + body))]
        return []

    def _move(self, parameters: bytes) -> None:
        if len(parameters) < 3 or len(parameters) != 3 + 3 * parameters[0]:
            return
        duration_ms = min(parameters[1] | parameters[2] << 8, 30000)
        for number, counts in struct.iter_unpack("<BH", parameters[3:]):
            if number in self._servos:
                self._servos[number].move(min(counts, 1000), duration_ms)


def frame_of(command: int, parameters: bytes) -> bytes:
    """Return a whole frame."""
    return b"\x55\x55" + bytes([len(parameters) + 2, command]) + parameters
