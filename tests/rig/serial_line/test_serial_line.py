"""Ports on a pseudo-terminal, on a socket and on nothing; recordings, and replays that notice every difference."""

import errno
import json
import os
import socket
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
import serial

from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.rig_file import LightsPart, TurntablePart
from rhizotwin.rig.serial_line.port import Port
from rhizotwin.rig.serial_line.recording import Recorder
from rhizotwin.rig.table.lights import MarlinLights
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.turntable import MarlinTurntable
from rhizotwin.rig.twin.faults import Fault
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from tests.rig.serial_line.replay import ReplayError, ReplayPort, replay_port


@dataclass
class _Terminal:
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


ACTIONS = {"read": lambda port: port.read(1.0), "write": lambda port: port.write(b"x")}


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS)
def test_unplugged(action: Callable[[Port], object], terminal: _Terminal) -> None:
    os.close(terminal.master)
    terminal.master = -1
    with pytest.raises(LostError, match=r"turntable on /dev/pts/\d+: the device was unplugged"):
        action(terminal.port)


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


def test_a_forbidden_port_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    refuse = Mock(side_effect=serial.SerialException(errno.EACCES, "could not open port"))
    monkeypatch.setattr("serial.serial_for_url", refuse)
    with pytest.raises(RigError, match=r"turntable.*/dev/ttyUSB0.*dialout"):
        opened("/dev/ttyUSB0")


def test_time_outs_last_as_long_as_they_should(monkeypatch: pytest.MonkeyPatch) -> None:
    waited, slow = [], SimpleNamespace(in_waiting=0, timeout=0.0)
    slow.read = lambda _size: waited.append(slow.timeout) or b""
    slow.write = Mock(side_effect=serial.SerialTimeoutException("Write timeout"))
    monkeypatch.setattr("serial.serial_for_url", lambda *_args, **_settings: slow)
    port = opened("fake")
    assert port.read(9.97) == b""
    assert 9.97 - 1e-9 <= sum(waited) <= 9.97 + 2.0**-10
    with pytest.raises(NoAnswerError, match="accepted no bytes"):
        port.write(b"x")


def test_every_byte_is_recorded_and_a_crash_loses_none(terminal: _Terminal, tmp_path: Path) -> None:
    recorder, url = Recorder(tmp_path / "new folder" / "wire.jsonl"), terminal.port.url
    terminal.port.close()
    port = opened(url, recorder)
    port.write(b"ask")
    os.write(terminal.master, b"\xff")
    port.read(1.0)
    port.read(0.0)
    port.close()
    _, *entries = lines(tmp_path / "new folder" / "wire.jsonl")  # without close
    recorder.close()
    assert [entry.pop("t_s") >= 0.0 for entry in entries] == [True] * 3
    said = [{"open": {"url": url, "baud": 115200}}, {"dir": ">", "hex": b"ask".hex()}, {"dir": "<", "hex": "ff"}]
    assert entries == [{"device": "turntable"} | one for one in said]


def test_a_socket_is_a_port_that_one_program_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("serial.urlhandler.protocol_socket.time.sleep", lambda _seconds: None)  # pyserial rests after closing a socket
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        port = opened(url)
        with pytest.raises(RigError, match=rf"turntable: {url}: process \d+ on .* is using it"):
            opened(url)
        device, _ = listening.accept()
        with device:
            device.sendall(b"start\n")
            assert port.read(5.0) == b"start\n"
        with pytest.raises(LostError):
            port.read(5.0)
        port.close()
        opened(url).close()


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def small(path: Path) -> Path:
    """Record a session: three exchanges of the turntable, one of the arm between them."""
    recorder = Recorder(path)
    recorder.record_open(0.0, "turntable", url="/dev/ttyUSB0", baud=115200)
    recorder.record(0.5, "turntable", ">", b"M114\n")
    recorder.record(0.6, "turntable", "<", b"X:1")
    recorder.record(0.7, "arm", ">", b"\x55\x55")
    recorder.record(0.8, "turntable", "<", b".00\nok\n")
    recorder.record(0.9, "turntable", ">", b"M17\n")
    recorder.record(1.0, "turntable", "<", b"ok\n")
    recorder.close()
    return path


