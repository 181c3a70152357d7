"""Device interfaces used by the scan; the drivers implement them.

All methods raise a `rig.errors.RigError` if the device fails after its retries. Callers that open a device must close
it in any case.
"""

from dataclasses import dataclass
from typing import Protocol

from rhizotwin.rig.rig_file import BandPart
from rhizotwin.scenes.picture_codec import Grey

LEAST_DEG, MOST_DEG = -90.0, 720.0
"""Range of table angles: the cables permit no more turns."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One picture with the exposure data reported by the camera."""

    image: Grey
    """(H, W) uint8, or uint16 with the converter's bits left-aligned, linear in light."""
    exposure_s: float | None
    """Exposure time reported for this picture."""
    gain: float | None


class Turntable(Protocol):
    """A turntable. Angles are degrees of the table, not wrapped."""

    def describe(self) -> str:
        """Return a short description: firmware, position."""

    def prepare(self) -> None:
        """Connect: synchronise line numbers, switch the motor on permanently, use absolute angles."""

    def position_deg(self) -> float:
        """Read the angle from the device."""

    def declare(self, angle_deg: float) -> None:
        """Define the present position as this angle (no motion)."""

    def knows_zero(self) -> bool:
        """Whether the device still has a declared angle: False after power-up or a reset."""

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of subsequent moves; initially that of the rig file."""

    def move_to(self, angle_deg: float) -> float:
        """Rotate to an angle, always arriving from the same side; wait until done, and return the measured angle.

        Raises `LostError` if the device was reset during the move.
        """

    def release(self) -> None:
        """Switch the motor off."""

    def close(self) -> None:
        """Close the port."""


class Lights(Protocol):
    """Backlight panel, front light and lamps of bands.

    Levels are fractions 0 to 1 of the maximum in the rig file.
    """

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        """Set all lamps and wait until their light is steady.

        Parameters
        ----------
        panel, front : float
            Levels of the panel and the front light.
        band : BandPart or None
            Colours and switched output of a band; None for those of ``[lights]``, without output.
        """

    def off(self) -> None:
        """Switch all off."""


def check_levels(*, panel: float, front: float) -> None:
    """Raise an error for lamp levels that are not fractions.

    Raises
    ------
    ValueError
        If one is below 0 or above 1.
    """
    for name, level in (("panel", panel), ("front", front)):
        if not 0.0 <= level <= 1.0:
            raise ValueError(f"{name}={level} but expected 0 to 1")


class Arm(Protocol):
    """The arm that holds the camera.

    Joint angles are in degrees, from base to wrist roll; they are zero with all links aligned along the base's axis.
    """

    def describe(self) -> str:
        """Return a short description: voltage, warmest servo."""

    def prepare(self) -> None:
        """Connect, and switch the torque on in the present position without a jump.

        Servos, voltage and temperature are checked first.
        """

    def read_joints(self) -> tuple[float, ...]:
        """Return the five measured joint angles."""

    def holds(self) -> bool:
        """Whether every joint still has its torque on."""

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Move all joints at once at a limited speed, wait, verify, and return the measured angles."""

    def turn_filter(self, angle_deg: float) -> None:
        """Rotate the filter wheel in front of the lens."""

    def health(self) -> None:
        """Raise `UnsafeError` if a servo is too warm or the voltage is out of range."""

    def relax(self) -> None:
        """Switch the torque off."""

    def close(self) -> None:
        """Close the port."""


class Carousel(Protocol):
    """A changer that puts one of several canisters on the turntable. Places are numbered from 1."""

    def describe(self) -> str:
        """Return a short description: firmware, number of places."""

    def prepare(self) -> None:
        """Connect, and find the reference position."""

    def load(self, place: int) -> None:
        """Put the canister of a place on the turntable, and the one that is there back to its own place.

        Return when it is done. Raises `UnsafeError` when it is blocked.
        """

    def unload(self) -> None:
        """Put the canister on the turntable back to its place; do nothing when there is none."""

    def close(self) -> None:
        """Close the port."""


class Camera(Protocol):
    """A camera with all automatic functions switched off."""

    def describe(self) -> str:
        """Return a short description."""

    def prepare(self) -> None:
        """Open the camera with fixed settings, and verify them with a first picture."""

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call; verify its settings."""

    def close(self) -> None:
        """Release the camera."""
