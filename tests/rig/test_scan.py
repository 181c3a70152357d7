"""The scan's own logic on devices that are a few lines each: order of the calls, faults one by one, every way out."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rig import kinematics, session
from rig import scan as scan_module
from rig.devices import Shot
from rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from rig.homing import facing_angle
from rig.markers import read_strip
from rig.open import Devices
from rig.rig_file import ArmPart, RigFile
from rig.scan import scan
from rig.tangency import azimuth_rad
from rig.twin.sketch import Sketch
from rig.twin.world import Sight
from scenes import frames, plan
from scenes.dataset import Dataset, load_dataset, read_image
from scenes.errors import UserError
from scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene

LENS = Camera(image_wh=(400, 300), focal_px=(650.0, 650.0), principal_px=(199.5, 149.5))
STRIP = MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0)
"""Fewer markers, which are read sooner."""
SCENE = Scene(camera=LENS, strip=STRIP, plan=CapturePlan(rings=(Ring(views=4),)))
BLIND = replace(SCENE, strip=replace(SCENE.strip, bottom_mm=400.0))
"""Its strip is out of the picture."""
CALLS = 25
"""Calls of devices in a scan of `SCENE` without trouble."""


@dataclass
class World:
    """What the fakes share: what the table's mechanics, the lamps and the clock really do, and every call."""

    scene: Scene = SCENE
    table_true_deg: float = 77.0
    counter_deg: float | None = None
    """What the board believes; None after power-up."""
    panel: float = 0.0
    front: float = 0.0
    now_s: float = 0.0
    motor: bool = False
    joints_deg: tuple[float, ...] | None = None
    """Where the arm really is; None: the camera stands on a tripod where the first ring wants it."""
    torque: bool = False
    moved_s: float = 0.0
    rested_s: float = 1e9
    """Shortest rest of the arm before a picture."""
    reset: bool = False
    """Whether the board was reset since it was connected, which the driver notices at the next call."""
    calls: list[str] = field(default_factory=list)
    on_call: Callable[[str], None] = lambda _: None

    def call(self, name: str) -> None:
        """Note a call of a device, and let happen what is to happen at it."""
        self.calls.append(name)
        self.on_call(name)
        if self.reset and name.startswith(("table", "lights")):
            raise LostError("turntable: was reset")

    def reset_unnoticed(self) -> None:
        """Reset the board so that only its counter tells."""
        self.reset_board()
        self.reset = False

    @property
    def cam_from_rig(self) -> np.ndarray:
        """Where the camera really stands."""
        if self.joints_deg is not None:
            return kinematics.cam_from_rig(ArmPart(), self.joints_deg)
        ring = self.scene.plan.rings[0]
        return frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)

    def reset_board(self) -> None:
        """Let the board forget everything, the rotor jump and the lamps go out."""
        self.reset = True
        self.counter_deg, self.panel, self.front = None, 0.0, 0.0
        self.table_true_deg += 2.6


@dataclass
class _FakeClock:
    world: World

    def now_s(self) -> float:
        return self.world.now_s

    def sleep(self, seconds: float) -> None:
        self.world.now_s += max(0.0, seconds)


@dataclass
class _FakeTable:
    world: World
    closed: bool = False

    def describe(self) -> str:
        return "a fake board"

    def prepare(self) -> None:
        self.world.reset = False
        self.world.call("table.prepare")
        self.world.motor = True

    def position_deg(self) -> float:
        self.world.call("table.position")
        return -360.0 if self.world.counter_deg is None else self.world.counter_deg

    def declare(self, angle_deg: float) -> None:
        self.world.call("table.declare")
        self.world.counter_deg = angle_deg

    def knows_zero(self) -> bool:
        self.world.call("table.knows")
        return self.world.counter_deg is not None

    def move_to(self, angle_deg: float) -> float:
        self.world.call("table.move")
        if self.world.counter_deg is None:
            return angle_deg - 360.0
        self.world.table_true_deg += angle_deg - self.world.counter_deg
        self.world.counter_deg = angle_deg
        self.world.now_s += 0.3
        return angle_deg

    def release(self) -> None:
        self.world.call("table.release")
        self.world.motor = False

    def close(self) -> None:
        self.closed = True


@dataclass
class _FakeLights:
    world: World

    def set(self, *, panel: float, front: float) -> None:
        self.world.call("lights.set")
        self.world.panel, self.world.front = panel, front

    def off(self) -> None:
        self.world.call("lights.off")
        self.world.panel = self.world.front = 0.0


@dataclass
class _FakeCamera:
    world: World

    def describe(self) -> str:
        return "a fake camera"

    def prepare(self) -> None:
        self.world.call("camera.prepare")

    def capture(self) -> Shot:
        self.world.call("camera.capture")
        self.world.now_s += 0.01
        world = self.world
        world.rested_s = min(world.rested_s, world.now_s - world.moved_s)
        return Shot(
            image=drawn(world.scene, world.cam_from_rig.tobytes(), round(world.table_true_deg % 360.0, 6), world.panel, world.front),
            exposure_s=0.01,
            gain=1.0,
        )

    def close(self) -> None:
        self.world.call("camera.close")


