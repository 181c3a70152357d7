"""The twin's ports, in virtual and in real time, and its fault menu: each does what it says, at the message or moment it says."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import serial

from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.rig_file import load_rig
from rhizotwin.rig.twin.adapter import Reply
from rhizotwin.rig.twin.faults import Fault, Pending, parse_fault
from rhizotwin.rig.twin.line import Line
from rhizotwin.rig.twin.server import TwinServer, run_twin
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_scene
from rhizotwin.scenes.model import Scene

ASK_ARM = bytes.fromhex("55 55 05 03 1c db")  # position of servo 5


def twin(*faults: Fault, seed: int = 0, profile_name: str = "clean") -> Twin:
    return Twin(Scene(disturbances=Disturbances(table_deg=0.1)), seed=seed, profile_name=profile_name, faults=faults, pictures="sketch")


def opened(url: str, timeout: float = 0.25) -> serial.SerialBase:
    return serial.serial_for_url(url, baudrate=115200, timeout=timeout)


def test_a_read_ends_with_bytes_or_time_out_or_is_refused() -> None:
    rig = twin()
    port = opened(rig.rig.arm.port, timeout=0.5)
    assert port.read(8) == b""
    assert rig.clock.now_s() == pytest.approx(0.5)
    port.write(ASK_ARM)
    assert port.in_waiting == 0
    assert port.read(8)[:5] == bytes.fromhex("55 55 05 05 1c")
    assert 0.5 < rig.clock.now_s() < 0.51
    port.close()
    with serial.serial_for_url(rig.rig.turntable.port, timeout=None) as board:
        board.write(b"G4 S5\n")
        assert board.read(5) == b"echo:"
        assert board.read(42) == b"busy: processing\necho:busy: processing\nok\n"
        with pytest.raises(serial.SerialException, match="forever"):
            board.read(1000)


def talk(seed: int) -> bytes:
    rig = twin(Fault(kind="reply_corrupted", device="table", at_message=3), seed=seed, profile_name="bench")
    board, arm = opened(rig.rig.turntable.port, timeout=9.0), opened(rig.rig.arm.port)
    heard = b""
    for line in (b"M17\n", b"M115\n", b"G1 X9 F1800\n", b"M400\n", b"M114\n"):
        board.write(line)
        heard += board.read_until(b"ok\n")
    arm.write(bytes.fromhex("55 55 05 07 01 f4 01 e8 03 12"))  # servo 5 to 500 in a second
    rig.clock.sleep(0.7)
    arm.write(ASK_ARM)
    heard += arm.read(8)
    board.close()
    arm.close()
    return heard + repr((rig.world.joints_deg, rig.world.table_deg, rig.clock.now_s())).encode()


def test_the_same_seed_gives_the_same_bytes() -> None:
    assert talk(3) == talk(3)
    assert talk(3) != talk(4)


def test_device_faults_reach_their_device() -> None:
    rig = twin(
        Fault(kind="stalled", device="arm", at_s=1.0, amount=2.0, joint=1),
        Fault(kind="overheated", device="arm", at_s=1.0, amount=90.0, joint=2),
        Fault(kind="brown_out", device="arm", at_s=5.0, amount=1.0),
    )
    world, joints = rig.world, rig.rig.arm.joints
    shoulder, elbow = world.servos[joints[1].servo], world.servos[joints[2].servo]
    for unit in world.servos.values():
        unit.load(True)
    rig.clock.sleep(1.0)
    assert (shoulder.stalled, elbow.holds) == (True, False)
    rig.clock.sleep(4.5)
    assert (shoulder.stalled, world.supply.up) == (False, False)
    assert not any(unit.holds for unit in world.servos.values())


NEEDS_TERMINALS = pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo-terminals")
SERVED = Scene(disturbances=Disturbances(distortion=(-0.05, 0.0, 0.0, 0.0, 0.0)))


@NEEDS_TERMINALS
def test_another_program_finds_table_arm_and_camera(tmp_path: Path) -> None:
    twin = Twin(SERVED, seed=1, profile_name="clean", pictures="sketch", resets_on_open=True)
    server = TwinServer(twin, tmp_path, speed=100.0)
    server.start()
    rig = server.rig
    try:
        with serial.serial_for_url(rig.turntable.port, baudrate=rig.turntable.baud, timeout=5.0) as port:
            assert port.read_until(b"Loaded\n").startswith(b"start\n External Reset\n")
            port.write(b"M150 S0 R U B\nM400\n")
            assert port.read_until(b"ok\nok\n")
            port.write(b"G1 X90 F1800\nM400\nM114\n")
            assert port.read_until(b"X:90.00 ").endswith(b"X:90.00 ")
        with serial.serial_for_url(rig.arm.port, baudrate=rig.arm.baud, timeout=5.0) as port:
            port.write(ASK_ARM)
            assert port.read(8)[:5] == bytes.fromhex("55 55 05 05 1c")
        camera = open_camera(rig.camera, image_wh=SERVED.camera.image_wh, bits=SERVED.camera.bits, clock=SystemClock())
        camera.prepare()
        shot = camera.capture()
        camera.close()
        assert "panel 1.0" in server.where()
    finally:
        server.stop()
    assert twin.world.table.true_deg == pytest.approx(90.0)
    assert not Path(rig.turntable.port).exists()
    assert shot.image.max() / 65535.0 == pytest.approx(0.75, abs=0.02)


@NEEDS_TERMINALS
def test_run_twin_writes_a_rig_file_and_obeys_the_console(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.write(write, b"where\nrest\nreset\nfau")
    os.write(write, b"lts\nquit\n")
    said: list[str] = []
    twin = Twin(SERVED, faults=[parse_fault("reply_late arm amount=2")], pictures="sketch", rig=default_rig("lsc"))
    run_twin(twin, speed=10.0, write_rig=tmp_path / "rig.toml", say=said.append, commands=read)
    os.close(read)
    os.close(write)
    text = "\n".join(said)
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.arm is not None
    assert (rig.arm.protocol, rig.arm.baud) == ("lsc", 9600)
    assert rig.camera.kind == "http"
    answers = ("true state: table", 'there is no fault "rest"', "fault reset was added to the table", "brown_out (arm)")
    assert [words for words in (rig.turntable.port, rig.camera.address, *answers) if words not in text] == []
    assert load_scene(tmp_path / "rig_scene.toml").camera.distortion == SERVED.disturbances.distortion
    assert not Path(rig.turntable.port).exists()


BAUD = 10_000  # a byte takes a millisecond


class _Parrot:
    """Answers every request with what was heard, and an ok."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        self.heard.append(data)
        return [Reply(now_s, data), Reply(now_s, b"ok\n")]

    def next_s(self) -> float:
        return float("inf")

    def poll(self, _now_s: float) -> list[Reply]:
        return []


