"""Inverse kinematics: joint angles for a given camera pose.

The solution is either in closed form (thesis section 3.3) or by Newton's method (appendix C.3).

With five joints, the camera's centre can be placed anywhere within reach, but the optical axis remains in the plane
that contains the base's axis and the camera. The closed form meets the centre exactly, chooses the nearest possible
orientation, and returns the remaining angle. Newton's method minimises the squared errors of position and orientation.
If the target may rotate about an axis, it meets the target exactly, with six unknowns for six equations.

All functions accept any number of targets at once: transforms of shape (..., 4, 4) and joint angles of shape (..., 5),
rad.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhizotwin.rig.arm.kinematics import body_jacobian, forward, log_se3
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes.frames import Array

EXACT_MM = 1e-9
"""Length below which a distance is treated as zero, because it may be a rounding error, mm."""
NEAR_AXIS_MM = 1.0
"""Maximum distance between the camera and the base's axis, mm, at which the azimuth may be computed from the optical
axis. So close to the axis, the azimuth of the camera's position is uncertain."""
MOST_STEPS = 20
CLOSE_MM, CLOSE_RAD = 1e-7, 1e-9
"""Thresholds of the position error, mm, and the orientation error, rad, at which Newton's method has converged. The
method also stops when the step of every joint is below CLOSE_RAD."""
DAMPING = 0.1
"""Damping of the normal equations, relative to the squared norm of the remaining twist. It limits the size of the steps
far from the target, and becomes negligible near the target."""
UNIT_MM = 100.0
"""Position error that has the same weight as an orientation error of one radian, mm. It is about the length of a link,
so that neither of the two errors dominates."""


@dataclass(frozen=True, kw_only=True)
class Branches:
    """Solutions of the closed form.

    The base points forward or backward, and the elbow angle is positive or negative.
    """

    joints_rad: Array
    """Joint angles between -pi and pi, shape (..., 4, 5). They are NaN if the target is out of reach."""
    left_over_rad: Array
    """Minimum angle by which the camera's orientation deviates from the target, rad, shape (...,). It is 0 if five
    joints can reach the target orientation at the target position."""
    wrist_mm: Array
    """Distance between the wrist and the shoulder at the target pose, shape (...,)."""


@dataclass(frozen=True, kw_only=True)
class NewtonSolution:
    """Result of Newton's method for one or several targets."""

    joints_rad: Array
    """Joint angles, shape (..., 5)."""
    steps: NDArray[np.int64]
    """Number of iterations, shape (...,)."""
    converged: NDArray[np.bool_]
    """Whether the method converged, shape (...,)."""
    left_over: Array
    """Remaining twist between the camera and the target, shape (..., 6). The translation in mm is followed by the
    rotation in rad."""
    turned_rad: Array
    """Angle by which the target was rotated about ``arm_from_axis`` of `newton`, shape (...,). It is 0 if no axis was
    given."""


def three_link(links_mm: tuple[float, float, float], x_mm: ArrayLike, y_mm: ArrayLike, theta_rad: ArrayLike, *, elbow: int = 1) -> Array:
    """Return the joint angles q1, q2, q3 (..., 3) of a planar arm.

    The end of the arm has position (x, y) and direction theta. The function evaluates equations 3.1 to 3.6 of the
    thesis with ``r = hypot(x_w, y_w)``, written with atan2 of half angles, which is accurate for a stretched arm.
    ``elbow`` is the sign of q2, which is -1 in the thesis. The result is NaN if the wrist is out of reach.

    Parameters
    ----------
    links_mm : tuple of float
        Lengths from shoulder to elbow, to wrist, and to end.
    x_mm, y_mm : (...) array
        Position of the end; the arm points along x at angles 0.
    theta_rad : (...) array
        Direction of the last link.
    elbow : int
        Sign of q2.

    Returns
    -------
    (..., 3) array
        Joint angles, rad.
    """
    l1, l2, l3 = links_mm
    theta = np.asarray(theta_rad, dtype=float)
    x_w = np.asarray(x_mm) - l3 * np.cos(theta)
    y_w = np.asarray(y_mm) - l3 * np.sin(theta)
    r = np.hypot(x_w, y_w)
    reached = (r <= l1 + l2 + EXACT_MM) & (r >= abs(l1 - l2) - EXACT_MM)
    beyond = np.sqrt(np.maximum((l1 + l2 - r) * (l1 + l2 + r), 0.0))
    within = np.sqrt(np.maximum((r - l1 + l2) * (r + l1 - l2), 0.0))
    q2 = elbow * 2.0 * np.arctan2(beyond, within)
    q1 = np.arctan2(y_w, x_w) - np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))
    return np.where(reached[..., None], np.stack([q1, q2, theta - q1 - q2], axis=-1), np.nan)