@dataclass
class _FakeArm:
    """Goes beside every place by the same error."""

    world: World
    error_deg: tuple[float, ...] = (0.0, 1.5, -2.0, 1.0, 1.5)
    settled: bool = True

    def describe(self) -> str:
        return "a fake arm"

    def prepare(self) -> None:
        self.world.call("arm.prepare")
        self.world.torque = True

    def read_joints(self) -> tuple[float, ...]:
        self.world.call("arm.read")
        return tuple(a - b for a, b in zip(self.world.joints_deg, self.error_deg, strict=True))

    def holds(self) -> bool:
        self.world.call("arm.holds")
        return self.world.torque

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        self.world.call("arm.move")
        assert self.world.torque
        self.world.joints_deg = tuple(round(a / 0.24) * 0.24 + b for a, b in zip(joints_deg, self.error_deg, strict=True))
        self.world.now_s += 2.0
        self.world.moved_s = self.world.now_s
        return self.read_joints()

    def health(self) -> None:
        self.world.call("arm.health")

    def relax(self) -> None:
        self.world.call("arm.relax")
        self.world.torque = False

    def close(self) -> None:
        self.world.call("arm.close")


@cache
def sketch(scene: Scene) -> Sketch:
    return Sketch(scene, distortion=scene.camera.distortion, canister_from_strip=np.eye(4))


@cache
def drawn(scene: Scene, camera: bytes, table_deg: float, panel: float, front: float) -> np.ndarray:
    """Draw the strip before the panel."""
    canister = plan.rig_from_table(scene, table_deg)
    cam_from_rig = np.frombuffer(camera).reshape(4, 4)
    sight = Sight(cam_from_rig=cam_from_rig, rig_from_canister=canister, table_deg=table_deg, panel=panel, front=front)
    return sketch(scene).picture(sight)


def devices(world: World) -> Devices:
    with_arm = world.joints_deg is not None
    return Devices(
        rig=RigFile(arm=ArmPart() if with_arm else None),
        clock=_FakeClock(world),
        table=_FakeTable(world),
        lights=_FakeLights(world),
        camera=_FakeCamera(world),
        arm=_FakeArm(world) if with_arm else None,
        open_board=lambda: (_FakeTable(world), _FakeLights(world)),
    )


def run(world: World, folder: Path, *, said: list[str] | None = None, **options) -> Dataset:
    return scan(devices(world), world.scene, folder, say=(said if said is not None else []).append, progress=False, **options)


def angles(dataset: Dataset) -> list[float]:
    return [frame.table_deg for frame in dataset.frames]


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
    for word in ("disk", "turntable", "lights", "camera", "picture", "markers"):
        assert sum(line.startswith(word) for line in said) >= 1, said


def test_angle_zero_is_the_seam_toward_the_camera(tmp_path: Path) -> None:
    world = World(table_true_deg=123.4)
    run(world, tmp_path / "d")
    assert (world.table_true_deg - world.counter_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.3)


def stop_at(number: int) -> Callable[[str], None]:
    """Return what presses Ctrl-C at a call."""
    left = [number]

    def count(_: str) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    return count


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


@dataclass(frozen=True)
class Trouble:
    """Something that goes wrong once, at a call of a device."""

    name: str
    call: str
    at: int
    """Which of these calls."""
    happens: Callable[[World], None]

    def arm(self, world: World) -> None:
        """Let it happen in a world."""
        left = [self.at]

        def on_call(name: str) -> None:
            if name == self.call:
                left[0] -= 1
                if left[0] == 0:
                    self.happens(world)

        world.on_call = on_call


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
    Trouble("lamps go out", "camera.capture", 3, lambda world: _FakeLights(replace_calls(world)).off()),
]


def replace_calls(world: World) -> World:
    world.on_call = lambda _: None
    return world


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
    with pytest.raises(RigError, match=r"view_002\.png to view_003\.png show other angles"):
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


def test_angle_that_the_table_kept_is_used_again(tmp_path: Path) -> None:
    world, said = World(on_call=stop_at(16)), []
    with pytest.raises(KeyboardInterrupt):
        run(world, tmp_path / "d")
    world.on_call = lambda _: None
    run(world, tmp_path / "d", resume=True, said=said)
    assert any(line.startswith("turntable: kept its angle") for line in said)
    assert world.calls.count("table.declare") == 1


def test_angle_is_asked_when_no_marker_can_be_read(tmp_path: Path) -> None:
    world, asked = World(scene=BLIND), []

    def ask(question: str) -> str:
        asked.append(question)
        return ["north", "77"][len(asked) - 1]

    run(world, tmp_path / "d", ask=ask)
    assert len(asked) == 2
    assert "no markers were found" in asked[0]
    assert "'north' is no angle" in asked[1]
    assert (world.table_true_deg - world.counter_deg) % 360.0 == pytest.approx(0.0)


