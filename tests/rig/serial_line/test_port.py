"""A port on a pseudo-terminal, on a socket, and on nothing."""

import errno
import os
import socket
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import serial

from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Port
from rhizotwin.rig.serial_line.recording import Recorder


@dataclass
class _Terminal:
    """The device's side of a pseudo-terminal, and the host's."""

    master: int
    port: Port


def opened(url: str, recorder: Recorder | None = None) -> Port:
    return Port(url, baud=115200, clock=SystemClock(), device="turntable", recorder=recorder)


@pytest.fixture
def terminal() -> Iterator[_Terminal]:
    master, slave = os.openpty()
    tty.setraw(slave)
    there = _Terminal(master, opened(os.ttyname(slave)))
    os.close(slave)
    yield there
    there.port.close()
    if there.master >= 0:
        os.close(there.master)


def test_all_bytes_pass_both_ways_and_a_read_does_not_wait_for_more(terminal: _Terminal) -> None:
    every = bytes(range(256))
    terminal.port.write(every)
    heard = b""
    while len(heard) < len(every):
        heard += os.read(terminal.master, 1000)
    assert heard == every
    os.write(terminal.master, every)
    heard = b""
    while len(heard) < len(every):
        heard += terminal.port.read(60.0)
    assert heard == every
    assert terminal.port.read(0.0) == terminal.port.read(0.003) == b""


def test_input_is_discarded_and_recorded(serial_board: Any) -> None:
    """Not on a pseudo-terminal, where bytes take their time from one side to the other."""
    notes = _Notes()
    port = Port("fake", baud=115200, clock=serial_board.clock, device="turntable", recorder=notes)
    serial_board.waiting = [(0.0, b"old"), (0.0, b"older"), (5.0, b"new")]
    port.discard_input()
    assert port.read(6.0) == b"new"
    assert b"".join(data for _, _, data in notes.entries[1:]) == b"oldoldernew"


def test_unplugged(terminal: _Terminal) -> None:
    os.close(terminal.master)
    terminal.master = -1
    for action in (lambda: terminal.port.read(1.0), lambda: terminal.port.read(0.0), lambda: terminal.port.write(b"x")):
        with pytest.raises(LostError, match=r"turntable on /dev/pts/\d+: unplugged"):
            action()


def test_a_port_in_use_is_refused_and_a_closed_one_lost(terminal: _Terminal) -> None:
    with pytest.raises(RigError, match="used by another program"):
        opened(terminal.port.url)
    terminal.port.close()
    terminal.port.close()
    with pytest.raises(LostError):
        terminal.port.read(0.0)


def test_an_absent_port_is_refused_with_those_that_are_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    there = [SimpleNamespace(device="/dev/ttyUSB7"), SimpleNamespace(device="/dev/ttyACM0")]
    for ports, says in ((there, r"is not there \(serial ports that are: /dev/ttyACM0, /dev/ttyUSB7\)"), ([], "ports that are: none")):
        monkeypatch.setattr("rhizotwin.rig.serial_line.port.list_ports.comports", lambda ports=ports: ports)
        with pytest.raises(RigError, match=says):
            opened(str(tmp_path / "ttyUSB0"))


REFUSALS = {
    "forbidden": (serial.SerialException(errno.EACCES, "could not open port"), "dialout"),
    "busy": (serial.SerialException(errno.EBUSY, "could not open port"), "used by another program"),
    "baud": (ValueError("Invalid baud rate: 5"), "Invalid baud rate: 5"),
    "other": (serial.SerialException("Could not configure port: (25, 'Inappropriate')"), "cannot be opened as a serial port"),
}


@pytest.mark.parametrize(("error", "says"), REFUSALS.values(), ids=REFUSALS)
def test_a_port_that_cannot_be_opened(error: Exception, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RigError, match="protocol 'smoke' not known"):
        opened("smoke://signals")

    def refuse(*_args: object, **_settings: object) -> None:
        raise error

    monkeypatch.setattr("serial.serial_for_url", refuse)
    with pytest.raises(RigError, match=says) as caught:
        opened("/dev/ttyUSB0")
    assert "turntable" in str(caught.value)
    assert "/dev/ttyUSB0" in str(caught.value)


def test_a_socket_is_a_port(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("serial.urlhandler.protocol_socket.time.sleep", lambda _seconds: None)  # pyserial rests after closing a socket
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = opened(f"socket://127.0.0.1:{server.getsockname()[1]}")
        device, _ = server.accept()
        with device:
            device.sendall(b"start\n")
            heard = port.read(5.0)
            while len(heard) < 6:
                heard += port.read(5.0)
            assert heard == b"start\n"
            port.write(b"N0 M110 N0*125\n")
            assert device.recv(100) == b"N0 M110 N0*125\n"
        with pytest.raises(LostError):
            port.read(5.0)
        port.close()


class _Notes(Recorder):
    """A recorder without a file."""

    def __init__(self) -> None:
        self.entries: list[tuple[Any, ...]] = []

    def record_open(self, _t_s: float, device: str, *, url: str, baud: int) -> None:
        self.entries.append((device, url, baud))

    def record(self, _t_s: float, device: str, direction: str, data: bytes) -> None:
        self.entries.append((device, direction, data))


class _Slow:
    """A serial port on which nothing comes and which takes nothing; counts how often its time-out is set."""

    in_waiting = 0

    def __init__(self) -> None:
        self.waited: list[float] = []
        self.changes = 0
        self._timeout = 0.0

    @property
    def timeout(self) -> float:
        return self._timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._timeout = value
        self.changes += 1

    def read(self, _size: int) -> bytes:
        self.waited.append(self._timeout)
        return b""

    def write(self, _data: bytes) -> int:
        raise serial.SerialTimeoutException("Write timeout")


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> _Slow:
    there = _Slow()
    monkeypatch.setattr("serial.serial_for_url", lambda *_args, **_settings: there)
    return there


def test_time_outs_last_as_long_as_they_should(slow: _Slow) -> None:
    port = opened("fake")
    for timeout_s in (0.001, 0.02, 0.25, 1.0, 9.97, 3600.0):
        slow.waited.clear()
        assert port.read(timeout_s) == b""
        assert timeout_s - 1e-9 <= sum(slow.waited) <= timeout_s + 2.0**-10
    with pytest.raises(NoAnswerError, match="took no bytes"):
        port.write(b"x")


def test_time_outs_are_seldom_set(slow: _Slow) -> None:
    """Reads that end early, as most do, with less and less time left to a deadline."""
    port = opened("fake")
    slow.read = lambda _size: b"x"
    for k in range(100):
        assert port.read(10.0 - 0.01 * k) == b"x"
    assert slow.changes == 1


def test_every_byte_is_recorded(terminal: _Terminal) -> None:
    notes, url = _Notes(), terminal.port.url
    terminal.port.close()
    port = opened(url, notes)
    port.write(b"ask")
    os.write(terminal.master, b"\xff")
    port.read(1.0)
    port.read(0.0)
    assert notes.entries == [("turntable", url, 115200), ("turntable", ">", b"ask"), ("turntable", "<", b"\xff")]
    port.close()


def test_a_socket_is_held_against_other_programs_of_this_computer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        first = opened(url)
        with pytest.raises(RigError, match=rf"turntable: {url}: process \d+ on .* works in it"):
            opened(url)
        first.close()
        opened(url).close()
