"""Handler of the URLs ``twin://ID/table`` and ``twin://ID/arm`` for pyserial.

The handler provides the ports of a twin that runs in this process, in virtual time. A read with a timeout advances the
twin's clock until the bytes have arrived or the timeout has expired. There is no waiting and no concurrency, so that
the same seed always produces the same bytes.
"""

import errno
import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from serial import PortNotOpenError, SerialBase, SerialException

from rhizotwin.rig.twin.clock import VirtualClock
from rhizotwin.rig.twin.line import Line

PACKAGE = "rhizotwin.rig.twin"
"""Package in which pyserial searches for this module."""
CALL_S = 20e-6
"""Time by which each call to the port advances the virtual time, s. It lets polling loops reach their deadlines."""
GONE = "device reports readiness to read but returned no data (device disconnected or multiple access on port?)"


@dataclass(eq=False)
class Socket:
    """Connection between a port and the twin."""

    line: Line
    clock: VirtualClock
    opened: Callable[[], None]
    """Function that is called when a host opens the port."""
    users: int = 0


_SOCKETS: "weakref.WeakValueDictionary[str, Socket]" = weakref.WeakValueDictionary()


def register(url: str, socket: Socket) -> None:
    """Make a socket available under a URL for as long as the socket exists."""
    _SOCKETS[url.lower()] = socket


class Serial(SerialBase):
    """Port of a twin.

    It behaves like a USB serial port on Linux, including its errors.
    """

    # these attributes are set by SerialBase and its properties
    is_open: bool
    _port: str | None
    _timeout: float | None
    _exclusive: bool | None

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._socket: Socket | None = None
        self._plugs = 0
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Open the port.

        Bytes that arrived earlier are discarded.
        """
        if self.is_open:
            raise SerialException("Port is already open.")
        socket = _SOCKETS.get(str(self._port).lower())
        if socket is None or not socket.line.plugged:
            error = f"[Errno 2] No such file or directory: '{self._port}'"
            raise SerialException(errno.ENOENT, f"could not open port {self._port}: {error}")
        if self._exclusive and socket.users:
            error = "[Errno 11] Resource temporarily unavailable"
            raise SerialException(errno.EAGAIN, f"Could not exclusively lock port {self._port}: {error}")
        socket.users += 1
        self._socket, self._plugs = socket, socket.line.plugs
        self.is_open = True
        socket.line.drop_input()
        socket.opened()

    def close(self) -> None:
        """Close the port."""
        if self.is_open and self._socket is not None:
            self._socket.users -= 1
            self._socket = None
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived and were not read yet."""
        socket = self._there()
        if self._dead(socket):
            raise OSError(errno.EIO, "Input/output error")
        socket.clock.sleep(CALL_S)
        return socket.line.waiting

    def read(self, size: int = 1) -> bytes:
        """Read up to ``size`` bytes.

        The virtual time advances until they have arrived or the timeout expires.
        """
        socket = self._there()
        clock = socket.clock
        deadline_s = math.inf if self._timeout is None else clock.now_s() + max(self._timeout, CALL_S)
        data = b""
        while True:
            if self._dead(socket):
                raise SerialException(GONE)
            data += socket.line.take(size - len(data))
            if len(data) >= size or clock.now_s() >= deadline_s:
                return data
            if math.isinf(deadline_s) and math.isinf(clock.next_s()):
                raise SerialException("a read without a timeout would block forever, because no event is pending in virtual time")
            clock.step(deadline_s)

    def write(self, data: Any, /) -> int:
        """Send bytes, and return their number."""
        socket = self._there()
        if self._dead(socket):
            raise SerialException("write failed: [Errno 5] Input/output error")
        payload = bytes(data)
        socket.line.write(payload, socket.clock.now_s())
        return len(payload)

    def flush(self) -> None:
        """Return immediately, as on a pseudo-terminal."""
        self._there()

    def reset_input_buffer(self) -> None:
        """Discard the bytes that have arrived."""
        self._there().line.drop_input()

    def reset_output_buffer(self) -> None:
        """Do nothing, because written bytes are already in transmission."""
        self._there()

    def _there(self) -> Socket:
        if not self.is_open or self._socket is None:
            raise PortNotOpenError()
        return self._socket

    def _dead(self, socket: Socket) -> bool:
        """Return whether the cable was disconnected after the port was opened.

        In this case the port has to be opened again.
        """
        return not socket.line.plugged or socket.line.plugs != self._plugs

    def _reconfigure_port(self) -> None:
        """Accept any setting of the port, as a USB port does."""

    def _update_dtr_state(self) -> None:
        """Ignore the state of the modem line DTR."""

    def _update_rts_state(self) -> None:
        """Ignore the state of the modem line RTS."""

    def _update_break_state(self) -> None:
        """Ignore the break condition."""
