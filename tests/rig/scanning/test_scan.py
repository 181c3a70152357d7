"""The scan's own logic on devices that are a few lines each: its order, what it refuses, where the angles come from, the arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError, UnsafeError
from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Ring
from tests.rig.fake_devices import BLIND, SCENE, World, angles, at_call, devices, run, stop_at, with_rings


def test_complete_scan_is_the_plan(tmp_path: Path) -> None:
    world = World()
    made = run(world, tmp_path / "d")
    read = load_dataset(tmp_path / "d")
    assert read == made
    assert angles(read) == [view.table_deg for view in plan.views(SCENE)]
    assert [frame.table_read_deg for frame in read.frames] == angles(read)
    assert read.origin["complete"]
    assert {frame.placement for frame in read.frames} == {0}
    times = [frame.time_s for frame in read.frames]
    assert times == sorted(times)
    assert all(read_image(read, frame).shape == (300, 400) for frame in read.frames)
    assert (world.panel, world.front, world.motor) == (0.0, 0.0, False)


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
    at_call(world, "table.move", 3, World.reset_board)
    with pytest.raises(RigError, match="angle is unknown"):
        run(world, tmp_path / "e", table_angle_deg=77.0)


HIGH = with_rings(Ring(views=2), Ring(views=2, height_mm=900.0))
REFUSALS = {
    "far angle": (World(scene=with_rings(Ring(first_deg=-180.0))), UserError, "plan.rings 1: first_deg requires a table angle of -180 deg"),
    "no arm": (World(scene=HIGH), UserError, "the plan has 2 rings, but the rig has no arm"),
    "out of reach": (World(scene=HIGH, with_arm=True), UnsafeError, r"arm: .*reach"),
}


@pytest.mark.parametrize(("world", "error", "named"), REFUSALS.values(), ids=REFUSALS)
def test_refused_before_anything_moves(world: World, error: type[Exception], named: str, tmp_path: Path) -> None:
    with pytest.raises(error, match=named):
        run(world, tmp_path / "d")
    assert world.calls == []
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(("says", "level", "saturated"), [("too dark", 0.1, False), ("at full scale", 1.0, True)])
def test_dark_and_saturated_pictures_are_refused(says: str, level: float, saturated: bool, tmp_path: Path) -> None:
    world = World()
    opened = devices(world)
    opened.rig = replace(opened.rig, lights=replace(opened.rig.lights, panel_level=level))
    if saturated:
        opened.camera.capture = lambda: Shot(image=np.full((300, 400), 65520, np.uint16), exposure_s=1.0, gain=1.0)
    with pytest.raises(RigError, match=says):
        scan(opened, SCENE, tmp_path / "d", observers=Observers(say=lambda _: None))
    assert (world.panel, world.front) == (0.0, 0.0)


def test_tripod_is_moved_by_a_person_for_further_rings(tmp_path: Path) -> None:
    scene, asked = with_rings(Ring(views=2), Ring(views=2, distance_mm=420.0)), []
    world = World(scene=scene)
    made = run(world, tmp_path / "d", ask=lambda question: asked.append(question) or "")
    assert len(asked) == 1
    assert "420 mm from the axis, at z = -42 mm" in asked[0]
    assert [(frame.ring, frame.placement) for frame in made.frames] == [(0, 0), (0, 0), (1, 0), (1, 0)]


class _Heard(Observer):
    watches_motion = True

    def __init__(self) -> None:
        self.looks: list[Look] = []

    def on_look(self, look: Look) -> None:
        self.looks.append(look)


def test_every_picture_is_heard_of_with_its_motion(tmp_path: Path) -> None:
    heard = _Heard()
    made = run(World(), tmp_path / "d", observer=heard)
    assert [look.frame.file for look in heard.looks] == [frame.file for frame in made.frames]
    assert max(look.motion for look in heard.looks) < 0.05
