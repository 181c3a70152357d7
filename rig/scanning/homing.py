"""Table angle from the markers. At angle 0, the strip's seam faces the camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from rhizotwin.rig.devices import LEAST_DEG, MOST_DEG
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene

Ask: TypeAlias = Callable[[str], str]
"""Function that asks the user a question and returns the answer."""

DISAGREE_DEG = 5.0
"""Difference between the given angle and that of the markers beyond which one of them must be wrong."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Camera pose measured in a picture at a known table angle."""

    table_deg: float
    cam_from_canister: Array


@dataclass(frozen=True, kw_only=True)
class Angle:
    """A table angle and its source."""

    table_deg: float
    source: str


def facing_angle(seen: Sighting, scene: Scene) -> float:
    """Return the table angle (-180 to 180) at which a camera on the +x side sees the strip as measured.

    It is 0 with the seam toward the camera.
    """
    return wrap_angle(-scene.turntable.direction * seen.azimuth_deg)


def angle_against(cam_from_canister: Array, references: Sequence[Reference], scene: Scene) -> float:
    """Return the table angle relative to pictures at known angles from a camera in the same position.

    With ``cam_from_canister = C Rz(angle) S`` for camera C and canister pose S, both constant, the rotation between two
    pictures is that of the table alone: errors of camera, canister and strip cancel. The median over several references
    reduces the noise of single pictures.

    Parameters
    ----------
    cam_from_canister : (4, 4) array
        Present pose, by the markers.
    references : sequence of Reference
        Poses at known angles, from the same position.
    scene : Scene
        Scene with the direction of the table.

    Returns
    -------
    float
        Angle in deg.
    """
    canister_from_cam = frames.invert(cam_from_canister)
    direction = scene.turntable.direction
    angles = [reference.table_deg - direction * _turn_deg(canister_from_cam @ reference.cam_from_canister) for reference in references]
    return angles[0] + float(np.median([wrap_angle(angle - angles[0]) for angle in angles]))


def find_angle(
    seen: Sighting | None,
    references: Sequence[Reference],
    scene: Scene,
    *,
    near_deg: float,
    given_deg: float | None = None,
    ask: Ask | None = None,
    why: str = "the strip cannot be read",
) -> Angle:
    """Determine the present table angle: from the markers, otherwise as given, otherwise by asking the user.

    It is never assumed.

    Parameters
    ----------
    seen : Sighting or None
        Present measurement of the strip; None if it cannot be read.
    references : sequence of Reference
        Earlier pictures from the present or a nearby camera position; may be empty.
    scene : Scene
        Scene with the direction of the table.
    near_deg : float
        Of all angles that differ by full turns, the one nearest to this is returned, within the turntable's range.
    given_deg : float or None
        Angle given by the user, for a strip that cannot be read.
    ask : Ask or None
        Function that asks the user; None if there is no user.
    why : str
        Reason why the strip cannot be read, used in messages.

    Returns
    -------
    Angle
        Angle with its source.

    Raises
    ------
    RigError
        If the angle cannot be determined, or the markers contradict the given one.
    """
    if seen is not None:
        angle = angle_against(seen.cam_from_canister, references, scene) if references else facing_angle(seen, scene)
        if given_deg is not None and abs(wrap_angle(angle - given_deg)) > DISAGREE_DEG:
            raise RigError(
                f"turntable: was declared to be at {given_deg:g} deg, but the markers show {angle % 360.0:.1f} deg; omit --table-angle"
            )
        return Angle(table_deg=nearest_turn(angle, near_deg), source=f"{seen.markers} markers")
    if given_deg is not None:
        return Angle(table_deg=nearest_turn(given_deg, near_deg), source="as given")
    if ask is None:
        raise RigError(
            f"turntable: its angle is not known, and {why}; light and focus the strip, or run it on a terminal, "
            "or give --table-angle DEG (0: the strip's seam faces the camera)"
        )
    answer = _ask_angle(ask, why)
    return Angle(table_deg=nearest_turn(answer, near_deg), source="given by the operator")


def nearest_turn(angle_deg: float, near_deg: float) -> float:
    """Return the angle nearest to another one, of those that differ by full turns and are in the turntable's range."""
    turns = [angle_deg % 360.0 + 360.0 * k for k in range(-1, 3)]
    return min((turn for turn in turns if LEAST_DEG <= turn <= MOST_DEG), key=lambda turn: abs(turn - near_deg))


def wrap_angle(angle_deg: float) -> float:
    """Return an angle between -180 (included) and 180 (not)."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _turn_deg(a_from_b: Array) -> float:
    """Return the component of a rotation about z (its twist)."""
    _, _, z, w = Rotation.from_matrix(a_from_b[:3, :3]).as_quat()
    return float(np.rad2deg(2.0 * np.arctan2(z, w)))


def _ask_angle(ask: Ask, why: str) -> float:
    question = f"The table's angle is not known: {why}. Type its angle in degrees (0: the strip's seam faces the camera): "
    while True:
        answer = ask(question).strip()
        try:
            angle = float(answer.removesuffix("deg"))
        except ValueError:
            angle = np.nan
        if abs(angle) <= 720.0:
            return angle
        question = f"{answer!r} is not an angle in degrees; type a number such as 0 or 117.5: "
