"""Errors of the emulated devices: one set of numbers per profile."""

from dataclasses import dataclass, replace

Key = tuple[int, ...]
"""Key of a random stream, beginning with the seed."""


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Errors of the devices. Zero means no error; quantisation is always present."""

    servo_zero_deg: float = 0.0
    """Maximum error of each joint's zero in both directions, drawn once."""
    servo_scale: float = 0.0
    """Maximum relative error of each joint's angle, drawn once."""
    servo_repeat_deg: float = 0.0
    """Standard deviation of a servo's final position, drawn for each move."""
    servo_backlash_deg: tuple[float, float] = (0.0, 0.0)
    """Range of the gears' backlash, drawn once: a servo stops half of it before or beyond its target, depending on the
    direction."""
    servo_sag_deg: tuple[float, float] = (0.0, 0.0)
    """Range of the shoulder's sag with the arm stretched horizontally, drawn once; the sag of other joints and poses is
    proportional to the torque."""
    servo_dead_band_counts: int = 0
    """Maximum distance of a commanded position that does not move the servo."""
    table_microstep_deg: float = 0.0
    """Amplitude of the table's periodic error within four full steps, as a function of the motor's position."""
    table_play_deg: float = 0.0
    """Backlash between motor and table."""
    table_jump_steps: float = 0.0
    """Maximum jump of the rotor, in full steps, when the motor is first switched on after power-up."""
    swing_hz: float = 0.0
    """Frequency of undamped torsional oscillation of the roots in water; 0 for rigid roots."""
    swing_damping: float = 1.0
    """Damping of this oscillation, as a fraction of critical damping."""
    lamp_ramp_s: float = 0.0
    """Time of a lamp from dark to full brightness."""
    lamp_level_error: float = 0.0
    """Maximum relative error of a lamp's brightness, drawn once."""


CLEAN = Imperfections()

BENCH = Imperfections(
    servo_zero_deg=2.0,
    servo_scale=0.01,
    servo_repeat_deg=0.3,
    servo_backlash_deg=(0.5, 1.0),
    servo_sag_deg=(0.5, 2.0),
    servo_dead_band_counts=1,
    table_microstep_deg=0.075,
    table_play_deg=0.1,
    table_jump_steps=2.0,
    lamp_ramp_s=0.1,
    lamp_level_error=0.02,
)
"""A hobby arm with LX servos and a stepper motor with a DRV8825; sources of the numbers: docs/twin.md."""

REAL = replace(BENCH, swing_hz=0.86, swing_damping=1.4)
"""A bench with soft roots: a root of 0.5 mm diameter, 100 mm length and 30 MPa is a cantilever with 0.86 Hz in water,
and its drag is 1.4 of critical damping (calculations in docs/twin.md)."""


def device_errors(profile_name: str) -> Imperfections:
    """Return the device errors of a disturbance profile.

    There are none for ``clean``; ``real`` has flexible roots; all others are those of a bench.
    """
    return {"clean": CLEAN, "real": REAL}.get(profile_name, BENCH)
