"""The arm's chain against elementary matrices, poses found by hand, and finite differences; slips of the thesis's appendix C.1."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from rhizotwin.rig.arm.kinematics import arm_from_cam, body_jacobian, cam_from_rig, forward, log_se3, places, rig_from_arm
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
    np.testing.assert_allclose(
        places(PART.links_mm, q)[3], (turn(2, q[0]) @ up[0] @ turn(1, q[1]) @ up[1] @ turn(1, q[2]) @ up[2])[:3, 3], atol=1e-10
    )


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A pose of the arm that can be told without calculating."""

    name: str
    joints_deg: tuple[float, ...]
    centre_mm: tuple[float, float, float]
    right: tuple[float, float, float]
    ahead: tuple[float, float, float]


POSES = (
    Pose(name="upright", joints_deg=(0, 0, 0, 0, 0), centre_mm=(0, 0, L0 + L1 + L2 + L3), right=(0, -1, 0), ahead=(0, 0, 1)),
    Pose(name="leans forward", joints_deg=(0, 90, 0, 0, 0), centre_mm=(L1 + L2 + L3, 0, L0), right=(0, -1, 0), ahead=(1, 0, 0)),
    Pose(name="turned left", joints_deg=(90, 90, 0, 0, 0), centre_mm=(0, L1 + L2 + L3, L0), right=(1, 0, 0), ahead=(0, 1, 0)),
    Pose(name="gallows", joints_deg=(0, 0, 90, 0, 0), centre_mm=(L2 + L3, 0, L0 + L1), right=(0, -1, 0), ahead=(1, 0, 0)),
    Pose(name="looks down", joints_deg=(0, 0, 90, 90, 0), centre_mm=(L2, 0, L0 + L1 - L3), right=(0, -1, 0), ahead=(0, 0, -1)),
    Pose(name="rolled right", joints_deg=(0, 90, 0, 0, 90), centre_mm=(L1 + L2 + L3, 0, L0), right=(0, 0, -1), ahead=(1, 0, 0)),
)


@pytest.mark.parametrize("pose", POSES, ids=lambda pose: pose.name)
def test_poses_told_by_hand(pose: Pose) -> None:
    camera = arm_from_cam(PART, pose.joints_deg)
    np.testing.assert_allclose(camera[:3, 3], pose.centre_mm, atol=1e-9)
    np.testing.assert_allclose(camera[:3, 0], pose.right, atol=1e-12)
    np.testing.assert_allclose(camera[:3, 2], pose.ahead, atol=1e-12)
    np.testing.assert_allclose(np.cross(camera[:3, 2], camera[:3, 0]), camera[:3, 1], atol=1e-12)


def test_level_camera_of_the_default_arm_is_upright_and_faces_the_table() -> None:
    rig_from_cam = frames.invert(cam_from_rig(PART, (0.0, 20.0, 30.0, 40.0, 0.0)))
    np.testing.assert_allclose(rig_from_cam[:3, 1], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(rig_from_cam[:3, 2], [-1, 0, 0], atol=1e-12)
    assert rig_from_cam[0, 3] < PART.position_mm[0]
    np.testing.assert_allclose(rig_from_cam, rig_from_arm(PART) @ arm_from_cam(PART, (0.0, 20.0, 30.0, 40.0, 0.0)), atol=1e-10)


def test_many_at_once_agree_with_one_by_one() -> None:
    many = np.random.default_rng(1).uniform(-2, 2, (3, 4, 5))
    for index in np.ndindex(3, 4):
        np.testing.assert_allclose(forward(PART.links_mm, many)[index], forward(PART.links_mm, many[index]), atol=1e-12)
        np.testing.assert_allclose(body_jacobian(PART, many)[index], body_jacobian(PART, many[index]), atol=1e-12)


def test_wrong_number_of_joints_is_named() -> None:
    with pytest.raises(ValueError, match=r"joints must be \(..., 5\), not \(6,\)"):
        arm_from_cam(PART, (0.0,) * 6)


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


@pytest.mark.parametrize("angle_rad", [1e-6, 9.9e-4, 1.01e-3])
def test_logarithm_of_small_turns_keeps_its_second_order(angle_rad: float) -> None:
    twist = np.array([300.0, -200.0, 400.0, angle_rad, 0.0, 0.0])
    np.testing.assert_allclose(log_se3(expm(hat(twist))), twist, rtol=0.0, atol=1e-8)


# Appendix C.1 of the thesis. Its base frame's x, y, z are our arm's z, -y, x: there the arm points along x at home.
THESIS_FROM_ARM = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])


def printed_position(a: Array) -> Array:
    """Return x, y, z of g_e as printed, with our lengths: l_0 + l_1 up to the shoulder."""
    a1, a2, a3 = a[:3]
    lean = L2 * np.sin(a2 + a3) + L1 * np.sin(a2)
    return np.array([L0 + L1 * np.cos(a2) + L2 * np.cos(a2 + a3), np.sin(a1) * lean, -np.cos(a1) * lean])


def printed_jacobian(a: Array) -> Array:
    """Return J_v over J_omega as printed."""
    a1, a2, a3, a4 = a[:4]
    c1, s1, c2, s2, c23, s23 = np.cos(a1), np.sin(a1), np.cos(a2), np.sin(a2), np.cos(a2 + a3), np.sin(a2 + a3)
    c234, s234 = np.cos(a2 + a3 + a4), np.sin(a2 + a3 + a4)
    lean, rise = L2 * s23 + L1 * s2, L2 * c23 + L1 * c2
    j_v = [[0, -lean, -L2 * s23, 0, 0], [c1 * lean, s1 * rise, L2 * c23 * s1, 0, 0], [s1 * lean, -c1 * rise, -L2 * c23 * c1, 0, 0]]
    j_omega = [[1, 0, 0, 0, c234], [0, c1, c1, c1, s1 * s234], [0, s1, s1, s1, -c1 * s234]]
    return np.array([*j_v, *j_omega])


ALPHA = np.array([0.3, 0.5, 0.7, -0.4, 0.2])
OURS = ALPHA * [1, -1, -1, -1, 1]
"""The same pose: the thesis's pitch leans toward -z, which is our -x."""


def test_slip_the_link_beyond_the_wrist_is_missing() -> None:
    at = places(PART.links_mm, OURS) @ THESIS_FROM_ARM.T
    np.testing.assert_allclose(printed_position(ALPHA), at[3], atol=1e-9)  # the wrist, not the camera
    assert np.linalg.norm(at[4] - at[3]) == pytest.approx(L3)
    assert not printed_jacobian(ALPHA)[:3, 3].any()
    assert np.linalg.norm(body_jacobian(PART, OURS)[:3, 3]) == pytest.approx(L3)


def test_slip_the_printed_jacobian_is_not_the_body_jacobian() -> None:
    short = ArmPart(links_mm=(L0, L1, L2, 0.0))  # without the link that the thesis leaves out
    sign = np.array([1, -1, -1, -1, 1])
    body = body_jacobian(short, OURS) * sign
    thesis_from_cam = THESIS_FROM_ARM @ forward(short.links_mm, OURS)[:3, :3]
    turned = np.concatenate([thesis_from_cam @ body[:3], thesis_from_cam @ body[3:]])
    np.testing.assert_allclose(printed_jacobian(ALPHA), turned, atol=1e-9)  # velocities of the camera, but along the base's axes
    assert np.abs(printed_jacobian(ALPHA) - body).max() > 10.0
