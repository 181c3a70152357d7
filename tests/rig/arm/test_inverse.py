"""Inverse kinematics: 10,000 random targets, the borders of reach, what five joints cannot do; slips of sections 3.3, C.1 and C.3."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rhizotwin.rig.arm.inverse import MOST_STEPS, inverse, newton, three_link
from rhizotwin.rig.arm.kinematics import body_jacobian, forward, log_se3
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


def planar(links_mm: tuple[float, float, float], q: Array) -> Array:
    """Return x, y, theta (..., 3) of a planar arm."""
    angles = np.cumsum(q, axis=-1)
    return np.stack([(links_mm * np.cos(angles)).sum(-1), (links_mm * np.sin(angles)).sum(-1), angles[..., 2]], axis=-1)


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


@given(
    q=st.lists(st.floats(-3.1, 3.1), min_size=5, max_size=5).map(np.array),
    links=st.lists(st.floats(1.0, 500.0), min_size=4, max_size=4).map(tuple),
)
def test_closed_form_on_any_arm(q: Array, links: tuple[float, ...]) -> None:
    part = ArmPart(links_mm=links)
    target = forward(links, q)
    found = inverse(part, target)
    assert not np.isnan(found.joints_rad).any()
    np.testing.assert_allclose(forward(links, found.joints_rad), np.broadcast_to(target, (4, 4, 4)), atol=1e-8)


@dataclass(frozen=True, kw_only=True)
class Special:
    """Joint angles at which an answer is not unique or hard to tell."""

    name: str
    joints_deg: tuple[float, ...]


SPECIAL = (
    Special(name="straight up", joints_deg=(20, 0, 0, 0, 30)),
    Special(name="straight up, looks down", joints_deg=(20, 0, 0, 180, 30)),
    Special(name="stretched forward", joints_deg=(10, 50, 0, 0, 0)),
    Special(name="stretched, wrist bent", joints_deg=(10, 50, 0, 70, -20)),
    Special(name="folded", joints_deg=(10, 50, 180, 70, -20)),
    Special(name="looks along the base's axis", joints_deg=(10, 40, 60, -100, 15)),
)


@pytest.mark.parametrize("special", SPECIAL, ids=lambda special: special.name)
def test_closed_form_at_singular_poses(special: Special) -> None:
    target = forward(LINKS, np.deg2rad(special.joints_deg))
    np.testing.assert_allclose(forward(LINKS, inverse(PART, target).joints_rad), np.broadcast_to(target, (4, 4, 4)), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("off_mm", [0.0, 1e-13, 1e-10, 1e-6, 1e-3, 1.0])
def test_closed_form_with_the_camera_on_the_base_axis(off_mm: float) -> None:
    """There the camera's place does not tell in which direction the base stands; its optical axis does."""
    reach = 90.0 - off_mm
    pitch = three_link(LINKS[1:], 120.0, reach - 90.0, -0.9)
    target = forward(LINKS, np.array([0.7, *pitch, 0.3]))
    assert np.hypot(*target[:2, 3]) == pytest.approx(off_mm, abs=1e-12)
    np.testing.assert_allclose(forward(LINKS, inverse(PART, target).joints_rad), np.broadcast_to(target, (4, 4, 4)), rtol=0.0, atol=1e-9)


@given(rotvec=st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3).map(np.array), seed=st.integers(0, 1000))
def test_orientation_outside_five_joints_is_the_nearest_and_says_what_is_left(rotvec: Array, seed: int) -> None:
    target = forward(LINKS, within_limits(1, seed)[0])
    target[:3, :3] = target[:3, :3] @ Rotation.from_rotvec(rotvec).as_matrix()
    found = inverse(PART, target)
    assume(not np.isnan(found.joints_rad).any())
    got = forward(LINKS, found.joints_rad)
    np.testing.assert_allclose(got[:, :3, 3], np.broadcast_to(target[:3, 3], (4, 3)), atol=1e-9)
    left = np.linalg.norm(log_se3(np.linalg.inv(target) @ got)[:, 3:], axis=1)
    np.testing.assert_allclose(left, found.left_over_rad, atol=1e-7)
    # No orientation with its optical axis in the plane is nearer.
    rng = np.random.default_rng(seed)
    azimuth = np.arctan2(target[1, 3], target[0, 3])
    rolls = rng.uniform(-np.pi, np.pi, (500, 2))
    others = Rotation.from_euler("ZYZ", np.column_stack([np.full(500, azimuth), rolls])).as_matrix()
    angles = Rotation.from_matrix(target[:3, :3].T @ others).magnitude()
    assert angles.min() > found.left_over_rad - 1e-9


