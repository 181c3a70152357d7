"""The correction of appendix C.2: its constraints, its convergence on a badly known arm, and the slips in its printed matrices."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rhizotwin.rig.arm.inverse import inverse
from rhizotwin.rig.arm.kinematics import cam_from_rig, forward, log_se3, rig_from_arm
from rhizotwin.rig.arm.tangency import azimuth_rad, correct, tangent, turned_to
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


def printed_desired(camera: Array, corner: float = 1.0) -> Array:
    """Return g_d, the camera in the canister's frame, by the product printed in C.2 (``corner``: last element of its second factor)."""
    x, y, z = frames.invert(camera)[:3, 3]
    theta, r = np.arctan2(y, x), np.hypot(x, y)
    shift = np.array([[1.0, 0, 0, r], [0, 1, 0, 0], [0, 0, 1, z], [0, 0, 0, corner]])
    face = np.array([[0.0, 0, -1, 0], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return frames.rotation_z(theta) @ shift @ face


def seen_off_mm(measured: Array) -> float:
    """Return by how much the camera misses the ring, at whatever azimuth: its shift, and the picture's at the axis by its rotation."""
    off_mm, off_deg = frames.pose_error(measured, turned_to(RING, measured))
    return off_mm + 400.0 * np.deg2rad(off_deg)


@given(camera=cameras)
def test_tangent_pose_faces_the_axis_level_and_upright_from_the_same_place(camera: Array) -> None:
    wanted = frames.invert(tangent(camera))
    x_c, y_c, z_c = wanted[:3, :3].T
    centre = frames.invert(camera)[:3, 3]
    np.testing.assert_allclose(wanted[:3, 3], centre, atol=1e-9)
    assert z_c[2] == pytest.approx(0.0, abs=1e-12)
    assert y_c[2] == pytest.approx(-1.0)
    assert x_c[2] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(centre[:2] + np.hypot(*centre[:2]) * z_c[:2], 0.0, atol=1e-9)  # the optical axis crosses the canister's
    np.testing.assert_allclose(wanted, printed_desired(camera), atol=1e-9)


def test_tangent_pose_in_front_is_the_plans_level_camera() -> None:
    tilted = frames.from_rotvec(np.array([0.1, -0.2, 0.3]), np.zeros(3)) @ RING
    np.testing.assert_allclose(tangent(tilted), RING, atol=1e-9)


@given(camera=cameras, like=cameras)
def test_turning_round_the_axis_changes_the_azimuth_only(camera: Array, like: Array) -> None:
    turned = turned_to(camera, like)
    assert np.cos(azimuth_rad(turned) - azimuth_rad(like)) == pytest.approx(1.0)
    np.testing.assert_allclose(tangent(turned) @ frames.invert(turned), tangent(camera) @ frames.invert(camera), atol=1e-9)


def test_correction_of_a_perfect_arm_is_no_correction() -> None:
    joints = np.deg2rad([0.0, 50.0, 70.0, -30.0, 0.0])
    here = cam_from_rig(PART, np.rad2deg(joints))
    np.testing.assert_allclose(correct(PART, joints, here, here).joints_rad, joints, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
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


# Slips of appendix C.2.


def test_slip_zero_in_the_corner_of_a_transform() -> None:
    wrong = printed_desired(RING, corner=0.0)
    assert not wrong[3].any()  # although it is printed with a 1
    assert np.linalg.det(wrong) == pytest.approx(0.0)  # nothing can be seen from it: it has no inverse
    np.testing.assert_allclose(printed_desired(RING), frames.invert(RING), atol=1e-9)


def test_slip_the_two_constraints_do_not_centre_the_canister() -> None:
    """<z_r, z_c> = 0 and <z_r, y_c> = -1 also hold for a camera that looks past the canister; the second implies the first."""
    aside = frames.rotation_z(0.0)
    aside[:3, :3] = Rotation.from_rotvec([0.0, np.deg2rad(20.0), 0.0]).as_matrix()
    past = frames.invert(aside @ RING)
    assert past[2, 2] == pytest.approx(0.0, abs=1e-12)
    assert past[2, 1] == pytest.approx(-1.0)
    assert frames.pose_error(tangent(aside @ RING), aside @ RING)[1] == pytest.approx(20.0)


def test_slip_camera_on_the_end_effector_is_printed_as_a_mirror() -> None:
    printed = np.array([[0.0, 0, -1], [-1, 0, 0], [0, -1, 0]])
    assert np.linalg.det(printed) == pytest.approx(-1.0)
    product = Rotation.from_rotvec([-np.pi / 2, 0, 0]).as_matrix() @ Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()
    np.testing.assert_allclose(product, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    # The thesis's end effector has x along the last link, z up when that is level: ours, with z along the link, gives the product.
    link_from_effector = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    link_from_cam = forward(PART.links_mm, np.zeros(5))[:3, :3]
    np.testing.assert_allclose(link_from_effector.T @ link_from_cam, product, atol=1e-12)


def test_slip_arctan_of_two_arguments_is_atan2() -> None:
    behind = frames.invert(frames.from_rotvec(np.zeros(3), np.array([-300.0, 200.0, 0.0])))
    assert azimuth_rad(behind) == pytest.approx(np.pi - np.arctan(200.0 / 300.0))


def test_slip_euler_angles_are_not_a_rotation_vector() -> None:
    rotvec = np.deg2rad([25.0, -30.0, 20.0])
    change = frames.from_rotvec(rotvec, np.array([4.0, -2.0, 7.0]))
    r = change[:3, :3]
    euler = np.array([np.arctan2(r[2, 1], r[2, 2]), np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2])), np.arctan2(r[1, 0], r[0, 0])])
    assert np.rad2deg(np.abs(euler - rotvec).max()) > 4.0
    np.testing.assert_allclose(log_se3(change)[3:], rotvec, atol=1e-12)
    # The velocity that carries the frame there is not its displacement either, and not zero as printed.
    assert np.abs(log_se3(change)[:3] - change[:3, 3]).max() > 1.0
