"""Emulated serial line.

It simulates the transmission times in both directions, and transmission faults.
"""

import math
from bisect import insort
from collections import deque
from collections.abc import Callable

from rhizotwin.rig.twin.adapter import Adapter, Reply
from rhizotwin.rig.twin.faults import Device, Fault, Pending
from rhizotwin.rig.twin.lsc_adapter import COMPLETED

BITS_A_BYTE = 10
NOISE = bytes((0xFF, 0x00, 0x55, 0x13, 0x9C, 0x0A, 0x55, 0x55, 0xFE, 0x7F, 0x01, 0x80))
BUSY = b"echo:busy: processing\n"
BUSY_EVERY_S = 2.0
SPLIT_EVERY = 4
"""Every message with a number divisible by this value reaches the host in two pieces."""


class Line:
    """Emulated serial connection between the host and one device.

    Parameters
    ----------
    device
        Name of the device to which faults refer.
    adapter
        Adapter that implements the device's protocol.
    baud
        Baud rate, bit/s. It determines the transmission time, with 10 bits per byte.
    pending
        Faults that have not occurred yet.
    break_device
        Function that is called with each fault of kind "device" that is due at a message.
    """

    def __init__(self, device: Device, adapter: Adapter, *, baud: int, pending: Pending, break_device: Callable[[Fault], None]) -> None:
        self.device: Device = device
        self.adapter = adapter
        self._byte_s = BITS_A_BYTE / baud
        self._pending = pending
        self._break_device = break_device
        self._requests: deque[tuple[float, bytes]] = deque()  # with the arrival time of the last byte
        self._request_free_s = 0.0
        self._replies: list[Reply] = []  # by due time, before transmission
        self._arrivals: list[tuple[float, bytes]] = []  # by arrival time at the host
        self._reply_free_s = 0.0
        self._received = bytearray()
        self._sent_count = self._reply_count = self._message_count = 0
        self._mute_ok = False
        self.plugged = True
        self.plugs = 0
        """Number of times the cable was disconnected. A port that was opened before the last disconnection is
        invalid."""

    def write(self, data: bytes, now_s: float) -> None:
        """Begin the transmission of bytes from the host to the device."""
        self._sent_count += 1
        for fault in self._pending.due(self.device, "request", self._sent_count, now_s):
            self._pending.use(fault, now_s)
            if fault.kind == "echo":
                self._arrive(now_s + len(data) * self._byte_s, data)
            elif fault.kind == "request_dropped":
                return
            else:
                data = corrupt(data, fault.amount)
                self._mute_ok |= fault.kind == "ok_missing_after_resend"
        self._request_free_s = max(self._request_free_s, now_s) + len(data) * self._byte_s
        self._requests.append((self._request_free_s, data))

    def take(self, size: int | None = None) -> bytes:
        """Return and remove up to ``size`` of the bytes that have arrived at the host."""
        size = len(self._received) if size is None else size
        data = bytes(self._received[:size])
        del self._received[:size]
        return data

    @property
    def waiting(self) -> int:
        """Number of bytes that have arrived at the host and were not read yet."""
        return len(self._received)

    def drop_input(self) -> None:
        """Discard the bytes that have arrived, as flushing a serial port does."""
        self._received.clear()

    def unplug(self) -> None:
        """Disconnect the cable. Bytes in transmission are lost."""
        self.plugged = False
        self.plugs += 1
        self._requests.clear()
        self._replies.clear()
        self._arrivals.clear()
        self._received.clear()
        self._request_free_s = self._reply_free_s = 0.0
        self._mute_ok = False

    def plug(self) -> None:
        """Reconnect the cable."""
        self.plugged = True

    def silence(self) -> None:
        """Discard the replies that the device has not sent yet.

        It is called when the device was reset.
        """
        self._replies.clear()

    def next_s(self) -> float:
        """Return the time of the next event on the line, s."""
        times = [self.adapter.next_s()]
        if self._requests:
            times.append(self._requests[0][0])
        if self._replies:
            times.append(self._replies[0].due_s)
        if self._arrivals:
            times.append(self._arrivals[0][0])
        return min(times)

    def advance_to(self, now_s: float) -> None:
        """Deliver all bytes that are due."""
        while self._requests and self._requests[0][0] <= now_s:
            self._answer(self.adapter.receive(self._requests.popleft()[1], now_s))
        self._answer(self.adapter.poll(now_s))
        while self._replies and self._replies[0].due_s <= now_s:
            self._send(self._replies.pop(0), now_s)
        while self._arrivals and self._arrivals[0][0] <= now_s:
            self._received += self._arrivals.pop(0)[1]

    def _answer(self, replies: list[Reply]) -> None:
        for reply in replies:
            insort(self._replies, reply, key=lambda waiting: waiting.due_s)

    def _arrive(self, at_s: float, data: bytes) -> None:
        insort(self._arrivals, (at_s, data), key=lambda arrival: arrival[0])

    def _send(self, reply: Reply, now_s: float) -> None:
        """Apply the faults that are due to a reply, and transmit it."""
        self._reply_count += 1
        for fault in self._pending.due(self.device, "device", self._reply_count, now_s):
            self._break_device(fault)
        pieces = [reply.data]
        delay_s = 0.0
        if self._mute_ok and reply.data.startswith(b"ok"):
            self._mute_ok = False
            pieces = []
        for fault in self._pending.due(self.device, "reply", self._reply_count, now_s):
            if fault.kind == "ok_missing" and not reply.data.startswith(b"ok"):
                continue
            self._pending.use(fault, now_s)
            if fault.kind == "busy":
                times = [now_s + BUSY_EVERY_S * (i + 1) for i in range(math.ceil(fault.amount / BUSY_EVERY_S))]
                for at_s in times:
                    self._carry(BUSY, at_s)
            if fault.kind in ("busy", "reply_late"):
                delay_s += fault.amount
            pieces = apply_fault(pieces, fault)
        for piece in pieces:
            self._carry(piece, now_s + delay_s)

    def _carry(self, data: bytes, start_s: float) -> None:
        if not self.plugged or not data:
            return
        self._message_count += 1
        cut = len(data) // 2 if self._message_count % SPLIT_EVERY == 0 else 0
        for piece in (data[:cut], data[cut:]):
            if piece:
                self._reply_free_s = max(self._reply_free_s, start_s) + len(piece) * self._byte_s
                self._arrive(self._reply_free_s, piece)


def apply_fault(pieces: list[bytes], fault: Fault) -> list[bytes]:
    """Return the messages that replace the given messages because of a transmission fault."""
    if fault.kind in ("reply_dropped", "ok_missing"):
        return []
    if fault.kind == "reply_corrupted":
        return [corrupt(piece, fault.amount) for piece in pieces]
    if fault.kind == "reply_doubled":
        return [*pieces, *pieces]
    if fault.kind == "reply_truncated":
        return [piece[: int(fault.amount * len(piece))] for piece in pieces]
    if fault.kind == "garbage":
        return [NOISE[: 1 + int(fault.amount * (len(NOISE) - 1))], *pieces]
    if fault.kind == "unasked":
        return [COMPLETED, *pieces]
    return pieces


def corrupt(data: bytes, amount: float) -> bytes:
    """Return a copy of a message in which one bit is inverted.

    The position of the bit is selected by ``amount`` (0 to 1).
    """
    if not data:
        return data
    bit = min(int(amount * 8 * len(data)), 8 * len(data) - 1)
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << (bit * 5 % 8)
    return bytes(changed)