class _Talk:
    """A line to a parrot, and the host at its other end."""

    def __init__(self, *faults: Fault) -> None:
        self.parrot = _Parrot()
        self.pending = Pending(faults)
        self.broken: list[str] = []
        self.line = Line("table", self.parrot, baud=BAUD, pending=self.pending, break_device=self._broken)
        self.now_s = 0.0

    def _broken(self, fault: Fault) -> None:
        self.broken.append(fault.kind)
        self.pending.use(fault, self.now_s)

    def ask(self, data: bytes, *, wait_s: float = 1.0) -> bytes:
        self.line.write(data, self.now_s)
        return self.listen(wait_s)

    def listen(self, wait_s: float) -> bytes:
        until_s = self.now_s + wait_s
        while self.now_s < until_s:
            self.now_s = min(self.line.next_s(), until_s)
            self.line.advance_to(self.now_s)
        return self.line.take()


def table(kind: str, **changes: object) -> Fault:
    return replace(Fault(kind=kind, device="table"), **changes)


def test_bytes_take_their_time_both_ways() -> None:
    talk = _Talk()
    talk.line.write(b"123456789\n", 0.0)
    heard = [(talk.listen(wait_s), list(talk.parrot.heard)) for wait_s in (0.0099, 0.0100, 0.0102)]
    assert heard == [(b"", []), (b"", [b"123456789\n"]), (b"123456789\nok\n", [b"123456789\n"])]


CASES = [
    (table("reply_dropped"), b"ok\n", b"B\nok\n"),
    (table("reply_dropped", at_s=0.5), b"A\nok\n", b"ok\n"),
    (table("reply_truncated", at_message=2, amount=0.4), b"A\no", b"B\nok\n"),
    (table("garbage", amount=0.3), b"\xff\x00\x55\x13A\nok\n", b"B\nok\n"),
    (table("request_dropped"), b"", b"B\nok\n"),
    (table("ok_missing", count=2), b"A\n", b"B\n"),
    (table("reply_corrupted", amount=0.0), b"@\nok\n", b"B\nok\n"),
    (table("request_corrupted", amount=0.0), b"@\nok\n", b"B\nok\n"),
    (table("ok_missing_after_resend", amount=0.0), b"@\n", b"B\nok\n"),
    (table("echo"), b"A\nA\nok\n", b"B\nok\n"),
    (table("unasked"), bytes.fromhex("55 55 05 08 01 01 00") + b"A\nok\n", b"B\nok\n"),
]
"""Faults, and what is heard after each of two requests."""


@pytest.mark.parametrize(("fault", "first", "second"), CASES, ids=[f"{case[0].kind} {case[0].count}" for case in CASES])
def test_what_goes_wrong_on_the_wire(fault: Fault, first: bytes, second: bytes) -> None:
    talk = _Talk(fault)
    assert [talk.ask(b"A\n"), talk.ask(b"B\n"), talk.ask(b"C\n")] == [first, second, b"C\nok\n"]


def test_a_late_reply_comes_late_and_busy_lines_before_it() -> None:
    talk = _Talk(table("reply_late", amount=3.0))
    assert talk.ask(b"A\n", wait_s=2.9) == b""
    assert talk.listen(0.2) == b"A\nok\n"
    talk = _Talk(table("busy", amount=5.0))
    assert talk.ask(b"A\n", wait_s=4.5) == b"echo:busy: processing\n" * 2
    assert talk.listen(4.0) == b"echo:busy: processing\nA\nok\n"


def test_a_device_breaks_at_its_message() -> None:
    talk = _Talk(table("reset", at_message=3))
    talk.ask(b"A\n")
    assert talk.broken == []
    talk.ask(b"B\n")
    assert talk.broken == ["reset"]


def test_faults_are_read_from_words() -> None:
    assert parse_fault("reset") == Fault(kind="reset", device="table", amount=0.1)
    assert parse_fault("reply_late arm amount=3 at_s=20 count=2") == Fault(kind="reply_late", device="arm", at_s=20.0, amount=3.0, count=2)
    assert [parse_fault(f"stalled joint={number}").joint for number in (1, 5)] == [0, 4]
    for text, named in (("stalled joint=6", "from 1 to 5"), ("rest", '"reset"'), ("reset arm", "'arm'"), ("reset at_s=nan", "at_s")):
        with pytest.raises(UserError, match=named):
            parse_fault(text)
