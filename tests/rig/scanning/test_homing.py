"""The table's angle from the markers: exact poses, constant errors that must cancel, and who is asked when nothing can be read."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.devices import LEAST_DEG
from rhizotwin.rig.scanning.homing import (
    Reference,
    angle_against,
    angle_from_markers,
    angle_from_user,
    facing_angle,
    nearest_turn,
    wrap_angle,
)
from rhizotwin.rig.scanning.markers import Sighting, read_strip, unread_reason
from rhizotwin.rig.twin.sketch import Sketch
from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Ring, Scene, Turntable
from rhizotwin.scenes.plan import visible_markers

SCENE = Scene(camera=Camera().resized((800, 600)))
ANGLES = st.floats(-90.0, 720.0)


LEVEL = frames.level_camera(distance_mm=Ring().distance_mm, height_mm=Ring().height_mm, tilt_deg=Ring().tilt_deg)


def sighting(table_deg: float, *, camera: np.ndarray | None = None, seat: np.ndarray | None = None, direction: int = 1) -> Sighting:
    turned = frames.rotation_z(direction * np.deg2rad(table_deg))
    pose = (LEVEL if camera is None else camera) @ turned @ (np.eye(4) if seat is None else seat)
    return Sighting(cam_from_canister=pose, markers=18, reprojection_px=0.05)


def difference(a: float, b: float) -> float:
    return abs(wrap_angle(a - b))


@given(angle=ANGLES, direction=st.sampled_from([1, -1]))
def test_strip_that_faces_the_camera_tells_the_angle(angle: float, direction: int) -> None:
    scene = replace(SCENE, turntable=Turntable(direction=direction))
    assert difference(facing_angle(sighting(angle, direction=direction), scene), angle) < 1e-9


@given(angle=ANGLES, known=st.lists(ANGLES, min_size=1, max_size=6), direction=st.sampled_from([1, -1]), seed=st.integers(0, 2**31))
def test_constant_errors_of_camera_and_seat_cancel(angle: float, known: list[float], direction: int, seed: int) -> None:
    """But for the twist about a leaning axis, which is not quite the turn."""
    rng = np.random.default_rng(seed)
    scene = replace(SCENE, turntable=Turntable(direction=direction))
    camera = frames.from_rotvec(rng.normal(0.0, 0.05, 3), rng.normal(0.0, 5.0, 3)) @ LEVEL
    seat = frames.from_rotvec(np.array([*rng.uniform(-0.01, 0.01, 2), 0.0]), np.array([*rng.normal(0.0, 1.0, 2), 0.0]))

    def pose(table_deg: float) -> np.ndarray:
        return sighting(table_deg, camera=camera, seat=seat, direction=direction).cam_from_canister

    references = [Reference(table_deg=k, cam_from_canister=pose(k)) for k in known]
    assert difference(angle_against(pose(angle), references, scene), angle) < 0.02


def test_one_wrong_reference_among_several_does_no_harm() -> None:
    good = [Reference(table_deg=k, cam_from_canister=sighting(k).cam_from_canister) for k in (0.0, 9.0, 18.0, 27.0)]
    wrong = Reference(table_deg=90.0, cam_from_canister=sighting(4.0).cam_from_canister)
    assert difference(angle_against(sighting(200.0).cam_from_canister, [wrong, *good], SCENE), 200.0) < 0.01


@given(angle=st.floats(-1e4, 1e4), near=st.floats(LEAST_DEG, 1e4))
def test_of_all_turns_the_nearest_that_the_table_takes(angle: float, near: float) -> None:
    found = nearest_turn(angle, near)
    assert found >= LEAST_DEG
    assert difference(found, angle) < 1e-6
    others = [found + 360.0 * k for k in (-2, -1, 1, 2)]
    assert all(abs(found - near) <= abs(other - near) + 1e-6 for other in others if other >= LEAST_DEG)


def test_unseen_angle_is_as_given_or_a_person_is_asked() -> None:
    assert angle_from_user(near_deg=0.0, given_deg=370.0).table_deg == pytest.approx(10.0)
    answers = iter(["nan", "1e9", " 45 deg"])
    found = angle_from_user(near_deg=0.0, ask=lambda _: next(answers))
    assert (found.table_deg, found.source) == (45.0, "given by the operator")
    assert angle_from_markers(sighting(100.0), [], SCENE, near_deg=0.0, given_deg=103.0).table_deg == pytest.approx(100.0)


def test_expected_markers_are_read_but_not_of_another_strip() -> None:
    sketch = Sketch(SCENE, distortion=SCENE.camera.distortion, canister_from_strip=np.eye(4))
    image = sketch.picture(Sight(cam_from_rig=LEVEL, rig_from_canister=np.eye(4), table_deg=0.0, panel=1.0, front=1.0))
    read = read_strip(image, SCENE)
    assert read is not None
    assert unread_reason(image, SCENE) == ""
    assert abs(visible_markers(SCENE, LEVEL) - read.markers) <= 6
    other = replace(SCENE, strip=replace(SCENE.strip, columns=20))
    assert read_strip(image, other) is None
    assert "do not fit the strip and camera of the scene" in unread_reason(image, other)
    assert "no markers" in unread_reason(np.zeros_like(image), SCENE)
