"""Compute the joint angles for a ring of the capture plan, and correct them with the pose measured from the markers.

Angles are in degrees in this module, and in radians in the modules that it imports.
"""

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.arm.inverse import Branches, NewtonSolution, inverse, newton
from rhizotwin.rig.arm.kinematics import forward, rig_from_arm
from rhizotwin.rig.arm.tangency import azimuth_rad, correct, tangent_pose
from rhizotwin.rig.errors import RigError, UnsafeError
from rhizotwin.rig.rig_file import JOINT_NAMES, ArmPart, RigFile
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Ring

Joints = tuple[float, ...]

LEFT_OVER_RAD = 1e-9
MOST_AZIMUTH_DEG = 15.0
"""Maximum azimuth of the camera about the table's axis, deg. A camera at a larger azimuth would not face the
backlight."""
MOST_CORRECTION_DEG = 25.0
"""Maximum angle by which a joint is corrected, deg. A larger correction indicates a wrong picture or rig file rather
than a calibration error."""
ROUNDING_DEG = 1e-6
MOST_ASIDE_DEG = 0.5
"""Maximum angle between the requested and the reachable viewing direction, deg. It is within the accuracy of the
servos."""
UPRIGHT = 1e-3
"""Minimum sine of the angle between the viewing direction and the vertical. At smaller angles the upright orientation
of the camera is undefined."""
_TESTED = 1001
"""Number of positions that are tested for reach. They lie on the line from the target to the shoulder."""


def planned_camera_pose(ring: Ring) -> Array:
    """Return the planned transform ``cam_from_rig`` (4, 4) of the camera in a ring.

    Parameters
    ----------
    ring : Ring
        Ring with distance, height and tilt.

    Returns
    -------
    (4, 4) array
        Pose of the camera, on the rig's +x side.
    """
    return frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)


def compute_joints(rig: RigFile, cam_from_rig: Array) -> Joints:
    """Return the joint angles for a camera pose, with the elbow as high as possible.

    All angles are within the joints' limits. If five joints cannot reach the orientation, because the arm is not
    exactly in front of the table, the camera is rotated about the table's axis until they can. The angle of the table
    compensates this rotation.

    Parameters
    ----------
    rig : RigFile
        Rig with position and joints of the arm.
    cam_from_rig : (4, 4) array
        Target pose.

    Returns
    -------
    Joints
        Five joint angles, deg.

    Raises
    ------
    UnsafeError
        If the pose is out of reach or requires a joint angle beyond its limits; the message states the values.
    """
    part = require_arm(rig)
    arm_from_rig = frames.invert(rig_from_arm(part))
    target = arm_from_rig @ frames.invert(cam_from_rig)
    branches = inverse(part, target)
    _check_reach(part, branches, cam_from_rig)
    joints_rad = branches.joints_rad
    if branches.left_over_rad > LEFT_OVER_RAD:
        joints_rad = _rotate_about_table(part, arm_from_rig, target, branches, cam_from_rig)
    excess, joints_deg = _fit_joints(part, joints_rad)
    if excess.min() > ROUNDING_DEG:
        raise UnsafeError(
            f"arm: {_describe_position(cam_from_rig)} cannot be reached within the joints' limits: "
            f"{_describe_excess(part, joints_deg[excess.argmin()])}; move the ring or the arm's base"
        )
    elbow_up = np.cos(np.deg2rad(joints_deg[:, 1])) - np.where(excess > ROUNDING_DEG, np.inf, 0.0)
    return _clip_joints(part, joints_deg[int(np.argmax(elbow_up))])


