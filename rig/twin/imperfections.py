"""Errors of the emulated devices for each profile."""

from dataclasses import dataclass, replace

Key = tuple[int, ...]
"""Key of a random stream: the seed first."""


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Errors of the devices. Zero means none; quantisation is always present."""

    servo_zero_deg: float = 0.0
    """Maximum error of each joint's zero in either direction, constant."""
    servo_scale: float = 0.0
    """Maximum relative scale error of each joint, constant."""
    servo_repeat_deg: float = 0.0
    """Standard deviation of the final position of a servo, random for each move."""
    servo_backlash_deg: tuple[float, float] = (0.0, 0.0)
    """Play of the gears: a servo stops half of it before or beyond, by the side from which it came; drawn once between
    these."""
    servo_sag_deg: tuple[float, float] = (0.0, 0.0)
    """How far the shoulder gives way under the arm stretched out level; other joints, and other poses, by their torque.
    Drawn once."""
    servo_dead_band_counts: int = 0
    """A servo does not move for a command this close to its position."""
    table_microstep_deg: float = 0.0
    """Amplitude of the periodic error of the turntable within four full steps."""
    table_play_deg: float = 0.0
    """Backlash between motor and turntable."""
    table_jump_steps: float = 0.0
    """Maximum jump of the rotor in full steps when the motor is first energised."""
    swing_hz: float = 0.0
    """Natural frequency of the torsion of the roots in water; 0: no swinging."""
    swing_damping: float = 1.0
    """Damping of the torsion, relative to critical damping."""
    lamp_ramp_s: float = 0.0
    """Time from dark to full brightness."""
    lamp_level_error: float = 0.0
    """Maximum relative error of the brightness, constant."""


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
    """Return the device errors of a profile.

    There are none for ``clean``; ``real`` adds swinging roots; all others have those of ``bench``.
    """
    return {"clean": CLEAN, "real": REAL}.get(profile_name, BENCH)
