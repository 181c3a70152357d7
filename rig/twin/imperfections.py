"""Errors of the emulated devices.

There is one set of values for each disturbance profile.
"""

from dataclasses import dataclass, replace

Key = tuple[int, ...]
"""Key of a random stream. The first element is the seed."""


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Errors of the emulated devices. Zero means no error. Quantisation is always present."""

    servo_zero_deg: float = 0.0
    """Maximum magnitude of the error of each joint's zero position, deg. One value is drawn for each joint."""
    servo_scale: float = 0.0
    """Maximum magnitude of the relative error of the scale between a joint's angle and its counts. One value is drawn
    for each joint."""
    servo_repeat_deg: float = 0.0
    """Standard deviation of the position at which a servo stops, deg. One value is drawn for each move."""
    servo_backlash_deg: tuple[float, float] = (0.0, 0.0)
    """Minimum and maximum of the backlash of a servo's gears, deg. One value is drawn for each servo. A servo stops
    half of its backlash before or beyond its target, depending on the direction of the move."""
    servo_sag_deg: tuple[float, float] = (0.0, 0.0)
    """Minimum and maximum of the shoulder's sag if the arm is stretched horizontally, deg. One value is drawn. In other
    joints and poses the sag is proportional to the torque."""
    servo_dead_band_counts: int = 0
    """Maximum difference between the commanded and the present position at which the servo does not move, in counts."""
    table_microstep_deg: float = 0.0
    """Amplitude of the periodic error of the table angle, deg. Its period is four full steps of the motor."""
    table_play_deg: float = 0.0
    """Backlash between motor and table, deg."""
    table_jump_steps: float = 0.0
    """Maximum jump of the rotor when the motor is first switched on after power-up, in full steps."""
    swing_hz: float = 0.0
    """Undamped natural frequency of the torsional oscillation of the roots in water, Hz. It is 0 for rigid roots."""
    swing_damping: float = 1.0
    """Damping of the torsional oscillations, as a fraction of critical damping."""
    lamp_ramp_s: float = 0.0
    """Time in which a lamp changes from dark to full brightness, s."""
    lamp_level_error: float = 0.0
    """Maximum magnitude of the relative error of a lamp's brightness. One value is drawn for each lamp."""


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
"""Errors of a hobby arm with LX servos, and of a stepper motor with a DRV8825. The sources of the values are listed in
docs/twin.md."""

REAL = replace(BENCH, swing_hz=0.86, swing_damping=1.4)
"""Errors of a bench rig with flexible roots. The values are those of a root with a diameter of 0.5 mm, a length of 100
mm and an elastic modulus of 30 MPa. As a cantilever in water, it has a natural frequency of 0.86 Hz, and its damping by
drag is 1.4 times the critical damping (calculations in docs/twin.md)."""


def device_errors(profile_name: str) -> Imperfections:
    """Return the device errors of a disturbance profile.

    The profile ``clean`` has no errors, and ``real`` has flexible roots. All other profiles have the errors of a bench
    rig.
    """
    return {"clean": CLEAN, "real": REAL}.get(profile_name, BENCH)