def camera_pose_from_direction(position_mm: tuple[float, float, float], direction: tuple[float, float, float]) -> Array:
    """Return the transform ``cam_from_rig`` (4, 4) of an upright camera.

    The camera has the given position and viewing direction in the rig frame.

    Raises
    ------
    UnsafeError
        If the direction has length 0, or is vertical, so that "upright" is undefined.
    """
    forward_ = np.asarray(direction, float)
    right = np.cross(forward_, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < UPRIGHT * np.linalg.norm(forward_) or not np.linalg.norm(forward_) > 0.0:
        raise UnsafeError("arm: a camera that points straight up or down cannot be upright; choose another direction")
    forward_, right = forward_ / np.linalg.norm(forward_), right / np.linalg.norm(right)
    rig_from_cam = np.eye(4)
    rig_from_cam[:3, :3] = np.column_stack([right, np.cross(forward_, right), forward_])
    rig_from_cam[:3, 3] = position_mm
    return frames.invert(rig_from_cam)


def compute_joints_from_direction(rig: RigFile, position_mm: tuple[float, float, float], direction: tuple[float, float, float]) -> Joints:
    """Return the joint angles, in degrees, for a given position and viewing direction of the camera.

    Five joints can place the camera anywhere within reach, but the optical axis remains in the vertical plane that
    contains the base's axis and the camera.

    Parameters
    ----------
    rig : RigFile
        Rig with position and joints of the arm.
    position_mm, direction : tuple of float
        Centre (mm) and direction of the optical axis of the camera, rig frame.

    Raises
    ------
    UnsafeError
        If the position is out of reach, the direction is impossible there, or a joint would exceed its limits; the
        message states the nearest possible values.
    """
    part, wanted = require_arm(rig), camera_pose_from_direction(position_mm, direction)
    arm_from_rig = frames.invert(rig_from_arm(part))
    branches = inverse(part, arm_from_rig @ frames.invert(wanted))
    at = ", ".join(f"{value:.4g}" for value in position_mm)
    if np.isnan(branches.joints_rad).all():
        nearest = _nearest_in_reach(part, wanted)
        raise UnsafeError(f"arm: ({at}) mm is out of reach with that direction; the nearest reachable position is ({nearest}) mm")
    joints_rad = branches.joints_rad[~np.isnan(branches.joints_rad).any(axis=-1)]
    if branches.left_over_rad > np.deg2rad(MOST_ASIDE_DEG):
        axis = (rig_from_arm(part) @ forward(part.links_mm, joints_rad[0]))[:3, 2]
        near = ", ".join(f"{value:.4f}" for value in axis)
        raise UnsafeError(
            f"arm: at ({at}) mm the camera would deviate by {np.rad2deg(branches.left_over_rad):.1f} deg from the requested direction; "
            f"the nearest direction that the five joints can reach is ({near})"
        )
    excess, joints_deg = _fit_joints(part, joints_rad)
    if excess.min() > ROUNDING_DEG:
        raise UnsafeError(
            f"arm: ({at}) mm cannot be reached within the joints' limits: {_describe_excess(part, joints_deg[excess.argmin()])}; "
            "choose another position or direction"
        )
    elbow_up = np.cos(np.deg2rad(joints_deg[:, 1])) - np.where(excess > ROUNDING_DEG, np.inf, 0.0)
    return _clip_joints(part, joints_deg[int(np.argmax(elbow_up))])


def _nearest_in_reach(part: ArmPart, wanted: Array) -> str:
    """Format the coordinates of the reachable position that is nearest to the requested position.

    Only positions on the line to the shoulder are tested, with the viewing direction unchanged.
    """
    arm_from_rig, rig_from_cam = frames.invert(rig_from_arm(part)), frames.invert(wanted)
    shoulder = frames.apply(rig_from_arm(part), np.array([[0.0, 0.0, part.links_mm[0]]]))[0]
    for share in np.linspace(0.0, 1.0, _TESTED):
        tried = rig_from_cam.copy()
        tried[:3, 3] += share * (shoulder - rig_from_cam[:3, 3])
        if not np.isnan(inverse(part, arm_from_rig @ tried).joints_rad).all():
            return ", ".join(f"{value:.1f}" for value in tried[:3, 3])
    return "none between this position and the shoulder"


def correct_joints(rig: RigFile, joints_deg: Joints, cam_from_rig_measured: Array, cam_from_rig_wanted: Array | None = None) -> Joints:
    """Return joint angles, in degrees, that correct the error of the camera's measured pose.

    The pose was measured with the markers. The azimuth of the corrected camera is free.

    Parameters
    ----------
    rig : RigFile
        Rig with position and joints of the arm.
    joints_deg : Joints
        Joint angles that were commanded when the pose was measured.
    cam_from_rig_measured : (4, 4) array
        Pose measured with the markers.
    cam_from_rig_wanted : (4, 4) array or None
        Target pose; None for the correction of the thesis, which keeps distance and height and makes the image plane
        tangent to the canister.

    Returns
    -------
    Joints
        Five joint angles, deg.

    Raises
    ------
    UnsafeError
        If no such pose is within reach and limits, or the correction is implausibly large; the message states the
        values.
    """
    part = require_arm(rig)
    wanted = tangent_pose(cam_from_rig_measured) if cam_from_rig_wanted is None else cam_from_rig_wanted
    found = correct(part, np.deg2rad(joints_deg), cam_from_rig_measured, wanted)
    if not _is_reached(found)[()]:
        left = np.linalg.norm(found.left_over[:3])
        raise UnsafeError(
            f"arm: {_describe_position(wanted)} cannot be reached; the nearest position is {left:.1f} mm away. Move the ring or the arm's "
            "base"
        )
    excess, fitted = _fit_joints(part, found.joints_rad[None], near_deg=joints_deg)
    change = np.abs(fitted[0] - joints_deg)
    if change.max() > MOST_CORRECTION_DEG:
        k = int(change.argmax())
        raise UnsafeError(
            f"arm: the markers require the {JOINT_NAMES[k]} to move from {joints_deg[k]:.1f} to {fitted[0, k]:.1f} deg, more than "
            f"the maximum correction of {MOST_CORRECTION_DEG:g} deg; check joints, links_mm and position_mm in the rig file"
        )
    if excess[0] > ROUNDING_DEG:
        raise UnsafeError(
            f"arm: the camera's position cannot be corrected within the joints' limits: {_describe_excess(part, fitted[0])}; move the ring"
        )
    return _clip_joints(part, fitted[0])


def require_arm(rig: RigFile) -> ArmPart:
    """Return the arm of the rig.

    Raise an error if the rig file does not describe an arm.
    """
    if rig.arm is None:
        raise RigError(f"arm: the rig file of {rig.name!r} has no [arm]; add one, or place the camera by hand")
    return rig.arm


def camera_position(cam_from_rig: Array) -> tuple[float, float, float]:
    """Return the camera's position as distance from the table's axis, height, and tilt below the horizon.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        Pose of the camera.

    Returns
    -------
    tuple of float
        Distance and height in mm, tilt in degrees.
    """
    rig_from_cam = frames.invert(cam_from_rig)
    x, y, z = rig_from_cam[:3, 3]
    return float(np.hypot(x, y)), float(z), float(np.rad2deg(np.arcsin(np.clip(-rig_from_cam[2, 2], -1.0, 1.0))))


def check_limits(part: ArmPart, joints_deg: Joints) -> None:
    """Raise an error if a joint angle is outside its limits."""
    for number, (joint, angle) in enumerate(zip(part.joints, joints_deg, strict=True), start=1):
        if not joint.min_deg <= angle <= joint.max_deg:
            raise UnsafeError(f"arm: joint {number} at {angle:.1f} deg is beyond its limits, {joint.min_deg:g} to {joint.max_deg:g} deg")


def _rotate_about_table(part: ArmPart, arm_from_rig: Array, target: Array, branches: Branches, cam_from_rig: Array) -> Array:
    """Rotate the target pose about the table's axis until the arm can reach it.

    Return the n sets of joint angles (n, 5), in radians, with which it does.
    """
    found = newton(part, np.broadcast_to(target, (4, 4, 4)), branches.joints_rad, arm_from_axis=arm_from_rig)
    met = _is_reached(found)
    left_deg = float(np.rad2deg(branches.left_over_rad))
    if not met.any():
        raise UnsafeError(
            f"arm: {_describe_position(cam_from_rig)} is {left_deg:.2f} deg from the nearest orientation that five joints can reach; "
            "place the arm's base upright in front of the table (position_mm and rotation_deg in the rig file)"
        )
    turn_deg = float(np.rad2deg(np.abs(found.turned_rad[met]).min()))
    if turn_deg > MOST_AZIMUTH_DEG:
        raise UnsafeError(
            f"arm: {_describe_position(cam_from_rig)} would be {turn_deg:.1f} deg from the rig's x axis, but at more than "
            f"{MOST_AZIMUTH_DEG:g} deg it does not face the backlight; move the arm's base (arm.position_mm) nearer to y = 0"
        )
    return found.joints_rad[met & (np.abs(found.turned_rad) <= np.deg2rad(MOST_AZIMUTH_DEG))]


def _is_reached(found: NewtonSolution) -> NDArray[np.bool_]:
    """Return whether the remaining error of each target is within the tolerance.

    Newton's method may also converge to the nearest reachable pose, which differs from the target.
    """
    left = np.maximum(np.linalg.norm(found.left_over[..., :3], axis=-1) / 1e-3, np.linalg.norm(found.left_over[..., 3:], axis=-1) / 1e-5)
    return found.converged & (left < 1.0)


def _fit_joints(part: ArmPart, joints_rad: Array, *, near_deg: Joints | None = None) -> tuple[Array, Array]:
    """Return how far the worst joint exceeds its limits (n,), and the joint angles (n, 5), both in degrees.

    Multiples of 360 degrees are added to bring each angle nearest to ``near_deg`` or, if it is None, to the middle of
    its limits.
    """
    low, high = _limits_deg(part)
    middle = (low + high) / 2.0 if near_deg is None else np.asarray(near_deg)
    joints_deg = np.rad2deg(joints_rad)
    joints_deg = joints_deg - 360.0 * np.round((joints_deg - middle) / 360.0)
    return np.maximum(low - joints_deg, joints_deg - high).max(axis=-1), joints_deg


def _clip_joints(part: ArmPart, joints_deg: Array) -> Joints:
    return tuple(round(float(angle), 9) + 0.0 for angle in np.clip(joints_deg, *_limits_deg(part)))  # + 0.0 avoids -0.0


def _limits_deg(part: ArmPart) -> tuple[Array, Array]:
    return np.array([joint.min_deg for joint in part.joints]), np.array([joint.max_deg for joint in part.joints])


def _check_reach(part: ArmPart, branches: Branches, cam_from_rig: Array) -> None:
    if not np.isnan(branches.joints_rad).any():
        return
    _, upper, fore, _ = part.links_mm
    raise UnsafeError(
        f"arm: {_describe_position(cam_from_rig)} is out of reach: the wrist would have to be "
        f"{branches.wrist_mm:.0f} mm from the shoulder, but the links permit "
        f"{abs(upper - fore):.0f} to {upper + fore:.0f} mm; move the ring or the arm's base"
    )


def _describe_excess(part: ArmPart, joints_deg: Array) -> str:
    low, high = _limits_deg(part)
    return ", ".join(
        f"{name} {angle:.1f} deg (limits {least:g} to {most:g})"
        for name, angle, least, most in zip(JOINT_NAMES, joints_deg, low, high, strict=True)
        if not least - ROUNDING_DEG <= angle <= most + ROUNDING_DEG
    )


def _describe_position(cam_from_rig: Array) -> str:
    """Return a text with the camera's distance, height, tilt and azimuth."""
    distance_mm, height_mm, tilt_deg = camera_position(cam_from_rig)
    beside_deg = np.rad2deg(azimuth_rad(cam_from_rig))
    beside = f", {beside_deg:.1f} deg from the x axis" if abs(beside_deg) > 0.05 else ""
    return f"the camera at distance {distance_mm:.0f} mm, height {height_mm:.0f} mm, tilt {tilt_deg:.0f} deg{beside}"