def inverse(part: ArmPart, arm_from_cam: Array) -> Branches:
    """Return all joint angles that place the camera's centre at the target position.

    The camera's orientation is as close to that of the target as five joints permit.

    Parameters
    ----------
    part : ArmPart
        Arm with its links.
    arm_from_cam : (..., 4, 4) array
        Target poses.

    Returns
    -------
    Branches
        Joint angles (..., 4, 5) for two base and two elbow configurations, and the remaining angle of the orientation.
    """
    base, *links = part.links_mm
    l1, l2, l3 = links
    at, rotation = arm_from_cam[..., :3, 3], arm_from_cam[..., :3, :3]
    azimuth = _azimuth(at, rotation[..., 2])
    ahead, left_over = _into_plane(rotation[..., 2], azimuth)
    answers = []
    for base_rad in (azimuth, azimuth + np.pi):
        out = np.cos(base_rad) * at[..., 0] + np.sin(base_rad) * at[..., 1]
        lean = np.arctan2(np.cos(base_rad) * ahead[..., 0] + np.sin(base_rad) * ahead[..., 1], ahead[..., 2])
        # At roll 0 the camera's x points to the arm's right; rotating the optical axis into the plane scales both of
        # these equally.
        right = np.stack([np.sin(base_rad), -np.cos(base_rad), np.zeros_like(base_rad)], axis=-1)
        x_cam, y_cam = (np.sum(right * rotation[..., k], axis=-1) for k in (0, 1))
        roll = np.arctan2(-y_cam, x_cam)
        for elbow in (1, -1):
            pitch = three_link((l1, l2, l3), at[..., 2] - base, out, lean, elbow=elbow)
            answers.append(np.concatenate([base_rad[..., None], pitch, roll[..., None]], axis=-1))
    joints = np.stack(answers, axis=-2)
    joints = np.where(np.isnan(joints).any(axis=-1, keepdims=True), np.nan, _wrap_angle(joints))
    wrist = at - l3 * ahead - np.array([0.0, 0.0, base])
    return Branches(joints_rad=joints, left_over_rad=left_over, wrist_mm=np.linalg.norm(wrist, axis=-1))


def newton(part: ArmPart, arm_from_cam: Array, start_rad: Array, *, arm_from_axis: Array | None = None) -> NewtonSolution:
    """Compute joint angles by Newton's method, using the damped pseudo-inverse of the body Jacobian.

    Each step solves ``(J^T J + m I) dq = J^T V``, where V = log(g^-1 g_wanted) is the twist in the camera's frame, and
    m decreases with |V|^2. For m = 0, dq is V multiplied by the pseudo-inverse of J, which has more rows than columns
    (Lynch and Park, Modern Robotics, section 6.2.2).

    Parameters
    ----------
    part : ArmPart
        Arm with its links.
    arm_from_cam : (..., 4, 4) float64 array
        Target poses.
    start_rad : (..., 5) float64 array
        Initial joint angles, or (5,) for all targets.
    arm_from_axis : float64 array or None
        Frame about whose z axis the target may rotate freely.

    Returns
    -------
    NewtonSolution
        Joint angles, and the remaining errors of position and orientation.
    """
    shape = arm_from_cam.shape[:-2]
    goal = arm_from_cam.reshape(-1, 4, 4)
    count = len(goal)
    unknowns = np.zeros((count, 5 if arm_from_axis is None else 6))
    unknowns[:, :5] = np.broadcast_to(start_rad, (*shape, 5)).reshape(-1, 5)
    left = np.zeros((count, 6))
    steps, converged = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.bool_)
    weight = np.array([1.0 / UNIT_MM] * 3 + [1.0] * 3)
    running = np.arange(count)
    for step in range(MOST_STEPS + 1):
        joints = unknowns[running, :5]
        camera = forward(part.links_mm, joints)
        jacobian = body_jacobian(part, joints)
        wanted = goal[running]
        if arm_from_axis is not None:
            wanted = _rotation_about_axis(arm_from_axis, unknowns[running, 5]) @ wanted
            jacobian = np.concatenate([jacobian, -_twist_about_axis(arm_from_axis, camera)[..., None]], axis=-1)
        twist = log_se3(np.linalg.inv(camera) @ wanted)
        left[running], steps[running] = twist, step
        there = (np.linalg.norm(twist[:, :3], axis=1) < CLOSE_MM) & (np.linalg.norm(twist[:, 3:], axis=1) < CLOSE_RAD)
        move = _step(jacobian * weight[:, None], twist * weight)
        still = there | (np.abs(move).max(axis=1) < CLOSE_RAD)
        converged[running] = still
        running, move = running[~still], move[~still]
        if not len(running) or step == MOST_STEPS:
            break
        unknowns[running] += move
    return NewtonSolution(
        joints_rad=_wrap_angle(unknowns[:, :5]).reshape(*shape, 5),
        steps=steps.reshape(shape),
        converged=converged.reshape(shape),
        left_over=left.reshape(*shape, 6),
        turned_rad=(np.zeros(count) if arm_from_axis is None else _wrap_angle(unknowns[:, 5])).reshape(shape),
    )


