"""How far a camera is from facing the canister: image plane tangent, optical axis through the canister's (C.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.arm.kinematics import forward
from rhizotwin.rig.arm.placing import Joints
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

ALIGNED_MM, ALIGNED_DEG, ALIGNED_ROLL_DEG = 0.5, 0.1, 0.5
"""Nearer than this there is nothing to correct; a turn of the picture about the optical axis does least harm."""
MOST_MOVES = 60
"""A bus servo stops within 0.3 degrees (one sigma) of where it is sent, which moves the optical axis by 3 mm: one move
in nine ends within `ALIGNED_MM`."""
ALL_JOINTS = 2
"""So many corrections are of all joints together, the others of one at a time."""
APPROACH_STEPS = 6
"""A joint comes to its goal from so many steps below: always from the same side of the play of its gears, and from
outside of the dead band."""
_SEARCHED_STEPS = 15
"""Steps of one servo on either side that are tried: 3.6 degrees."""
_MOVES = (0, 3, 4)
"""The joints that correct axis, tilt and roll."""


@dataclass(frozen=True, kw_only=True)
class Misalignment:
    """How a camera misses the level, upright view through the canister's axis."""

    axis_mm: float
    """Horizontal distance at which the optical axis passes the canister's axis, positive to its left."""
    tilt_deg: float
    """Optical axis below the horizon."""
    roll_deg: float
    """Turn of the picture about the optical axis, positive where its right side hangs down."""

    @property
    def is_aligned(self) -> bool:
        """Return whether nothing is left that is worth a correction."""
        return self.size <= 1.0

    @property
    def size(self) -> float:
        """Return one number for comparing two: in units of what counts as aligned."""
        return float(np.abs(self.relative).max())

    @property
    def relative(self) -> Array:
        """Return axis, tilt and roll (3,) in units of what counts as aligned."""
        return np.array([self.axis_mm / ALIGNED_MM, self.tilt_deg / ALIGNED_DEG, self.roll_deg / ALIGNED_ROLL_DEG])

    def text(self) -> str:
        """Return it for people."""
        return f"axis {self.axis_mm:+.2f} mm, tilt {self.tilt_deg:+.3f} deg, roll {self.roll_deg:+.3f} deg"


def misalignment(cam_from_canister: Array) -> Misalignment:
    """Return how a camera (4, 4) misses the tangent view, wherever round the axis it stands."""
    centre = frames.invert(cam_from_canister)[:3, 3]
    right, forward = cam_from_canister[0, :3], cam_from_canister[2, :3]
    level = float(np.hypot(forward[0], forward[1]))
    return Misalignment(
        axis_mm=float(forward[0] * centre[1] - forward[1] * centre[0]) / level,
        tilt_deg=float(np.rad2deg(np.arctan2(-forward[2], level))),
        roll_deg=float(np.rad2deg(np.arcsin(np.clip(-right[2], -1.0, 1.0)))),
    )


def single_move(part: ArmPart, joints_deg: Joints, cam_from_canister: Array) -> list[Joints]:
    """Return a way on which one joint, in whole steps of its servo, corrects what is worst.

    The base turns the optical axis, the wrist's pitch tilts it, the wrist's roll turns the picture. Each move of a
    servo has an error of its own, so that the others stay where they are; where no step is nearer, the same one is
    approached again.

    Parameters
    ----------
    part : ArmPart
        Links, and the joints' steps.
    joints_deg : Joints
        Commanded where the camera was measured.
    cam_from_canister : (4, 4) array
        Measured, by the markers.
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
