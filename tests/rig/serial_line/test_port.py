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


def test_all_bytes_pass_and_a_read_does_not_wait_for_more(terminal: _Terminal) -> None:
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


def test_unplugged(terminal: _Terminal) -> None:
    os.close(terminal.master)
    terminal.master = -1
    for action in (lambda: terminal.port.read(1.0), lambda: terminal.port.read(0.0), lambda: terminal.port.write(b"x")):
        with pytest.raises(LostError, match=r"turntable on /dev/pts/\d+: the device was unplugged"):
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
    monkeypatch.setattr("rhizotwin.rig.serial_line.port.list_ports.comports", lambda: there)
    with pytest.raises(RigError, match=r"does not exist \(existing serial ports: /dev/ttyACM0, /dev/ttyUSB7\)"):
        opened(str(tmp_path / "ttyUSB0"))


REFUSALS = {
    "forbidden": (serial.SerialException(errno.EACCES, "could not open port"), "dialout"),
    "baud": (ValueError("Invalid baud rate: 5"), "Invalid baud rate: 5"),
    "other": (serial.SerialException("Could not configure port: (25, 'Inappropriate')"), "cannot be opened as a serial port"),
}


@pytest.mark.parametrize(("error", "says"), REFUSALS.values(), ids=REFUSALS)
def test_a_port_that_cannot_be_opened(error: Exception, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object, **_settings: object) -> None:
        raise error

    monkeypatch.setattr("serial.serial_for_url", refuse)
    with pytest.raises(RigError, match=f"turntable.*/dev/ttyUSB0.*{says}"):
        opened("/dev/ttyUSB0")


class _Notes(Recorder):
    """A recorder without a file."""

    def __init__(self) -> None:
        self.entries: list[tuple[Any, ...]] = []

    def record_open(self, _t_s: float, device: str, *, url: str, baud: int) -> None:
        self.entries.append((device, url, baud))

    def record(self, _t_s: float, device: str, direction: str, data: bytes) -> None:
        self.entries.append((device, direction, data))


class _Slow:
    """A serial port on which nothing comes and which takes nothing."""

    in_waiting = 0
    timeout = 0.0

    def __init__(self) -> None:
        self.waited: list[float] = []

    def read(self, _size: int) -> bytes:
        self.waited.append(self.timeout)
        return b""

    def write(self, _data: bytes) -> int:
        raise serial.SerialTimeoutException("Write timeout")


def test_time_outs_last_as_long_as_they_should(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = _Slow()
    monkeypatch.setattr("serial.serial_for_url", lambda *_args, **_settings: slow)
    port = opened("fake")
    for timeout_s in (0.001, 1.0, 9.97):
        slow.waited.clear()
        assert port.read(timeout_s) == b""
        assert timeout_s - 1e-9 <= sum(slow.waited) <= timeout_s + 2.0**-10
    with pytest.raises(NoAnswerError, match="accepted no bytes"):
        port.write(b"x")
    pieces = iter([b"old", b"older", b""])
    port.read = lambda _: next(pieces)
    port.discard_input()
    assert not list(pieces)


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


def test_a_socket_is_a_port_that_one_program_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("serial.urlhandler.protocol_socket.time.sleep", lambda _seconds: None)  # pyserial rests after closing a socket
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        first = opened(url)
        with pytest.raises(RigError, match=rf"turntable: {url}: process \d+ on .* is using it"):
            opened(url)
        first.close()
        device, _ = listening.accept()
        with device:
            assert device.recv(1) == b"", "the first was closed"
        port = opened(url)
        device, _ = listening.accept()
        with device:
            device.sendall(b"start\n")
            assert port.read(5.0) == b"start\n"
        with pytest.raises(LostError):
            port.read(5.0)
        port.close()
