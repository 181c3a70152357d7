"""Arm that holds the camera during a scan.

For each ring, the arm moves to the planned pose on a path without collisions. The pose is corrected using the markers,
and the joint angles are monitored while the arm is at rest.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.arm.clearance import check_path, plan_path
from rhizotwin.rig.arm.placement import Joints, check_limits, compute_joints, correct_joints, planned_camera_pose
from rhizotwin.rig.arm.tangency import azimuth_rad
from rhizotwin.rig.devices import Arm, Shot
from rhizotwin.rig.errors import LostError, RigError, UnsafeError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.rig.scanning.scan_camera import ScanCamera
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Ring
from rhizotwin.scenes.plan import visible_markers

NEAR_MM, NEAR_DEG = 3.0, 0.6
"""Errors of the camera's position (mm) and orientation (deg), below which no correction is made. They are about equal
to the repeatability of the servos. The exact pose is calibrated later from the pictures."""
FAR_MM, FAR_DEG = 80.0, 20.0
"""Errors of the camera's position (mm) and orientation (deg), above which the rig file must be wrong. In this case, the
collision checks of the arm's paths were invalid."""
FAIR_MM, FAIR_DEG = 8.0, 2.0
"""Maximum errors of the camera's position (mm) and orientation (deg) after `CORRECTIONS` corrections. They are larger
than the errors below which no correction is made, because further corrections of an arm with backlash do not reduce the
errors."""
CORRECTIONS, MOST_CORRECTIONS = 4, 8
WRIST = 3
"""Index of the joint that tilts the camera. Smaller angles point higher."""
SEARCH_DEG = (-5.0, 5.0, -10.0, 10.0)
"""Changes of the camera's tilt in the search for the strip, deg, in the order in which they are tried. The first change
points the camera upwards, because the strip is at the top of most pictures."""
LEAST_EXPECTED = 4
DRIFT_DEG = 1.5
"""Maximum change of a joint angle while pictures of a ring are taken, deg. A larger change indicates that the joint was
pushed or gave way."""
HEALTH_EVERY_S = 20.0


@dataclass(frozen=True, kw_only=True)
class ArmPlacement:
    """Joint angles of the arm for a ring."""

    joints_deg: Joints
    """Commanded joint angles, deg."""
    joints_read_deg: Joints
    """Joint angles measured after the arm had come to rest, deg."""


