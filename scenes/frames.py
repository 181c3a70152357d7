"""Coordinate frames of the project, and rigid transforms between them.

Transforms are 4x4 float64 arrays named ``a_from_b``, with ``p_a = a_from_b @ p_b``. Lengths are in millimetres, and
angles in radians.

Frames
------
canister : origin on the cylinder's axis in the plane of its rim, +z up, +x through the strip's seam; roots have z < 0.
table    : rotates with the turntable; equals ``canister`` if the canister is perfectly centred and upright.
rig      : static; equals ``table`` at table angle 0. The camera is on the +x side, the backlight on the -x side.
cam      : OpenCV axes, x right, y down, z forward.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OPENCV_FROM_OPENGL: Array = np.diag([1.0, -1.0, -1.0, 1.0])
"""Axes of the cameras in OpenGL and nerfstudio: x right, y up, z backward."""


def from_rotation_translation(rotation: Array, translation_mm: Array) -> Array:
    """Return the 4x4 transform that consists of a 3x3 rotation and a translation (3,), mm."""
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation
    a_from_b[:3, 3] = translation_mm
    return a_from_b


def translation(x_mm: float, y_mm: float, z_mm: float) -> Array:
    """Return the transform of a translation by (x, y, z).

    Parameters
    ----------
    x_mm, y_mm, z_mm : float
        Components of the translation along the axes.

    Returns
    -------
    (4, 4) array
        Transform.
    """
    return from_rotation_translation(np.eye(3), np.array([x_mm, y_mm, z_mm]))


def rotation_z(angle_rad: float) -> Array:
    """Return the 4x4 transform of a rotation about +z, counter-clockwise seen from above."""
    return from_rotation_translation(_rotation([0.0, 0.0, angle_rad]), np.zeros(3))


def from_rotvec(rotvec_rad: Array, translation_mm: Array) -> Array:
    """Return the 4x4 transform that consists of a rotation vector (3,), rad, and a translation (3,), mm."""
    return from_rotation_translation(_rotation(rotvec_rad), np.asarray(translation_mm))


def to_rotvec(a_from_b: Array) -> Array:
    """Return the rotation of a 4x4 transform as a rotation vector (3,), rad."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(a_from_b[:3, :3]).as_rotvec()


def invert(a_from_b: Array) -> Array:
    """Invert a rigid transform ``a_from_b`` (4, 4), and return ``b_from_a`` (4, 4)."""
    rotation = a_from_b[:3, :3].T
    return from_rotation_translation(rotation, -rotation @ a_from_b[:3, 3])


def apply(a_from_b: Array, points_b: Array) -> Array:
    """Transform points (..., 3) from frame b to frame a."""
    return points_b @ a_from_b[:3, :3].T + a_from_b[:3, 3]


def twist(points: Array, share: Array, twist_deg: float) -> Array:
    """Rotate each of the points (N, 3) about the z axis. The angle is multiplied by a fraction (N,) for each point.

    Parameters
    ----------
    points : (N, 3) array
        Points to rotate.
    share : (N,) array
        Fraction of the angle for each point.
    twist_deg : float
        Angle, counter-clockwise seen from above.

    Returns
    -------
    (N, 3) array
        Rotated points.
    """
    angle_rad = np.deg2rad(twist_deg) * share
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1], points[:, 2]], axis=1)


def level_camera(*, distance_mm: float, height_mm: float, tilt_deg: float) -> Array:
    """Return the pose ``cam_from_rig`` (4, 4) of an upright camera on the +x side that points at the table's axis.

    Parameters
    ----------
    distance_mm, height_mm : float
        Distance of the camera's centre from the table's axis, and its z coordinate.
    tilt_deg : float
        Angle of the optical axis below the horizon.

    Returns
    -------
    (4, 4) array
        Pose of the camera, ``cam_from_rig``.
    """
    tilt = np.deg2rad(tilt_deg)
    forward = np.array([-np.cos(tilt), 0.0, -np.sin(tilt)])
    right = np.array([0.0, 1.0, 0.0])
    down = np.cross(forward, right)
    rig_from_cam = from_rotation_translation(np.stack([right, down, forward], axis=1), np.array([distance_mm, 0.0, height_mm]))
    return invert(rig_from_cam)


def pose_error(cam_from_x: Array, cam_from_x_true: Array) -> tuple[float, float]:
    """Return the difference of two camera poses (4, 4).

    It consists of the distance between the camera centres (mm) and the angle of the rotation between the cameras (deg).
    """
    difference = cam_from_x[:3, :3].T @ cam_from_x_true[:3, :3]
    angle_rad = float(np.linalg.norm(to_rotvec(difference)))
    centre_mm = invert(cam_from_x)[:3, 3] - invert(cam_from_x_true)[:3, 3]
    return float(np.linalg.norm(centre_mm)), float(np.rad2deg(angle_rad))


def _rotation(rotvec_rad: Array | list[float]) -> Array:
    from scipy.spatial.transform import Rotation  # imported here: loading takes a third of a second

    return np.asarray(Rotation.from_rotvec(rotvec_rad).as_matrix())
