"""Initial rig from the poses of single views: cameras of the rings, table angles, and scatter of the views."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.rig_fit import Rig
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.frames import Array

_ARM_MM = 100.0
"""Factor by which the entries of rotation matrices are multiplied for comparison with shifts, mm. The norm of the
change of the nine entries is sqrt(2) times the angle. A rotation therefore counts as the shift of a point at a distance
of 141 mm, near the centre of the canister's floor (146 mm)."""
_LEAST_SPREAD = np.array([1e-3, 0.1])
"""Value that is added to the initial standard deviations of the cameras' movements, rad and mm. The fit then starts
with larger standard deviations than the final ones."""
AGREE_RAD = np.deg2rad(5.0)
"""Maximum scatter of the differences between the table angles in the pictures and the commanded angles, rad. If the
scatter is larger, the commanded angles are not used."""


@dataclass(frozen=True, kw_only=True)
class FirstRig:
    """Initial values of the rig fit."""

    rig: Rig
    """Initial rig, which reproduces the given poses of the views."""
    command_rad: Array
    """(V,) commanded table angles about +z, rad. If an angle was not commanded, this is the angle estimated from the
    pictures."""
    known: NDArray[np.bool_]
    """(V,) whether each commanded table angle is used."""
    stations: tuple[tuple[int, int], ...]
    """(R,) ring and placement of each static camera, in the order of ``rig.cam_from_rig``."""
    warnings: tuple[str, ...]
    """Warnings about contradictory table angles."""


def first_rig(cam_from_canister: Sequence[Array], captured: Sequence[Frame], *, direction: int) -> FirstRig:
    """Compute the initial rig from the poses of single views.

    Parameters
    ----------
    cam_from_canister : sequence of (4, 4) float64 array
        Pose of each view, estimated from its own markers, mm.
    captured : sequence of Frame
        Frames of the views, with ring, placement and commanded table angle. Each placement of the camera in a ring is
        treated as a separate static camera.
    direction : int
        +1 if positive table angles are counter-clockwise from above.
    """
    poses = np.array(cam_from_canister)
    stations = sorted({frame.station for frame in captured})
    ring = np.array([stations.index(frame.station) for frame in captured])
    centres = np.array([frames.invert(pose)[:3, 3] for pose in poses])
    angle = -np.arctan2(centres[:, 1], centres[:, 0])
    command, known = angle.copy(), np.zeros(len(poses), bool)
    warnings: list[str] = []
    for r, (number, _) in enumerate(stations):
        members = [i for i, frame in enumerate(captured) if ring[i] == r and frame.table_deg is not None]
        if not members:
            continue
        commanded = direction * np.deg2rad([captured[i].table_deg or 0.0 for i in members])
        if _scatter(angle[members] - commanded) < AGREE_RAD:
            command[members], known[members] = commanded, True
        else:
            other = ", but match the opposite turntable.direction" if _scatter(angle[members] + commanded) < AGREE_RAD else ""
            warnings.append(
                f"ring {number}: the table angles in the pictures differ from the commanded angles{other}. "
                "The angles from the pictures are used."
            )
    turned = np.array([pose @ frames.rotation_z(-turn) for pose, turn in zip(poses, command, strict=True)])
    cam_from_rig = np.array([_medoid(turned[ring == r]) for r in range(len(stations))])
    own = np.array([pose @ frames.invert(cam_from_rig[r]) for pose, r in zip(turned, ring, strict=True)])
    rig = Rig(
        ring=ring,
        cam_from_rig=cam_from_rig,
        angle_rad=command,
        own=own,
        table_from_canister=np.eye(4),
        inset_px=0.0,
        focal_scale=1.0,
        spread=np.array([_spread(own[ring == r]) for r in range(len(stations))]),
    )
    return FirstRig(rig=rig, command_rad=command, known=known, stations=tuple(stations), warnings=tuple(warnings))


def _scatter(angles: Array) -> float:
    """Return the median absolute deviation of angles from their median direction, rad."""
    middle = np.angle(np.median(np.cos(angles)) + 1j * np.median(np.sin(angles)))
    return float(np.median(np.abs(np.angle(np.exp(1j * (angles - middle))))))


def _medoid(poses: Array) -> Array:
    """Return the pose (4, 4) among (N, 4, 4) with the smallest total distance to the other poses.

    Rotations are converted to shifts of a point at a distance of sqrt(2) `_ARM_MM`.
    """
    flat = np.concatenate([poses[:, :3, :3].reshape(-1, 9) * _ARM_MM, poses[:, :3, 3]], axis=1)
    return np.asarray(poses[np.argmin(np.linalg.norm(flat[:, None] - flat[None], axis=2).sum(axis=1))])


def _spread(own: Array) -> Array:
    """Return initial standard deviations (2,) of the rotation, rad, and shift, mm, of movements (N, 4, 4)."""
    turns = np.median([np.linalg.norm(frames.to_rotvec(pose)) for pose in own])
    return np.array([turns, np.median(np.linalg.norm(own[:, :3, 3], axis=1))]) + _LEAST_SPREAD
