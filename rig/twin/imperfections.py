"""How far the emulated devices are from perfect: one set of numbers a profile."""

from dataclasses import dataclass, replace

Key = tuple[int, ...]
"""Key of a random stream: the seed first."""


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Errors of the devices. Every zero means perfect; quantisation is always there."""

    servo_zero_deg: float = 0.0
    """Each joint's zero is off by up to this much either way, drawn once."""
    servo_scale: float = 0.0
    """Each joint turns this fraction too far or not far enough, at most, drawn once."""
    servo_repeat_deg: float = 0.0
    """Standard deviation of where a servo stops, drawn for each move."""
    servo_backlash_deg: tuple[float, float] = (0.0, 0.0)
    """Play of the gears: a servo stops half of it before or beyond, by the side from which it came; drawn once between
    these."""
    servo_sag_deg: tuple[float, float] = (0.0, 0.0)
    """How far the shoulder gives way under the arm stretched out level; other joints, and other poses, by their torque.
    Drawn once."""
    servo_dead_band_counts: int = 0
    """A command this near to where the servo stands does not move it."""
    table_microstep_deg: float = 0.0
    """Amplitude of the table's error within four full steps: a function of the motor's position."""
    table_play_deg: float = 0.0
    """Play between the motor and the table."""
    table_jump_steps: float = 0.0
    """When the motor is first energised after power-up, the rotor jumps by up to this many full steps."""
    swing_hz: float = 0.0
    """At which the roots would twist to and fro in the water without damping; 0: they hang still whatever the table
    does."""
    swing_damping: float = 1.0
    """Of it, as a fraction of the critical one."""
    lamp_ramp_s: float = 0.0
    """Time a lamp takes from dark to full."""
    lamp_level_error: float = 0.0
    """Relative error of a lamp's brightness, at most, drawn once."""


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
"""A hobby arm of LX servos and a stepper behind a DRV8825; sources of the numbers: docs/twin.md."""

REAL = replace(BENCH, swing_hz=0.86, swing_damping=1.4)
"""A bench with soft roots: one of 0.5 mm across and 100 mm long, of 30 MPa, is a cantilever in water of 0.86 Hz, and
its drag is 1.4 of the critical one (docs/twin.md has the sums)."""


def imperfections_of(profile_name: str) -> Imperfections:
    """Return the device errors that go with a disturbance profile.

    None for ``clean``, roots that swing for ``real``, those of a bench for every other.
    """
    return {"clean": CLEAN, "real": REAL}.get(profile_name, BENCH)
