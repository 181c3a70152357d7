"""What a person on the bench sees: one line for each device, and typed lines that refuse what is not safe."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import rhizotwin.rig.align_camera
from rhizotwin.rig.bench import check
from rhizotwin.rig.example import EXAMPLE
from rhizotwin.rig.jog import Jog
from rhizotwin.rig.rig_file import ArmPart, Pose, RigFile, load_rig
from rhizotwin.rig.scanning import alignment
from rhizotwin.rig.twin.faults import Fault
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.picture_codec import decode_grey
from tests.rig.fake_devices import CLEAN as SCENE
from tests.rig.fake_devices import opened


def twin_of(*faults: Fault, rig: RigFile | None = None, profile: str = "clean") -> Twin:
    return Twin(SCENE, seed=2, profile_name=profile, pictures="sketch", faults=faults, rig=rig)


def looked(twin: Twin, folder: Path) -> tuple[int, list[str]]:
    lines: list[str] = []
    bench = SimpleNamespace(rig=twin.rig, scene=twin.calibrated_scene(), clock=twin.clock, open_camera=twin.open_camera)
    wrong = check(bench, say=lines.append, folder=folder)
    twin.clock.sleep(1.0)
    return wrong, lines


def test_a_sound_rig_is_all_ok(tmp_path: Path) -> None:
    twin = twin_of()
    wrong, lines = looked(twin, tmp_path)
    assert wrong == 0
    assert [line.split()[0] for line in lines] == ["turntable", "arm", "camera", "lights", "picture", "markers", "disk"]
    assert all(line.split()[1] == "ok" for line in lines)
    assert twin.world.panel.level == twin.world.front.level == 0.0
    assert not any(servo.torque_on for servo in twin.world.servos.values()), "the arm was at rest"


BROKEN = [
    ("turntable", Fault(kind="unplugged", device="table", at_s=0.0, amount=0.0), "unplugged|does not exist"),
    ("arm", Fault(kind="overheated", device="arm", at_s=0.0, amount=80.0), "°C, above 65 °C"),
    ("camera", Fault(kind="camera_stopped", device="camera", at_message=1, amount=0.0), "no picture"),
]


@pytest.mark.parametrize(("device", "fault", "named"), BROKEN, ids=["unplugged", "too warm", "no camera"])
def test_what_is_wrong_is_said_and_the_rest_is_looked_at(device: str, fault: Fault, named: str, tmp_path: Path) -> None:
    wrong, lines = looked(twin_of(fault), tmp_path)
    bad = [line for line in lines if line.split()[1] == "WRONG"]
    assert wrong == len(bad) >= 1
    assert bad[0].startswith(device)
    assert re.search(named, bad[0])
    assert {"turntable", "arm", "camera", "disk"} <= {line.split()[0] for line in lines}


def test_lamps_that_do_not_light_up_are_noticed(tmp_path: Path) -> None:
    rig = replace(RigFile(arm=None), lights=replace(RigFile().lights, panel_level=0.0, front_level=0.0))
    wrong, lines = looked(twin_of(rig=rig), tmp_path)
    assert wrong >= 1
    assert any(line.startswith("lights     WRONG the picture is equally bright without") for line in lines)


class Bench:
    """A twin with somebody who types."""

    def __init__(self, rig: RigFile | None = None, *, profile: str = "clean") -> None:
        self.twin = twin_of(rig=rig, profile=profile)
        self.said: list[str] = []

    def types(self, *lines: str | Callable[[], object]) -> list[str]:
        """Type lines at the twin's bench, with what happens in between; return what was said."""

        def typed() -> Iterator[str]:
            for line in lines:
                if isinstance(line, str):
                    yield line
                else:
                    line()

        with opened(self.twin) as devices:
            Jog(devices, self.twin.calibrated_scene(), say=self.said.append).run(typed(), stop_at_mistake=False)
        return self.said

    def is_safe(self) -> bool:
        """Whether the panel is off and the arm without torque."""
        return self.twin.world.panel.level == 0.0 and not any(servo.torque_on for servo in self.twin.world.servos.values())


def test_table_is_turned_by_hand_once_its_angle_is_known() -> None:
    bench = Bench()
    start_deg = bench.twin.world.table_deg
    said = bench.types("table +9", "home 40", "table +9", "table 30  # back", "table -130", "table 9000", "quit", "table 0")
    assert "turntable: the table's angle is unknown; enter home, or home 0 if the seam of the marker strip faces the camera" in said
    assert "table at 49.000 deg" in said
    assert any("the table would turn by 8970 deg, but at most 720 deg" in line for line in said)
    assert any("the angle is -100 deg but must be finite and at least -90 deg" in line for line in said)
    assert bench.twin.world.table_deg - start_deg == pytest.approx(-10.0, abs=0.06)  # a microstep
    assert said[-1] == "turntable: the motor remains on, so that the table's angle is not lost"


