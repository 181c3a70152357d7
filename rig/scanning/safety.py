"""The way out of a scan, whatever ended it: lights off, arm parked and let go, table held or released."""

from collections.abc import Callable
from contextlib import suppress
from typing import TypeAlias

from rhizotwin.rig.arm.clearance import plan_path
from rhizotwin.rig.devices import Arm
from rhizotwin.rig.open import Devices
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

Say: TypeAlias = Callable[[str], None]


def make_safe(
    devices: Devices, scene: Scene, *, say: Say, board: bool, arm: bool, finished: bool, board_lost: bool = False, arm_failed: bool = False
) -> None:
    """Leave the rig safe; what fails on the way is said and never raised, so that it does not hide what ended the scan.

    Parameters
    ----------
    devices : Devices
        Open, or lost on the way.
    scene : Scene
        What the arm must not touch.
    say : Say
        Hears what failed.
    board, arm : bool
        Whether the board of table and lights, and the arm, were used at all; what was not is left alone.
    finished : bool
        The table's motor is switched off; otherwise it stays on, so that the angle survives until the scan is taken
        up.
    board_lost : bool
        The board was lost: it is connected once more to switch the lights off.
    arm_failed : bool
        The arm itself was at fault: it is not moved any more, only let go.
    """
    try:
        if board:
            if board_lost:
                _attempt("turntable and lights: not reached any more", devices.reconnect_board, say, again=False)
            _attempt("lights: they may still be on, switch them off by hand", lambda: devices.lights.off(), say)
    finally:
        try:
            if arm and devices.arm is not None:
                leave_arm(devices.arm, devices.rig, scene, say=say, move=not arm_failed)
        finally:
            if board and finished:
                _attempt("turntable: its motor may still be on", lambda: devices.table.release(), say)


def leave_arm(arm: Arm, rig: RigFile, scene: Scene, *, say: Say, move: bool = True) -> None:
    """Park the arm if it is sound and the way is clear, and switch its torque off in any case.

    Parameters
    ----------
    arm, rig, scene : Arm, RigFile, Scene
        The arm, its place of rest, and what it must not touch.
    say : Say
        Hears what failed.
    move : bool
        False: it is only let go.
    """
    try:
        parked = move and _attempt("arm: not parked", lambda: park(arm, rig, scene), say, again=False)
        if not parked:
            with suppress(OSError):
                say("arm: its torque goes off where it stands; hold the camera")
    finally:
        _attempt("arm: its torque may still be on, switch its supply off", arm.relax, say)


def park(arm: Arm, rig: RigFile, scene: Scene) -> None:
    """Move the arm to its place of rest along a checked path.

    Parameters
    ----------
    arm, rig, scene : Arm, RigFile, Scene
        The arm, its place of rest, and what it must not touch.

    Raises
    ------
    RigError
        When the arm is too warm, or no clear way is found.
    """
    if rig.arm is None:
        return
    arm.health()
    for joints_deg in plan_path(rig, scene, arm.read_joints(), rig.arm.park_deg):
        arm.move_to(joints_deg)


def _attempt(trouble: str, action: Callable[[], object], say: Say, *, again: bool = True) -> bool:
    """Do something on the way out; say what failed instead of raising it. Stopped by Ctrl-C, it is begun once more."""
    for last in (not again, True):
        try:
            action()
        except KeyboardInterrupt:
            if last:
                with suppress(OSError):
                    say(f"{trouble} (stopped by Ctrl-C)")
                return False
        except Exception as error:  # noqa: BLE001 - nothing may keep the next device from being made safe
            with suppress(OSError):
                say(f"{trouble} ({error if isinstance(error, UserError) else repr(error)})")
            return False
        else:
            return True
    return False
