"""What stops a scan or gets in its way: Ctrl-C at every call, faults one by one, a table that slips, a full disk."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from rhizotwin.rig.rig_file import RigFile, TurntablePart
from rhizotwin.rig.scanning import scan as scan_module
from rhizotwin.rig.scanning import session
from rhizotwin.rig.scanning.canister_check import shift_mm
from rhizotwin.rig.scanning.homing import facing_angle
from rhizotwin.rig.scanning.markers import read_strip
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from tests.rig import fake_devices
from tests.rig.fake_devices import BLIND, SCENE, World, angles, at_call, devices, run, stop_at

CALLS = 29  # of devices in a scan of `SCENE` without trouble


def taken_up(world: World, folder: Path, **options: Any) -> Dataset:
    """Take a scan up without further trouble, to the end of its plan."""
    world.on_call = lambda _: None
    made = run(world, folder, resume=True, **options)
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert made.origin["complete"]
    return made


@pytest.mark.parametrize("number", range(1, CALLS - 1, 6))
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
    made = taken_up(world, tmp_path / "d")
    assert made == load_dataset(tmp_path / "d")
    for frame in made.frames:
        assert read_image(made, frame) is not None
        assert frame == taken.get(frame.file, frame), "a picture was taken twice"


@pytest.mark.parametrize("number", [CALLS - 1, CALLS + 1])
def test_ctrl_c_on_the_way_out_of_a_finished_scan(number: int, tmp_path: Path) -> None:
    world = World(on_call=stop_at(number))
    assert run(world, tmp_path / "d").origin["complete"]
    assert (world.panel, world.front, world.motor) == (0.0, 0.0, False)
    assert number < CALLS or (world.calls[-2:], len(world.calls)) == (["lights.off", "table.release"], CALLS)


CURED = {
    "reset before a move": ("table.move", 3, World.reset_board),
    "reset while the place is looked at": ("camera.capture", 1, World.reset_board),
    "reset while the picture is taken, unnoticed": ("camera.capture", 4, World.reset_unnoticed),
    "no answer to a move": ("table.move", 4, Mock(side_effect=NoAnswerError("turntable: does not answer"))),
    "camera stops once": ("camera.capture", 4, Mock(side_effect=RigError("camera: no picture"))),
    "lamps go out": ("camera.capture", 4, World.lamps_out),
}


@pytest.mark.parametrize("name", CURED)
def test_fault_is_cured_in_place(name: str, tmp_path: Path) -> None:
    world, (call, at, happens) = World(), CURED[name]
    at_call(world, call, at, happens)
    made = run(world, tmp_path / "d")
    assert angles(made) == [view.table_deg for view in plan.views(SCENE)]
    assert made.origin["complete"]
    for frame in made.frames:
        shown = read_strip(read_image(made, frame), SCENE)
        assert (facing_angle(shown, SCENE) - frame.table_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.6)
    events = [event["event"] for event in made.origin["log"]]
    placements = {frame.placement for frame in made.frames}
    assert placements <= {0, 1} if "reset" in name else placements == {0}
    assert events.count("homed") >= (0 if "reset" not in name else 1 if at == 1 else 2), events
    assert at == 1 or {"fault", "camera", "lights"} & set(events)


def test_error_of_the_way_out_does_not_hide_the_first(tmp_path: Path) -> None:
    errors = {"table.move": UnsafeError("turntable: is on fire"), "lights.off": RigError("lights: no answer")}
    said: list[str] = []

    def on_call(name: str) -> None:
        if name in errors:
            raise errors[name]

    with pytest.raises(UnsafeError, match="on fire"):
        run(World(on_call=on_call), tmp_path / "d", said=said)
    assert any("switch them off by hand" in line and "no answer" in line for line in said)


STOPS = {
    "camera: no picture": ("camera.capture", RigError("camera: no picture")),
    "turntable: unplugged.*reconnecting the board failed": ("table.move", LostError("turntable: unplugged")),
    "lights: the panel is": ("camera.capture", None),
}


@pytest.mark.parametrize("named", STOPS, ids=["camera", "board", "lamps"])
def test_fault_that_stays_stops_the_scan_with_its_cause(named: str, tmp_path: Path) -> None:
    world, (call, error) = World(), STOPS[named]

    def stays(name: str) -> None:
        if error is None:
            world.lamps_out()
        elif name.startswith(call.split(".")[0]):
            raise error

    def begin(_: World) -> None:
        world.on_call = stays
        stays(call)

    at_call(world, call, 4, begin)
    with pytest.raises(RigError, match=named):
        run(world, tmp_path / "d")
    assert (world.panel, world.front) == (0.0, 0.0)
    kept = load_dataset(tmp_path / "d")
    assert 1 <= len(kept.frames) < 4
    assert kept.origin["log"][-1]["event"] == "stopped"
    assert world.clock.now_s() < 120.0
    world.reset_board()
    assert taken_up(world, tmp_path / "d").frames[: len(kept.frames)] == kept.frames


def slip(world: World, deg: float, *, move: int = 4) -> None:
    """Let the table slip before a move: the third for a picture, after that at the start."""
    at_call(world, "table.move", move, lambda world: setattr(world, "table_true_deg", world.table_true_deg + deg))


def test_table_that_slips_is_noticed_by_the_markers(tmp_path: Path) -> None:
    world = World()
    slip(world, 7.2)
    with pytest.raises(RigError, match=r"the markers of images/view_002\.png deviate by \+7\.\d\d deg from the commanded angle of 180 deg"):
        run(world, tmp_path / "d")
    assert [frame.file for frame in load_dataset(tmp_path / "d").frames] == ["images/view_000.png", "images/view_001.png"]
    assert [frame.placement for frame in taken_up(world, tmp_path / "d").frames] == [0, 0, 1, 1]


@pytest.mark.parametrize("killed", [False, True], ids=["stopped", "killed"])
def test_table_that_slipped_before_the_scan_was_stopped(killed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wrong picture is taken out on the way out, or else when the scan is taken up."""
    world, said, moves = World(), list[str](), [0]

    def slip_and_stop(name: str) -> None:
        moves[0] += name == "table.move"
        if name == "table.move" and moves[0] == 4:
            world.table_true_deg += 7.2
        if name == "table.move" and moves[0] == 5:
            raise KeyboardInterrupt

    world.on_call = slip_and_stop
    if killed:
        monkeypatch.setattr(scan_module._Scan, "_stopped", lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        run(world, tmp_path / "d")
    assert len(load_dataset(tmp_path / "d").frames) == (3 if killed else 2)
    assert [frame.placement for frame in taken_up(world, tmp_path / "d", said=said).frames] == [0, 0, 1, 1]
    assert any("was turned by hand" in line for line in said)


def test_full_disk_keeps_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world, written, write = World(), list[Path](), session.write_bytes

    def full_later(path: Path, data: bytes) -> None:
        written.append(path)
        if len(written) >= 3:
            raise UserError(f"{path}: the disk is full")
        write(path, data)

    monkeypatch.setattr(session, "write_bytes", full_later)
    with pytest.raises(UserError, match=r"view_002\.png: the disk is full"):
        run(world, tmp_path / "d")
    monkeypatch.undo()
    assert [frame.placement for frame in taken_up(world, tmp_path / "d").frames] == [0, 0, 1, 1]


def noisy(monkeypatch: pytest.MonkeyPatch, *, stuck_deg: float | None = None) -> None:
    """Give the fake camera noise, as every camera has, and perhaps another angle of the table than the true one."""
    rng, clean = np.random.default_rng(5), fake_devices.drawn

    def drawn(scene: Scene, camera: bytes, table_deg: float, *lamps: float) -> np.ndarray:
        picture = clean(scene, camera, table_deg if stuck_deg is None else stuck_deg, *lamps)
        full = np.iinfo(picture.dtype).max
        return np.clip(picture + rng.normal(0.0, 0.01 * full, picture.shape), 0.0, full).astype(picture.dtype)

    monkeypatch.setattr(fake_devices, "drawn", drawn)


OTHER = {
    "shows another canister (markers 3": replace(SCENE, strip=replace(SCENE.strip, first_id=22)),
    "no marker is left since images/view_002.png": BLIND,
    "view_002.png is 3.": replace(SCENE, plan=CapturePlan(rings=(Ring(views=4, height_mm=Ring().height_mm + 3.0),))),
}


@pytest.mark.parametrize("named", OTHER, ids=["another", "none", "pushed"])
def test_another_canister_or_place_ends_the_scan(named: str, tmp_path: Path) -> None:
    world = World()
    at_call(world, "camera.capture", 5, lambda world: setattr(world, "scene", OTHER[named]))
    with pytest.raises(RigError, match=re.escape(named)):
        run(world, tmp_path / "d")
    assert [frame.file for frame in load_dataset(tmp_path / "d").frames] == ["images/view_000.png", "images/view_001.png"]
    if OTHER[named].strip.first_id:
        with pytest.raises(RigError, match="not those of the scene"):
            scan_module.scan(devices(world), SCENE, tmp_path / "d", resume=True)
    world.scene = SCENE
    taken_up(world, tmp_path / "d")


def test_a_shift_of_3_mm_on_the_table_is_seen() -> None:
    camera = frames.level_camera(distance_mm=400.0, height_mm=-20.0, tilt_deg=10.0)
    rng, angles_deg = np.random.default_rng(2), np.arange(0.0, 360.0, 36.0)

    def first_wrong(shift_deg: float, moved_from: int) -> int | None:
        poses = []
        for k, angle_deg in enumerate(angles_deg):
            shift = 3.0 * np.exp(1j * np.deg2rad(shift_deg)) * (k >= moved_from)
            turned = camera @ frames.rotation_z(SCENE.turntable.direction * np.deg2rad(angle_deg))
            poses.append(turned @ frames.translation(1.0 + shift.real, 0.5 + shift.imag, 0.0))
            poses[-1][:2, 3] += rng.normal(0.0, 0.13, 2)
        return next((k for k in range(1, 11) if shift_mm(angles_deg[:k], poses[:k], SCENE)), None)

    assert [first_wrong(0.0, 10) for _ in range(20)] == [None] * 20
    firsts = [first_wrong(shift_deg, 5) for shift_deg in range(0, 360, 45)]
    assert all(first is not None and 6 <= first <= 9 for first in firsts), firsts


def test_camera_that_hangs_is_noticed_at_the_second_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy(monkeypatch)
    drawn, kept = fake_devices.drawn, list[np.ndarray]()
    monkeypatch.setattr(fake_devices, "drawn", lambda *sight: kept.append(drawn(*sight)) or kept[min(len(kept), 2) - 1])
    with pytest.raises(RigError, match="the pictures at 90 deg and 0 deg are identical"):
        run(World(scene=BLIND), tmp_path / "d", table_angle_deg=77.0)
    assert [path.name for path in (tmp_path / "d" / "images").iterdir()] == ["view_000.png"]


def test_table_that_does_not_turn_is_noticed_without_markers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(scene=BLIND)
    noisy(monkeypatch, stuck_deg=77.0)
    with pytest.raises(RigError, match="does not differ from the previous picture"):
        run(world, tmp_path / "d", table_angle_deg=77.0)
    assert sum(name == "camera.capture" for name in world.calls) <= 5
    assert [path.name for path in (tmp_path / "d" / "images").iterdir()] == ["view_000.png"]


def test_what_no_marker_proves_is_said_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy(monkeypatch)
    said: list[str] = []
    made = run(World(scene=BLIND), tmp_path / "d", said=said, table_angle_deg=77.0)
    assert made.origin["complete"]
    assert any("the markers of 4 of 4 pictures could not be read" in line for line in said)
    assert [event["event"] for event in made.origin["log"]].count("unchecked") == 1


def scan_geared(world: World, folder: Path, step_deg: float, **options: Any) -> Dataset:
    geared = replace(devices(world), rig=RigFile(arm=None, turntable=TurntablePart(full_step_deg=step_deg)))
    return scan_module.scan(geared, SCENE, folder, **options)


def test_four_lost_steps_of_a_geared_table_are_noticed(tmp_path: Path) -> None:
    """0.72 degrees of a table whose motor makes 0.18 degrees of it a step; half a degree of one that makes 1.8 is nothing."""

    def scanned(step_deg: float) -> Dataset:
        world = World()
        slip(world, 0.72)
        return scan_geared(world, tmp_path / str(step_deg), step_deg)

    with pytest.raises(RigError, match=r"view_002\.png deviate by \+0\.[67]\d deg from the commanded angle of 180 deg"):
        scanned(0.18)
    assert len(load_dataset(tmp_path / "0.18").frames) == 2
    assert scanned(1.8).origin["complete"]


def test_a_table_anywhere_in_its_play_is_approached_first(tmp_path: Path) -> None:
    """The play of 0.5 degrees, which the next move takes up, is more than half of the four steps that a geared motor can lose."""
    world = World(on_call=stop_at(22))
    with pytest.raises(KeyboardInterrupt):
        scan_geared(world, tmp_path / "d", 0.18)
    world.table_true_deg -= 0.5
    slip(world, 0.5, move=1)
    made = scan_geared(world, tmp_path / "d", 0.18, resume=True)
    assert made.origin["complete"]
    assert not any(event["event"] == "slipped" for event in made.origin["log"])
