"""A port on a pseudo-terminal, on a socket, and on nothing."""

import errno
import os
import socket
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import serial

from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Port
from rhizotwin.rig.serial_line.recording import Recorder


@dataclass
class Terminal:
    """The device's side of a pseudo-terminal, and the host's."""

    master: int
    port: Port

    def unplug(self) -> None:
        """Pull the cable."""
        os.close(self.master)
        self.master = -1


def opened(url: str) -> Port:
    return Port(url, baud=115200, clock=SystemClock(), device="turntable")


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    master, slave = os.openpty()
    tty.setraw(slave)
    there = Terminal(master, opened(os.ttyname(slave)))
    os.close(slave)
    yield there
    there.port.close()
    if there.master >= 0:
        os.close(there.master)


def test_all_bytes_pass_both_ways(terminal: Terminal) -> None:
    every = bytes(range(256))
    terminal.port.write(every)
    heard = b""
    while len(heard) < len(every):
        heard += os.read(terminal.master, 1000)
    assert heard == every
    os.write(terminal.master, every)
    heard = b""
    while len(heard) < len(every):
        heard += terminal.port.read(1.0)
    assert heard == every


def test_a_read_returns_what_is_there_and_does_not_wait_for_more(terminal: Terminal) -> None:
    assert terminal.port.read(0.0) == b""
    assert terminal.port.read(0.003) == b""
    os.write(terminal.master, b"ok")
    assert terminal.port.read(60.0) == b"ok"


def test_input_is_discarded_and_recorded(serial_board: Any) -> None:
    """Not on a pseudo-terminal, where bytes take their time from one side to the other."""
    notes = Notes()
    port = Port("fake", baud=115200, clock=serial_board.clock, device="turntable", recorder=notes)
    serial_board.waiting = [(0.0, b"old"), (0.0, b"older"), (5.0, b"new")]
    port.discard_input()
    assert port.read(6.0) == b"new"
    assert b"".join(data for _, _, data in notes.entries[1:]) == b"oldoldernew"


def test_unplugged(terminal: Terminal) -> None:
    terminal.unplug()
    for action in (lambda: terminal.port.read(1.0), lambda: terminal.port.read(0.0), lambda: terminal.port.write(b"x")):
        with pytest.raises(LostError, match=r"turntable on /dev/pts/\d+: unplugged"):
            action()


def test_a_closed_port_is_lost_and_may_be_closed_again(terminal: Terminal) -> None:
    terminal.port.close()
    terminal.port.close()
    with pytest.raises(LostError):
        terminal.port.read(0.0)


def test_a_port_in_use_is_refused(terminal: Terminal) -> None:
    with pytest.raises(RigError, match="used by another program"):
        opened(terminal.port.url)


def test_an_absent_port_is_refused_with_those_that_are_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    @dataclass
    class There:
        device: str

    monkeypatch.setattr("rhizotwin.rig.serial_line.port.list_ports.comports", lambda: [There("/dev/ttyUSB7"), There("/dev/ttyACM0")])
    with pytest.raises(RigError, match=r"is not there \(serial ports that are: /dev/ttyACM0, /dev/ttyUSB7\)"):
        opened(str(tmp_path / "ttyUSB0"))
    monkeypatch.setattr("rhizotwin.rig.serial_line.port.list_ports.comports", list)
    with pytest.raises(RigError, match="ports that are: none"):
        opened(str(tmp_path / "ttyUSB0"))


@dataclass(frozen=True)
class Refusal:
    """What pyserial raises, and what the person reads."""

    name: str
    error: Exception
    says: str


