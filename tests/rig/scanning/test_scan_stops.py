"""What stops a scan or gets in its way: Ctrl-C at every call, faults one by one, a table that slips, a full disk."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from rhizotwin.rig.rig_file import RigFile, TurntablePart
from rhizotwin.rig.scanning import scan as scan_module
from rhizotwin.rig.scanning import session
from rhizotwin.rig.scanning.homing import facing_angle
from rhizotwin.rig.scanning.markers import read_strip
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from tests.rig import fake_devices
from tests.rig.fake_devices import BLIND, SCENE, Trouble, World, angles, devices, run, stop_at

CALLS = 25
"""Calls of devices in a scan of `SCENE` without trouble."""


@pytest.mark.parametrize("number", range(1, CALLS - 1))
def test_ctrl_c_at_any_call(number: int, tmp_path: Path) -> None:
    world = World(on_call=stop_at(number))
    with pytest.raises(KeyboardInterrupt):
        run(world, tmp_path / "d")
    assert (world.panel, world.front) == (0.0, 0.0)
    taken = {}
    if (tmp_path / "d" / "dataset.json").exists():
        before = load_dataset(tmp_path / "d")
        assert not before.origin["complete"]
        taken = {frame.file: frame for frame in before.frames}
        assert world.motor, "the angle must survive until the scan is taken up"
    world.on_call = lambda _: None
    made = run(world, tmp_path / "d", resume=True)
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert made == load_dataset(tmp_path / "d")
    assert made.origin["complete"]
    for frame in made.frames:
        assert read_image(made, frame) is not None
        if frame.file in taken:
            assert frame == taken[frame.file], "a picture was taken twice"


@pytest.mark.parametrize("number", [CALLS - 1, CALLS])
def test_ctrl_c_on_the_way_out_of_a_finished_scan(number: int, tmp_path: Path) -> None:
    world = World(on_call=stop_at(number))
    assert run(world, tmp_path / "d").origin["complete"]
    assert (world.panel, world.front, world.motor) == (0.0, 0.0, False)


def test_the_calls_above_reach_the_end_of_a_scan(tmp_path: Path) -> None:
    world = World()
    run(world, tmp_path / "d")
    assert world.calls[-2:] == ["lights.off", "table.release"]
    assert len(world.calls) == CALLS


def fails(error: Exception) -> Callable[[World], None]:
    def raise_it(_: World) -> None:
        raise error

    return raise_it


CURED = [
    Trouble("reset before a move", "table.move", 2, World.reset_board),
    Trouble("reset before the first move", "table.move", 1, World.reset_board),
    Trouble("reset while the picture is taken", "camera.capture", 3, World.reset_board),
    Trouble("reset while the place is looked at", "camera.capture", 1, World.reset_board),
    Trouble("reset while the picture is taken, unnoticed", "camera.capture", 3, World.reset_unnoticed),
    Trouble("reset just before the angle is asked again", "table.position", 5, World.reset_board),
    Trouble("no answer to a move", "table.move", 3, fails(NoAnswerError("turntable: does not answer"))),
    Trouble("unplugged", "table.move", 3, fails(LostError("turntable: unplugged"))),
    Trouble("unplugged after a picture", "table.position", 3, fails(LostError("turntable: unplugged"))),
    Trouble("camera stops once", "camera.capture", 3, fails(RigError("camera: no picture"))),
    Trouble("lamps go out", "camera.capture", 3, World.lamps_out),
]


@pytest.mark.parametrize("trouble", CURED, ids=lambda trouble: trouble.name)
def test_fault_is_cured_in_place(trouble: Trouble, tmp_path: Path) -> None:
    world, said = World(), []
    trouble.arm(world)
    made = run(world, tmp_path / "d", said=said)
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert made.origin["complete"]
    for frame in made.frames:
        shown = read_strip(read_image(made, frame), SCENE)
        assert (facing_angle(shown, SCENE) - frame.table_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.6)
    if "reset" in trouble.name:
        assert max(frame.placement for frame in made.frames) <= 1
        homed = sum(event["event"] == "homed" for event in made.origin["log"])
        assert homed >= (1 if trouble.name == "reset while the place is looked at" else 2), made.origin["log"]
    else:
        assert {frame.placement for frame in made.frames} == {0}
    assert any(event["event"] in ("fault", "camera", "lights") for event in made.origin["log"]) or trouble.at == 1


def test_table_that_was_reset_is_found_again(tmp_path: Path) -> None:
    world, offsets = World(), []

    def reset(world: World) -> None:
        offsets.append(world.table_true_deg - world.counter_deg)
        world.reset_board()

    Trouble("", "table.move", 4, reset).arm(world)
    made = run(world, tmp_path / "d")
    assert [frame.placement for frame in made.frames] == [0, 0, 0, 1]
    offset = world.table_true_deg - world.counter_deg
    assert (offset - offsets[0] + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.1)


STOPS = [
    Trouble("camera dead", "camera.capture", 3, lambda world: keep_failing(world, "camera", RigError("camera: no picture"))),
    Trouble("board dead", "table.move", 3, lambda world: keep_failing(world, "table", LostError("turntable: unplugged"))),
    Trouble("lamps dead", "camera.capture", 3, lambda world: keep_dark(world)),
]


def keep_failing(world: World, device: str, error: Exception) -> None:
    def on_call(name: str) -> None:
        if name.startswith(device):
            raise error

    world.on_call = on_call
    raise error


def keep_dark(world: World) -> None:
    def on_call(_: str) -> None:
        world.panel = world.front = 0.0

    world.on_call = on_call
    on_call("")


@pytest.mark.parametrize("trouble", STOPS, ids=lambda trouble: trouble.name)
def test_fault_that_stays_stops_the_scan_with_its_cause(trouble: Trouble, tmp_path: Path) -> None:
    world, said = World(), []
    trouble.arm(world)
    named = {
        "camera dead": "camera: no picture",
        "board dead": "turntable: unplugged.*did not come back",
        "lamps dead": "lights: the panel is",
    }
    with pytest.raises(RigError, match=named[trouble.name]):
        run(world, tmp_path / "d", said=said)
    assert (world.panel, world.front) == (0.0, 0.0)
    kept = load_dataset(tmp_path / "d")
    assert 1 <= len(kept.frames) < 4
    assert kept.origin["log"][-1]["event"] == "stopped"
    assert world.now_s < 120.0
    world.on_call = lambda _: None
    world.reset_board()
    made = run(world, tmp_path / "d", resume=True)
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert made.frames[: len(kept.frames)] == kept.frames


def test_error_of_the_way_out_does_not_hide_the_first(tmp_path: Path) -> None:
    world, said = World(), []

    def on_call(name: str) -> None:
        if name == "table.move":
            raise UnsafeError("turntable: is on fire")
        if name == "lights.off":
            raise RigError("lights: no answer")

    world.on_call = on_call
    with pytest.raises(UnsafeError, match="on fire"):
        run(world, tmp_path / "d", said=said)
    assert any("switch them off by hand" in line and "no answer" in line for line in said)


def test_table_that_slips_is_noticed_by_the_markers(tmp_path: Path) -> None:
    world = World()
    Trouble("", "table.move", 3, lambda world: setattr(world, "table_true_deg", world.table_true_deg + 7.2)).arm(world)
    with pytest.raises(RigError, match=r"the markers of images/view_002\.png show \+7\.\d\d deg beside the commanded 180 deg"):
        run(world, tmp_path / "d")
    assert [frame.file for frame in load_dataset(tmp_path / "d").frames] == ["images/view_000.png", "images/view_001.png"]
    made = run(world, tmp_path / "d", resume=True)
    assert [frame.placement for frame in made.frames] == [0, 0, 1, 1]
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]


def slip_and_stop(world: World) -> None:
    """Let the table slip before its third move, and press Ctrl-C at its fourth."""
    moves = [0]

    def on_call(name: str) -> None:
        if name == "table.move":
            moves[0] += 1
            if moves[0] == 3:
                world.table_true_deg += 7.2
            if moves[0] == 4:
                raise KeyboardInterrupt

    world.on_call = on_call


@pytest.mark.parametrize("killed", [False, True], ids=["stopped", "killed"])
def test_table_that_slipped_before_the_scan_was_stopped(killed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wrong picture is taken out on the way out, or else when the scan is taken up."""
    world, said = World(), []
    slip_and_stop(world)
    if killed:
        monkeypatch.setattr(scan_module._Scan, "_stopped", lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        run(world, tmp_path / "d")
    assert len(load_dataset(tmp_path / "d").frames) == (3 if killed else 2)
    world.on_call = lambda _: None
    made = run(world, tmp_path / "d", resume=True, said=said)
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert [frame.placement for frame in made.frames] == [0, 0, 1, 1]
    assert any("it was turned" in line for line in said)


def test_full_disk_keeps_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world, written = World(), []
    write = session.write_bytes

    def full_later(path: Path, data: bytes) -> None:
        written.append(path)
        if len(written) >= 3:
            raise UserError(f"{path}: the disk is full")
        write(path, data)

    monkeypatch.setattr(session, "write_bytes", full_later)
    with pytest.raises(UserError, match=r"view_002\.png: the disk is full"):
        run(world, tmp_path / "d")
    monkeypatch.undo()
    made = run(world, tmp_path / "d", resume=True)
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert [frame.placement for frame in made.frames] == [0, 0, 1, 1]


def noisy(monkeypatch: pytest.MonkeyPatch, *, shown_deg: Callable[[float], float] = lambda angle: angle) -> None:
    """Give the fake camera noise, as every camera has, and perhaps another angle of the table than the true one."""
    rng = np.random.default_rng(5)
    clean = fake_devices.drawn

    def drawn(scene: Scene, camera: bytes, table_deg: float, panel: float, front: float) -> np.ndarray:
        picture = clean(scene, camera, shown_deg(table_deg), panel, front)
        full = np.iinfo(picture.dtype).max
        return np.clip(picture + rng.normal(0.0, 0.01 * full, picture.shape), 0.0, full).astype(picture.dtype)

    monkeypatch.setattr(fake_devices, "drawn", drawn)


@pytest.mark.parametrize("scene", [SCENE, BLIND], ids=["markers", "no markers"])
def test_camera_that_hangs_is_noticed_at_the_second_picture(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(scene=scene)
    noisy(monkeypatch)
    drawn, kept = fake_devices.drawn, []

    def hanging(*sight: Any) -> np.ndarray:
        if len(kept) < 2:
            kept.append(drawn(*sight))
        return kept[-1]

    monkeypatch.setattr(fake_devices, "drawn", hanging)
    with pytest.raises(RigError, match="gave the same picture at 90 deg as at 0 deg, byte for byte"):
        run(world, tmp_path / "d", table_angle_deg=77.0 if scene is BLIND else None)
    assert [path.name for path in (tmp_path / "d" / "images").iterdir()] == ["view_000.png"]


@pytest.mark.parametrize("scene", [SCENE, BLIND], ids=["markers", "no markers"])
def test_table_that_only_says_that_it_turns_is_noticed_at_the_second_picture(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(scene=scene)
    noisy(monkeypatch, shown_deg=lambda _: 77.0)
    world.table_true_deg = 77.0
    named = "looks like the picture before" if scene is BLIND else r"view_00[01]\.png show [+-]\d+\.\d\d deg beside"
    with pytest.raises(RigError, match=named):
        run(world, tmp_path / "d", table_angle_deg=77.0 if scene is BLIND else None)
    assert sum(name == "camera.capture" for name in world.calls) <= 4
    if scene is BLIND:
        assert [path.name for path in (tmp_path / "d" / "images").iterdir()] == ["view_000.png"]


def test_what_no_marker_proves_is_said_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy(monkeypatch)
    said: list[str] = []
    made = run(World(scene=BLIND), tmp_path / "d", said=said, table_angle_deg=77.0)
    assert made.origin["complete"]
    assert any("the markers of 4 of 4 pictures could not be read" in line for line in said)
    assert [event["event"] for event in made.origin["log"]].count("unchecked") == 1


def test_four_lost_steps_of_a_geared_table_are_noticed(tmp_path: Path) -> None:
    """0.72 degrees of a table whose motor makes 0.18 degrees of it a step; half a degree of one that makes 1.8 is nothing."""
    for step_deg, slips in ((0.18, True), (1.8, False)):
        world = World()
        Trouble("", "table.move", 3, lambda world: setattr(world, "table_true_deg", world.table_true_deg + 0.72)).arm(world)
        rig = RigFile(arm=None, turntable=TurntablePart(full_step_deg=step_deg))
        made = replace(devices(world), rig=rig)
        if slips:
            with pytest.raises(RigError, match=r"view_002\.png show \+0\.[67]\d deg beside the commanded 180"):
                scan_module.scan(made, SCENE, tmp_path / "slips")
            assert len(load_dataset(tmp_path / "slips").frames) == 2
        else:
            assert scan_module.scan(made, SCENE, tmp_path / "not").origin["complete"]
