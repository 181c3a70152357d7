"""Functional check of every device of a rig.

For each device, the check reports its state, or the problem and a remedy.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TypeVar

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Arm, Camera, Lights, Turntable
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import connect_shutter, open_arm, open_board
from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.rig.serial_line.recording import Recorder
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.plan import count_pictures

AT_REST_DEG = 5.0
"""Maximum deviation of each joint from the parking position, deg, at which the torque of the arm may be switched off.
At larger deviations, the arm could drop."""
LIT, LEAST_LIGHT = 1.3, 0.02
"""Thresholds for the brightness of the picture with the lamps on. It must exceed the brightness without the lamps
multiplied by the first value, plus the second value, which is a fraction of full scale."""

T = TypeVar("T")


class Bench(Protocol):
    """Rig, real or emulated, with its scene."""

    @property
    def rig(self) -> RigFile:
        """Description of the devices."""

    @property
    def scene(self) -> Scene:
        """Scene with the strip and the camera."""

    @property
    def clock(self) -> Clock:
        """Clock for waiting times."""

    def open_camera(self) -> Camera:
        """Open the camera of the rig, or of the twin."""


def check(bench: Bench, *, say: Say, folder: Path, recorder: Recorder | None = None) -> int:
    """Check every device of a rig and report one line per device, without moving any of them.

    The lamps are off at the end. The table's motor remains on only if the board knows its angle. The arm's torque is
    switched off only in the parking position.

    Parameters
    ----------
    bench : Bench
        Rig with its scene.
    say : Say
        Function that receives each line of the report.
    folder : path
        Folder in which scans would be written.
    recorder : Recorder or None
        Recorder of all transmitted bytes, if any.

    Returns
    -------
    int
        Number of problems found.
    """
    rig = bench.rig
    scene = bench.scene
    clock = bench.clock
    report = _Report(say)
    board = report.look("turntable", lambda: _board(rig, clock, recorder))
    arm = None
    try:
        if rig.arm is None:
            report.line("arm", "ok", "the rig file has no arm; the camera is on a tripod")
        else:
            arm = report.look("arm", lambda: _arm(rig, clock, recorder))
        camera = report.look("camera", lambda: _camera(bench.open_camera, rig, None if board is None else board[1]))
        if camera is not None:
            try:
                _look_at_pictures(report, camera, None if board is None else board[1], rig, scene)
            finally:
                camera.close()
    finally:
        if board is not None:
            report.quietly("lights", board[1].off)
            report.quietly("turntable", lambda: _leave_table(board[0]))
        if arm is not None and rig.arm is not None:
            part, held = rig.arm, arm
            report.quietly("arm", lambda: _leave_arm(held, part, say))
    report.look("disk", lambda: (None, preflight.check_disk(folder, count_pictures(scene), scene.camera)))
    return report.failed


class _Report:
    """Output of the check. One line is written per device, and the problems are counted."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self.failed = 0

    def line(self, name: str, verdict: str, text: str) -> None:
        """Write the report line of one device."""
        self._say(f"{name:<10} {verdict:<5} {text.removeprefix(f'{name}: ')}")

    def look(self, name: str, action: Callable[[], tuple[T, str]]) -> T | None:
        """Run a check and report its text.

        A failure is reported as a problem, and the result is then None.
        """
        try:
            found, text = action()
        except UserError as error:
            self.failed += 1
            self.line(name, "WRONG", str(error))
            return None
        self.line(name, "ok", text)
        return found

    def quietly(self, name: str, action: Callable[[], object]) -> None:
        """Run an action, and report it only if it fails."""
        try:
            action()
        except UserError as error:
            self.failed += 1
            self.line(name, "WRONG", str(error))


def _board(rig: RigFile, clock: Clock, recorder: Recorder | None) -> tuple[tuple[Turntable, Lights], str]:
    table, lights = open_board(rig, clock=clock, recorder=recorder)
    try:
        return (table, lights), preflight.check_table(table)
    except BaseException:
        table.close()
        raise