def test_the_camera_is_aligned_by_the_markers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Although its servos stop anywhere within 0.3 degrees (sigma) of where they are sent."""
    bench, found, misalignment = Bench(profile="bench"), list[alignment.Misalignment](), alignment.misalignment
    monkeypatch.setattr(rhizotwin.rig.align_camera, "misalignment", lambda pose: found.append(misalignment(pose)) or found[-1])
    bench.types("lights 1 1", "align 400 -42")
    assert found[0].size > 5.0
    assert found[-1].is_aligned
    assert bench.is_safe()


def test_a_named_pose_is_gone_to() -> None:
    rig = replace(twin_of().rig, poses=(Pose(name="near", position_mm=(380.0, 0.0, -30.0)),))
    said = Bench(rig).types("look near", "pose", "look far", "look 400 0 -42 -1 0 0", "look 1 2")
    assert any("from the joint angles, the camera is 380" in line or "from the joint angles, the camera is 379.9" in line for line in said)
    assert "the rig file has no pose 'far'; its poses are: near" in said
    assert any("is invalid" in line for line in said)


LEVEL = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0)
MISALIGNED = {
    "at any azimuth": (LEVEL @ frames.rotation_z(2.0), (0.0, 0.0, 0.0)),
    "tilted": (frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=1.5), (0.0, 1.5, 0.0)),
    "rolled": (frames.rotation_z(np.deg2rad(2.0)) @ LEVEL, (0.0, 0.0, 2.0)),
    "aside": (frames.translation(3.0, 0.0, 0.0) @ LEVEL, (3.0, 0.0, 0.0)),
}


@pytest.mark.parametrize(("pose", "expected"), MISALIGNED.values(), ids=MISALIGNED)
def test_misalignment_is_that_of_the_optical_axis(pose: Array, expected: tuple[float, ...]) -> None:
    found = alignment.misalignment(pose)
    assert (abs(found.axis_mm), found.tilt_deg, abs(found.roll_deg)) == pytest.approx(expected, abs=1e-9)


def test_arm_goes_before_the_canister_homes_and_comes_back(tmp_path: Path) -> None:
    bench, seen, file = Bench(), list[tuple[float, ...]](), tmp_path / "look.png"
    lines = ("lights 1 1", "go 400 -20", "markers", "home", "pose", f"picture {file}", "joint 1 +3")
    said = bench.types(*lines, f"picture {file}", lambda: seen.append(bench.twin.world.joints_deg))
    assert f"{file} already exists; choose another name" in said
    assert any("markers, " in line and "reprojection error" in line for line in said), said
    assert any("from the markers, the camera is 4" in line or "from the markers, the camera is 39" in line for line in said)
    assert decode_grey(file.read_bytes(), where="look").shape == (300, 400)
    assert seen[0][0] == pytest.approx(3.0, abs=0.3)
    assert bench.twin.world.joints_deg == pytest.approx(bench.twin.rig.arm.park_deg, abs=0.5)
    assert bench.is_safe()


REFUSED = {
    "dance": "there is no command 'dance'; available commands are table, home",
    "lights nan": "'lights nan' is invalid; usage: lights",
    "joint 2 +400": "limits",
    "joint 2 89": "the floor",
    "go 60 -42": "arm: ",
    "go 400 900": "out of reach",
    "picture look.jpg": "written as PNG",
    "markers": "markers: ",
}
"""Lines that are not done, and what is said; on an arm that stands so low that it reaches the floor."""


def test_refused_with_the_reason_and_nothing_moves() -> None:
    bench = Bench(rig=replace(twin_of().rig, arm=ArmPart(position_mm=(650.0, 0.0, -100.0))))
    before, moved = bench.twin.world.joints_deg, list[tuple[float, ...]]()
    said = bench.types(*REFUSED, lambda: moved.append(bench.twin.world.joints_deg))
    assert [line for line, named in REFUSED.items() if not any(named in one for one in said)] == []
    assert moved[0] == pytest.approx(before, abs=0.5)


def test_a_rig_without_an_arm_says_so() -> None:
    assert Bench(rig=RigFile(arm=None)).types("park", "relax", "joint 1 +3", "go 400 0").count("this rig has no arm") == 4


def test_an_arm_without_torque_is_prepared_again() -> None:
    bench = Bench()
    said = bench.types("joint 1 +3", lambda: bench.twin.world.brown_out(0.0), "joint 1 +3", "joint 1 +3")
    assert sum("has lost its torque" in line for line in said) == 1
    assert sum(line.startswith("joints at") for line in said) == 2
    assert bench.is_safe()


def test_ctrl_c_at_the_prompt_leaves_the_rig_safe() -> None:
    bench = Bench()
    with pytest.raises(KeyboardInterrupt):
        bench.types("lights 1 1", "joint 1 +3", Mock(side_effect=KeyboardInterrupt))
    assert bench.is_safe()


CLASHES = [
    ("/dev/ttyUSB1", "/dev/ttyUSB0", "port.*must differ from the port of"),
    ("step_pin = 23", "step_pin = 24", "differ from step_pin"),
]


@pytest.mark.parametrize(("own", "other", "says"), CLASHES)
def test_rig_files_that_cannot_work_are_refused(own: str, other: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(EXAMPLE.replace(own, other))
    with pytest.raises(UserError, match=says):
        load_rig(tmp_path / "rig.toml")


def test_the_example_is_a_whole_rig_file_of_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(EXAMPLE)
    rig = load_rig(path)
    assert rig == RigFile(name="my_rig", description="arm, turntable and lights on a bench", arm=ArmPart())
    keys = {line.split("=")[0].strip() for line in EXAMPLE.splitlines() if "=" in line and not line.startswith("#")}
    for part in (rig, rig.turntable, rig.lights, rig.hat, rig.arm, rig.arm.joints[0], rig.camera, rig.clearance):
        sections = {"turntable", "lights", "hat", "arm", "camera", "clearance", "joints", "filter"}
        assert {name for name, value in vars(part).items() if value is not None} <= keys | sections, part
