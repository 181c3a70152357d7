"""Errors of the emulated devices, with one set of values per disturbance profile."""

from dataclasses import dataclass, replace

Key = tuple[int, ...]
"""Key of a random stream. The first element is the seed."""


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Errors of the emulated devices. Zero means no error. Quantisation is always present."""

    servo_zero_deg: float = 0.0
    """Maximum zero error of each joint in both directions, deg, drawn once per joint."""
    servo_scale: float = 0.0
    """Maximum relative scale error of each joint's angle, drawn once per joint."""
    servo_repeat_deg: float = 0.0
    """Standard deviation of a servo's final position, deg, drawn for each move."""
    servo_backlash_deg: tuple[float, float] = (0.0, 0.0)
    """Range of the backlash of the gears, deg, drawn once per servo. A servo stops half of its backlash before or
    beyond its target, depending on the direction."""
    servo_sag_deg: tuple[float, float] = (0.0, 0.0)
    """Range of the shoulder's sag with the arm stretched horizontally, deg, drawn once. In other joints and poses the
    sag is proportional to the torque."""
    servo_dead_band_counts: int = 0
    """Maximum distance of a commanded position that does not move the servo, in counts."""
    table_microstep_deg: float = 0.0
    """Amplitude of the table's periodic error within four full steps of the motor, deg."""
    table_play_deg: float = 0.0
    """Backlash between motor and table, deg."""
    table_jump_steps: float = 0.0
    """Maximum jump of the rotor when the motor is first switched on after power-up, in full steps."""
    swing_hz: float = 0.0
    """Undamped frequency of torsional oscillations of the roots in water, Hz; 0 for rigid roots."""
    swing_damping: float = 1.0
    """Damping of the torsional oscillations, as a fraction of critical damping."""
    lamp_ramp_s: float = 0.0
    """Time in which a lamp changes from dark to full brightness, s."""
    lamp_level_error: float = 0.0
    """Maximum relative error of a lamp's brightness, drawn once per lamp."""


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
"""Errors of a hobby arm with LX servos, and of a stepper motor with a DRV8825. The values' sources are listed in
docs/twin.md."""

REAL = replace(BENCH, swing_hz=0.86, swing_damping=1.4)
"""Errors of a bench rig with flexible roots. A root with 0.5 mm diameter, 100 mm length and 30 MPa is a cantilever with
0.86 Hz in water, and its drag is 1.4 of critical damping (calculations in docs/twin.md)."""


def device_errors(profile_name: str) -> Imperfections:
    """Return the device errors of a disturbance profile.

    The profile ``clean`` has no errors, and ``real`` has flexible roots. All other profiles have the errors of a bench
    rig.
    """
    return {"clean": CLEAN, "real": REAL}.get(profile_name, BENCH)
