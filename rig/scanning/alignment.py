"""Misalignment of a camera relative to the tangent view through the canister's axis (thesis, appendix C.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.arm.kinematics import forward
from rhizotwin.rig.arm.placement import Joints
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

ALIGNED_MM, ALIGNED_DEG, ALIGNED_ROLL_DEG = 0.5, 0.1, 0.5
"""Tolerances of axis, tilt and roll, below which no correction is made. The tolerance of roll, a rotation of the
picture, is large because roll is least harmful."""
MOST_MOVES = 60
"""Maximum number of moves. A bus servo stops within 0.3 deg (one sigma) of its target, which displaces the optical axis
by 3 mm, so that one move in nine ends within `ALIGNED_MM`."""
ALL_JOINTS = 2
"""Number of corrections of all joints together before the joints are corrected one at a time."""
APPROACH_STEPS = 6
"""Number of servo steps below its target from which a joint approaches the target. The approach is always from the same
side of the backlash, and begins outside the dead band."""
_SEARCHED_STEPS = 15
"""Number of servo steps tested on either side of the present angle (3.6 deg)."""
_MOVES = (0, 3, 4)
"""Indices of the joints that correct axis, tilt and roll."""


@dataclass(frozen=True, kw_only=True)
class Misalignment:
    """Deviation of a camera from the level, upright view through the canister's axis."""

    axis_mm: float
    """Horizontal distance between the optical axis and the canister's axis, mm, positive if the optical axis is to the
    left."""
    tilt_deg: float
    """Angle of the optical axis below the horizon, deg."""
    roll_deg: float
    """Rotation of the picture about the optical axis, deg, positive if the picture's right side is lower."""

    @property
    def is_aligned(self) -> bool:
        """Whether all errors are within the tolerances."""
        return self.size <= 1.0

    @property
    def size(self) -> float:
        """Largest error as a multiple of its tolerance."""
        return float(np.abs(self.relative).max())

    @property
    def relative(self) -> Array:
        """Errors of axis, tilt and roll (3,) as multiples of their tolerances."""
        return np.array([self.axis_mm / ALIGNED_MM, self.tilt_deg / ALIGNED_DEG, self.roll_deg / ALIGNED_ROLL_DEG])

    def text(self) -> str:
        """Return the errors of axis, tilt and roll as a text."""
        return f"axis {self.axis_mm:+.2f} mm, tilt {self.tilt_deg:+.3f} deg, roll {self.roll_deg:+.3f} deg"


def misalignment(cam_from_canister: Array) -> Misalignment:
    """Return the misalignment of a camera pose ``cam_from_canister`` (4, 4), at any azimuth."""
    centre = frames.invert(cam_from_canister)[:3, 3]
    right, forward = cam_from_canister[0, :3], cam_from_canister[2, :3]
    level = float(np.hypot(forward[0], forward[1]))
    return Misalignment(
        axis_mm=float(forward[0] * centre[1] - forward[1] * centre[0]) / level,
        tilt_deg=float(np.rad2deg(np.arctan2(-forward[2], level))),
        roll_deg=float(np.rad2deg(np.arcsin(np.clip(-right[2], -1.0, 1.0)))),
    )


def single_move(part: ArmPart, joints_deg: Joints, cam_from_canister: Array) -> list[Joints]:
    """Return a path on which a single joint corrects the largest error, in whole steps of its servo.

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
