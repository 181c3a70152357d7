"""Interactive commands for operating every device manually, with collision checks of the arm's paths."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rhizotwin.rig import bands
from rhizotwin.rig.align_camera import align_camera
from rhizotwin.rig.arm.kinematics import cam_from_rig as camera_at
from rhizotwin.rig.arm.placement import camera_position, compute_joints, compute_joints_from_direction, planned_camera_pose
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.prepared_devices import PreparedDevices
from rhizotwin.rig.rig_file import JOINTS
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.homing import facing_angle
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Ring, Scene
from rhizotwin.scenes.picture_codec import Grey, encode_png

MOST_TURN_DEG = 720.0
"""Maximum turn of the table by one command, deg. A wrongly typed angle could otherwise turn it for hours."""


@dataclass(frozen=True, kw_only=True)
class Word:
    """Command that can be typed in the interactive mode."""

    usage: str
    does: str
    run: Callable[[list[str]], None]


class Jog:
    """Interactive operation of a rig's devices by typed commands."""

    def __init__(self, devices: Devices, scene: Scene, *, say: Say) -> None:
        self._devices = PreparedDevices(devices, scene, say=say)
        self._scene = scene
        self._say = say
        self._words: Mapping[str, Word] = {
            "table": Word(
                usage="table +9 | table 90", does="rotate the table by an angle (with a sign) or to an angle (without)", run=self._table
            ),
            "home": Word(usage="home [DEG]", does="determine the table's angle from the markers, or define it as DEG", run=self._home),
            "lights": Word(usage="lights PANEL [FRONT]", does="set the brightness of panel and front light, from 0 to 1", run=self._lights),
            "band": Word(usage="band NAME", does="set lamps and filter for a band of the camera", run=self._band),
            "joint": Word(
                usage="joint 2 +5 | joint 2 30",
                does="move one of the joints 1 to 5 by an angle (with a sign) or to an angle",
                run=self._joint,
            ),
            "go": Word(
                usage="go DISTANCE HEIGHT [TILT]",
                does="move the camera to a distance from the table's axis and a height above the rim (mm)",
                run=self._go,
            ),
            "look": Word(
                usage="look X Y Z DX DY DZ | look NAME",
                does="move the camera to a position (mm) and viewing direction, or to a named pose",
                run=self._look_from,
            ),
            "align": Word(
                usage="align [DISTANCE HEIGHT]",
                does="align the camera with the canister's axis, level and upright, using the markers",
                run=self._align,
            ),
            "park": Word(usage="park", does="move the arm to its parking position", run=self._park),
            "relax": Word(usage="relax", does="switch the arm's torque off (hold the camera first)", run=self._relax),
            "pose": Word(usage="pose", does="show table angle, joint angles and camera position", run=self._pose),
            "markers": Word(usage="markers", does="take a picture and show the detected markers", run=self._markers),
            "picture": Word(usage="picture FILE.png", does="take a picture and write it to a file", run=self._picture),
            "help": Word(usage="help", does="list all commands", run=self._help),
        }

    def run(self, lines: Iterable[str], *, stop_at_mistake: bool) -> None:
        """Execute commands until ``quit``, and leave the rig in a safe state.

        Parameters
        ----------
        lines : iterable of str
            Command lines, from a terminal or a pipe.
        stop_at_mistake : bool
            Whether to stop at the first error and raise it, as for a pipe. Otherwise errors are printed, and the next
            line is executed.
        """
        try:
            for line in lines:
                words = line.split("#", 1)[0].split()
                if not words:
                    continue
                if words[0] in ("quit", "exit"):
                    break
                try:
                    self.do(words)
                except UserError as error:
                    if stop_at_mistake:
                        raise
                    self._say(str(error))
        finally:
            self.leave()

    def do(self, words: list[str]) -> None:
        """Execute a command that is given as a list of words.

        Raises
        ------
        UserError
            If the command is unknown or invalid, or fails.
        """
        word = self._words.get(words[0])
        if word is None:
            raise UserError(f"there is no command {words[0]!r}; available commands are {', '.join(self._words)} and quit")
        try:
            word.run(words[1:])
        except (ValueError, IndexError):
            raise UserError(f"{' '.join(words)!r} is invalid; usage: {word.usage}") from None

    def leave(self) -> None:
        """Leave the rig in a safe state, see `PreparedDevices.leave`."""
        self._devices.leave()

    def shot(self) -> Grey:
        """Take a picture, and check that its size is that of the scene's camera."""
        return self._devices.take_picture()

    def _table(self, words: list[str]) -> None:
        (text,) = words
        angle_deg = parse_number(text)
        table = self._devices.table()
        if not table.knows_zero():
            raise RigError(
                "turntable: the table's angle is unknown; enter home, or home 0 if the seam of the marker strip faces the camera"
            )
        here_deg = table.position_deg()
        goal_deg = angle_deg + (here_deg if text[0] in "+-" else 0.0)
        if goal_deg - here_deg > MOST_TURN_DEG:
            raise RigError(
                f"turntable: the table would turn by {goal_deg - here_deg:g} deg, but at most {MOST_TURN_DEG:g} deg are permitted, because "
                "a turn is completed even if the program is stopped"
            )
        self._say(f"table at {table.move_to(goal_deg):.3f} deg")

    def _home(self, words: list[str]) -> None:
        table = self._devices.table()
        if words:
            (text,) = words
            angle_deg = parse_number(text)
        else:
            seen, why = self._devices.read_markers()
            if seen is None:
                raise RigError(f"turntable: the angle cannot be determined from the markers ({why}); give the angle, for example: home 90")
            angle_deg = facing_angle(seen, self._scene)
        angle_deg %= 360.0
        table.declare(angle_deg)
        self._say(f"table at {angle_deg:.3f} deg")

    def _lights(self, words: list[str]) -> None:
        panel, front = parse_number(words[0]), parse_number(words[1]) if len(words) > 1 else 0.0
        if len(words) > 2 or not (0.0 <= panel <= 1.0 and 0.0 <= front <= 1.0):
            raise ValueError(words)
        self._devices.lights().set(panel=panel, front=front)

    def _band(self, words: list[str]) -> None:
        (name,) = words
        part = bands.band_part(self._devices.rig, name)
        if part is None:
            known = ", ".join(one.name for one in self._devices.rig.camera.bands) or "none"
            raise UserError(f"the rig file has no band {name!r}; its bands are: {known}")
        bands.light(self._devices.lights(), self._devices.rig, name)
        if part.filter_deg is not None:
            self._devices.arm().turn_filter(part.filter_deg)

    def _joint(self, words: list[str]) -> None:
        number, text = words
        k = int(number) - 1
        if not 0 <= k < JOINTS:
            raise ValueError(number)
        angle_deg = parse_number(text)
        here = self._devices.arm().read_joints()
        goal = list(here)
        goal[k] = angle_deg + (here[k] if text[0] in "+-" else 0.0)
        self._say(joints_text(self._devices.move_along([tuple(goal)])))

    def _go(self, words: list[str]) -> None:
        distance_mm, height_mm = parse_number(words[0]), parse_number(words[1])
        tilt_deg = parse_number(words[2]) if len(words) > 2 else 0.0
        if len(words) > 3 or distance_mm <= 0.0:
            raise ValueError(words)
        self._devices.arm()  # without an arm, no goal can be computed
        pose = planned_camera_pose(Ring(distance_mm=distance_mm, height_mm=height_mm, tilt_deg=tilt_deg))
        self._say(joints_text(self._devices.move_around(compute_joints(self._devices.rig, pose))))

    def _look_from(self, words: list[str]) -> None:
        rig = self._devices.rig
        if len(words) == 1:
            named = {pose.name: pose for pose in rig.poses}
            if words[0] not in named:
                raise UserError(f"the rig file has no pose {words[0]!r}; its poses are: {', '.join(named) or 'none'}")
            position_mm, direction = named[words[0]].position_mm, named[words[0]].direction
        else:
            x, y, z, dx, dy, dz = (parse_number(word) for word in words)
            position_mm, direction = (x, y, z), (dx, dy, dz)
        self._devices.arm()  # without an arm, no goal can be computed
        self._say(joints_text(self._devices.move_around(compute_joints_from_direction(rig, position_mm, direction))))

    def _align(self, words: list[str]) -> None:
        if len(words) not in (0, 2):
            raise ValueError(words)
        if words:
            self._go(words)
        align_camera(self._devices, say=self._say)

    def _park(self, words: list[str]) -> None:
        require_no_arguments(words)
        self._say(joints_text(self._devices.park()))

    def _relax(self, words: list[str]) -> None:
        require_no_arguments(words)
        self._devices.relax()

    def _pose(self, words: list[str]) -> None:
        require_no_arguments(words)
        table, part = self._devices.table(), self._devices.rig.arm
        known = "" if table.knows_zero() else " (not homed)"
        self._say(f"table at {table.position_deg():.3f} deg{known}")
        if part is not None:
            joints = self._devices.arm().read_joints()
            distance_mm, height_mm, tilt_deg = camera_position(camera_at(part, joints))
            self._say(joints_text(joints))
            self._say(
                f"from the joint angles, the camera is {distance_mm:.1f} mm from the axis, at z = {height_mm:.1f} mm, tilted down by "
                f"{tilt_deg:.1f} deg"
            )

    def _markers(self, words: list[str]) -> None:
        require_no_arguments(words)
        seen, why = self._devices.read_markers()
        if seen is None:
            raise RigError(f"markers: {why}")
        distance_mm, height_mm, tilt_deg = camera_position(seen.cam_from_canister)
        facing_deg = facing_angle(seen, self._scene) % 360.0
        self._say(
            f"{seen.markers} markers, reprojection error {seen.reprojection_px:.2f} px; the table is at {facing_deg:.2f} deg if the "
            "camera is on the +x side"
        )
        self._say(
            f"from the markers, the camera is {distance_mm:.1f} mm from the axis, at z = {height_mm:.1f} mm, tilted down by "
            f"{tilt_deg:.1f} deg"
        )

    def _picture(self, words: list[str]) -> None:
        (name,) = words
        path = Path(name)
        if path.suffix.lower() != ".png":
            raise UserError(f"{name}: pictures are written as PNG; choose a name that ends in .png")
        image = self.shot()
        write_bytes(path, encode_png(image), new=True)
        found = preflight.measure_exposure(image)
        self._say(f"{path}: {100.0 * found.bright:.0f} % of full scale, {100.0 * found.saturated:.1f} % saturated")

    def _help(self, words: list[str]) -> None:
        require_no_arguments(words)
        width = max(len(word.usage) for word in self._words.values())
        for word in self._words.values():
            self._say(f"  {word.usage:<{width}}  {word.does}")
        self._say(f"  {'quit':<{width}}  switch the lamps off, park the arm, and switch its torque off")


def parse_number(text: str) -> float:
    """Parse a finite number. Words such as nan and inf are rejected."""
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(text)
    return value


def require_no_arguments(words: list[str]) -> None:
    """Raise an error if arguments were given to a command that takes none."""
    if words:
        raise ValueError(words)


def joints_text(joints_deg: tuple[float, ...]) -> str:
    """Format joint angles (deg), in order from the base to the wrist roll, as text."""
    return "joints at " + ", ".join(f"{angle:.1f}" for angle in joints_deg) + " deg"
