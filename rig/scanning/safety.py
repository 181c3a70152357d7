"""Safe shutdown of a scan, after any end: lights off, arm parked without torque, table held or released."""

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
    """Leave the rig in a safe state.

    Failures are reported but never raised, so that they do not hide the error that ended the scan.

    Parameters
    ----------
    devices : Devices
        Devices, open or lost.
    scene : Scene
        Scene with the obstacles of the arm.
    say : Say
        Receives failures.
    board, arm : bool
        Whether the board of table and lights, and the arm, were used; unused ones are not changed.
    finished : bool
        Whether to switch the table's motor off; otherwise it remains on, so that the angle is kept until the scan is
        resumed.
    board_lost : bool
        Whether the board was lost, and must be reconnected to switch the lights off.
    arm_failed : bool
        Whether the arm itself failed; then it is not moved, and only its torque is switched off.
    """
    try:
        if board:
            if board_lost:
                _attempt("turntable and lights: not reachable", devices.reconnect_board, say, again=False)
            _attempt("lights: they may still be on, switch them off by hand", lambda: devices.lights.off(), say)
    finally:
        try:
            if arm and devices.arm is not None:
                leave_arm(devices.arm, devices.rig, scene, say=say, move=not arm_failed)
        finally:
            if board and finished:
                _attempt("turntable: its motor may still be on", lambda: devices.table.release(), say)


def leave_arm(arm: Arm, rig: RigFile, scene: Scene, *, say: Say, move: bool = True) -> None:
    """Park the arm if it works and the path is clear, and switch its torque off in any case.

    Parameters
    ----------
    arm, rig, scene : Arm, RigFile, Scene
        The arm, its parking position, and obstacles.
    say : Say
        Receives failures.
    move : bool
        Whether to park it; otherwise only its torque is switched off.
    """
    try:
        parked = move and _attempt("arm: not parked", lambda: park(arm, rig, scene), say, again=False)
        if not parked:
            with suppress(OSError):
                say("arm: its torque is switched off in its present position; hold the camera")
    finally:
        _attempt("arm: its torque may still be on, switch its supply off", arm.relax, say)


def park(arm: Arm, rig: RigFile, scene: Scene) -> None:
    """Move the arm to its parking position along a checked path.

    Parameters
    ----------
    arm, rig, scene : Arm, RigFile, Scene
        The arm, its parking position, and obstacles.

    Raises
    ------
    RigError
        If the arm is too warm, or no clear path is found.
    """
    if rig.arm is None:
        return
    arm.health()
    for joints_deg in plan_path(rig, scene, arm.read_joints(), rig.arm.park_deg):
        arm.move_to(joints_deg)


def _attempt(trouble: str, action: Callable[[], object], say: Say, *, again: bool = True) -> bool:
    """Run an action of the shutdown; report failures instead of raising them, and retry once after Ctrl-C."""
    for last in (not again, True):
        try:
            action()
        except KeyboardInterrupt:
            if last:
                with suppress(OSError):
                    say(f"{trouble} (stopped by Ctrl-C)")
                return False
        except Exception as error:  # noqa: BLE001 - no error may prevent the shutdown of the next device
            with suppress(OSError):
                say(f"{trouble} ({error if isinstance(error, UserError) else repr(error)})")
            return False
        else:
            return True
    return False
