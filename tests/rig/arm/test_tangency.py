"""The correction of appendix C.2: the pose that it aims at, and its convergence on a badly known arm."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.arm.inverse import inverse
from rhizotwin.rig.arm.kinematics import cam_from_rig, rig_from_arm
from rhizotwin.rig.arm.tangency import azimuth_rad, correct, rotate_to_azimuth, tangent_pose
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

PART = ArmPart()
RING = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0)
cameras = st.tuples(
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array),
    st.floats(100.0, 600.0),
    st.floats(-np.pi, np.pi),
    st.floats(-200.0, 200.0),
).map(lambda c: frames.invert(frames.from_rotvec(c[0], np.array([c[1] * np.cos(c[2]), c[1] * np.sin(c[2]), c[3]]))))


def printed_desired(camera: Array) -> Array:
    """Return g_d, the camera in the canister's frame, by the product of appendix C.2."""
    x, y, z = frames.invert(camera)[:3, 3]
    face = np.array([[0.0, 0, -1, 0], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return frames.rotation_z(np.arctan2(y, x)) @ frames.translation(np.hypot(x, y), 0.0, z) @ face


def seen_off_mm(measured: Array) -> float:
    """Return by how much the camera misses the ring, at whatever azimuth: its shift, and the picture's at the axis by its rotation."""
    off_mm, off_deg = frames.pose_error(measured, rotate_to_azimuth(RING, measured))
    return off_mm + 400.0 * np.deg2rad(off_deg)


@given(camera=cameras)
def test_tangent_pose_is_that_of_appendix_c2(camera: Array) -> None:
    np.testing.assert_allclose(frames.invert(tangent_pose(camera)), printed_desired(camera), atol=1e-9)


def test_tangent_pose_in_front_is_the_plans_level_camera() -> None:
    tilted = frames.from_rotvec(np.array([0.1, -0.2, 0.3]), np.zeros(3)) @ RING
    np.testing.assert_allclose(tangent_pose(tilted), RING, atol=1e-9)
    behind = frames.invert(frames.from_rotvec(np.zeros(3), np.array([-300.0, 200.0, 0.0])))
    assert azimuth_rad(behind) == pytest.approx(np.pi - np.arctan(200.0 / 300.0))


@given(camera=cameras, like=cameras)
def test_turning_round_the_axis_changes_the_azimuth_only(camera: Array, like: Array) -> None:
    turned = rotate_to_azimuth(camera, like)
    assert np.cos(azimuth_rad(turned) - azimuth_rad(like)) == pytest.approx(1.0)
    np.testing.assert_allclose(tangent_pose(turned) @ frames.invert(turned), tangent_pose(camera) @ frames.invert(camera), atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_correction_brings_a_badly_known_arm_to_its_place(seed: int) -> None:
    """Zero errors of 2 degrees, scales of 1 %, links, mount and azimuth of the table that nobody knows: two corrections suffice."""
    rng = np.random.default_rng(seed)
    tilted = frames.from_rotvec(np.deg2rad(rng.normal(0.0, 1.0, 3)), np.zeros(3)) @ rig_from_arm(PART)
    real = replace(
        PART,
        position_mm=tuple(np.array(PART.position_mm) + rng.normal(0.0, 4.0, 3)),
        rotation_deg=tuple(np.rad2deg(frames.to_rotvec(tilted))),
        links_mm=tuple(np.array(PART.links_mm) + rng.normal(0.0, 2.0, 4)),
    )
    zero, scale, table = np.deg2rad(rng.uniform(-2, 2, 5)), 1.0 + rng.uniform(-0.01, 0.01, 5), frames.rotation_z(rng.uniform(-3.0, 3.0))

    def measure(joints: Array) -> Array:
        return cam_from_rig(real, np.rad2deg(joints * scale + zero)) @ table

    joints = inverse(PART, frames.invert(rig_from_arm(PART)) @ frames.invert(RING)).joints_rad[0]
    off = [seen_off_mm(measure(joints))]
    for _ in range(2):
        found = correct(PART, joints, measure(joints), RING)
        assert found.converged
        assert found.steps <= 4  # however far the table is turned
        joints = found.joints_rad
        off.append(seen_off_mm(measure(joints)))
    assert off[0] > 5.0
    assert off[1] < 0.1 * off[0]
    assert off[2] < 0.2
