"""The scan's own logic on devices that are a few lines each: its order, what it refuses, where the angles come from, the arm."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.rig.arm.tangency import azimuth_rad
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError, UnsafeError
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Ring, Scene
from tests.rig.fake_devices import ARM_ERROR_DEG, BLIND, SCENE, Trouble, World, angles, devices, run, stop_at, with_rings


def test_complete_scan_is_the_plan(tmp_path: Path) -> None:
    world, said = World(), []
    made = run(world, tmp_path / "d", said=said)
    read = load_dataset(tmp_path / "d")
    assert read == made
    assert angles(read) == [view.table_deg for view in plan.views(SCENE)]
    assert [frame.table_read_deg for frame in read.frames] == angles(read)
    assert read.origin["complete"]
    assert read.origin["planned_views"] == 4
    assert {frame.placement for frame in read.frames} == {0}
    times = [frame.time_s for frame in read.frames]
    assert times == sorted(times)
    assert all(read_image(read, frame).shape == (300, 400) for frame in read.frames)
    assert (world.panel, world.front, world.motor) == (0.0, 0.0, False)
    assert {"disk", "turntable", "lights", "camera", "picture", "markers"} <= {line.split()[0].rstrip(":") for line in said}


def test_angle_zero_is_the_seam_whatever_a_person_says(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"--table-angle is 30 deg, but the markers show 7[67]\.\d deg"):
        run(World(), tmp_path / "d", table_angle_deg=30.0)
    world = World(table_true_deg=123.4)
    run(world, tmp_path / "e")
    assert (world.table_true_deg - world.counter_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.3)


def test_angle_that_the_table_kept_is_used_again(tmp_path: Path) -> None:
    world, said = World(on_call=stop_at(20)), []
    with pytest.raises(KeyboardInterrupt):
        run(world, tmp_path / "d")
    world.on_call = lambda _: None
    run(world, tmp_path / "d", resume=True, said=said)
    assert any(line.startswith("turntable: the angle is still known") for line in said)
    assert world.calls.count("table.declare") == 1


def test_without_markers_the_angle_is_asked_not_guessed(tmp_path: Path) -> None:
    world, asked, answers = World(scene=BLIND), [], iter(["north", "77"])
    with pytest.raises(RigError, match=r"angle is unknown \(no markers were found.*--table-angle"):
        run(World(scene=BLIND), tmp_path / "d")
    assert not (tmp_path / "d" / "dataset.json").exists()
    run(world, tmp_path / "d", ask=lambda question: asked.append(question) or next(answers))
    assert "no markers were found" in asked[0]
    assert "'north' is not an angle" in asked[1]
    assert (world.table_true_deg - world.counter_deg) % 360.0 == pytest.approx(0.0)


def test_angle_that_was_given_is_taken_once(tmp_path: Path) -> None:
    world = World(scene=BLIND)
    run(world, tmp_path / "d", table_angle_deg=77.0)
    assert (world.table_true_deg - world.counter_deg) % 360.0 == pytest.approx(0.0)
    world = World(scene=BLIND)
    Trouble("", "table.move", 3, World.reset_board).arm(world)
    with pytest.raises(RigError, match="angle is unknown"):
        run(world, tmp_path / "e", table_angle_deg=77.0)


REFUSALS = {
    "jitter": (with_rings(Ring(jitter_mm=1.0)), None, "plan.rings 1: jitter_mm and jitter_deg must be 0"),
    "far angle": (with_rings(Ring(first_deg=-180.0)), None, "plan.rings 1: first_deg requires a table angle of -180 deg"),
    "no arm": (with_rings(Ring(views=2), Ring(views=2, height_mm=0.0)), None, "the plan has 2 rings, but the rig has no arm"),
    "out of reach": (with_rings(Ring(views=2), Ring(views=2, height_mm=900.0)), ArmPart().park_deg, r"arm: .*reach"),
}


@pytest.mark.parametrize(("scene", "joints_deg", "named"), REFUSALS.values(), ids=REFUSALS)
def test_refused_before_anything_moves(scene: Scene, joints_deg: tuple[float, ...] | None, named: str, tmp_path: Path) -> None:
    world = World(scene=scene, joints_deg=joints_deg)
    with pytest.raises(UserError if joints_deg is None else UnsafeError, match=named):
        run(world, tmp_path / "d")
    assert world.calls == []
    assert not (tmp_path / "d").exists()


BAD_PICTURES = {
    "too dark": (0.1, False, SCENE),
    "at full scale": (1.0, True, SCENE),
    "400x300 pixels, but the scene's camera has image_wh 800x600": (1.0, False, replace(SCENE, camera=SCENE.camera.resized((800, 600)))),
}


@pytest.mark.parametrize(("says", "case"), BAD_PICTURES.items())
def test_dark_saturated_and_other_sizes_are_refused(says: str, case: tuple[float, bool, Scene], tmp_path: Path) -> None:
    (level, saturated, scene), world = case, World()
    opened = devices(world)
    opened.rig = replace(opened.rig, lights=replace(opened.rig.lights, panel_level=level))
    if saturated:
        opened.camera.capture = lambda: Shot(image=np.full((300, 400), 65520, np.uint16), exposure_s=1.0, gain=1.0)
    with pytest.raises(RigError, match=says):
        scan(opened, scene, tmp_path / "d", observers=Observers(say=lambda _: None))
    assert (world.panel, world.front) == (0.0, 0.0)


def test_tripod_is_moved_by_a_person_for_further_rings(tmp_path: Path) -> None:
    scene, asked = with_rings(Ring(views=2), Ring(views=2, distance_mm=420.0)), []
    world = World(scene=scene)
    made = run(world, tmp_path / "d", ask=lambda question: asked.append(question) or "")
    assert len(asked) == 1
    assert "420 mm from the axis, at z = -42 mm" in asked[0]
    assert [(frame.ring, frame.placement) for frame in made.frames] == [(0, 0), (0, 0), (1, 0), (1, 0)]


RINGS = with_rings(Ring(views=3), Ring(views=2, height_mm=-10.0, tilt_deg=5.0))


def armed() -> World:
    """Return a world with the arm at its place of rest."""
    return World(scene=RINGS, joints_deg=ArmPart().park_deg)


def test_arm_goes_to_the_rings_and_is_corrected_by_the_markers(tmp_path: Path) -> None:
    world, places = armed(), []
    world.on_call = lambda name: places.append(world.cam_from_rig) if name == "table.move" else None
    made = run(world, tmp_path / "d")
    assert angles(made) == [view.table_deg for view in plan.views(RINGS)]
    assert world.rested_s >= ArmPart().settle_s
    for place, view in zip(places[1:], plan.views(RINGS), strict=True):  # the table is first approached
        off_mm, off_deg = frames.pose_error(place @ frames.rotation_z(azimuth_rad(place)), view.cam_from_rig)
        assert off_mm < 4.0
        assert off_deg < 1.0
    for frame in made.frames:
        assert len(frame.joints_deg) == len(frame.joints_read_deg) == 5
        assert frame.joints_deg == pytest.approx(frame.joints_read_deg, abs=0.13)
    assert {frame.joints_deg for frame in made.frames if frame.ring == 0} == {made.frames[0].joints_deg}
    assert np.subtract(world.joints_deg, ARM_ERROR_DEG) == pytest.approx(ArmPart().park_deg, abs=0.13)
    assert not world.torque


@pytest.mark.parametrize("number", [12, 58])
def test_ctrl_c_with_an_arm(number: int, tmp_path: Path) -> None:
    world = armed()
    world.on_call = stop_at(number)
    with pytest.raises(KeyboardInterrupt):
        run(world, tmp_path / "d")
    assert (world.panel, world.front, world.torque) == (0.0, 0.0, False)
    world.on_call = lambda _: None
    run(world, tmp_path / "d", resume=True)
    assert angles(load_dataset(tmp_path / "d")) == [view.table_deg for view in plan.views(RINGS)]
    assert (world.panel, world.front, world.torque, world.motor) == (0.0, 0.0, False, False)


class _Heard(Observer):
    """Keeps what it hears, and holds the scan twice."""

    watches_motion = True

    def __init__(self) -> None:
        self.looks: list[Look] = []
        self.lines: list[str] = []
        self.asked = 0

    def on_plan(self, total: int, done: int) -> None:
        self.plan = (total, done)

    def on_look(self, look: Look) -> None:
        assert threading.current_thread() is not threading.main_thread()
        self.looks.append(look)

    def on_line(self, text: str) -> None:
        self.lines.append(text)

    def holds(self) -> bool:
        self.asked += 1
        return self.asked <= 2


def test_every_picture_is_heard_of_once_with_what_it_shows(tmp_path: Path):
    heard = _Heard()
    made = run(World(), tmp_path / "d", observer=heard)
    assert heard.plan == (len(made.frames), 0)
    assert [look.frame.file for look in heard.looks] == [frame.file for frame in made.frames]
    assert heard.asked == len(made.frames) + 2
    for look in heard.looks:
        assert len(look.sighting.corners_px) == look.sighting.markers
        assert look.sighting.blur_px is not None
        assert look.motion < 0.05
    assert any(line.startswith("camera") for line in heard.lines)