@pytest.mark.parametrize(
    "case",
    [
        Refusal("forbidden", serial.SerialException(errno.EACCES, "could not open port"), "dialout"),
        Refusal("busy", serial.SerialException(errno.EBUSY, "could not open port"), "used by another program"),
        Refusal("baud", ValueError("Invalid baud rate: 5"), "Invalid baud rate: 5"),
        Refusal("other", serial.SerialException("Could not configure port: (25, 'Inappropriate')"), "cannot be opened as a serial port"),
    ],
    ids=lambda case: case.name,
)
def test_a_port_that_cannot_be_opened(case: Refusal, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object, **_settings: object) -> None:
        raise case.error

    monkeypatch.setattr("serial.serial_for_url", refuse)
    with pytest.raises(RigError, match=case.says) as caught:
        opened("/dev/ttyUSB0")
    assert "turntable" in str(caught.value)
    assert "/dev/ttyUSB0" in str(caught.value)


def test_no_serial_port_and_no_such_url() -> None:
    with pytest.raises(RigError, match="cannot be opened as a serial port"):
        opened("/dev/null")
    with pytest.raises(RigError, match="protocol 'smoke' not known"):
        opened("smoke://signals")


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


class Notes(Recorder):
    """A recorder without a file."""

    def __init__(self) -> None:
        self.entries: list[tuple[Any, ...]] = []

    def record_open(self, _t_s: float, device: str, *, url: str, baud: int) -> None:
        """Note it."""
        self.entries.append((device, url, baud))

    def record(self, _t_s: float, device: str, direction: str, data: bytes) -> None:
        """Note it."""
        self.entries.append((device, direction, data))


class Slow:
    """A serial port on which nothing comes; counts what is asked of it."""

    def __init__(self) -> None:
        self.waited: list[float] = []
        self.changes = 0
        self.in_waiting = 0
        self._timeout = 0.0

    @property
    def timeout(self) -> float:
        """The time-out that is set."""
        return self._timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._timeout = value
        self.changes += 1

    def read(self, _size: int) -> bytes:
        """Wait in vain."""
        self.waited.append(self._timeout)
        return b""

    def write(self, _data: bytes) -> int:
        """Take nothing."""
        raise serial.SerialTimeoutException("Write timeout")

    def close(self) -> None:
        """Do nothing."""


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Slow:
    there = Slow()
    monkeypatch.setattr("serial.serial_for_url", lambda *_args, **_settings: there)
    return there


@pytest.mark.parametrize("timeout_s", [0.001, 0.02, 0.25, 1.0, 9.97, 3600.0])
def test_time_outs_last_as_long_as_asked(slow: Slow, timeout_s: float) -> None:
    assert opened("fake").read(timeout_s) == b""
    assert timeout_s <= sum(slow.waited) + 1e-9
    assert sum(slow.waited) <= timeout_s + 2.0**-10


def test_time_outs_are_seldom_set(slow: Slow) -> None:
    """Reads that end early, as most do, with less and less time left to a deadline."""
    port = opened("fake")
    slow.read = lambda _size: b"x"
    for k in range(100):
        assert port.read(10.0 - 0.01 * k) == b"x"
    assert slow.changes == 1


@pytest.mark.usefixtures("slow")
def test_a_device_that_takes_nothing() -> None:
    with pytest.raises(NoAnswerError, match="took no bytes"):
        opened("fake").write(b"x")


def test_every_byte_is_recorded() -> None:
    notes = Notes()
    master, slave = os.openpty()
    tty.setraw(slave)
    url = os.ttyname(slave)
    port = Port(url, baud=9600, clock=SystemClock(), device="arm", recorder=notes)
    port.write(b"ask")
    os.write(master, b"\xff")
    port.read(1.0)
    port.read(0.0)
    assert notes.entries == [("arm", url, 9600), ("arm", ">", b"ask"), ("arm", "<", b"\xff")]
    port.close()
    os.close(master)
    os.close(slave)


def test_a_socket_is_held_against_other_programs_of_this_computer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        first = Port(url, baud=9600, clock=SystemClock(), device="arm")
        with pytest.raises(RigError, match=rf"turntable: {url}: process \d+ on .* works in it"):
            Port(url, baud=9600, clock=SystemClock(), device="turntable")
        first.close()
        Port(url, baud=9600, clock=SystemClock(), device="arm").close()
