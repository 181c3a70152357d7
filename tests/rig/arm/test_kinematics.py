"""The arm's chain against elementary matrices, poses found by hand, and finite differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from rhizotwin.rig.arm.kinematics import arm_from_cam, body_jacobian, forward, log_se3, places
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

PART = ArmPart()
L0, L1, L2, L3 = PART.links_mm
joint_angles = st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5).map(np.array)


def turn(axis: int, angle_rad: float) -> Array:
    """Return the 4x4 rotation about a coordinate axis, written out."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    matrix = np.eye(4)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = c
    matrix[j, i], matrix[i, j] = s, -s
    return matrix


def hat(twist: Array) -> Array:
    """Return the 4x4 matrix of a twist: velocity, rotation."""
    vx, vy, vz, x, y, z = twist
    return np.array([[0, -z, y, vx], [z, 0, -x, vy], [-y, x, 0, vz], [0, 0, 0, 0]])


def vee(matrix: Array) -> Array:
    return np.array([*matrix[:3, 3], matrix[2, 1], matrix[0, 2], matrix[1, 0]])


@given(q=joint_angles)
def test_chain_is_product_of_its_joints(q: Array) -> None:
    up = [frames.translation(0.0, 0.0, length) for length in PART.links_mm]
    mount = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    chain = turn(2, q[0]) @ up[0] @ turn(1, q[1]) @ up[1] @ turn(1, q[2]) @ up[2] @ turn(1, q[3]) @ up[3] @ turn(2, q[4]) @ mount
    np.testing.assert_allclose(forward(PART.links_mm, q), chain, atol=1e-10)
    wrist = turn(2, q[0]) @ up[0] @ turn(1, q[1]) @ up[1] @ turn(1, q[2]) @ up[2]
    np.testing.assert_allclose(places(PART.links_mm, q)[3], wrist[:3, 3], atol=1e-10)


REACH = L1 + L2 + L3
POSES = {
    "turned left": ((90, 90, 0, 0, 0), (0, REACH, L0), (1, 0, 0), (0, 1, 0)),
    "gallows": ((0, 0, 90, 0, 0), (L2 + L3, 0, L0 + L1), (0, -1, 0), (1, 0, 0)),
    "looks down": ((0, 0, 90, 90, 0), (L2, 0, L0 + L1 - L3), (0, -1, 0), (0, 0, -1)),
    "rolled right": ((0, 90, 0, 0, 90), (REACH, 0, L0), (0, 0, -1), (1, 0, 0)),
}
"""Poses found without calculating: joints in degrees, the camera's centre, what is right and ahead of it."""


@pytest.mark.parametrize(("joints_deg", "centre_mm", "right", "ahead"), POSES.values(), ids=POSES)
def test_poses_by_hand(joints_deg: tuple[float, ...], centre_mm: tuple[float, ...], right: Array, ahead: Array) -> None:
    camera = arm_from_cam(PART, joints_deg)
    np.testing.assert_allclose(camera[:3, 3], centre_mm, atol=1e-9)
    np.testing.assert_allclose(camera[:3, :3].T, [right, np.cross(ahead, right), ahead], atol=1e-12)


@given(q=joint_angles)
@settings(max_examples=50)
def test_body_jacobian_is_that_of_finite_differences(q: Array) -> None:
    step = 1e-5
    for j, column in enumerate(body_jacobian(PART, q).T):
        ahead, behind = (forward(PART.links_mm, q + sign * step * np.eye(5)[j]) for sign in (1.0, -1.0))
        # V_b^ = g^-1 g_dot
        v_b = vee(np.linalg.inv(forward(PART.links_mm, q)) @ (ahead - behind) / (2.0 * step))
        np.testing.assert_allclose(column, v_b, atol=1e-5)


@given(
    direction=st.lists(st.floats(-1, 1), min_size=3, max_size=3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1),
    angle=st.one_of(st.floats(0.0, 1e-8), st.floats(1e-5, 1e-2), st.floats(0.0, np.pi - 1e-3)),
    v=st.lists(st.floats(-300, 300), min_size=3, max_size=3).map(np.array),
)
@settings(max_examples=50)
def test_logarithm_undoes_the_exponential(direction: Array, angle: float, v: Array) -> None:
    twist = np.concatenate([v, angle * direction / np.linalg.norm(direction)])
    np.testing.assert_allclose(log_se3(expm(hat(twist))), twist, atol=1e-7)


def test_logarithm_of_small_turns_keeps_its_second_order() -> None:
    for angle_rad in (1e-6, 9.9e-4, 1.01e-3):
        twist = np.array([300.0, -200.0, 400.0, angle_rad, 0.0, 0.0])
        np.testing.assert_allclose(log_se3(expm(hat(twist))), twist, rtol=0.0, atol=1e-8)
