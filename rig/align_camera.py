"""Alignment of the camera with the canister by the arm (thesis, appendix C.2)."""

from rhizotwin.rig.arm.placement import correct_joints, require_arm
from rhizotwin.rig.errors import RigError, UnsafeError
from rhizotwin.rig.prepared_devices import PreparedDevices
from rhizotwin.rig.scanning.alignment import ALL_JOINTS, MOST_MOVES, misalignment, single_move
from rhizotwin.rig.scanning.arm_stand import tilted_joints
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.frames import Array


def align_camera(devices: PreparedDevices, *, say: Say) -> None:
    """Align the camera with the canister, using the markers.

    Parameters
    ----------
    devices : PreparedDevices
        Devices of a rig with an arm.
    say : Say
        Receives the misalignment before and after.

    Raises
    ------
    UserError
        If the marker strip cannot be read, the path is not clear, or the corrections do not converge.
    """
    rig, part = devices.rig, require_arm(devices.rig)
    here = devices.commanded_deg or devices.arm().read_joints()
    pose, moves = _measure_pose(devices, search=True), 0
    here, left = devices.commanded_deg or here, misalignment(pose)
    say(f"before: {left.text()}")
    while not left.is_aligned and moves < MOST_MOVES:
        path = [correct_joints(rig, here, pose)] if moves < ALL_JOINTS else single_move(part, here, pose)
        devices.move_along(path)
        moves, here, pose = moves + 1, path[-1], _measure_pose(devices)
        left = misalignment(pose)
    say(f"after {moves} moves: {left.text()}")
    if not left.is_aligned:
        raise RigError(
            f"arm: the camera is not aligned after {moves} moves ({left.text()}), because the servos do not reach the commanded "
            "positions; check the servos' supply and end stops, or calibrate the arm"
        )


def _measure_pose(devices: PreparedDevices, *, search: bool = False) -> Array:
    """Take a picture, and return the pose (4, 4) of the camera in the canister frame.

    With ``search``, the camera is tilted until the strip is visible. Tilts that the arm cannot reach are omitted.
    """
    seen, why = devices.read_markers()
    if seen is None and search:
        for goal in tilted_joints(devices.arm().read_joints()):
            try:
                devices.check_clear([goal])
            except UnsafeError:
                continue
            devices.move_along([goal])
            seen, _ = devices.read_markers()
            if seen is not None:
                break
    if seen is None:
        raise RigError(f"markers: {why}")
    return seen.cam_from_canister
