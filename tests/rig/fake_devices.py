"""Devices of a few lines each for the tests of the scan, and the world that they share."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np

from rhizotwin.rig.devices import LEAST_DEG, Shot
from rhizotwin.rig.errors import LostError
from rhizotwin.rig.open import Devices, open_devices
from rhizotwin.rig.rig_file import ArmPart, BandPart, RigFile
from rhizotwin.rig.scanning.observer import Observer
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.twin.sketch import Sketch
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene
from tests.rig.fake_time import Time

LENS = Camera(image_wh=(400, 300), focal_px=(650.0, 650.0), principal_px=(199.5, 149.5))
STRIP = MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0)  # fewer markers, which are read sooner
CLEAN = Scene(camera=Camera().resized((400, 300)), strip=STRIP, disturbances=load_profile("clean"))  # for the emulated rig
SCENE = Scene(camera=LENS, strip=STRIP, plan=CapturePlan(rings=(Ring(views=4),)))
BLIND = replace(SCENE, strip=replace(SCENE.strip, bottom_mm=400.0))  # the strip is out of the picture


@dataclass
class World:
    """What the fakes share: what the table's mechanics, the lamps and the clock really do, and every call."""

    scene: Scene = SCENE
    table_true_deg: float = 77.0
    counter_deg: float | None = None  # what the board believes; None after power-up
    panel: float = 0.0
    front: float = 0.0
    clock: Time = field(default_factory=Time)
    band: str = ""
    motor: bool = False
    acceleration_deg_per_s2: float = 60.0
    with_arm: bool = False
    reset: bool = False  # whether the board was reset since it was connected, which the driver notices at the next call
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
        """Where the camera stands."""
        ring = self.scene.plan.rings[0]
        return frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)

    def lamps_out(self) -> None:
        """Let the lamps go out."""
        self.panel = self.front = 0.0

    def reset_board(self) -> None:
        """Let the board forget everything, the rotor jump and the lamps go out."""
        self.reset = True
        self.counter_deg = None
        self.lamps_out()
        self.table_true_deg += 2.6


@dataclass
class _FakeBoard:
    """Table and lights."""

    world: World

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
        assert angle_deg >= LEAST_DEG
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
        self.world.clock.at_s += 0.3
        return angle_deg

    def accelerate(self, deg_per_s2: float) -> None:
        self.world.call("table.accelerate")
        self.world.acceleration_deg_per_s2 = deg_per_s2

    def release(self) -> None:
        self.world.call("table.release")
        self.world.motor = False

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        self.world.call("lights.set")
        self.world.panel, self.world.front, self.world.band = panel, front, "" if band is None else band.name

    def off(self) -> None:
        self.world.call("lights.off")
        self.world.lamps_out()

    def close(self) -> None:
        pass


@dataclass
class _FakeCamera:
    world: World

    def describe(self) -> str:
        return "a fake camera"

    def prepare(self) -> None:
        self.world.call("camera.prepare")

    def capture(self) -> Shot:
        self.world.call("camera.capture")
        world = self.world
        world.clock.at_s += 0.01
        return Shot(
            image=drawn(world.scene, world.cam_from_rig.tobytes(), round(world.table_true_deg % 360.0, 6), world.panel, world.front),
            exposure_s=0.01,
            gain=1.0,
        )

    def close(self) -> None:
        self.world.call("camera.close")


@cache
def _sketch(scene: Scene) -> Sketch:
    return Sketch(scene, distortion=scene.camera.distortion, canister_from_strip=np.eye(4))


@cache
def drawn(scene: Scene, camera: bytes, table_deg: float, panel: float, front: float) -> np.ndarray:
    """Draw the strip before the panel."""
    poses = {"cam_from_rig": np.frombuffer(camera).reshape(4, 4), "rig_from_canister": plan.rig_from_table(scene, table_deg)}
    return _sketch(scene).picture(Sight(**poses, table_deg=table_deg, panel=panel, front=front))


def devices(world: World) -> Devices:
    board = _FakeBoard(world)
    return Devices(
        rig=RigFile(arm=ArmPart() if world.with_arm else None),
        clock=world.clock,
        table=board,
        lights=board,
        camera=_FakeCamera(world),
        arm=Mock() if world.with_arm else None,
        open_board=lambda: (_FakeBoard(world), _FakeBoard(world)),
    )


def run(world: World, folder: Path, *, said: list[str] | None = None, observer: Any = None, resume: bool = False, **user: Any) -> Dataset:
    observers = Observers(say=(said if said is not None else []).append, observer=observer or Observer(), **user)
    return scan(devices(world), world.scene, folder, observers=observers, resume=resume)


@contextmanager
def opened(twin: Twin, *, scene: Scene | None = None, camera: Any = None) -> Iterator[Devices]:
    """Open the devices of an emulated rig, which is left until its lamps have faded."""
    found = open_devices(twin.rig, scene or twin.calibrated_scene(), clock=twin.clock, camera=camera or twin.open_camera())
    try:
        yield found
    finally:
        found.close()
        twin.clock.sleep(1.0)


def scan_twin(twin: Twin, folder: Path, *, said: list[str] | None = None, **options: Any) -> Dataset:
    with opened(twin) as found:
        observers = Observers(say=(said if said is not None else []).append)
        return scan(found, twin.calibrated_scene(), folder, observers=observers, **options)


def angles(dataset: Dataset) -> list[float]:
    return [frame.table_deg for frame in dataset.frames]


def with_rings(*rings: Ring) -> Scene:
    return replace(SCENE, plan=CapturePlan(rings=rings))


def stop_at(number: int) -> Callable[[str], None]:
    """Return what presses Ctrl-C at a call."""
    calls = count(1)

    def press(_: str) -> None:
        if next(calls) == number:
            raise KeyboardInterrupt

    return press


def at_call(world: World, call: str, at: int, happens: Callable[[World], None]) -> None:
    """Let something happen once, at one of the calls of that name."""
    calls = count(1)

    def on_call(name: str) -> None:
        if name == call and next(calls) == at:
            happens(world)

    world.on_call = on_call
