"""Shutdown of the rig after a scan, including a scan that failed.

The lights are switched off, and the arm is parked and its torque is switched off. The table's motor remains on unless
the scan is finished.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeAlias

from rhizotwin.rig.arm.clearance import plan_path
from rhizotwin.rig.devices import Arm
from rhizotwin.rig.open import Devices
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

Say: TypeAlias = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class BoardState:
    """State of the board of table and lights at the end of a scan."""

    used: bool
    """Whether the board was used. An unused board is not changed."""
    lost: bool = False
    """Whether the connection was lost, so that it must be restored to switch the lights off."""
    finished: bool = False
    """Whether to switch the table's motor off. Otherwise it remains on, so that the table's angle is not lost until the
    scan is resumed."""


@dataclass(frozen=True, kw_only=True)
class ArmState:
    """State of the arm at the end of a scan."""

    used: bool
    """Whether the arm was used. An unused arm is not changed."""
    failed: bool = False
    """Whether the arm has failed. In this case only its torque is switched off."""


def make_safe(devices: Devices, scene: Scene, board: BoardState, arm: ArmState, *, say: Say) -> None:
    """Switch the lights off, park the arm, and switch the table's motor off if the scan is finished.

    Failures are reported but never raised, so that they do not hide the error that ended the scan.

    Parameters
    ----------
    devices : Devices
        Devices of the rig, which are open or lost.
    scene : Scene
        Scene with the obstacles of the arm.
    board, arm : BoardState, ArmState
        States of the board of table and lights, and of the arm.
    say : Say
        Function that receives messages about failures.
    """
    try:
        if board.used:
            if board.lost:
                _attempt("turntable and lights: the board cannot be reached", devices.reconnect_board, say, again=False)
            _attempt("lights: the lamps may still be on; switch them off by hand", lambda: devices.lights.off(), say)
    finally:
        try:
            if arm.used and devices.arm is not None:
                leave_arm(devices.arm, devices.rig, scene, say=say, move=not arm.failed)
        finally:
            if board.used and board.finished:
                _attempt("turntable: the motor may still be on", lambda: devices.table.release(), say)


def leave_arm(arm: Arm, rig: RigFile, scene: Scene, *, say: Say, move: bool = True) -> None:
    """Park the arm if it works and the path is clear, and switch its torque off in any case.

    Parameters
    ----------
    arm, rig, scene : Arm, RigFile, Scene
        Arm, rig file with its parking position, and scene with obstacles.
    say : Say
        Function that receives messages about failures.
    move : bool
        Whether to park the arm. Otherwise only its torque is switched off.
    """
    try:
        parked = move and _attempt("arm: parking failed", lambda: park(arm, rig, scene), say, again=False)
        if not parked:
            with suppress(OSError):
                say("arm: the torque is switched off in the present position; hold the camera")
    finally:
        _attempt("arm: the torque may still be on; switch the arm's supply off", arm.relax, say)


def park(arm: Arm, rig: RigFile, scene: Scene) -> None:
    """Move the arm to its parking position along a path that was checked for collisions.

    Parameters
    ----------
    arm, rig, scene : Arm, RigFile, Scene
        Arm, rig file with its parking position, and scene with obstacles.

    Raises
    ------
    RigError
        If the arm is too warm, or there is no path without collisions.
    """
    if rig.arm is None:
        return
    arm.health()
    for joints_deg in plan_path(rig, scene, arm.read_joints(), rig.arm.park_deg):
        arm.move_to(joints_deg)


def _attempt(trouble: str, action: Callable[[], object], say: Say, *, again: bool = True) -> bool:
    """Run an action of the shutdown, report failures instead of raising them, and retry once after Ctrl-C.

    Return whether it succeeded.
    """
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
