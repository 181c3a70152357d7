"""The scan on the emulated twin, over its serial bytes: every fault of the menu by itself, and what is left behind."""

from dataclasses import replace
from pathlib import Path

import pytest

from rig.errors import RigError
from rig.open import Devices, open_devices
from rig.scan import scan
from rig.twin.faults import FOR_GOOD, MENU, Fault, FaultKind
from rig.twin.twin import Twin
from scenes import plan
from scenes.dataset import Dataset, load_dataset, read_image
from scenes.files import load_profile
from scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene

SCENE = Scene(
    camera=Camera().resized((400, 300)),
    strip=MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0),
    plan=CapturePlan(rings=(Ring(views=3, height_mm=-20.0),)),
    disturbances=load_profile("bench"),
)


def twin_of(*faults: Fault, scene: Scene = SCENE, seed: int = 1, **options) -> Twin:
    return Twin(scene, seed=seed, profile_name="bench", pictures="sketch", faults=faults, **options)


def opened(twin: Twin) -> Devices:
    return open_devices(twin.rig, twin.calibrated_scene(), clock=twin.clock, camera=twin.open_camera())


def run(twin: Twin, folder: Path, **options) -> Dataset:
    devices = opened(twin)
    try:
        return scan(devices, twin.calibrated_scene(), folder, say=lambda _: None, progress=False, **options)
    finally:
        devices.close()
        twin.clock.sleep(1.0)  # the lamps fade


def off_deg(twin: Twin, dataset: Dataset) -> list[float]:
    """Return by how much the table really stood beside each frame's angle."""
    found = []
    for frame in dataset.frames:
        shot = twin.record.shot_of(read_image(dataset, frame))
        if shot is not None:
            found.append((shot.sight.table_deg - frame.table_deg + 180.0) % 360.0 - 180.0)
    return found


def is_safe(twin: Twin) -> bool:
    """Tell whether lamps and torque are off."""
    return max(twin.world.panel.level, twin.world.front.level) == 0.0 and not any(
        twin.world.servos[joint.servo].torque_on for joint in twin.rig.arm.joints
    )


@pytest.mark.parametrize("protocol", ["lx", "lsc"])
def test_complete_scan_is_the_plan(protocol: str, tmp_path: Path) -> None:
    twin = twin_of(protocol=protocol)
    made = run(twin, tmp_path / "d")
    assert made == load_dataset(tmp_path / "d")
    assert [(frame.ring, frame.kind, frame.table_deg) for frame in made.frames] == [
        (view.ring, view.kind, view.table_deg) for view in plan.views(SCENE)
    ]
    offsets = off_deg(twin, made)
    assert len(offsets) == 3
    assert max(offsets) - min(offsets) < 0.3  # the motor's own errors
    assert max(map(abs, offsets)) < 2.0
    for frame in made.frames:
        assert frame.joints_read_deg == pytest.approx(frame.joints_deg, abs=3.0)
        assert (frame.exposure_s, frame.gain) == (twin.rig.camera.exposure_s, twin.rig.camera.gain)
    assert is_safe(twin)


@pytest.mark.parametrize("at_message", [24, 26, 29])
def test_table_that_was_reset_is_found_within_a_tenth_of_a_degree(at_message: int, tmp_path: Path) -> None:
    """Reset at some reply of the board, while the pictures are taken: true angles before and after agree."""
    scene = replace(SCENE, plan=CapturePlan(rings=(Ring(views=8, height_mm=-20.0),)))
    quiet = twin_of(scene=scene)
    run(quiet, tmp_path / "quiet")
    reset_s = quiet.clock.now_s() * at_message / 40.0
    twin = twin_of(Fault(kind="reset", device="table", at_s=reset_s), scene=scene)
    made = run(twin, tmp_path / "d")
    offsets = off_deg(twin, made)
    before = [off for off, frame in zip(offsets, made.frames, strict=True) if frame.placement == 0]
    after = [off for off, frame in zip(offsets, made.frames, strict=True) if frame.placement == 1]
    assert before
    assert after
    play_deg = 0.1 + 2 * 0.075  # of the twin's motor
    assert sum(after) / len(after) == pytest.approx(sum(before) / len(before), abs=0.1 + play_deg / 2.0)


SINGLE = [
    pytest.param(kind, count, id=f"{kind.name} {'once' if count == 1 else 'for good'}")
    for kind in MENU
    for count in (1, FOR_GOOD)
    if kind.protocol != "lsc" and count in kind.counts
]


@pytest.mark.parametrize(("kind", "count"), SINGLE)
def test_each_fault_is_cured_or_named(kind: FaultKind, count: int, tmp_path: Path) -> None:
    message = {"shot": 5, "device": None}.get(kind.where, 70)
    fault = Fault(
        kind=kind.name,
        device=kind.devices[0],
        at_message=message,
        at_s=14.0 if kind.where == "device" else None,
        amount=kind.amounts[-1],
        count=count,
    )
    twin = twin_of(fault)
    kept, named = None, True
    try:
        run(twin, tmp_path / "d")
    except RigError as error:
        named = str(error).split()[0].rstrip(":") in ("arm", "turntable", "camera", "lights")
        if (tmp_path / "d" / "dataset.json").exists():
            kept = load_dataset(tmp_path / "d")
        twin = twin_of(seed=2)
        run(twin, tmp_path / "d", resume=True)
    made = load_dataset(tmp_path / "d")
    assert named
    assert [frame.table_deg for frame in made.frames] == [view.table_deg for view in plan.views(SCENE)]
    assert kept is None or made.frames[: len(kept.frames)] == kept.frames
    assert all(abs(off) < 4.0 for off in off_deg(twin, made))  # a fault at the wrong moment would give many times that
    assert is_safe(twin)


def test_arm_is_let_go_and_lamps_are_off_after_a_fault_of_the_arm(tmp_path: Path) -> None:
    twin = twin_of(Fault(kind="stalled", device="arm", at_s=5.0, amount=0.0, joint=2))
    with pytest.raises(RigError, match="arm: "):
        run(twin, tmp_path / "d")
    assert is_safe(twin)
