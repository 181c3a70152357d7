"""Serial port whose error messages state how the user can solve the problem.

The port can be a tty, a pseudo-terminal, ``socket://``, or any other URL supported by pyserial.
"""

import errno
import math
import re
import tempfile
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Protocol

import serial
from serial.tools import list_ports

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.recording import Recorder
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import lock_file

_WRITE_TIMEOUT_S = 5.0
_READ_AT_ONCE = 4096
_ABSENT = {errno.ENOENT, errno.ENODEV, errno.ENXIO}
_BUSY = {errno.EBUSY, errno.EAGAIN}


class Wire(Protocol):
    """Interface of the serial port that drivers use.

    It is implemented by `Port`, and by a port of the tests that replays a recording.
    """

    @property
    def clock(self) -> Clock:
        """Clock with which timeouts are measured."""

    @property
    def url(self) -> str:
        """URL or device file of the port."""

    @property
    def device(self) -> str:
        """Name of the connected device, used in messages."""

    def write(self, data: bytes) -> None:
        """Send bytes to the device."""

    def read(self, timeout_s: float) -> bytes:
        """Return received bytes as soon as there are any.

        If none arrive before the timeout, the result is empty.
        """

    def discard_input(self) -> None:
        """Discard all bytes received so far."""

    def close(self) -> None:
        """Close the port."""


class Port:
    """Open serial port.

    Parameters
    ----------
    url
        A device file, ``COM3``, or a URL such as ``socket://localhost:4000``. A device file is locked against all other
        programs, a socket against programs on this computer.
    baud
        Baud rate, bit/s.
    clock
        Clock for the time stamps of the recording and the deadlines of the drivers.
    device
        Name of the connected device, used in messages: "turntable" or "arm".
    recorder
        Recorder of all transmitted bytes, if any.

    Raises
    ------
    RigError
        If the port cannot be opened; the message states a remedy.
    """

    def __init__(self, url: str, *, baud: int, clock: Clock, device: str, recorder: Recorder | None = None) -> None:
        self.url = url
        self.clock = clock
        self.device = device
        self._recorder = recorder
        self._timeout_s = 0.0
        self._is_open = True
        only_for_files: dict[str, Any] = {} if "://" in url else {"exclusive": True}
        self._held = ExitStack()
        if url.startswith("socket://"):
            _hold(url, device, self._held)
        try:
            self._serial = serial.serial_for_url(url, baudrate=baud, timeout=0.0, write_timeout=_WRITE_TIMEOUT_S, **only_for_files)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            self._held.close()
            raise RigError(f"{device}: {_open_error(url, error)}") from error
        try:
            if recorder is not None:
                recorder.record_open(clock.now_s(), device, url=url, baud=baud)
        except RigError:
            self.close()
            raise

    def write(self, data: bytes) -> None:
        """Send bytes to the device.

        Raises
        ------
        LostError
            If the device was unplugged.
        NoAnswerError
            If the device does not accept bytes.
        """
        if self._recorder is not None:
            self._recorder.record(self.clock.now_s(), self.device, ">", data)
        self._check_open()
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException as error:
            raise NoAnswerError(
                f"{self.device} on {self.url}: the device accepted no bytes for {_WRITE_TIMEOUT_S:g} s; switch it off and on, and check "
                "the cable"
            ) from error
        except OSError as error:
            raise self._lost(error) from error

    def read(self, timeout_s: float) -> bytes:
        """Return received bytes as soon as there are any.

        If none arrive before the timeout, the result is empty. With a timeout of 0, the method does not wait.

        Raises
        ------
        LostError
            If the device was unplugged.
        """
        self._check_open()
        try:
            data = self._waiting() or self._wait(timeout_s)
        except OSError as error:  # in_waiting raises a plain OSError, whereas read and write raise SerialException
            raise self._lost(error) from error
        if data and self._recorder is not None:
            self._recorder.record(self.clock.now_s(), self.device, "<", data)
        return data

    def discard_input(self) -> None:
        """Discard all bytes received so far.

        They are recorded all the same, so that a replay contains them.
        """
        for _ in range(16):  # a limit, because a device may never stop sending
            if not self.read(0.0):
                return

    def close(self) -> None:
        """Close the port.

        If it is already closed, nothing happens.
        """
        self._is_open = False
        with suppress(OSError):
            self._serial.close()
        self._held.close()

    def _check_open(self) -> None:
        if not self._is_open:
            raise LostError(f"{self.device} on {self.url}: the port was closed; open it again")

    def _waiting(self) -> bytes:
        """Read all bytes that have arrived.

        A socket reports at most one waiting byte, so the port is read until no byte is waiting.
        """
        data = b""
        while len(data) < _READ_AT_ONCE and (waiting := self._serial.in_waiting):
            data += self._serial.read(min(waiting, _READ_AT_ONCE))
        return data

    def _wait(self, timeout_s: float) -> bytes:
        left_s = timeout_s
        while left_s > 0.0:
            slice_s = _slice_s(left_s)
            if slice_s != self._timeout_s:  # each change makes pyserial reconfigure the port
                self._serial.timeout = self._timeout_s = slice_s
            first: bytes = self._serial.read(1)
            if first:
                return first + self._waiting()
            left_s -= slice_s
        return b""

    def _lost(self, error: OSError) -> LostError:
        return LostError(
            f"{self.device} on {self.url}: the device was unplugged or switched off ({error}); check its cable and supply, then start again"
        )


def _hold(url: str, device: str, stack: ExitStack) -> None:
    """Lock a network port, so that no other program on this computer can open it.

    For device files, the operating system provides such a lock.
    """
    name = re.sub(r"[^0-9a-z.]+", "-", url.lower())
    try:
        stack.enter_context(lock_file(Path(tempfile.gettempdir()) / f"rhizotwin-{name}.lock", what=f"{device}: {url}"))
    except UserError as error:
        raise RigError(str(error)) from error
    except PermissionError as error:
        raise RigError(
            f"{device}: {url} is being used by another user of this computer ({error.filename}); wait until the port is free"
        ) from error


def _slice_s(left_s: float) -> float:
    """Return the duration of the next wait, s.

    It is the largest power of two that does not exceed the remaining time, limited to 1 ms to 8 s. Thus the timeout of
    the port, whose changes take time, has few different values and rarely changes.
    """
    _, exponent = math.frexp(left_s)
    return min(max(math.ldexp(0.5, exponent), 2.0**-10), 8.0)


def _open_error(url: str, error: OSError | ValueError) -> str:
    code = error.errno if isinstance(error, OSError) else None
    if code == errno.EACCES:
        return (
            f"you are not permitted to open {url}; join the group of serial ports ('sudo usermod -aG dialout $USER' on most systems), "
            "log out and in, and try again"
        )
    if code in _BUSY:
        return f"{url} is being used by another program; close that program and try again"
    if code in _ABSENT:
        there = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        return f"{url} does not exist (existing serial ports: {there}); connect the device, or correct its port in the rig file"
    return f"{url} cannot be opened as a serial port ({error}); check the device, and its port in the rig file"