def _azimuth(at: Array, ahead: Array) -> Array:
    """Return the azimuth (...,) of the vertical plane that contains the base's axis and the camera, rad.

    For a camera on the base's axis, the plane contains the optical axis instead.
    """
    far = np.hypot(at[..., 0], at[..., 1])
    by_axis = np.arctan2(ahead[..., 1], ahead[..., 0])
    level = np.hypot(ahead[..., 0], ahead[..., 1])
    off_plane = np.abs(np.sin(by_axis) * at[..., 0] - np.cos(by_axis) * at[..., 1])
    use_axis = (far < EXACT_MM) | ((far < NEAR_AXIS_MM) & (off_plane < EXACT_MM) & (level > 1e-3))
    return np.where(use_axis, np.where(level > EXACT_MM, by_axis, 0.0), np.arctan2(at[..., 1], at[..., 0]))


def _into_plane(ahead: Array, azimuth: Array) -> tuple[Array, Array]:
    """Project the optical axis onto the vertical plane with the given azimuth.

    Return the projected unit vectors (..., 3), and the angles between the optical axis and the plane (...,), rad.
    """
    zero = np.zeros_like(azimuth)
    normal = np.stack([-np.sin(azimuth), np.cos(azimuth), zero], axis=-1)
    outward = np.stack([np.cos(azimuth), np.sin(azimuth), zero], axis=-1)
    aside = np.sum(normal * ahead, axis=-1, keepdims=True)
    flat = ahead - aside * normal
    length = np.linalg.norm(flat, axis=-1, keepdims=True)
    flat = np.where(length > EXACT_MM, flat / np.maximum(length, EXACT_MM), outward)
    return flat, np.arctan2(np.abs(aside), length)[..., 0]


def _step(jacobian: Array, twist: Array) -> Array:
    """Return the damped Gauss-Newton step (N, n) of n unknowns for N targets."""
    transposed = np.swapaxes(jacobian, -1, -2)
    damping = DAMPING * np.sum(twist**2, axis=-1) + 1e-14  # the constant keeps singular poses solvable
    normal = transposed @ jacobian + damping[:, None, None] * np.eye(jacobian.shape[-1])
    return np.linalg.solve(normal, transposed @ twist[..., None])[..., 0]


def _rotation_about_axis(arm_from_axis: Array, angle_rad: Array) -> Array:
    """Return transforms (N, 4, 4) that rotate by the given angles about the z axis of ``arm_from_axis``.

    The transforms apply to points in the arm's frame.
    """
    turn = np.zeros((len(angle_rad), 4, 4))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle_rad)
    turn[:, 1, 0] = np.sin(angle_rad)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = turn[:, 3, 3] = 1.0
    return arm_from_axis @ turn @ np.linalg.inv(arm_from_axis)


def _twist_about_axis(arm_from_axis: Array, camera: Array) -> Array:
    """Return the twist (N, 6) of a camera that rotates at unit speed about the z axis of ``arm_from_axis``.

    The twist is expressed in the camera's frame.
    """
    axis, lever = arm_from_axis[:3, 2], camera[:, :3, 3] - arm_from_axis[:3, 3]
    in_arm = np.stack([np.cross(axis, lever), np.broadcast_to(axis, lever.shape)], axis=1)
    return (in_arm @ camera[:, :3, :3]).reshape(-1, 6)


def _wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles to the range from -pi to pi, rad."""
    return np.arctan2(np.sin(angle_rad), np.cos(angle_rad))