def test_out_of_reach_is_nan_with_the_distance() -> None:
    target = frames.from_rotvec(np.array([0.0, np.pi / 2, 0.0]), np.array([400.0, 0.0, 61.0]))
    found = inverse(PART, target)
    assert np.isnan(found.joints_rad).all()
    assert found.wrist_mm == pytest.approx(400.0 - 95.0)


# The planar arm of section 3.3.


@given(
    q=st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3).map(np.array),
    links=st.lists(st.floats(1.0, 300.0), min_size=3, max_size=3).map(tuple),
)
def test_three_link_round_trip(q: Array, links: tuple[float, float, float]) -> None:
    x, y, theta = planar(links, q)
    for elbow in (1, -1):
        np.testing.assert_allclose(planar(links, three_link(links, x, y, theta, elbow=elbow)), [x, y, theta], atol=1e-8)
    if abs(np.sin(q[1])) > 1e-3:
        same = three_link(links, x, y, theta, elbow=1 if q[1] > 0.0 else -1)
        assert difference(same, q).max() < 1e-6


def test_three_link_beyond_reach_is_nan() -> None:
    x = np.array([300.0, 250.0, 3.0])
    reached = ~np.isnan(three_link((100.0, 95.0, 60.0), x, 0.0, [0.0, 0.0, np.pi / 2])).any(axis=-1)
    np.testing.assert_array_equal(reached, [False, True, True])
    assert np.isnan(three_link((100.0, 95.0, 60.0), 62.0, 0.0, 0.0)).all()  # the wrist would be 2 mm from the first joint


def printed_three_link(links: tuple[float, float, float], x: float, y: float, theta: float, *, sum_inside_norm: bool) -> Array:
    """Return q1, q2, q3 by equations 3.1 to 3.6, with r = |x_w + y_w| as printed or with hypot."""
    l1, l2, l3 = links
    x_w, y_w = x - l3 * np.cos(theta), y - l3 * np.sin(theta)
    r = abs(x_w + y_w) if sum_inside_norm else np.hypot(x_w, y_w)
    alpha, beta = np.arctan2(y_w, x_w), np.arccos((l1**2 + r**2 - l2**2) / (2 * r * l1))
    gamma = np.arccos((l1**2 + l2**2 - r**2) / (2 * l1 * l2))
    return np.array([alpha + beta, gamma - np.pi, theta - alpha - beta - gamma + np.pi])


def test_slip_equation_3_3_takes_the_norm_of_a_sum() -> None:
    links = (101.6, 96.4, 95.0)
    wanted = np.array([190.0, 60.0, 0.1])
    ours = three_link(links, *wanted, elbow=-1)
    np.testing.assert_allclose(ours, printed_three_link(links, *wanted, sum_inside_norm=False), atol=1e-9)
    as_printed = planar(links, printed_three_link(links, *wanted, sum_inside_norm=True))
    assert np.hypot(*(as_printed - wanted)[:2]) > 10.0


def test_slip_no_word_of_reach() -> None:
    with np.errstate(invalid="ignore"):
        assert np.isnan(printed_three_link((101.6, 96.4, 95.0), 400.0, 0.0, 0.0, sum_inside_norm=False)).any()
    assert np.isnan(three_link((101.6, 96.4, 95.0), 400.0, 0.0, 0.0)).all()


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


def test_newton_alone_and_in_a_batch_is_the_same() -> None:
    targets = forward(LINKS, within_limits(6, 3)).reshape(2, 3, 4, 4)
    batch = newton(PART, targets, START)
    for index in np.ndindex(2, 3):
        one = newton(PART, targets[index], START)
        np.testing.assert_allclose(one.joints_rad, batch.joints_rad[index], atol=1e-12)
        assert one.steps == batch.steps[index]


