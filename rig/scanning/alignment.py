"""Misalignment of a camera relative to a horizontal view of the canister (thesis, appendix C.2).

If the camera is aligned, it is upright, and its optical axis is horizontal and intersects the axis of the canister.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.arm.kinematics import forward
from rhizotwin.rig.arm.placement import Joints
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

ALIGNED_MM, ALIGNED_DEG, ALIGNED_ROLL_DEG = 0.5, 0.1, 0.5
"""Tolerances within which no correction is made: of the distance between the optical axis and the canister's axis, mm,
of the tilt, deg, and of the roll, deg. The tolerance of the roll, which is a rotation of the picture, is larger because
roll is least harmful."""
MOST_MOVES = 60
"""Maximum number of moves to align the camera. The position at which a bus servo stops has a standard deviation of 0.3
deg, which displaces the optical axis by 3 mm. Therefore, only one move in nine ends within `ALIGNED_MM`."""
ALL_JOINTS = 2
"""Number of corrections in which all joints move simultaneously. In later corrections, only one joint moves."""
APPROACH_STEPS = 6
"""Distance below its target from which a joint approaches the target, in servo steps. The approach is always from the
same side because of the backlash, and the distance is larger than the dead band."""
_SEARCHED_STEPS = 15
"""Maximum change of a joint angle in the search for the best angle, in servo steps (15 steps are 3.6 deg)."""
_MOVES = (0, 3, 4)
"""Indices of the three joints that correct the distance between the axes, the tilt and the roll, in this order."""


@dataclass(frozen=True, kw_only=True)
class Misalignment:
    """Deviation of a camera from the level, upright view through the canister's axis."""

    axis_mm: float
    """Horizontal distance between the optical axis and the canister's axis, mm. It is positive if the optical axis is
    to the left."""
    tilt_deg: float
    """Angle of the optical axis below the horizon, deg."""
    roll_deg: float
    """Rotation of the picture about the optical axis, deg. It is positive if the picture's right side is lower."""

    @property
    def is_aligned(self) -> bool:
        """Whether all errors are within the tolerances."""
        return self.size <= 1.0

    @property
    def size(self) -> float:
        """Largest of the three errors, each divided by its tolerance."""
        return float(np.abs(self.relative).max())

    @property
    def relative(self) -> Array:
        """Errors of axis, tilt and roll, each divided by its tolerance, shape (3,)."""
        return np.array([self.axis_mm / ALIGNED_MM, self.tilt_deg / ALIGNED_DEG, self.roll_deg / ALIGNED_ROLL_DEG])

    def text(self) -> str:
        """Format the errors of axis, tilt and roll as text."""
        return f"axis {self.axis_mm:+.2f} mm, tilt {self.tilt_deg:+.3f} deg, roll {self.roll_deg:+.3f} deg"


def misalignment(cam_from_canister: Array) -> Misalignment:
    """Return the misalignment of a camera with the pose ``cam_from_canister`` (4, 4). Its azimuth has no effect."""
    centre = frames.invert(cam_from_canister)[:3, 3]
    right, forward = cam_from_canister[0, :3], cam_from_canister[2, :3]
    level = float(np.hypot(forward[0], forward[1]))
    return Misalignment(
        axis_mm=float(forward[0] * centre[1] - forward[1] * centre[0]) / level,
        tilt_deg=float(np.rad2deg(np.arctan2(-forward[2], level))),
        roll_deg=float(np.rad2deg(np.arcsin(np.clip(-right[2], -1.0, 1.0)))),
    )


def single_move(part: ArmPart, joints_deg: Joints, cam_from_canister: Array) -> list[Joints]:
    """Return a path that corrects the largest error by moving a single joint, in whole steps of its servo.

    The base rotates the optical axis horizontally, the wrist's pitch tilts it, and the wrist's roll rotates the
    picture. Since each move of a servo has a random error, all other joints remain at rest. If no step would reduce the
    error, the present angle is approached again.

    Parameters
    ----------
    part : ArmPart
        Arm with the lengths of its links and the steps of its servos.
    joints_deg : Joints
        Joint angles that were commanded when the pose was measured.
    cam_from_canister : (4, 4) array
        Pose measured with the markers.
    """
    arm_from_canister = forward(part.links_mm, np.deg2rad(joints_deg)) @ cam_from_canister
    worst = int(np.abs(misalignment(cam_from_canister).relative).argmax())
    number = _MOVES[worst]
    joint, here_deg = part.joints[number], joints_deg[number]
    some = here_deg + np.arange(-_SEARCHED_STEPS, _SEARCHED_STEPS + 1) / joint.counts_per_deg
    ways = [(*joints_deg[:number], float(angle), *joints_deg[number + 1 :]) for angle in some if joint.min_deg <= angle <= joint.max_deg]
    poses = [frames.invert(forward(part.links_mm, np.deg2rad(way))) @ arm_from_canister for way in ways]
    goal = ways[int(np.argmin([abs(misalignment(pose).relative[worst]) for pose in poses]))]
    before_deg = max(goal[number] - APPROACH_STEPS / joint.counts_per_deg, joint.min_deg)
    return [(*goal[:number], before_deg, *goal[number + 1 :]), goal]
