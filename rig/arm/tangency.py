"""Correction of the camera pose (thesis appendix C.2).

The corrected image plane is tangent to the canister, and the optical axis intersects the canister's axis. The azimuth
of the camera is free, because the table rotates the canister. As the sixth unknown, it makes six equations solvable
with five joints. Without it, an angular error would remain.
"""

import numpy as np

from rhizotwin.rig.arm.inverse import NewtonSolution, newton
from rhizotwin.rig.arm.kinematics import forward
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array


def azimuth_rad(cam_from_rig: Array) -> float:
    """Return the camera's azimuth about the table's axis, rad.

    The azimuth is 0 on the rig's +x side, and increases counter-clockwise seen from above.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        Pose of the camera.

    Returns
    -------
    float
        Azimuth between -pi and pi.
    """
    centre = frames.invert(cam_from_rig)[:3, 3]
    return float(np.arctan2(centre[1], centre[0]))


def tangent_pose(cam_from_rig: Array) -> Array:
    """Return the target pose of the correction described in the thesis.

    It has the distance, height and azimuth of the given pose, but is level and upright, and its optical axis intersects
    the table's axis.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        Measured pose.

    Returns
    -------
    (4, 4) array
        Target pose.
    """
    centre = frames.invert(cam_from_rig)[:3, 3]
    level = frames.level_camera(distance_mm=float(np.hypot(centre[0], centre[1])), height_mm=float(centre[2]), tilt_deg=0.0)
    return rotate_to_azimuth(level, cam_from_rig)


def rotate_to_azimuth(cam_from_rig: Array, like_cam_from_rig: Array) -> Array:
    """Rotate a pose about the table's axis so that its azimuth equals that of a reference pose.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        Pose to rotate.
    like_cam_from_rig : (4, 4) array
        Pose with the target azimuth.

    Returns
    -------
    (4, 4) array
        Rotated pose.
    """
    return cam_from_rig @ frames.rotation_z(azimuth_rad(cam_from_rig) - azimuth_rad(like_cam_from_rig))


def correct(part: ArmPart, joints_rad: Array, cam_from_rig_measured: Array, cam_from_rig_wanted: Array) -> NewtonSolution:
    """Compute the joint angles that move the camera from its measured pose to its target pose.

    The azimuth is free. The camera has to move by ``measured @ inv(wanted)`` in its own frame, regardless of the cause
    of the error. This is the change of configuration of the thesis, and it is applied to the pose computed from the
    joint angles. The error after one correction is of second order.

    Parameters
    ----------
    part : ArmPart
        Arm with its links.
    joints_rad : (5,) float64 array
        Joint angles that were commanded when the pose was measured.
    cam_from_rig_measured : (4, 4) array
        Pose measured with the markers.
    cam_from_rig_wanted : (4, 4) array
        Target pose, at any azimuth.

    Returns
    -------
    NewtonSolution
        Joint angles, and the remaining errors of position and orientation.
    """
    believed = forward(part.links_mm, joints_rad)
    arm_from_rig = believed @ cam_from_rig_measured
    target = arm_from_rig @ frames.invert(rotate_to_azimuth(cam_from_rig_wanted, cam_from_rig_measured))
    return newton(part, target, joints_rad, arm_from_axis=arm_from_rig)
