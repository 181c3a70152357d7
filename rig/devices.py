"""Device interfaces that the scan uses and the drivers implement.

All methods raise a `rig.errors.RigError` if the device fails after its retries. A caller that opens a device must close
it, even after an error.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.rig_file import BandPart
from rhizotwin.scenes.picture_codec import Grey

LEAST_DEG = -90.0
"""Minimum table angle, deg. A Marlin board that was reset reports -360 deg; the distance leaves room for the overshoot
before an approach. There is no maximum, because no cable turns with the table."""

SHUTTER_S = 0.1
"""Time for which a board closes the contact of a camera's shutter input, s. Marlin's own triggers close it for 0.05 s
(CHDK_DELAY in Configuration_adv.h)."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """Picture with the exposure data reported by the camera."""

    image: Grey
    """Picture (H, W), whose values are linear in light. The type is uint8, or uint16 with values left-aligned in 16
    bits."""
    exposure_s: float | None
    """Exposure time reported for this picture, s. It is None if the camera does not report it."""
    gain: float | None


class Turntable(Protocol):
    """Interface of a turntable.

    Angles are rotations of the table in degrees. They are not reduced to one revolution.
    """

    def describe(self) -> str:
        """Return a short description with firmware and position."""

    def prepare(self) -> None:
        """Connect to the device.

        Line numbers are synchronised, the motor is switched on permanently, and absolute angles are selected.
        """

    def position_deg(self) -> float:
        """Read the table angle from the device, deg."""

    def declare(self, angle_deg: float) -> None:
        """Set the table angle of the present position, without moving the table."""

    def knows_zero(self) -> bool:
        """Return whether the device still knows the table angle set by `declare`.

        A reset or a loss of power deletes it.
        """

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of subsequent moves. The initial value is that of the rig file."""

    def move_to(self, angle_deg: float) -> float:
        """Rotate the table to an angle, wait until it has stopped, and return the measured angle.

        The angle is always approached from the same side. A `LostError` is raised if the device was reset during the
        move.
        """

    def release(self) -> None:
        """Switch the motor off. The table can then be rotated by hand."""

    def close(self) -> None:
        """Close the port."""


class Lights(Protocol):
    """Interface of the backlight panel, the front light and the lamps of spectral bands.

    Levels are fractions of the maximum in the rig file, from 0 to 1.
    """

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        """Set the levels of all lamps, and wait until their light is steady.

        Parameters
        ----------
        panel, front : float
            Levels of the panel and the front light.
        band : BandPart or None
            Colours and switched output of a band; None for the colours of ``[lights]``, without a switched output.
        """

    def off(self) -> None:
        """Switch all lamps off."""

    def release_shutter(self, pin: int | None) -> None:
        """Release the shutter of a camera whose shutter input is connected to the board of the lamps.

        Parameters
        ----------
        pin : int or None
            Pin of the board; None for the board's command for cameras.
        """


def check_angle(angle_deg: float) -> None:
    """Raise an error if a table angle is below the minimum.

    Raises
    ------
    UnsafeError
        If the angle is below -90 deg, or not finite.
    """
    if not LEAST_DEG <= angle_deg < math.inf:
        raise UnsafeError(f"turntable: the angle is {angle_deg:g} deg but must be finite and at least {LEAST_DEG:g} deg; add full turns")


def check_levels(*, panel: float, front: float) -> None:
    """Raise an error if a lamp level is not a fraction from 0 to 1.

    Raises
    ------
    ValueError
        If a level is below 0 or above 1.
    """
    for name, level in (("panel", panel), ("front", front)):
        if not 0.0 <= level <= 1.0:
            raise ValueError(f"{name}={level} but must be from 0 to 1")


class Arm(Protocol):
    """Interface of the arm that positions the camera.

    Joint angles are in degrees, in order from the base to the wrist roll. All angles are zero in the position in which
    the links are aligned along the axis of the base.
    """

    def describe(self) -> str:
        """Return a short description with the supply voltage and the highest temperature of a servo."""

    def prepare(self) -> None:
        """Connect, and switch the torque on in the present position without a jump.

        The servos, the supply voltage and the temperatures are checked first.
        """

    def read_joints(self) -> tuple[float, ...]:
        """Return the five measured joint angles, deg."""

    def holds(self) -> bool:
        """Return whether the torque of every joint is still on."""

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Move all joints simultaneously at a limited speed, wait, verify, and return the measured angles (deg)."""

    def turn_filter(self, angle_deg: float) -> None:
        """Rotate the filter wheel in front of the lens."""

    def health(self) -> None:
        """Raise an `UnsafeError` if a servo is too warm or the supply voltage is out of range."""

    def relax(self) -> None:
        """Switch the torque off. An arm that is not supported drops."""

    def close(self) -> None:
        """Close the port."""


class Carousel(Protocol):
    """Interface of a changer that places one of several canisters on the turntable. Places are numbered from 1."""

    def describe(self) -> str:
        """Return a short description with the firmware and the number of places."""

    def prepare(self) -> None:
        """Connect to the changer, and find its reference position."""

    def load(self, place: int) -> None:
        """Return the canister on the turntable to its place, then put the canister of the given place on the turntable.

        The method returns when the exchange is complete. An `UnsafeError` is raised if the changer is blocked.
        """

    def unload(self) -> None:
        """Return the canister on the turntable to its place. Nothing is done if there is none."""

    def close(self) -> None:
        """Close the port."""


class Camera(Protocol):
    """Interface of a camera with all automatic functions switched off."""

    def describe(self) -> str:
        """Return a short description of the camera."""

    def prepare(self) -> None:
        """Open the camera with fixed settings, and verify them with a first picture."""

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call, and verify its settings."""

    def close(self) -> None:
        """Release the camera for other programs."""
