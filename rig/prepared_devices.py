"""Devices that are connected and checked when they are first used, for manual operation of a rig."""

from rhizotwin.rig.arm.clearance import check_path, plan_path
from rhizotwin.rig.arm.placement import Joints, check_limits, require_arm
from rhizotwin.rig.devices import Arm, Lights, Turntable
from rhizotwin.rig.errors import LostError, RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.markers import Sighting, read_strip, unread_reason
from rhizotwin.rig.scanning.safety import ArmState, BoardState, Say, make_safe, park
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey


class PreparedDevices:
    """Open devices of a rig, each of which is prepared by its first use."""

    def __init__(self, devices: Devices, scene: Scene, *, say: Say) -> None:
        self._devices = devices
        self._scene = scene
        self._say = say
        self.rig = devices.rig
        self._board_ready = self._camera_ready = self._arm_ready = False
        self._arm_used = False  # whether the torque may be on
        self.commanded_deg: Joints | None = None
        """Joint angles at the end of the arm's last path, deg. They are None if the arm may have moved since."""

    def table(self) -> Turntable:
        """Return the turntable."""
        self._prepare_board()
        return self._devices.table

    def lights(self) -> Lights:
        """Return the lamps."""
        self._prepare_board()
        return self._devices.lights

    def arm(self) -> Arm:
        """Return the arm, with its torque on.

        Raises
        ------
        UserError
            If the rig has no arm.
        """
        arm = self._connected_arm()
        if not self._arm_ready:
            self._arm_used = True
            self._say(preflight.check_arm(arm))
            self._arm_ready = True
        return arm

    def take_picture(self) -> Grey:
        """Take a picture, and check that its size is that of the scene's camera."""
        camera = self._devices.camera
        if not self._camera_ready:
            self._say(preflight.check_camera(camera))
            self._camera_ready = True
        image = camera.capture().image
        preflight.check_size(image, self._scene.camera)
        return image

    def read_markers(self) -> tuple[Sighting | None, str]:
        """Take a picture, and return the measurement of the marker strip, or None and why it cannot be read."""
        image = self.take_picture()
        seen = read_strip(image, self._scene)
        return seen, "" if seen is not None else unread_reason(image, self._scene)

    def move_around(self, goal_deg: Joints) -> Joints:
        """Move the arm to joint angles on a path around all obstacles, and return the measured joint angles, deg."""
        return self.move_along(plan_path(self.rig, self._scene, self.arm().read_joints(), goal_deg))

    def check_clear(self, path: list[Joints]) -> None:
        """Raise an error if a path of the arm ends beyond a limit of a joint, or something is in the way."""
        check_limits(require_arm(self.rig), path[-1])
        check_path(self.rig, self._scene, [self.arm().read_joints(), *path])

    def move_along(self, path: list[Joints]) -> Joints:
        """Check a path of the arm for collisions, move along it, and return the measured joint angles, deg.

        Raises
        ------
        UserError
            If the rig has no arm, the path ends beyond a limit of a joint, or something is in the way.
        """
        arm, part = self.arm(), require_arm(self.rig)
        self.check_clear(path)
        self.commanded_deg = None
        try:
            for joints_deg in path:
                read = arm.move_to(joints_deg)
        except LostError:
            self._arm_ready = False
            raise
        self._devices.clock.sleep(part.settle_s)
        self.commanded_deg = path[-1]
        return read

    def park(self) -> Joints:
        """Move the arm to its parking position, and return the measured joint angles, deg."""
        arm = self.arm()
        park(arm, self.rig, self._scene)
        self.commanded_deg = None
        return arm.read_joints()

    def relax(self) -> None:
        """Switch the arm's torque off, even if the arm was not prepared."""
        self._connected_arm().relax()
        self._arm_ready, self._arm_used, self.commanded_deg = False, False, None

    def leave(self) -> None:
        """Leave the rig in a safe state: lamps off, arm parked and without torque.

        The motor of a Marlin board remains on if the table's angle is known. That of the hat goes off with the program.
        """
        known = False
        try:
            known = self._board_ready and self.rig.turntable.kind == "marlin" and self._devices.table.knows_zero()
        except RigError:
            known = False
        finally:
            board = BoardState(used=self._board_ready, finished=not known)
            arm = ArmState(used=self._arm_used, failed=not self._arm_ready)
            make_safe(self._devices, self._scene, board, arm, say=self._say)
        if known:
            self._say("turntable: the motor remains on, so that the table's angle is not lost")

    def _prepare_board(self) -> None:
        if not self._board_ready:
            self._say(preflight.check_table(self._devices.table))
            self._board_ready = True

    def _connected_arm(self) -> Arm:
        if self._devices.arm is None:
            raise UserError("this rig has no arm")
        return self._devices.arm
