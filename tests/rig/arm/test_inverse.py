"""Inverse kinematics: 10,000 random targets, the borders of reach, what five joints cannot do."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rhizotwin.rig.arm.inverse import MOST_STEPS, inverse, newton, three_link
from rhizotwin.rig.arm.kinematics import forward, log_se3
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

PART = ArmPart()
LINKS = PART.links_mm
START = np.deg2rad([0.0, 30.0, 30.0, 30.0, 0.0])
"""One start for every target, whatever it is: leaning forward, bent a little."""
TARGETS = 10_000


def within_limits(count: int, seed: int) -> Array:
    low, high = (np.deg2rad([getattr(joint, name) for joint in PART.joints]) for name in ("min_deg", "max_deg"))
    return np.random.default_rng(seed).uniform(low, high, (count, 5))


def difference(angle_rad: Array, other_rad: Array) -> Array:
    return np.abs((angle_rad - other_rad + np.pi) % (2.0 * np.pi) - np.pi)


# The closed form.


def test_closed_form_is_exact_on_random_reachable_targets() -> None:
    joints = within_limits(TARGETS, 0)
    targets = forward(LINKS, joints)
    found = inverse(PART, targets)
    error = log_se3(np.linalg.inv(targets)[:, None] @ forward(LINKS, found.joints_rad))
    assert np.abs(error[..., :3]).max() < 1e-9
    assert np.abs(error[..., 3:]).max() < 1e-9
    assert found.left_over_rad.max() < 1e-9
    # One of the four branches is the one that the target came from.
    assert difference(found.joints_rad, joints[:, None]).max(axis=-1).min(axis=-1).max() < 1e-9


SINGULAR = ((20, 0, 0, 0, 30), (20, 0, 0, 180, 30), (10, 50, 0, 70, -20), (10, 50, 180, 70, -20), (10, 40, 60, -100, 15))
"""Joints in degrees: straight up, then looking down, stretched, folded, looking along the base's axis."""


def solved(target: Array) -> None:
    """Check that every branch of the closed form reaches a target."""
    np.testing.assert_allclose(forward(LINKS, inverse(PART, target).joints_rad), np.broadcast_to(target, (4, 4, 4)), rtol=0.0, atol=1e-9)


def test_closed_form_at_singular_poses() -> None:
    """There the camera's place does not determine in which direction the base stands; its optical axis does."""
    for joints_deg in SINGULAR:
        solved(forward(LINKS, np.deg2rad(joints_deg)))
    for off_mm in (0.0, 1e-13, 1e-6, 1.0):
        target = forward(LINKS, np.array([0.7, *three_link(LINKS[1:], 120.0, -off_mm, -0.9), 0.3]))
        assert np.hypot(*target[:2, 3]) == pytest.approx(off_mm, abs=1e-12)
        solved(target)


@given(rotvec=st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3).map(np.array), seed=st.integers(0, 1000))
def test_the_nearest_orientation_and_what_is_left(rotvec: Array, seed: int) -> None:
    target = forward(LINKS, within_limits(1, seed)[0])
    target[:3, :3] = target[:3, :3] @ Rotation.from_rotvec(rotvec).as_matrix()
    found = inverse(PART, target)
    assume(not np.isnan(found.joints_rad).any())
    got = forward(LINKS, found.joints_rad)
    np.testing.assert_allclose(got[:, :3, 3], np.broadcast_to(target[:3, 3], (4, 3)), atol=1e-9)
    left = np.linalg.norm(log_se3(np.linalg.inv(target) @ got)[:, 3:], axis=1)
    np.testing.assert_allclose(left, found.left_over_rad, atol=1e-7)
    # No orientation with its optical axis in the plane is nearer.
    azimuth, rolls = np.arctan2(target[1, 3], target[0, 3]), np.random.default_rng(seed).uniform(-np.pi, np.pi, (500, 2))
    others = Rotation.from_euler("ZYZ", np.column_stack([np.full(500, azimuth), rolls])).as_matrix()
    assert Rotation.from_matrix(target[:3, :3].T @ others).magnitude().min() > found.left_over_rad - 1e-9


def test_out_of_reach_is_nan_but_finite_by_newton() -> None:
    target = frames.from_rotvec(np.array([0.0, np.pi / 2, 0.0]), np.array([900.0, 0.0, 61.0]))
    found = inverse(PART, target)
    assert np.isnan(found.joints_rad).all()
    assert found.wrist_mm == pytest.approx(900.0 - 95.0)
    near = newton(PART, target, START)
    assert np.isfinite(near.joints_rad).all()
    assert np.linalg.norm(near.left_over[:3]) > 500.0


# Newton's method.


def test_newton_converges_from_one_start() -> None:
    targets = forward(LINKS, within_limits(TARGETS, 0))
    found = newton(PART, targets, START)
    error = log_se3(np.linalg.inv(targets) @ forward(LINKS, found.joints_rad))
    there = (np.linalg.norm(error[:, :3], axis=1) < 1e-6) & (np.linalg.norm(error[:, 3:], axis=1) < 1e-8)
    assert found.steps.max() <= MOST_STEPS == 20
    assert np.mean(found.converged & there) >= 0.999
    assert not (found.converged & ~there).any()
    assert np.median(found.steps) <= 8


def test_newton_with_a_free_axis_meets_what_five_joints_cannot() -> None:
    part = ArmPart(position_mm=(650.0, 30.0, -100.0))
    arm_from_axis = frames.invert(frames.from_rotvec(np.deg2rad([0.0, 0.0, 180.0]), np.array(part.position_mm)))
    target = arm_from_axis @ frames.invert(frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=5.0))
    held = newton(part, target, START)
    free = newton(part, target, START, arm_from_axis=arm_from_axis)
    assert np.linalg.norm(held.left_over[3:]) > 0.01
    assert free.converged
    assert np.linalg.norm(free.left_over) < 1e-6
    turned = arm_from_axis @ frames.rotation_z(float(free.turned_rad)) @ frames.invert(arm_from_axis) @ target
    np.testing.assert_allclose(forward(LINKS, free.joints_rad), turned, atol=1e-6)
    assert np.rad2deg(free.turned_rad) == pytest.approx(np.rad2deg(np.arctan2(30.0, 650.0)), abs=1e-6)