def test_newton_at_the_target_takes_no_step() -> None:
    joints = within_limits(1, 5)[0]
    found = newton(PART, forward(LINKS, joints), joints)
    assert found.steps == 0
    assert found.converged


def test_newton_far_out_of_reach_stays_finite_and_says_so() -> None:
    target = frames.from_rotvec(np.array([0.0, np.pi / 2, 0.0]), np.array([900.0, 10.0, 61.0]))
    found = newton(PART, target, START)
    assert np.isfinite(found.joints_rad).all()
    assert np.linalg.norm(found.left_over[:3]) > 500.0


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


# Slips of appendices C.1 and C.3.


def test_slip_the_printed_pseudo_inverse_does_not_exist() -> None:
    jacobian = body_jacobian(PART, np.array([0.2, 0.4, 0.9, -0.3, 0.1]))
    jacobian[:3] /= 100.0
    assert jacobian.shape == (6, 5)
    assert np.linalg.matrix_rank(jacobian @ jacobian.T) == 5  # 6x6, so that it has no inverse
    np.testing.assert_allclose(np.linalg.inv(jacobian.T @ jacobian) @ jacobian.T, np.linalg.pinv(jacobian), atol=1e-9)


def test_slip_five_joints_do_not_reach_every_configuration() -> None:
    target = forward(LINKS, np.array([0.2, 0.4, 0.9, -0.3, 0.1]))
    target[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix() @ target[:3, :3]
    assert inverse(PART, target).left_over_rad > 0.1
    assert np.linalg.norm(newton(PART, target, START).left_over[3:]) > 0.01


def test_slip_the_printed_loop_never_looks_again() -> None:
    """Algorithm 1 computes the twist once; with the same step added again and again it runs past the target."""
    start, joints = START, np.array([0.2, 0.6, 0.7, 0.2, 0.1])
    target = forward(LINKS, joints)
    weight = np.array([0.01] * 3 + [1.0] * 3)
    twist = log_se3(np.linalg.inv(forward(LINKS, start)) @ target)
    printed = start.copy()
    away = []
    for _ in range(5):
        printed = printed + np.linalg.pinv(body_jacobian(PART, printed) * weight[:, None]) @ (twist * weight)
        away.append(np.linalg.norm(log_se3(np.linalg.inv(forward(LINKS, printed)) @ target) * weight))
    assert away[-1] > 5.0 * away[0]
    assert newton(PART, target, start).converged


@pytest.mark.parametrize(("off_mm", "off_rad", "moves"), [(0.0, 5e-8, True), (5e-8, 0.0, False)], ids=["turned", "shifted"])
def test_slip_each_threshold_belongs_to_its_own_unit(off_mm: float, off_rad: float, moves: bool) -> None:
    """Algorithm 1 holds the velocity against epsilon_omega and the rotation against epsilon_v; ours are 1e-7 mm and 1e-9 rad."""
    joints = np.array([0.2, 0.6, 0.7, 0.2, 0.1])
    near = forward(LINKS, joints) @ frames.from_rotvec(np.array([0.0, 0.0, off_rad]), np.array([0.0, 0.0, off_mm]))
    assert (newton(PART, near, joints).steps > 0) == moves


def test_slip_without_a_unit_of_length_the_pseudo_inverse_means_nothing() -> None:
    """Where a target cannot be met, millimetres and metres give different joints: ours states its unit (UNIT_MM)."""
    jacobian = body_jacobian(PART, np.array([0.2, 0.4, 0.9, -0.3, 0.1]))
    twist = np.array([5.0, 2.0, 1.0, 0.02, 0.1, 0.03])
    metres = np.array([1e-3] * 3 + [1.0] * 3)
    in_mm = np.linalg.pinv(jacobian) @ twist
    in_m = np.linalg.pinv(jacobian * metres[:, None]) @ (twist * metres)
    assert np.rad2deg(np.abs(in_mm - in_m).max()) > 1.0
