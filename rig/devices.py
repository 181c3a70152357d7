"""Interfaces of the devices that the scan uses; their implementation is known to the drivers only.

Every method raises a `rig.errors.RigError` if the device fails after all retries. Devices must be closed with ``close``
in any case.
"""

from dataclasses import dataclass
from typing import Protocol

from rhizotwin.rig.rig_file import BandPart
from rhizotwin.scenes.pictures import Grey

LEAST_DEG, MOST_DEG = -90.0, 720.0
"""Range of the turntable in degrees, limited by its cables."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """Picture with the data that the camera reports."""

    image: Grey
    """(H, W) uint8, or uint16 with the bits of the converter left-aligned, linear in light."""
    exposure_s: float | None
    """Exposure time reported by the camera for this picture."""
    gain: float | None


class Turntable(Protocol):
    """Turntable. Angles are in degrees and not wrapped."""

    def describe(self) -> str:
        """Describe the device briefly: firmware, position."""

    def prepare(self) -> None:
        """Connect: synchronise line numbers, energise the motor permanently, use absolute angles."""

    def position_deg(self) -> float:
        """Read the angle from the device."""

    def declare(self, angle_deg: float) -> None:
        """Set the current angle of the device without moving it."""

    def knows_zero(self) -> bool:
        """Whether the device still knows its angle: False after power-up or a reset."""

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of the following moves; initially as in the rig file."""

    def move_to(self, angle_deg: float) -> float:
        """Rotate, always approaching from the same side; wait until done; return the angle read back.

        Raises `LostError` if the device was reset meanwhile.
        """

    def release(self) -> None:
        """Switch the motor off."""

    def close(self) -> None:
        """Close the port."""


class Lights(Protocol):
    """Light panel, front lamp and the lamps of bands.

    Levels are fractions 0 to 1 of what the rig file calls full.
    """

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        """Set all lamps and wait until they burn steadily.

        Parameters
        ----------
        panel, front : float
            Levels of the panel and the front light.
        band : BandPart or None
            Colours and switched output of a band; None: those of ``[lights]``, and no output.
        """

    def off(self) -> None:
        """Switch all lamps off."""


def check_levels(*, panel: float, front: float) -> None:
    """Reject lamp levels outside 0 to 1.

    Raises
    ------
    ValueError
        If a level is below 0 or above 1.
    """
    for name, level in (("panel", panel), ("front", front)):
        if not 0.0 <= level <= 1.0:
            raise ValueError(f"{name}={level} but expected 0 to 1")


class Arm(Protocol):
    """The arm that holds the camera.

    Joint angles in degrees, base to wrist roll, zero with all links in line along the base's axis.
    """

    def describe(self) -> str:
        """Describe the device briefly: voltage, warmest servo."""

    def prepare(self) -> None:
        """Connect, and power the servos at their current positions, without a jump.

        The servos are detected, and voltage and temperature checked first.
        """

    def read_joints(self) -> tuple[float, ...]:
        """Read the five joint angles."""

    def holds(self) -> bool:
        """Whether all joints are powered."""

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Move all joints simultaneously at limited speed, wait, verify; return the angles read back."""

    def turn_filter(self, angle_deg: float) -> None:
        """Turn the filter wheel before the lens."""

    def health(self) -> None:
        """Raise `UnsafeError` if a servo is too warm or the voltage is out of range."""

    def relax(self) -> None:
        """Unpower the servos."""

    def close(self) -> None:
        """Close the port."""


class Camera(Protocol):
    """Camera with all automatic functions disabled."""

    def describe(self) -> str:
        """Describe the camera."""

    def prepare(self) -> None:
        """Open the camera with fixed settings and verify them with a first picture."""

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call; verify its settings."""

    def close(self) -> None:
        """Release the camera."""