def _arm(rig: RigFile, clock: Clock, recorder: Recorder | None) -> tuple[Arm | None, str]:
    arm = open_arm(rig, clock=clock, recorder=recorder)
    if arm is None:
        return None, "none"
    try:
        return arm, preflight.check_arm(arm)
    except BaseException:
        arm.close()
        raise


def _camera(open_camera: Callable[[], Camera], rig: RigFile, lights: Lights | None) -> tuple[Camera, str]:
    camera = open_camera()
    try:
        if lights is not None:
            connect_shutter(camera, rig, lambda: lights)
        return camera, preflight.check_camera(camera)
    except BaseException:
        camera.close()
        raise


def _look_at_pictures(report: _Report, camera: Camera, lights: Lights | None, rig: RigFile, scene: Scene) -> None:
    """Take a picture with the lamps off and one with the lamps on, and check the lamps, the exposure and the markers.

    If the rig has an arm, exposure and markers are only reported, because the camera may point anywhere. If the lamps
    cannot be controlled, a single picture is taken, and only its size and exposure are checked.
    """
    if lights is None:
        report.look("picture", lambda: (None, preflight.check_picture(camera.capture().image, scene.camera)))
        return
    lit = report.look("lights", lambda: _take_lit_picture(camera, lights, rig, scene))
    if lit is None:
        return
    if rig.arm is None:
        report.look("picture", lambda: (None, preflight.check_picture(lit, scene.camera)))
        report.look("markers", lambda: (None, preflight.check_markers(lit, scene)))
    else:
        found = preflight.measure_exposure(lit)
        text = f"{100.0 * found.bright:.0f} % of full scale, {100.0 * found.saturated:.1f} % saturated, in the present position of the arm"
        report.line("picture", "ok", text)
        report.line("markers", "ok", f"not required in the present position of the arm ({_describe_markers(lit, scene)})")


def _take_lit_picture(camera: Camera, lights: Lights, rig: RigFile, scene: Scene) -> tuple[Grey, str]:
    """Take a picture with the lamps on, and return it with a description.

    Raise an error if the lamps have no effect.
    """
    lights.off()
    dark = camera.capture().image
    preflight.check_lights(lights, rig.lights)
    lit = camera.capture().image
    preflight.check_size(lit, scene.camera)
    before, after = (preflight.measure_exposure(image).bright for image in (dark, lit))
    brighter = after >= LIT * before + LEAST_LIGHT
    if not brighter and rig.arm is not None:
        return lit, "lamps reply, but the panel is not visible in the present position of the arm"
    if not brighter:
        raise RigError(
            f"lights: the picture is equally bright without ({100.0 * before:.0f} %) and with the lamps ({100.0 * after:.0f} %); check "
            "the lamps' supply and data line, darken the room, and point the camera at the panel"
        )
    return lit, f"the lamps raise the picture's brightness from {100.0 * before:.0f} % to {100.0 * after:.0f} % of full scale"


def _describe_markers(image: Grey, scene: Scene) -> str:
    try:
        return preflight.check_markers(image, scene)
    except RigError as error:
        return str(error).removeprefix("markers: ")


def _leave_table(table: Turntable) -> None:
    """Switch the motor off and close the table.

    The motor remains on if the table knows its angle, which would be lost otherwise.
    """
    try:
        if not table.knows_zero():
            table.release()
    finally:
        table.close()


def _leave_arm(arm: Arm, part: ArmPart, say: Say) -> None:
    """Close the arm. If the arm is parked, its torque is switched off first."""
    try:
        joints = arm.read_joints()
        if max(abs(angle - rest) for angle, rest in zip(joints, part.park_deg, strict=True)) <= AT_REST_DEG:
            arm.relax()
        else:
            say("arm: its torque remains on, because the arm is not parked; park it with 'rhizotwin rig jog'")
    finally:
        arm.close()
