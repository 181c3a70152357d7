"""The table's angle from the markers. Angle 0: the strip's seam faces the camera."""

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
"""Puts a question to the person at the terminal and returns the answer."""

DISAGREE_DEG = 5.0
"""An angle that a person gives and the markers contradict by more than this is a mistake of one of them."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A picture that was taken at a known table angle."""

    table_deg: float
    cam_from_canister: Array


@dataclass(frozen=True, kw_only=True)
class Angle:
    """A table angle and where it is known from."""

    table_deg: float
    source: str


def facing_angle(seen: Sighting, scene: Scene) -> float:
    """Return the table angle (-180 to 180) that brought the strip before the camera as it is seen.

    0 with the seam toward the camera.
    """
    return wrapped(-scene.turntable.direction * seen.azimuth_deg)


def angle_against(cam_from_canister: Array, references: Sequence[Reference], scene: Scene) -> float:
    """Return the table angle relative to pictures taken at known angles by a camera that stood at the same place.

    With ``cam_from_canister = C Rz(angle) S`` for camera C and canister pose S, both constant, the rotation between two
    pictures is the table's alone: errors of these and the strip cancel. Several references lessen the noise of single
    pictures; their median is taken.

    Parameters
    ----------
    cam_from_canister : (4, 4) array
        Now, by the markers.
    references : sequence of Reference
        Poses at known angles, from the same place.
    scene : Scene
        Which way the table turns.

    Returns
    -------
    float
        deg.
    """
    canister_from_cam = frames.invert(cam_from_canister)
    direction = scene.turntable.direction
    angles = [reference.table_deg - direction * _turn_deg(canister_from_cam @ reference.cam_from_canister) for reference in references]
    return angles[0] + float(np.median([wrapped(angle - angles[0]) for angle in angles]))


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
    """Find the table's present angle: by the markers, otherwise as it was given, otherwise as a person says.

    It is never guessed.

    Parameters
    ----------
    seen : Sighting or None
        What the strip says now; None when it cannot be read.
    references : sequence of Reference
        Earlier pictures by the camera where it stands now, or stood nearly; may be none.
    scene : Scene
        Which way the table turns.
    near_deg : float
        Of all angles that differ by whole turns the one nearest to this is returned, within what the turntable
        takes.
    given_deg : float or None
        What the person said beforehand, for a strip that cannot be read.
    ask : Ask or None
        None when nobody is there.
    why : str
        Why the strip cannot be read, for messages.

    Returns
    -------
    Angle
        The angle, and where it is from.

    Raises
    ------
    RigError
        When nobody and nothing knows the angle, or the markers contradict the one given.
    """
    if seen is not None:
        angle = angle_against(seen.cam_from_canister, references, scene) if references else facing_angle(seen, scene)
        if given_deg is not None and abs(wrapped(angle - given_deg)) > DISAGREE_DEG:
            raise RigError(
                f"turntable: was said to stand at {given_deg:g} deg, but the markers show {angle % 360.0:.1f} deg; leave --table-angle out"
            )
        return Angle(table_deg=turns_near(angle, near_deg), source=f"{seen.markers} markers")
    if given_deg is not None:
        return Angle(table_deg=turns_near(given_deg, near_deg), source="as given")
    if ask is None:
        raise RigError(
            f"turntable: its angle is not known, and {why}; light and focus the strip, or run it on a terminal, "
            "or give --table-angle DEG (0: the strip's seam faces the camera)"
        )
    answer = _asked_deg(ask, why)
    return Angle(table_deg=turns_near(answer, near_deg), source="as the operator said")


def turns_near(angle_deg: float, near_deg: float) -> float:
    """Return, of all angles that differ by whole turns and that the turntable takes, the one nearest to another."""
    turns = [angle_deg % 360.0 + 360.0 * k for k in range(-1, 3)]
    return min((turn for turn in turns if LEAST_DEG <= turn <= MOST_DEG), key=lambda turn: abs(turn - near_deg))


def wrapped(angle_deg: float) -> float:
    """Return an angle between -180 (included) and 180 (not)."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _turn_deg(a_from_b: Array) -> float:
    """Return the part of a rotation that is about z (its twist)."""
    _, _, z, w = Rotation.from_matrix(a_from_b[:3, :3]).as_quat()
    return float(np.rad2deg(2.0 * np.arctan2(z, w)))


def _asked_deg(ask: Ask, why: str) -> float:
    question = f"The table's angle is not known: {why}. Type its angle in degrees (0: the strip's seam faces the camera): "
    while True:
        answer = ask(question).strip()
        try:
            angle = float(answer.removesuffix("deg"))
        except ValueError:
            angle = np.nan
        if abs(angle) <= 720.0:
            return angle
        question = f"{answer!r} is no angle in degrees, type a number such as 0 or 117.5: "
