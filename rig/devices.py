"""What the scan asks of each device; the drivers and nothing else know how it is done.

Every method raises a `rig.errors.RigError` when the device fails after its retries. Devices are context managers in
spirit: whoever opened one calls ``close`` on every way out.
"""

from dataclasses import dataclass
from typing import Protocol

from rhizotwin.rig.rig_file import BandPart
from rhizotwin.scenes.pictures import Grey

LEAST_DEG, MOST_DEG = -90.0, 720.0
"""Angles to which a turntable can be sent: its wires allow no more turns."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One picture with what the camera says about it."""

    image: Grey
    """(H, W) uint8, or uint16 with the converter's bits left-aligned, linear in light."""
    exposure_s: float | None
    """What the camera reports for this very picture."""
    gain: float | None


class Turntable(Protocol):
    """A table that turns to an angle. Angles are degrees of the table, not wrapped."""

    def describe(self) -> str:
        """Say in a few words what answers: firmware, position."""

    def prepare(self) -> None:
        """Connect: agree on line numbers, energise the motor for good, absolute angles."""

    def position_deg(self) -> float:
        """Read the angle back from the device."""

    def declare(self, angle_deg: float) -> None:
        """Tell the device that it stands at this angle now (no motion)."""

    def knows_zero(self) -> bool:
        """Whether the device still holds an angle that was declared: False after power-up or a reset."""

    def accelerate(self, deg_per_s2: float) -> None:
        """Speed up and slow down so from the next move on; at first as the rig file says."""

    def move_to(self, angle_deg: float) -> float:
        """Turn, always arriving from the same side; wait until done; return the angle read back.

        Raises `LostError` when the device was reset meanwhile.
        """

    def release(self) -> None:
        """Switch the motor off."""

    def close(self) -> None:
        """Close the port."""


class Lights(Protocol):
    """The backlight panel, the front light and lamps of bands.

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
        """Switch all off."""


def check_levels(*, panel: float, front: float) -> None:
    """Refuse levels of lamps that are no fractions.

    Raises
    ------
    ValueError
        Where one is below 0 or above 1.
    """
    for name, level in (("panel", panel), ("front", front)):
        if not 0.0 <= level <= 1.0:
            raise ValueError(f"{name}={level} but expected 0 to 1")


class Arm(Protocol):
    """The arm that holds the camera.

    Joint angles in degrees, base to wrist roll, zero with all links in line along the base's axis.
    """

    def describe(self) -> str:
        """Say what answers: voltage, warmest servo."""

    def prepare(self) -> None:
        """Connect, and switch the torque on where the arm stands, without a jump.

        The servos are found first, and voltage and temperature checked.
        """

    def read_joints(self) -> tuple[float, ...]:
        """Read the five joint angles back."""

    def holds(self) -> bool:
        """Whether every joint still has its torque on."""

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Move all joints at once at a limited speed, wait, verify; return the angles read back."""

    def turn_filter(self, angle_deg: float) -> None:
        """Turn the filter wheel before the lens."""

    def health(self) -> None:
        """Raise `UnsafeError` when a servo is too warm or the voltage is out of its range."""

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
    """A camera with everything automatic switched off."""

    def describe(self) -> str:
        """Say what it is."""

    def prepare(self) -> None:
        """Open it with the fixed settings and prove by a first picture that they hold."""

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call; check that the settings held for it."""

    def close(self) -> None:
        """Give the camera back."""