def test_a_line_cut_off_by_a_crash_is_left_out(tmp_path: Path) -> None:
    path = small(tmp_path / "wire.jsonl")
    whole = path.read_bytes()
    with path.open("ab") as stream:
        stream.write(b'{"t_s": 3.0, "dev')
    assert replay_port(path, "turntable").read(0.0) == b""  # what was sent comes first
    Recorder(path).close()
    assert path.read_bytes().startswith(whole + b'{"recording": 1, ')
    assert len([line for line in lines(path) if "recording" in line]) == 2


def test_a_disk_that_gets_full_is_reported_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "wire.jsonl")
    recorder._stream.close()
    monkeypatch.setattr(recorder, "_stream", SimpleNamespace(write=lambda line: len(line) - 1, close=lambda: None))
    with pytest.raises(RigError, match="disk is full"):
        recorder.record(1.0, "arm", "<", b"\x00")
    recorder.record(1.1, "turntable", ">", b"M150")  # the lamps can still be switched off
    recorder.close()
    with pytest.raises(RigError, match="cannot be written"):
        Recorder("/dev/full")


@pytest.fixture
def replay(tmp_path: Path) -> ReplayPort:
    return replay_port(small(tmp_path / "wire.jsonl"), "turntable")


def test_the_first_difference_is_named_and_stays(replay: ReplayPort, tmp_path: Path) -> None:
    replay.write(b"M114\n")
    replay.discard_input()
    with pytest.raises(ReplayError, match=r"b'M17\\n' was sent in line 7, .* from byte 2 onwards: b'8\\n'"):
        replay.write(b"M18\n")
    for action in (lambda: replay.read(0.0), lambda: replay.write(b"M17\n"), replay.finish):
        with pytest.raises(ReplayError, match="line 7"):
            action()
    other = replay_port(tmp_path / "wire.jsonl", "turntable")
    with pytest.raises(ReplayError, match=r"driver sent b'M17\\n' before it read b'X:1', which was received in line 4"):
        other.write(b"M114\nM17\n")


def test_of_two_sessions_the_last_is_replayed(tmp_path: Path) -> None:
    path = small(tmp_path / "wire.jsonl")
    recorder = Recorder(path)
    recorder.record(0.0, "turntable", ">", b"M18\n")
    recorder.close()
    replay_port(path, "turntable").write(b"M18\n")
    with pytest.raises(UserError, match="does not contain the device 'arm'; its devices are: turntable"):
        replay_port(path, "arm")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [('"5555"', '"55x5"', "line 5 is damaged"), ('"recording": 1', '"recording": 2', "is not a recording of format 1")],
)
def test_a_damaged_recording_is_named(old: str, new: str, says: str, tmp_path: Path) -> None:
    path = small(tmp_path / "wire.jsonl")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UserError, match=says):
        replay_port(path, "turntable")


def drive(link: MarlinLink, clock: Any) -> list[float]:
    table = MarlinTurntable(link, TurntablePart(), clock)
    lights = MarlinLights(link, LightsPart(), clock)
    table.prepare()
    lights.set(panel=1.0, front=0.5)
    table.declare(0.0)
    angles = [table.move_to(angle) for angle in (0.0, 9.0, 18.0, 4.5)]
    lights.off()
    table.release()
    return angles


def test_a_session_replays_against_the_drivers(tmp_path: Path) -> None:
    """Of a board that resets when its port is opened, with a lost ``ok`` and a damaged request."""
    faults = (Fault(kind="ok_missing", device="table", at_message=12), Fault(kind="request_corrupted", device="table", at_message=18))
    twin, recorder = Twin(Scene(), pictures="sketch", faults=faults, resets_on_open=True), Recorder(tmp_path / "session.jsonl")
    port = Port(twin.rig.turntable.port, baud=115200, clock=twin.clock, device="turntable", recorder=recorder)
    angles = drive(MarlinLink(port), twin.clock)
    recorder.close()
    assert len(twin.pending.happened) == 2
    replay = replay_port(tmp_path / "session.jsonl", "turntable")
    assert drive(MarlinLink(replay), replay.clock) == angles
    replay.finish()
