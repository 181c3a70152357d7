"""Determination of the table angle from the markers. At angle 0, the strip's seam faces the camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from rhizotwin.rig.devices import LEAST_DEG
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene

Ask: TypeAlias = Callable[[str], str]
"""Type of a function that asks the user a question and returns the answer."""

DISAGREE_DEG = 5.0
"""Maximum difference between the table angle given by the user and the angle measured with the markers, deg. If the
difference is larger, one of the angles is wrong."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Camera pose measured in a picture with known table angle."""

    table_deg: float
    cam_from_canister: Array


@dataclass(frozen=True, kw_only=True)
class Angle:
    """Table angle and its source."""

    table_deg: float
    source: str


def facing_angle(seen: Sighting, scene: Scene) -> float:
    """Return the table angle at which a camera on the +x side has the measured pose, in degrees from -180 to 180.

    The angle is 0 if the strip's seam faces the camera.
    """
    return wrap_angle(-scene.turntable.direction * seen.azimuth_deg)


def angle_against(cam_from_canister: Array, references: Sequence[Reference], scene: Scene) -> float:
    """Return the table angle by comparing a picture with earlier pictures at known angles.

    All pictures are from a camera in the same position. Since ``cam_from_canister = C Rz(angle) S`` with constant
    camera pose C and canister pose S, the rotation between two pictures is only that of the table, and errors of
    camera, canister and strip cancel out. The median over several references reduces the noise of single pictures.

    Parameters
    ----------
    cam_from_canister : (4, 4) array
        Present pose, measured with the markers.
    references : sequence of Reference
        Poses at known table angles, with the camera in the same position.
    scene : Scene
        Scene with the table's direction of rotation.

    Returns
    -------
    float
        Table angle in deg.
    """
    canister_from_cam = frames.invert(cam_from_canister)
    direction = scene.turntable.direction
    angles = [reference.table_deg - direction * _turn_deg(canister_from_cam @ reference.cam_from_canister) for reference in references]
    return angles[0] + float(np.median([wrap_angle(angle - angles[0]) for angle in angles]))


def angle_from_markers(
    seen: Sighting, references: Sequence[Reference], scene: Scene, *, near_deg: float, given_deg: float | None = None
) -> Angle:
    """Determine the present table angle from the markers.

    Parameters
    ----------
    seen : Sighting
        Present measurement of the strip.
    references : sequence of Reference
        Earlier poses at known angles, with the camera in the present or a nearby position. May be empty.
    scene : Scene
        Scene with the table's direction of rotation.
    near_deg : float
        Expected angle. Full turns are added to the result to bring it nearest to this angle, but not below the minimum
        angle of the turntable.
    given_deg : float or None
        Angle given by the user, with which the measurement is compared.

    Returns
    -------
    Angle
        Table angle and its source.

    Raises
    ------
    RigError
        If the markers contradict the given angle.
    """
    angle = angle_against(seen.cam_from_canister, references, scene) if references else facing_angle(seen, scene)
    if given_deg is not None and abs(wrap_angle(angle - given_deg)) > DISAGREE_DEG:
        raise RigError(f"turntable: --table-angle is {given_deg:g} deg, but the markers show {angle % 360.0:.1f} deg; omit --table-angle")
    return Angle(table_deg=nearest_turn(angle, near_deg), source=f"{seen.markers} markers")


def angle_from_user(
    *, near_deg: float, given_deg: float | None = None, ask: Ask | None = None, why: str = "the strip cannot be read"
) -> Angle:
    """Return the present table angle according to the user, if the strip cannot be read. The angle is never assumed.

    Parameters
    ----------
    near_deg : float
        Expected angle, see `angle_from_markers`.
    given_deg : float or None
        Angle given by the user in advance.
    ask : Ask or None
        Function that asks the user; None if there is no user.
    why : str
        Reason why the strip cannot be read, used in messages.

    Returns
    -------
    Angle
        Table angle and its source.

    Raises
    ------
    RigError
        If no angle is given, and there is no user.
    """
    if given_deg is not None:
        return Angle(table_deg=nearest_turn(given_deg, near_deg), source="as given")
    if ask is None:
        raise RigError(
            f"turntable: the table's angle is unknown ({why}); light and focus the strip, or run the command in a terminal, "
            "or specify --table-angle DEG (0: the strip's seam faces the camera)"
        )
    return Angle(table_deg=nearest_turn(_ask_angle(ask, why), near_deg), source="given by the operator")


def nearest_turn(angle_deg: float, near_deg: float) -> float:
    """Return an angle that differs by full turns from the given angle, and is nearest to a reference angle.

    It is at least the minimum angle of the turntable. Angles are in degrees.
    """
    nearest = near_deg + wrap_angle(angle_deg - near_deg)
    return nearest if nearest >= LEAST_DEG else nearest + 360.0


def wrap_angle(angle_deg: float) -> float:
    """Wrap an angle to the range from -180 (included) to 180 (excluded), deg."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _turn_deg(a_from_b: Array) -> float:
    """Return the angle by which a transform (4, 4) rotates about the z axis, deg.

    Rotations about other axes are neglected (swing-twist decomposition).
    """
    _, _, z, w = Rotation.from_matrix(a_from_b[:3, :3]).as_quat()
    return float(np.rad2deg(2.0 * np.arctan2(z, w)))


def _ask_angle(ask: Ask, why: str) -> float:
    question = f"The table's angle is unknown ({why}). Enter the angle in degrees (0: the strip's seam faces the camera): "
    while True:
        answer = ask(question).strip()
        try:
            angle = float(answer.removesuffix("deg"))
        except ValueError:
            angle = np.nan
        if abs(angle) <= 720.0:
            return angle
        question = f"{answer!r} is not an angle in degrees; enter a number such as 0 or 117.5: "