def test_angle_is_refused_to_be_guessed(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"angle is not known, and no markers were found.*--table-angle"):
        run(World(scene=BLIND), tmp_path / "d")
    assert not (tmp_path / "d" / "dataset.json").exists()


def test_angle_that_was_given_is_taken_once(tmp_path: Path) -> None:
    world = World(scene=BLIND)
    run(world, tmp_path / "d", table_angle_deg=77.0)
    assert (world.table_true_deg - world.counter_deg) % 360.0 == pytest.approx(0.0)
    world = World(scene=BLIND)
    Trouble("", "table.move", 3, World.reset_board).arm(world)
    with pytest.raises(RigError, match="angle is not known"):
        run(world, tmp_path / "e", table_angle_deg=77.0)


def test_angle_that_the_markers_contradict_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"said to stand at 30 deg, but the markers show 7[67]\.\d deg"):
        run(World(), tmp_path / "d", table_angle_deg=30.0)


@dataclass(frozen=True)
class Refusal:
    """A scan that is not begun, and what must be named."""

    name: str
    named: str
    scene: Scene = SCENE
    world: dict[str, float] = field(default_factory=dict)


def with_rings(*rings: Ring) -> Scene:
    return replace(SCENE, plan=CapturePlan(rings=rings))


REFUSALS = [
    Refusal("jitter", "plan.rings 1: jitter_mm and jitter_deg must be 0", with_rings(Ring(jitter_mm=1.0))),
    Refusal("far angle", "plan.rings 1: first_deg brings the table to -180 deg", with_rings(Ring(first_deg=-180.0))),
    Refusal("two rings, no arm", "the plan has 2 rings, but the rig has no arm", with_rings(Ring(views=2), Ring(views=2, height_mm=0.0))),
]


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda refusal: refusal.name)
def test_refused_before_anything_moves(refusal: Refusal, tmp_path: Path) -> None:
    world = World(scene=refusal.scene)
    with pytest.raises(UserError, match=refusal.named):
        run(world, tmp_path / "d")
    assert world.calls == []
    assert not (tmp_path / "d").exists()


def test_picture_of_another_size_is_refused(tmp_path: Path) -> None:
    world = World()
    other = replace(SCENE, camera=SCENE.camera.resized((800, 600)))
    with pytest.raises(RigError, match="400x300 pixels, but the scene's camera has image_wh 800x600"):
        scan(devices(world), other, tmp_path / "d", say=lambda _: None, progress=False)
    assert (world.panel, world.front) == (0.0, 0.0)


def test_dark_and_saturated_pictures_are_refused(tmp_path: Path) -> None:
    dim = replace(devices(World()).rig.lights, panel_level=0.1)
    for part, named in ((dim, "too dark"), (replace(dim, panel_level=1.0), "at full scale")):
        world = World()
        opened = devices(world)
        opened.rig = replace(opened.rig, lights=part)
        if part.panel_level == 1.0:
            opened.camera.capture = lambda: Shot(image=np.full((300, 400), 65520, np.uint16), exposure_s=1.0, gain=1.0)
        with pytest.raises(RigError, match=named):
            scan(opened, SCENE, tmp_path / named, say=lambda _: None, progress=False)


def test_tripod_is_moved_by_a_person_for_further_rings(tmp_path: Path) -> None:
    scene, asked = with_rings(Ring(views=2), Ring(views=2, distance_mm=420.0)), []
    world = World(scene=scene)
    made = run(world, tmp_path / "d", ask=lambda question: asked.append(question) or "")
    assert len(asked) == 1
    assert "420 mm from the axis at z = -42 mm" in asked[0]
    assert [(frame.ring, frame.placement) for frame in made.frames] == [(0, 0), (0, 0), (1, 0), (1, 0)]


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
    for place, view in zip(places, plan.views(RINGS), strict=True):
        off_mm, off_deg = frames.pose_error(place @ frames.rotation_z(azimuth_rad(place)), view.cam_from_rig)
        assert off_mm < 4.0
        assert off_deg < 1.0
    for frame in made.frames:
        assert len(frame.joints_deg) == len(frame.joints_read_deg) == 5
        assert frame.joints_deg == pytest.approx(frame.joints_read_deg, abs=0.13)
    assert {frame.joints_deg for frame in made.frames if frame.ring == 0} == {made.frames[0].joints_deg}
    assert np.subtract(world.joints_deg, _FakeArm(world).error_deg) == pytest.approx(ArmPart().park_deg, abs=0.13)
    assert not world.torque


def test_ring_out_of_reach_is_refused_before_anything_moves(tmp_path: Path) -> None:
    world = armed()
    world.scene = with_rings(Ring(views=2), Ring(views=2, height_mm=900.0))
    with pytest.raises(UnsafeError, match=r"arm: .*reach"):
        run(world, tmp_path / "d")
    assert world.calls == []


@pytest.mark.parametrize("number", [3, 12, 23, 34, 47, 58])
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
