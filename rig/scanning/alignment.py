"""Misalignment of a camera relative to the tangent view through the canister's axis (thesis C.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.arm.kinematics import forward
from rhizotwin.rig.arm.placement import Joints
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

ALIGNED_MM, ALIGNED_DEG, ALIGNED_ROLL_DEG = 0.5, 0.1, 0.5
"""Tolerances of axis, tilt and roll below which no correction is made; roll, a rotation of the picture, is least
harmful."""
MOST_MOVES = 60
"""Maximum number of moves: a bus servo stops within 0.3 degrees (one sigma) of its target, which moves the optical axis
by 3 mm, so that one move in nine ends within `ALIGNED_MM`."""
ALL_JOINTS = 2
"""Number of corrections of all joints together, before joints are corrected one at a time."""
APPROACH_STEPS = 6
"""Number of servo steps below its target from which a joint approaches it, always from the same side of its backlash,
and from outside the dead band."""
_SEARCHED_STEPS = 15
"""Number of servo steps tested on either side: 3.6 degrees."""
_MOVES = (0, 3, 4)
"""Indices of the joints that correct axis, tilt and roll."""


@dataclass(frozen=True, kw_only=True)
class Misalignment:
    """Deviation of a camera from the level, upright view through the canister's axis."""

    axis_mm: float
    """Horizontal distance between optical axis and canister's axis, positive to the left of the latter."""
    tilt_deg: float
    """Angle of the optical axis below the horizon."""
    roll_deg: float
    """Rotation of the picture about the optical axis, positive if its right side is lower."""

    @property
    def is_aligned(self) -> bool:
        """Return whether all errors are below the tolerances."""
        return self.size <= 1.0

    @property
    def size(self) -> float:
        """Return the total error, in units of the tolerances, for comparison."""
        return float(np.abs(self.relative).max())

    @property
    def relative(self) -> Array:
        """Return axis, tilt and roll (3,) in units of the tolerances."""
        return np.array([self.axis_mm / ALIGNED_MM, self.tilt_deg / ALIGNED_DEG, self.roll_deg / ALIGNED_ROLL_DEG])

    def text(self) -> str:
        """Return the values as text."""
        return f"axis {self.axis_mm:+.2f} mm, tilt {self.tilt_deg:+.3f} deg, roll {self.roll_deg:+.3f} deg"


def misalignment(cam_from_canister: Array) -> Misalignment:
    """Return the deviation of a camera (4, 4) from the tangent view, at any azimuth."""
    centre = frames.invert(cam_from_canister)[:3, 3]
    right, forward = cam_from_canister[0, :3], cam_from_canister[2, :3]
    level = float(np.hypot(forward[0], forward[1]))
    return Misalignment(
        axis_mm=float(forward[0] * centre[1] - forward[1] * centre[0]) / level,
        tilt_deg=float(np.rad2deg(np.arctan2(-forward[2], level))),
        roll_deg=float(np.rad2deg(np.arcsin(np.clip(-right[2], -1.0, 1.0)))),
    )


def single_move(part: ArmPart, joints_deg: Joints, cam_from_canister: Array) -> list[Joints]:
    """Return a path on which one joint corrects the largest error, in whole steps of its servo.

    The base rotates the optical axis horizontally, the wrist's pitch tilts it, and the wrist's roll rotates the
    picture. Since each move of a servo has a random error, the other joints are not moved; if no step is nearer, the
    present one is approached again.

    Parameters
    ----------
    part : ArmPart
        Arm with links and steps of the joints.
    joints_deg : Joints
        Joint angles commanded at the measurement.
    cam_from_canister : (4, 4) array
        Pose measured by the markers.
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
