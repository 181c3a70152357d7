"""The scan on the emulated twin, over its serial bytes: every fault of the menu by itself, and what is left behind."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from rhizotwin.rig.arm.tangency import azimuth_rad
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.twin.faults import FOR_GOOD, MENU, Fault, FaultKind
from rhizotwin.rig.twin.imperfections import BENCH
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene
from tests.rig.fake_devices import STRIP, opened, scan_twin

pytestmark = pytest.mark.slow

SCENE = Scene(
    camera=Camera().resized((400, 300)),
    strip=STRIP,
    plan=CapturePlan(rings=(Ring(views=3, height_mm=-20.0),)),
    disturbances=load_profile("bench"),
)


def twin_of(*faults: Fault, scene: Scene = SCENE, seed: int = 1, **options) -> Twin:
    return Twin(scene, seed=seed, profile_name="bench", pictures="sketch", faults=faults, **options)


def table_off_deg(twin: Twin, dataset: Dataset) -> list[float]:
    """Return by how much the table really stood beside each frame's angle, if the twin took it."""
    shots = [(twin.record.shot_of(read_image(dataset, frame)), frame.table_deg) for frame in dataset.frames]
    return [(shot.sight.table_deg - angle_deg + 180.0) % 360.0 - 180.0 for shot, angle_deg in shots if shot is not None]


def is_safe(twin: Twin) -> bool:
    """Tell whether lamps and torque are off."""
    lit = max(twin.world.panel.level, twin.world.front.level)
    return lit == 0.0 and not any(twin.world.servos[joint.servo].torque_on for joint in twin.rig.arm.joints)


@pytest.mark.parametrize("protocol", ["lx", "lsc"])
def test_complete_scan_is_the_plan(protocol: str, tmp_path: Path) -> None:
    twin = twin_of(rig=default_rig(protocol))
    made = scan_twin(twin, tmp_path / "d")
    assert made == load_dataset(tmp_path / "d")
    assert [(frame.ring, frame.kind, frame.table_deg) for frame in made.frames] == [
        (view.ring, view.kind, view.table_deg) for view in plan.views(SCENE)
    ]
    offsets = table_off_deg(twin, made)
    assert len(offsets) == 3
    assert max(offsets) - min(offsets) < 0.3  # the motor's own errors
    assert max(map(abs, offsets)) < 2.0
    for frame, view in zip(made.frames, plan.views(SCENE), strict=True):
        assert frame.joints_read_deg == pytest.approx(frame.joints_deg, abs=3.0)
        assert (frame.exposure_s, frame.gain) == (twin.rig.camera.exposure_s, twin.rig.camera.gain)
        place = twin.record.shot_of(read_image(made, frame)).sight.cam_from_rig
        off_mm, off_deg = frames.pose_error(place @ frames.rotation_z(azimuth_rad(place)), view.cam_from_rig)
        assert off_mm < 4.0
        assert off_deg < 1.0
    assert is_safe(twin)


def test_ctrl_c_leaves_lamps_and_torque_off(tmp_path: Path) -> None:
    twin = twin_of()
    camera = twin.open_camera()
    camera.capture = Mock(side_effect=KeyboardInterrupt)
    with opened(twin, camera=camera) as devices, pytest.raises(KeyboardInterrupt):
        scan(devices, twin.calibrated_scene(), tmp_path / "d", observers=Observers(say=lambda _: None))
    assert is_safe(twin)


def test_reset_table_is_found_within_a_tenth_of_a_degree(tmp_path: Path) -> None:
    """Reset among the pictures: true angles before and after agree but for the motor's own errors."""
    scene = replace(SCENE, camera=Camera(), strip=MarkerStrip(), plan=CapturePlan(rings=(Ring(views=6),)))
    twin = twin_of(scene=scene)
    with opened(twin) as devices:
        move = devices.table.move_to

        def move_and_reset(angle_deg: float) -> float:
            if angle_deg == 180.0:
                twin.inject(Fault(kind="reset", device="table", at_s=twin.clock.now_s() + 0.2))
                del devices.table.move_to
            return move(angle_deg)

        devices.table.move_to = move_and_reset
        made = scan(devices, twin.calibrated_scene(), tmp_path / "d", observers=Observers(say=lambda _: None))
    assert [frame.placement for frame in made.frames] == [0, 0, 0, 1, 1, 1]
    before, after = np.array(table_off_deg(twin, made)).reshape(2, 3).mean(axis=1)
    assert after == pytest.approx(before, abs=0.1 + BENCH.table_microstep_deg)


DRIVERS = ("reply_late", "reply_doubled", "reply_truncated", "garbage", "request_dropped", "ok_missing", "ok_missing_after_resend", "busy")
"""Faults on the wire that the tests of the drivers put there."""
SINGLE = [
    pytest.param(kind, count, id=f"{kind.name} {'once' if count == 1 else 'for good'}")
    for kind in MENU
    for count in (1, FOR_GOOD)
    if kind.protocol != "lsc" and kind.name not in DRIVERS and (count == 1 or kind.name in ("reply_dropped", "stale_frame"))
]


@pytest.mark.parametrize(("kind", "count"), SINGLE)
def test_each_fault_is_cured_or_named(kind: FaultKind, count: int, tmp_path: Path) -> None:
    where = {"at_message": {"shot": 5, "device": None}.get(kind.where, 70), "at_s": 14.0 if kind.where == "device" else None}
    twin = twin_of(Fault(kind=kind.name, device=kind.devices[0], amount=kind.amounts[-1], count=count, **where))
    kept, named = None, "arm"
    try:
        scan_twin(twin, tmp_path / "d")
    except RigError as error:
        named = str(error).split()[0].rstrip(":")
        assert kind.where != "device" or is_safe(twin)
        if (tmp_path / "d" / "dataset.json").exists():
            kept = load_dataset(tmp_path / "d")
        twin = twin_of(seed=2)
        scan_twin(twin, tmp_path / "d", resume=True)
    made = load_dataset(tmp_path / "d")
    assert named in ("arm", "turntable", "camera", "lights")
    assert [frame.table_deg for frame in made.frames] == [view.table_deg for view in plan.views(SCENE)]
    assert kept is None or made.frames[: len(kept.frames)] == kept.frames
    assert all(abs(off) < 4.0 for off in table_off_deg(twin, made))  # a fault at the wrong moment would give many times that
    assert is_safe(twin)
