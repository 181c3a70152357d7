"""Serial lines of a twin as pseudo-terminals in real time.

Any program can open them. This module relies on the following properties of pseudo-terminals. Since no slave descriptor
is kept open, ``POLLHUP`` on the master means that no program has opened the port. Reads then fail with EIO, which is
not an error. pyserial discards bytes that arrived before it opened a port. A closed master represents a disconnected
cable. There are no modem lines, so that a reset by DTR is not visible. The baud rate is ignored, because lines have
their own transmission times.
"""

import errno
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from rhizotwin.rig.twin.clock import ScaledClock, VirtualClock
from rhizotwin.rig.twin.line import Line

LOOK_AGAIN_S = 0.02
"""Interval between checks whether a program has opened a port, s."""
LONGEST_WAIT_S = 0.25
QUIET_S = 0.05
"""Time after the opening of a port during which no bytes are sent to the host, s. pyserial may discard bytes that
arrive earlier."""
_CHUNK = 4096


class PtyPorts:
    """Serial lines of a twin as ports.

    A thread advances the twin's time in step with real time.

    Parameters
    ----------
    lines
        Lines by name. The link to each port has the same name.
    clock
        Clock of the twin, which must not be advanced by any other code.
    folder
        Folder of the links to the ports. The links' paths do not change when a cable is disconnected and reconnected.
    speed
        Speed of the twin relative to real time.
    opened
        Function that is called with the name of a line when a program opens its port.
    """

    def __init__(
        self,
        lines: Mapping[str, Line],
        clock: VirtualClock,
        folder: Path,
        *,
        speed: float = 1.0,
        opened: Callable[[str], None] | None = None,
    ) -> None:
        self.lock = threading.RLock()
        """Lock that must be held during every access to the twin."""
        self.real = ScaledClock(speed)
        self._clock = clock
        self._opened = opened or (lambda _name: None)
        self._ports = {name: _Port(line, folder / name) for name, line in lines.items()}
        self._wake_read, self._wake_write = os.pipe()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="twin ports", daemon=True)

    @property
    def paths(self) -> dict[str, Path]:
        """Paths of the symbolic links to the ports, keyed by line name."""
        return {name: port.link for name, port in self._ports.items()}

    def start(self) -> None:
        """Start the thread that serves the ports."""
        self._thread.start()

    def stop(self) -> None:
        """Close the ports, and wait for the end of the thread."""
        self._stopping = True
        self.wake()
        if self._thread.is_alive():
            self._thread.join()
        for port in self._ports.values():
            port.pull()
        for descriptor in (self._wake_read, self._wake_write):
            with suppress(OSError):
                os.close(descriptor)

    def wake(self) -> None:
        """Wake the thread after an external change, so that it serves the ports immediately."""
        with suppress(OSError):
            os.write(self._wake_write, b"x")

    def catch_up(self) -> None:
        """Advance the twin to the present time. The lock must be held."""
        self._clock.advance_to(self.real.now_s())

    def _run(self) -> None:
        while not self._stopping:
            poller = select.poll()
            poller.register(self._wake_read, select.POLLIN)
            with self.lock:
                self.catch_up()
                for name, port in self._ports.items():
                    if port.serve(self._clock.now_s()):
                        self._opened(name)
                    if port.is_open and port.master is not None:
                        poller.register(port.master, select.POLLIN)
                # The waiting time is relative to the time served, so that events since then are not delayed by
                # sleeping.
                wait_s = (self._clock.next_s() - self.real.now_s()) / self.real.speed
            closed = any(not port.is_open or port.holds_back for port in self._ports.values())
            wait_s = min(max(wait_s, 0.0), LOOK_AGAIN_S if closed else LONGEST_WAIT_S)
            for descriptor, _ in poller.poll(1000.0 * wait_s):
                if descriptor == self._wake_read:
                    os.read(self._wake_read, _CHUNK)


class _Port:
    """Pseudo-terminal of one serial line."""

    def __init__(self, line: Line, link: Path) -> None:
        self.line = line
        self.link = link
        self.master: int | None = None
        self.is_open = False
        self._quiet_until_s = 0.0
        self._unsent = b""
        self.plug()

    @property
    def holds_back(self) -> bool:
        """Whether some bytes could not be sent to the host yet."""
        return bool(self._unsent)

    def plug(self) -> None:
        """Create a pseudo-terminal in raw mode, and let the symbolic link point to it."""
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        new = self.link.with_name(f".{self.link.name}.new")
        new.unlink(missing_ok=True)
        new.symlink_to(os.ttyname(slave))
        new.replace(self.link)
        os.close(slave)
        self.is_open = False

    def pull(self) -> None:
        """Close the master side of the pseudo-terminal, which represents disconnecting the cable."""
        if self.master is not None:
            os.close(self.master)
            self.master = None
            self.link.unlink(missing_ok=True)
        self.is_open = False
        self._unsent = b""

    def serve(self, now_s: float) -> bool:
        """Transfer bytes between the pseudo-terminal and the line.

        Return whether a program has just opened the port.
        """
        if self.line.plugged != (self.master is not None):
            self.plug() if self.line.plugged else self.pull()
        if self.master is None:
            return False
        state = select.poll()
        state.register(self.master, select.POLLIN)
        flags = dict(state.poll(0)).get(self.master, 0)
        hung_up = bool(flags & select.POLLHUP)
        just_opened = not hung_up and not self.is_open
        if just_opened:
            self._quiet_until_s = time.monotonic() + QUIET_S
        if flags & select.POLLIN:  # bytes written before a hang-up are read first
            self._take(now_s)
        self.is_open = not hung_up
        self._send()
        return just_opened

    def _take(self, now_s: float) -> None:
        while self.master is not None:
            try:
                data = os.read(self.master, _CHUNK)
            except BlockingIOError:
                return
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
                return
            if not data:
                return
            self.line.write(data, now_s)

    def _send(self) -> None:
        self._unsent += self.line.take()
        if not self.is_open:
            self._unsent = b""  # no program is reading
        if not self._unsent or self.master is None or time.monotonic() < self._quiet_until_s:
            return
        with suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self.master, self._unsent) :]
