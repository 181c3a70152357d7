"""Forward kinematics of the arm.

The pose of the camera and its derivative are computed from the joint angles. The formulas follow section 3.3 and
appendix C.1 of the thesis.

Frames
------
arm : origin at the centre of the base plate's underside, +z along the base's axis. At joint angles 0 all links are
aligned along +z; positive shoulder, elbow and wrist angles lean toward +x; base and roll turn counter-clockwise about
+z.
cam : OpenCV axes at the camera's centre, which is the end of the last link, with z along that link. At joint angles 0,
x is the arm's -y and y the arm's +x, so that leaning forward by a right angle gives a level camera with an upright
picture.

All functions accept any number of joint vectors at once: joints (..., 5), transforms (..., 4, 4). Twists are (velocity
mm, rotation rad) in the camera's frame.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from rhizotwin.rig.rig_file import JOINTS, ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

LINK_FROM_CAM = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation from the camera's frame to the frame of the last link, at roll angle 0."""
_SERIES_BELOW_RAD = 1e-3
"""Rotation angle below which a series replaces the closed form in the logarithm of SE(3), rad. The closed form of its
last factor is inaccurate at small angles."""


def rig_from_arm(part: ArmPart) -> Array:
    """Return the 4x4 transform from the arm's frame to the rig frame."""
    return frames.from_rotvec(np.deg2rad(part.rotation_deg), np.array(part.position_mm))


def arm_from_cam(part: ArmPart, joints_deg: ArrayLike) -> Array:
    """Return the poses of the camera in the arm's frame (..., 4, 4) at joint angles (..., 5), deg."""
    return forward(part.links_mm, np.deg2rad(np.asarray(joints_deg, dtype=float)))


def cam_from_rig(part: ArmPart, joints_deg: ArrayLike) -> Array:
    """Return the 4x4 transform from the rig frame to the camera's frame at joint angles (5,), deg."""
    return frames.invert(rig_from_arm(part) @ arm_from_cam(part, joints_deg))


def forward(links_mm: tuple[float, ...], joints_rad: Array) -> Array:
    """Return the transforms ``arm_from_cam`` (..., 4, 4) at joint angles (..., 5), rad."""
    camera = np.zeros((*joints_rad.shape[:-1], 4, 4))
    camera[..., :3, :3] = _orientation(joints_rad)
    camera[..., :3, 3] = places(links_mm, joints_rad)[..., -1, :]
    camera[..., 3, 3] = 1.0
    return camera


def places(links_mm: tuple[float, ...], joints_rad: Array) -> Array:
    """Return the positions of base plate, shoulder, elbow, wrist and camera in the arm's frame (..., 5, 3), mm."""
    pitch = np.cumsum(joints_rad[..., 1:4], axis=-1)
    out = _heading(joints_rad[..., 0])
    steps = np.sin(pitch)[..., None] * out[..., None, :] + np.cos(pitch)[..., None] * np.array([0.0, 0.0, 1.0])
    at = np.zeros((*joints_rad.shape[:-1], 5, 3))
    at[..., 1, 2] = links_mm[0]
    at[..., 2:, :] = at[..., 1:2, :] + np.cumsum(steps * np.array(links_mm[1:])[:, None], axis=-2)
    return at


def body_jacobian(part: ArmPart, joints_rad: Array) -> Array:
    """Return the body Jacobian J_b (..., 6, 5) in ``V_b = J_b q_dot``.

    V_b is the twist of the camera in its own frame: the vee of ``g^-1 g_dot`` with g = ``arm_from_cam`` (Lynch and
    Park, Modern Robotics, section 5.1.2). It is in mm and rad per rad.
    """
    at = places(part.links_mm, joints_rad)
    cam_from_arm = np.swapaxes(_orientation(joints_rad), -1, -2)
    lean = np.cross(np.array([0.0, 0.0, 1.0]), _heading(joints_rad[..., 0]))
    last = cam_from_arm[..., 2, :]
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), lean.shape)
    axes = np.stack([up, lean, lean, lean, last], axis=-2)
    lever = at[..., 4:5, :] - at[..., [1, 1, 2, 3, 4], :]
    twist = np.concatenate([np.cross(axes, lever) @ np.swapaxes(cam_from_arm, -1, -2), axes @ np.swapaxes(cam_from_arm, -1, -2)], axis=-1)
    return np.swapaxes(twist, -1, -2)


def log_se3(a_from_b: Array) -> Array:
    """Return the logarithm of transforms (..., 4, 4) as twists (..., 6).

    The translational part, mm, is followed by the rotational part, rad.
    """
    shape = a_from_b.shape[:-2]
    rotation = Rotation.from_matrix(a_from_b[..., :3, :3].reshape(-1, 3, 3)).as_rotvec().reshape(*shape, 3)
    shift = a_from_b[..., :3, 3]
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    safe = np.maximum(angle, _SERIES_BELOW_RAD)
    # (1 - (a / 2) cot(a / 2)) / a^2
    factor = np.where(angle > _SERIES_BELOW_RAD, (1.0 - safe / 2.0 / np.tan(safe / 2.0)) / safe**2, 1.0 / 12.0 + angle**2 / 720.0)
    across = np.cross(rotation, shift)
    return np.concatenate([shift - across / 2.0 + factor * np.cross(rotation, across), rotation], axis=-1)


def _heading(base_rad: Array) -> Array:
    """Return the horizontal direction (..., 3) in which the arm tilts if its pitch angles are positive."""
    return np.stack([np.cos(base_rad), np.sin(base_rad), np.zeros_like(base_rad)], axis=-1)


def _orientation(joints_rad: Array) -> Array:
    """Return the rotation (..., 3, 3) from the camera's frame to the arm's frame."""
    if joints_rad.shape[-1] != JOINTS:
        raise ValueError(f"joints_rad must have shape (..., {JOINTS}), not {joints_rad.shape}")
    angles = np.stack([joints_rad[..., 0], joints_rad[..., 1:4].sum(axis=-1), joints_rad[..., 4]], axis=-1)
    turned = Rotation.from_euler("ZYZ", angles.reshape(-1, 3)).as_matrix().reshape(*joints_rad.shape[:-1], 3, 3)
    return turned @ LINK_FROM_CAM
