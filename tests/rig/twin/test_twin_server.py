"""The twin alone: ports and camera for other programs, a rig file that leads there, a console for faults."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import serial

from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.rig_file import load_rig
from rhizotwin.rig.twin.faults import parse_fault
from rhizotwin.rig.twin.server import TwinServer, rig_text, run_twin
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.files import load_scene
from rhizotwin.scenes.model import Scene

if sys.platform == "win32":
    pytest.skip("needs pseudo-terminals", allow_module_level=True)

ASK_ARM = bytes.fromhex("55 55 05 03 1c db")  # position of servo 5
SCENE = Scene(disturbances=Disturbances(distortion=(-0.05, 0.0, 0.0, 0.0, 0.0)))


def test_another_program_finds_table_arm_and_camera(tmp_path: Path) -> None:
    twin = Twin(SCENE, seed=1, profile_name="clean", pictures="sketch", resets_on_open=True)
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
        camera = open_camera(rig.camera, image_wh=SCENE.camera.image_wh, bits=SCENE.camera.bits, clock=SystemClock())
        camera.prepare()
        shot = camera.capture()
        camera.close()
        assert "panel 1.0" in server.where()
    finally:
        server.stop()
    assert twin.world.table.true_deg == pytest.approx(90.0)
    assert not Path(rig.turntable.port).exists()
    assert shot.image.max() / 65535.0 == pytest.approx(0.75, abs=0.02)


def test_run_twin_writes_a_rig_file_and_obeys_the_console(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.write(write, b"where\nrest\nreset\nfau")
    os.write(write, b"lts\nquit\n")
    said: list[str] = []
    twin = Twin(SCENE, faults=[parse_fault("reply_late arm amount=2")], pictures="sketch", rig=default_rig("lsc"))
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
    assert load_scene(tmp_path / "rig_scene.toml").camera.distortion == SCENE.disturbances.distortion
    assert not Path(rig.turntable.port).exists()


def test_a_rig_without_an_arm_is_written_too(tmp_path: Path) -> None:
    rig = replace(Twin(SCENE, pictures="sketch").rig, arm=None)
    (tmp_path / "rig.toml").write_text(rig_text(rig))
    assert load_rig(tmp_path / "rig.toml") == rig