class ArmStand:
    """Camera stand that moves the camera with the robot arm."""

    def __init__(self, devices: Devices, arm: Arm, part: ArmPart, camera: ScanCamera, *, note: Callable[[str, str], None]) -> None:
        self._rig = devices.rig
        self._clock = devices.clock
        self._arm = arm
        self._part = part
        self._scene = camera.scene
        self._camera = camera
        self._note = note
        self._ring = camera.scene.plan.rings[0]
        self._placed: ArmPlacement | None = None
        self._health_due_s = -np.inf
        self.failed = False
        """Whether the arm has failed. It must then not be moved."""

    def check_rings(self, rings: Sequence[Ring]) -> None:
        """Raise an error before any motion if the arm cannot reach the position of every ring without collisions."""
        at: Joints = self._part.park_deg
        for ring in rings:
            goal = compute_joints(self._rig, planned_camera_pose(ring))
            plan_path(self._rig, self._scene, at, goal)
            at = goal
        plan_path(self._rig, self._scene, at, self._part.park_deg)

    def place(self, ring: Ring) -> None:
        """Move the camera to the position of a ring, computed from the joint angles alone."""
        self._ring = ring
        goal = compute_joints(self._rig, planned_camera_pose(ring))
        with self._note_failure():
            start = self._arm.read_joints()
        self._move(plan_path(self._rig, self._scene, start, goal))

    def search(self) -> tuple[Shot, Sighting | None]:
        """Take a picture, and search for the strip if it is not visible although it should be.

        In the search, the camera is tilted up and down. Return the last picture and the measurement of the strip, which
        is None if the strip was not found.
        """
        shot, seen = self._camera.look()
        expected = visible_markers(self._scene, planned_camera_pose(self._ring))
        if seen is not None or self._placed is None or not self._part.correct or expected < LEAST_EXPECTED:
            return shot, seen
        placed = self._placed
        for goal in tilted_joints(placed.joints_deg):
            if self._move_if_clear(goal):
                shot, seen = self._camera.look()
                if seen is not None:
                    return shot, seen
        self._move_if_clear(placed.joints_deg)
        return self._camera.look()

    def correct(self, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Correct the camera's position for the placed ring, using the measured pose of the marker strip.

        Parameters
        ----------
        seen : Sighting or None
            Present measurement of the strip; None if the strip cannot be read.
        angle_deg : callable
            Function that returns the present table angle, deg.

        Returns
        -------
        Sighting
            Measurement of the strip from the final position; None if the strip cannot be read.

        Raises
        ------
        UnsafeError
            If measured and computed camera poses differ so much that the rig file must be wrong.
        """
        wanted = planned_camera_pose(self._ring)
        done = 0
        while seen is not None:
            measured = seen.cam_from_rig(angle_deg(), direction=self._scene.turntable.direction)
            # At any azimuth: the canister rotates, and the arm's base may be beside the x axis.
            off_mm, off_deg = frames.pose_error(measured @ frames.rotation_z(azimuth_rad(measured)), wanted)
            if off_mm > FAR_MM or off_deg > FAR_DEG:
                raise UnsafeError(
                    f"arm: according to the markers, the camera is {off_mm:.0f} mm and {off_deg:.0f} deg away from the pose computed from "
                    "the joints; check zero_counts, sign, links_mm and position_mm in the rig file"
                )
            near = off_mm <= NEAR_MM and off_deg <= NEAR_DEG
            fair = off_mm <= FAIR_MM and off_deg <= FAIR_DEG
            enough = not self._part.correct or near or done == MOST_CORRECTIONS or (fair and done >= CORRECTIONS)
            if enough or not self._improve(measured, wanted):
                plural = "" if done == 1 else "s"
                self._note(
                    "placed",
                    f"arm: the camera is {off_mm:.1f} mm and {off_deg:.2f} deg away from its target after {done} correction{plural}",
                )
                return seen
            done += 1
            _, seen = self.search()
        self._note("placed", "arm: the camera's position was not corrected, because the strip cannot be read from there")
        return None

    def joints(self) -> tuple[Joints | None, Joints | None]:
        """Return the commanded and the measured joint angles, deg.

        Both are None if the camera was not moved to a ring yet.

        Raises
        ------
        LostError
            If the torque of a joint was switched off.
        UnsafeError
            If a joint was pushed away, a servo is too warm, or the supply voltage is out of range.
        """
        placed = self._placed
        if placed is None:
            return None, None
        with self._note_failure():
            if not self._arm.holds():
                raise LostError(
                    "arm: a servo has lost its torque because its supply voltage dropped or it became too warm; "
                    "correct this, then finish the scan with --resume"
                )
            read = self._arm.read_joints()
            if self._clock.now_s() >= self._health_due_s:
                self._arm.health()
                self._health_due_s = self._clock.now_s() + HEALTH_EVERY_S
        drift = np.abs(np.subtract(read, placed.joints_read_deg))
        if drift.max() > DRIFT_DEG:
            k = int(drift.argmax())
            self.failed = True
            raise UnsafeError(
                f"arm: joint {k + 1} moved from {placed.joints_read_deg[k]:.1f} to {read[k]:.1f} deg although it should be at rest; "
                "find out what pushed it, then finish the scan with --resume"
            )
        return placed.joints_deg, read

    def _improve(self, measured: Array, wanted: Array) -> bool:
        """Move the camera to a corrected position. Return False if no correction is possible."""
        if self._placed is None:
            return False
        try:
            goal = correct_joints(self._rig, self._placed.joints_deg, measured, wanted)
        except UnsafeError as error:
            self._note("placed", f"{error}; the camera is not moved")
            return False
        count_deg = min(1.0 / joint.counts_per_deg for joint in self._part.joints)
        if np.abs(np.subtract(goal, self._placed.joints_deg)).max() < 0.5 * count_deg:  # the servos would not move
            return False
        return self._move_if_clear(goal)

    def _move_if_clear(self, goal: Joints) -> bool:
        """Move directly to a nearby configuration. If the path is not clear, return False without any motion."""
        try:
            here = self._placed.joints_read_deg if self._placed is not None else self._arm.read_joints()
            check_limits(self._part, goal)
            check_path(self._rig, self._scene, [here, goal])
        except UnsafeError as error:
            self._note("placed", f"{error}; the camera is not moved")
            return False
        self._move([goal])
        return True

    def _move(self, path: Sequence[Joints]) -> None:
        self._placed = None
        with self._note_failure():
            for joints_deg in path:
                read = self._arm.move_to(joints_deg)
        self._clock.sleep(self._part.settle_s)
        self._placed = ArmPlacement(joints_deg=tuple(path[-1]), joints_read_deg=tuple(read))

    @contextmanager
    def _note_failure(self) -> Iterator[None]:
        try:
            yield
        except RigError:
            self.failed = True
            raise


def tilted_joints(joints_deg: Joints) -> list[Joints]:
    """Return the joint angles at which the strip is searched for, in order. They tilt the camera up and down."""
    return [(*joints_deg[:WRIST], joints_deg[WRIST] + tilt_deg, *joints_deg[WRIST + 1 :]) for tilt_deg in SEARCH_DEG]
