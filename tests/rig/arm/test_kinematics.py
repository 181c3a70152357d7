"""The arm's chain against elementary matrices; its inverse; the correction by markers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from rhizotwin.rig.arm.inverse import MOST_STEPS, inverse, newton, three_link
from rhizotwin.rig.arm.kinematics import cam_from_rig, forward, log_se3, places, rig_from_arm
from rhizotwin.rig.arm.tangency import correct, rotate_to_azimuth, tangent_pose
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

PART = ArmPart()
LINKS = PART.links_mm


def vectors(size: int, most: float) -> st.SearchStrategy[Array]:
    return st.lists(st.floats(-most, most), min_size=size, max_size=size).map(np.array)


def turn(axis: str, angle_rad: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axis, angle_rad).as_matrix()
    return matrix


def hat(twist: Array) -> Array:
    vx, vy, vz, x, y, z = twist
    return np.array([[0, -z, y, vx], [z, 0, -x, vy], [-y, x, 0, vz], [0, 0, 0, 0]])


@given(q=vectors(5, 3.0))
def test_chain_is_product_of_its_joints(q: Array) -> None:
    up = [frames.translation(0.0, 0.0, length) for length in LINKS]
    mount = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    chain = turn("z", q[0]) @ up[0] @ turn("y", q[1]) @ up[1] @ turn("y", q[2]) @ up[2] @ turn("y", q[3]) @ up[3] @ turn("z", q[4]) @ mount
    np.testing.assert_allclose(forward(LINKS, q), chain, atol=1e-10)
    wrist = turn("z", q[0]) @ up[0] @ turn("y", q[1]) @ up[1] @ turn("y", q[2]) @ up[2]
    np.testing.assert_allclose(places(LINKS, q)[3], wrist[:3, 3], atol=1e-10)


@given(rotation=vectors(3, 1.8), scale=st.sampled_from((1.0, 1e-4, 1e-9)), v=vectors(3, 300.0))
@settings(max_examples=50)
def test_logarithm_undoes_the_exponential(rotation: Array, scale: float, v: Array) -> None:
    twist = np.concatenate([v, scale * rotation])
    np.testing.assert_allclose(log_se3(expm(hat(twist))), twist, atol=1e-7)


START = np.deg2rad([0.0, 30.0, 30.0, 30.0, 0.0])
TARGETS = 4_000


def within_limits(count: int, seed: int) -> Array:
    low, high = (np.deg2rad([getattr(joint, name) for joint in PART.joints]) for name in ("min_deg", "max_deg"))
    return np.random.default_rng(seed).uniform(low, high, (count, 5))


def test_closed_form_is_exact_on_random_reachable_targets() -> None:
    joints = within_limits(TARGETS, 0)
    targets = forward(LINKS, joints)
    found = inverse(PART, targets)
    assert np.abs(log_se3(np.linalg.inv(targets)[:, None] @ forward(LINKS, found.joints_rad))).max() < 1e-9
    assert found.left_over_rad.max() < 1e-9
    off = np.abs((found.joints_rad - joints[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
    assert off.max(axis=-1).min(axis=-1).max() < 1e-9


SINGULAR = ((20, 0, 0, 0, 30), (20, 0, 0, 180, 30), (10, 50, 0, 70, -20), (10, 50, 180, 70, -20), (10, 40, 60, -100, 15))
"""Straight up, then looking down, stretched, folded, looking along the base's axis."""


def test_closed_form_at_singular_poses() -> None:
    """On the base's axis the camera's place does not determine in which direction the base stands; its optical axis does."""
    targets = [forward(LINKS, np.deg2rad(joints_deg)) for joints_deg in SINGULAR]
    off_mm = (0.0, 1e-13, 1e-6, 1.0)
    targets += [forward(LINKS, np.array([0.7, *three_link(LINKS[1:], 120.0, -off, -0.9), 0.3])) for off in off_mm]
    assert [np.hypot(*target[:2, 3]) for target in targets[-4:]] == pytest.approx(off_mm, abs=1e-12)
    found = forward(LINKS, inverse(PART, np.array(targets)).joints_rad)  # by every branch
    np.testing.assert_allclose(found, np.repeat(np.array(targets)[:, None], 4, axis=1), rtol=0.0, atol=1e-9)


@given(rotvec=vectors(3, 1.7), seed=st.integers(0, 1000))
@settings(max_examples=40)
def test_the_nearest_orientation_and_what_is_left(rotvec: Array, seed: int) -> None:
    target = forward(LINKS, within_limits(1, seed)[0])
    target[:3, :3] = target[:3, :3] @ Rotation.from_rotvec(rotvec).as_matrix()
    found = inverse(PART, target)
    assume(not np.isnan(found.joints_rad).any())
    got = forward(LINKS, found.joints_rad)
    np.testing.assert_allclose(got[:, :3, 3], np.broadcast_to(target[:3, 3], (4, 3)), atol=1e-9)
    left = np.linalg.norm(log_se3(np.linalg.inv(target) @ got)[:, 3:], axis=1)
    np.testing.assert_allclose(left, found.left_over_rad, atol=1e-7)
    azimuth, rolls = np.arctan2(target[1, 3], target[0, 3]), np.random.default_rng(seed).uniform(-np.pi, np.pi, (500, 2))
    others = Rotation.from_euler("ZYZ", np.column_stack([np.full(500, azimuth), rolls])).as_matrix()
    assert Rotation.from_matrix(target[:3, :3].T @ others).magnitude().min() > found.left_over_rad - 1e-9


def test_newton_converges_from_one_start() -> None:
    targets = forward(LINKS, within_limits(TARGETS, 0))
    found = newton(PART, targets, START)
    error = log_se3(np.linalg.inv(targets) @ forward(LINKS, found.joints_rad))
    there = (np.linalg.norm(error[:, :3], axis=1) < 1e-6) & (np.linalg.norm(error[:, 3:], axis=1) < 1e-8)
    assert found.steps.max() <= MOST_STEPS == 20
    assert np.mean(found.converged & there) >= 0.999
    assert not (found.converged & ~there).any()
    assert np.median(found.steps) <= 8


RING = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=0.0)
cameras = st.tuples(vectors(3, 1.0), st.floats(100.0, 600.0), st.floats(-np.pi, np.pi), st.floats(-200.0, 200.0)).map(
    lambda c: frames.invert(frames.from_rotvec(c[0], np.array([c[1] * np.cos(c[2]), c[1] * np.sin(c[2]), c[3]])))
)


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


def test_correction_brings_a_badly_known_arm_to_its_place() -> None:
    """Zero errors of 2 degrees, scales of 1 %, links, mount and azimuth of the table that nobody knows: two corrections suffice."""
    rng = np.random.default_rng(0)
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
