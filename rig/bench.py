"""Looks at every device of a rig for a person on the bench, each by itself.

What is well, or what is wrong and what to do.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Arm, Camera, Lights, Turntable
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import open_arm, open_board
from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.rig.serial_line.recording import Recorder
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey

AT_REST_DEG = 5.0
"""An arm this near to its place of rest may lose its torque."""
LIT, LEAST_LIGHT = 1.3, 0.02
"""The lamps must brighten the picture by this factor, and by this fraction of full scale."""

T = TypeVar("T")


def check(
    rig: RigFile,
    scene: Scene,
    *,
    clock: Clock,
    open_camera: Callable[[], Camera],
    say: Say,
    folder: Path,
    recorder: Recorder | None = None,
) -> int:
    """Look at every device of a rig, one line each; nothing moves. Lamps are off at the end.

    The table's motor stays on only where the board knows its angle; the arm's torque goes off only where the arm is at
    rest.

    Parameters
    ----------
    rig, scene : RigFile, Scene
        Devices; strip and camera, for what the pictures must show.
    clock : Clock
        For the waits.
    open_camera : callable
        Opens the rig's camera, or the twin's.
    say : Say
        Hears the lines.
    folder : path
        Where scans would be written.
    recorder : Recorder or None
        Keeps every byte on the wire.

    Returns
    -------
    int
        How many things are wrong.
    """
    report = _Report(say)
    board = report.look("turntable", lambda: _board(rig, clock, recorder))
    arm = None
    try:
        if rig.arm is None:
            report.line("arm", "ok", "none in the rig file: the camera stands on a tripod")
        else:
            arm = report.look("arm", lambda: _arm(rig, clock, recorder))
        camera = report.look("camera", lambda: _camera(open_camera))
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
    pictures = sum(ring.views for ring in scene.plan.rings)
    report.look("disk", lambda: (None, preflight.check_disk(folder, pictures, scene.camera)))
    return report.failed


class _Report:
    """Lines of a check, and how many of them are bad."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self.failed = 0

    def line(self, name: str, verdict: str, text: str) -> None:
        """Say one line."""
        self._say(f"{name:<10} {verdict:<5} {text.removeprefix(f'{name}: ')}")

    def look(self, name: str, action: Callable[[], tuple[T, str]]) -> T | None:
        """Do something that returns what it found and a text, and say the text or what was wrong."""
        try:
            found, text = action()
        except UserError as error:
            self.failed += 1
            self.line(name, "WRONG", str(error))
            return None
        self.line(name, "ok", text)
        return found

    def quietly(self, name: str, action: Callable[[], object]) -> None:
        """Do something, and say only what was wrong."""
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


def _camera(open_camera: Callable[[], Camera]) -> tuple[Camera, str]:
    camera = open_camera()
    try:
        return camera, preflight.check_camera(camera)
    except BaseException:
        camera.close()
        raise


def _look_at_pictures(report: _Report, camera: Camera, lights: Lights | None, rig: RigFile, scene: Scene) -> None:
    """Take a picture without and with the lamps.

    An arm at rest may look anywhere, so that there only the lamps are judged.
    """
    if lights is None:
        report.look("picture", lambda: (None, preflight.check_picture(camera.capture().image, scene.camera)))
        return
    lit = report.look("lights", lambda: _lit(camera, lights, rig, scene))
    if lit is None:
        return
    if rig.arm is None:
        report.look("picture", lambda: (None, preflight.check_picture(lit, scene.camera)))
        report.look("markers", lambda: (None, preflight.check_markers(lit, scene)))
    else:
        found = preflight.exposure_of(lit)
        text = f"{100.0 * found.bright:.0f} % of full scale, {100.0 * found.saturated:.1f} % saturated, from where the arm stands now"
        report.line("picture", "ok", text)
        report.line("markers", "ok", f"not needed from where the arm stands now ({_seen(lit, scene)})")


def _lit(camera: Camera, lights: Lights, rig: RigFile, scene: Scene) -> tuple[Grey, str]:
    """Return a picture with the lamps on; refuse lamps that make no difference."""
    lights.off()
    dark = camera.capture().image
    preflight.check_lights(lights, rig.lights)
    lit = camera.capture().image
    preflight.check_size(lit, scene.camera)
    before, after = (preflight.exposure_of(image).bright for image in (dark, lit))
    brighter = after >= LIT * before + LEAST_LIGHT
    if not brighter and rig.arm is not None:
        return lit, "answer, but the camera does not see the panel from where the arm stands now"
    if not brighter:
        raise RigError(
            f"lights: the picture is as bright without them ({100.0 * before:.0f} %) as with them ({100.0 * after:.0f} %); check the "
            "lamps' supply and data line, darken the room, and see that the camera looks at the panel"
        )
    return lit, f"the picture goes from {100.0 * before:.0f} % to {100.0 * after:.0f} % of full scale"


def _seen(image: Grey, scene: Scene) -> str:
    try:
        return preflight.check_markers(image, scene)
    except RigError as error:
        return str(error).removeprefix("markers: ")


def _leave_table(table: Turntable) -> None:
    """Switch the motor off, unless an angle would be lost."""
    try:
        if not table.knows_zero():
            table.release()
    finally:
        table.close()


def _leave_arm(arm: Arm, part: ArmPart, say: Say) -> None:
    """Switch the torque off where nothing can drop."""
    try:
        joints = arm.read_joints()
        if max(abs(angle - rest) for angle, rest in zip(joints, part.park_deg, strict=True)) <= AT_REST_DEG:
            arm.relax()
        else:
            say("arm: its torque stays on, since it is not at its place of rest; 'rhizotwin rig jog' parks it")
    finally:
        arm.close()
