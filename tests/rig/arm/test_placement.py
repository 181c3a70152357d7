"""Joint angles for the plan's rings: what is refused with which numbers, the correction by markers."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.rig.arm.kinematics import cam_from_rig
from rhizotwin.rig.arm.placement import compute_joints, compute_joints_from_direction, correct_joints, planned_camera_pose
from rhizotwin.rig.arm.tangency import azimuth_rad, rotate_to_azimuth
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Ring

ARM = ArmPart(position_mm=(650.0, 0.0, -100.0))
RIG = RigFile(arm=ARM)


def with_arm(**changes: object) -> RigFile:
    return replace(RIG, arm=replace(ARM, **changes))


def test_elbow_is_up() -> None:
    pose = planned_camera_pose(Ring(height_mm=60.0))
    joints_deg = compute_joints(RIG, pose)
    below = tuple(replace(joint, max_deg=-1.0) if i == 2 else joint for i, joint in enumerate(ARM.joints))
    forced = compute_joints(with_arm(joints=below, park_deg=(0.0, 0.0, -10.0, 0.0, 0.0)), pose)
    assert joints_deg[2] > 0.0 > forced[2]
    np.testing.assert_allclose(cam_from_rig(ARM, forced), cam_from_rig(ARM, joints_deg), atol=1e-6)


ASIDE = with_arm(position_mm=(600.0, 180.0, -100.0), rotation_deg=(0.0, 0.0, -160.0))
REFUSED = {
    "too far": (RIG, Ring(distance_mm=350.0), r"is out of reach: .* 205 mm from the shoulder, but the links permit 5 to 198 mm; move"),
    "elbow": (RIG, Ring(distance_mm=450.0), r"within the joints' limits: elbow 116\.0 deg \(limits -88 to 88\); move"),
    "far aside": (ASIDE, Ring(), r"16\.7 deg from the rig's x axis, but at more than 15 deg it does not face the backlight"),
}


@pytest.mark.parametrize(("rig", "ring", "match"), REFUSED.values(), ids=REFUSED)
def test_refused_with_the_numbers(rig: RigFile, ring: Ring, match: str) -> None:
    with pytest.raises(UnsafeError, match=match):
        compute_joints(rig, planned_camera_pose(ring))


def test_an_askew_arm_turns_the_camera_round_the_table() -> None:
    rig = with_arm(position_mm=(650.0, 25.0, -100.0), rotation_deg=(2.0, 3.0, 178.0))
    ring = Ring(height_mm=-20.0, tilt_deg=4.0)
    camera = cam_from_rig(rig.arm, compute_joints(rig, planned_camera_pose(ring)))
    assert max(frames.pose_error(camera, rotate_to_azimuth(planned_camera_pose(ring), camera))) < 1e-5
    assert 0.01 < abs(np.rad2deg(azimuth_rad(camera))) < 5.0


def test_corrections_that_cannot_be_are_refused() -> None:
    wanted = planned_camera_pose(Ring())
    joints_deg = compute_joints(RIG, wanted)
    with pytest.raises(UnsafeError, match=r"the markers require the .* more than the maximum correction of 25 deg; check joints, links_mm"):
        correct_joints(RIG, joints_deg, cam_from_rig(ARM, np.add(joints_deg, (0, 0, 0, 0, 40))), wanted)
    with pytest.raises(UnsafeError, match=r"distance 300 mm, .* cannot be reached; the nearest position is \d+\.\d mm away"):
        correct_joints(RIG, joints_deg, cam_from_rig(ARM, joints_deg), planned_camera_pose(Ring(distance_mm=300.0)))


def test_a_pose_by_position_and_direction_is_held() -> None:
    position, direction = (420.0, 30.0, -20.0), (-230.0, 30.0, -40.0)  # through the base's axis at x = 650
    found = frames.invert(cam_from_rig(ARM, compute_joints_from_direction(RIG, position, direction)))
    np.testing.assert_allclose(found[:3, 3], position, atol=1e-6)
    np.testing.assert_allclose(found[:3, 2], np.array(direction) / np.linalg.norm(direction), atol=1e-6)
    assert found[2, 1] < 0.0  # the picture's down is down


def test_what_five_joints_cannot_hold_is_said_with_the_nearest() -> None:
    with pytest.raises(UnsafeError, match=r"the nearest direction that the five joints can reach is \((.*)\)") as refused:
        compute_joints_from_direction(RIG, (400.0, 30.0, -42.0), (-1.0, 0.5, 0.0))
    nearest = tuple(float(word) for word in str(refused.value).rpartition("(")[2].rstrip(")").split(","))
    compute_joints_from_direction(RIG, (400.0, 30.0, -42.0), nearest)  # which can be had
    with pytest.raises(UnsafeError, match=r"out of reach .* the nearest reachable position is \((.*)\) mm"):
        compute_joints_from_direction(RIG, (100.0, 0.0, -42.0), (-1.0, 0.0, 0.0))
    with pytest.raises(UnsafeError, match="straight up or down"):
        compute_joints_from_direction(RIG, (400.0, 0.0, -42.0), (0.0, 0.0, -1.0))
