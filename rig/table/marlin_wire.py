"""Line-based access to the port of a Marlin board."""

from collections import deque

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Wire
from rhizotwin.rig.table.marlin_lines import Kind, Line, read_line

MOST_BYTES = 65536


class MarlinWire:
    """Line-based connection to a Marlin board.

    It detects if the board was reset or has halted.
    """

    def __init__(self, port: Wire) -> None:
        self._port = port
        self._buffer = bytearray()
        self._lines: deque[Line] = deque()
        self._heard = 0
        self.clock = port.clock
        self.name = f"{port.device} on {port.url}"
        """Name of device and port, used in messages."""

    def send(self, data: bytes) -> None:
        """Send bytes to the board."""
        self._port.write(data)

    def next(self, until_s: float) -> Line | None:
        """Return the next line.

        It is None if no line is received before the given time in seconds.

        Raises
        ------
        NoAnswerError
            If too many bytes were received since `reset_count` or `drain`.
        """
        while not self._lines:
            data = self._port.read(max(until_s - self.clock.now_s(), 0.0))
            if not data:
                return None
            self._heard += len(data)
            if self._heard > MOST_BYTES:
                raise NoAnswerError(f"{self.name}: the device sends invalid data continuously; check baud rate and cable")
            self._buffer += data
            *whole, rest = self._buffer.split(b"\n")
            self._buffer = bytearray(rest)
            self._lines.extend(read_line(bytes(raw)) for raw in whole)
        return self._lines.popleft()

    def reset_count(self) -> None:
        """Reset the count of received bytes, which is limited in `next`."""
        self._heard = 0

    def forget(self) -> None:
        """Discard received lines that were not returned yet."""
        self._lines.clear()
        self._buffer.clear()

    def drain(self) -> None:
        """Discard lines received since the last command, such as late and duplicated replies.

        Raises
        ------
        LostError
            If the discarded lines contain the greeting of a board that was reset.
        """
        self.reset_count()
        while (line := self.next(self.clock.now_s())) is not None:
            self.check(line)
        self.forget()

    def check(self, line: Line) -> None:
        """Raise a `LostError` if a line indicates a reset or a halt, and a `RigError` if it is from other firmware."""
        if line.kind is Kind.RESET:
            raise self.was_reset(f'it sent "{line.text}"')
        if line.kind is Kind.FOREIGN:
            raise self.other_firmware(line.text)
        if line.kind is Kind.HALTED:
            raise LostError(f'{self.name}: the board has halted ("{line.text}"); find the cause, then switch the board off and on')

    def was_reset(self, why: str) -> LostError:
        """Return the error to be raised if the board was reset."""
        return LostError(
            f"{self.name}: the board was reset ({why}), so that the table angle is lost; check supply and cable, and determine the angle "
            "again"
        )

    def other_firmware(self, firmware: str) -> RigError:
        """Return the error to be raised if the board runs firmware other than Marlin."""
        return RigError(f"{self.name}: the board runs {firmware}; Marlin 2.1 is required: install it on the board, or correct the port")

    def close(self) -> None:
        """Close the port."""
        self._port.close()
