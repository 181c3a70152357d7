"""The twin's ports: in virtual time by pyserial's own way in, and behind pseudo-terminals, camera and console in real time."""

import os
import sys
from pathlib import Path

import pytest
import serial

from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.rig_file import load_rig
from rhizotwin.rig.twin.faults import Fault, parse_fault
from rhizotwin.rig.twin.server import TwinServer, run_twin
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes.disturbances import Disturbances
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
