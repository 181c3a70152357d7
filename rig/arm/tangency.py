"""The correction of a placed camera: image plane tangent to the canister, centred on its axis (thesis appendix C.2).

How far round the axis the camera stands does not matter, for the table turns the canister. That freedom is the sixth
unknown which makes six equations solvable with five joints, where the arm alone would have to leave an angle over.
"""

import numpy as np

from rhizotwin.rig.arm.inverse import Found, newton
from rhizotwin.rig.arm.kinematics import forward
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array


def azimuth_rad(cam_from_rig: Array) -> float:
    """Return where the camera stands round the table's axis.

    0 on the rig's +x side, counter-clockwise seen from above.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        Pose of the camera.

    Returns
    -------
    float
        From -pi to pi.
    """
    centre = frames.invert(cam_from_rig)[:3, 3]
    return float(np.arctan2(centre[1], centre[0]))


def tangent(cam_from_rig: Array) -> Array:
    """Return the pose that the thesis corrects to.

    Same distance, height and azimuth, but level, upright and facing the axis.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        Measured.

    Returns
    -------
    (4, 4) array
        Wanted.
    """
    centre = frames.invert(cam_from_rig)[:3, 3]
    level = frames.level_camera(distance_mm=float(np.hypot(centre[0], centre[1])), height_mm=float(centre[2]), tilt_deg=0.0)
    return turned_to(level, cam_from_rig)


def turned_to(cam_from_rig: Array, like_cam_from_rig: Array) -> Array:
    """Return a pose turned round the table's axis to the azimuth of another one.

    Parameters
    ----------
    cam_from_rig : (4, 4) array
        The pose that is turned.
    like_cam_from_rig : (4, 4) array
        Whose azimuth it gets.

    Returns
    -------
    (4, 4) array
        The turned pose.
    """
    return cam_from_rig @ frames.rotation_z(azimuth_rad(cam_from_rig) - azimuth_rad(like_cam_from_rig))


def correct(part: ArmPart, joints_rad: Array, cam_from_rig_measured: Array, cam_from_rig_wanted: Array) -> Found:
    """Find the joints that bring the camera from where it was measured to where it is wanted, at any azimuth.

    The camera has to move by ``measured @ inv(wanted)`` in its own frame (the thesis's change of configuration),
    whatever made the arm miss: that change is applied to where the arm believes its camera to be. What is left after
    one correction is second order in the error.

    Parameters
    ----------
    part : ArmPart
        Its links.
    joints_rad : (5,) float64 array
        Commanded when the camera was measured.
    cam_from_rig_measured : (4, 4) array
        By the markers.
    cam_from_rig_wanted : (4, 4) array
        At any azimuth.

    Returns
    -------
    Found
        Joint angles, and how near they come.
    """
    believed = forward(part.links_mm, joints_rad)
    arm_from_rig = believed @ cam_from_rig_measured
    target = arm_from_rig @ frames.invert(turned_to(cam_from_rig_wanted, cam_from_rig_measured))
    return newton(part, target, joints_rad, arm_from_axis=arm_from_rig)
