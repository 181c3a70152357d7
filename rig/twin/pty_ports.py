"""A twin's serial lines behind pseudo-terminals, in real time: any program can open them.

What a pseudo-terminal does, and this module follows: with no slave descriptor kept open here, ``POLLHUP`` on the master
says that nobody has the port open; reads then fail with EIO, which is no error. pyserial drops what arrived before it
opened a port. A closed master is a pulled cable. Modem lines do not exist, so that a reset by DTR cannot be seen; the
baud rate is ignored: a line counts its own wire time.
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
"""How often ports that nobody has open are looked at."""
LONGEST_WAIT_S = 0.25
QUIET_S = 0.05
"""Nothing is sent for so long after a port was opened: pyserial is still flushing."""
_CHUNK = 4096


class PtyPorts:
    """The lines of a twin as ports, and the thread that lets the twin's time pass as fast as the real one.

    Parameters
    ----------
    lines
        By name; the name is that of the port's link, too.
    clock
        The twin's, which nothing else may advance.
    folder
        Gets a link for each port, whose path stays the same when a cable is pulled and put back.
    speed
        How much faster than real.
    opened
        Called with a line's name when a program opens its port.
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
        """Held whenever the twin is touched."""
        self.real = ScaledClock(speed)
        self._clock = clock
        self._opened = opened or (lambda _name: None)
        self._ports = {name: _Port(line, folder / name) for name, line in lines.items()}
        self._wake_read, self._wake_write = os.pipe()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="twin ports", daemon=True)

    @property
    def paths(self) -> dict[str, Path]:
        """The ports to open, by name."""
        return {name: port.link for name, port in self._ports.items()}

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Close the ports and wait for the thread."""
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
        """Let the thread look at once: something was changed from outside."""
        with suppress(OSError):
            os.write(self._wake_write, b"x")

    def catch_up(self) -> None:
        """Bring the twin to the present; the lock must be held."""
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
                # Of the time that was served: what fell due since then must not be slept over.
                wait_s = (self._clock.next_s() - self.real.now_s()) / self.real.speed
            closed = any(not port.is_open or port.holds_back for port in self._ports.values())
            wait_s = min(max(wait_s, 0.0), LOOK_AGAIN_S if closed else LONGEST_WAIT_S)
            for descriptor, _ in poller.poll(1000.0 * wait_s):
                if descriptor == self._wake_read:
                    os.read(self._wake_read, _CHUNK)


class _Port:
    """One pseudo-terminal."""

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
        """Whether there is something that could not be sent yet."""
        return bool(self._unsent)

    def plug(self) -> None:
        """Make a new pseudo-terminal, raw from the start, and let the link lead to it."""
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
        """Close the master, as a pulled cable does."""
        if self.master is not None:
            os.close(self.master)
            self.master = None
            self.link.unlink(missing_ok=True)
        self.is_open = False
        self._unsent = b""

    def serve(self, now_s: float) -> bool:
        """Carry bytes between the terminal and the line; return whether a program has just opened the port."""
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
        if flags & select.POLLIN:  # what was written before a hang-up comes first
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
            self._unsent = b""  # nobody listens
        if not self._unsent or self.master is None or time.monotonic() < self._quiet_until_s:
            return
        with suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self.master, self._unsent) :]
