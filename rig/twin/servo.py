"""Model of a bus servo.

It includes position control at uniform speed, backlash, gravity, temperature and supply. The model is independent of
protocols. Positions are in counts of the servo (0.24 deg). ``sensed`` is the reading of the potentiometer, and ``true``
the position of the output:

    true - 500 = (sensed - 500) (1 + scale error) + zero error +- half the backlash + error of this move + sag
"""

import math

import numpy as np

from rhizotwin.rig.twin.imperfections import Imperfections, Key

DEG_PER_COUNT = 0.24
MAX_SPEED = 60.0 / 0.22 / DEG_PER_COUNT
"""Maximum speed, counts/s (60 deg in 0.22 s)."""
STOPS = (-60.0, 1060.0)
"""Positions of the mechanical end stops, counts."""
FRICTION = 0.45
"""Minimum torque at which gravity turns an unpowered servo against the friction of its gears. The unit is the torque of
gravity at the shoulder if the arm is stretched horizontally."""
FALL_SPEED = 400.0
"""Speed at which gravity turns an unpowered servo, in counts/s per unit of torque above `FRICTION`."""
SEEN_SAG = 0.5
"""Fraction of the sag that the potentiometer of the servo measures. The remaining sag occurs in the gears between the
potentiometer and the output shaft."""
IDLE_VOLT = 7.58
AMBIENT_CELSIUS = 24.0
WARM_UP_S = 300.0
"""Time constant with which a servo warms up and cools down, s."""
COOL_BELOW = 5.0
"""Cooling below the temperature limit after which an overheated servo switches its torque on again, °C."""
_ZERO, _MOVE = 1, 2


class Supply:
    """Power supply of the emulated arm."""

    def __init__(self, *, key: Key) -> None:
        self._volt = IDLE_VOLT + float(np.random.default_rng(key).uniform(-0.05, 0.05))
        self._low_for_s = 0.0
        self.load_volt = 0.0
        """Voltage drop caused by moving servos, V."""

    @property
    def millivolt(self) -> int:
        """Present voltage of the supply, mV."""
        return round(1000.0 * ((4.2 if self._low_for_s > 0.0 else self._volt) - self.load_volt))

    @property
    def up(self) -> bool:
        """Whether the voltage is sufficient for the processors in the servos."""
        return self._low_for_s <= 0.0

    def brown_out(self, for_s: float) -> None:
        """Let the voltage drop for a given time (s)."""
        self._low_for_s = for_s

    def advance(self, dt_s: float) -> None:
        """Advance the model by a time step (s)."""
        self._low_for_s = max(self._low_for_s - dt_s, 0.0)


class Servo:
    """Emulated bus servo.

    Parameters
    ----------
    start_counts
        Position measured by the potentiometer at power-up, in counts.
    imperfections
        Errors of zero, scale, repeatability, backlash, sag and dead band.
    key
        Key of the servo's random streams. The error of move n depends only on the key and n.
    """

    def __init__(self, *, start_counts: float, imperfections: Imperfections, key: Key) -> None:
        rng = np.random.default_rng([*key, _ZERO])
        wrong = imperfections
        self._zero = float(rng.uniform(-1.0, 1.0)) * wrong.servo_zero_deg / DEG_PER_COUNT
        self._scale = 1.0 + float(rng.uniform(-1.0, 1.0)) * wrong.servo_scale
        self._play = float(rng.uniform(*wrong.servo_backlash_deg)) / DEG_PER_COUNT
        self._give = float(rng.uniform(*wrong.servo_sag_deg)) / DEG_PER_COUNT
        self._warmth = 3.0 + float(rng.uniform(0.0, 6.0))
        self._repeat = wrong.servo_repeat_deg / DEG_PER_COUNT
        self._dead_band = wrong.servo_dead_band_counts
        self._key = key
        self._moves = 0
        self._celsius = AMBIENT_CELSIUS + self._warmth
        self._sensed = start_counts
        self._error = 0.0  # present error of repeatability and backlash
        self._from = (start_counts, 0.0)  # sensed position and error at the start of the move
        self._to = (start_counts, 0.0)
        self._into_s = 0.0
        self._duration_s = 0.0
        self.torque = 0.0
        """Torque that gravity exerts in the direction of increasing counts. The unit is the torque at the shoulder if
        the arm is stretched horizontally."""
        self.stalled = False
        """Whether the servo is blocked."""
        self.power_up()

    def power_up(self) -> None:
        """Reset the state to that after power-up: no torque, no commanded position, and default limits."""
        self.torque_on = False
        self.hot = False
        self.command = (min(max(round(self._sensed), 0), 1000), 0)
        """Last commanded position, in counts, and the duration of its move, in milliseconds."""
        self.waiting: tuple[int, int] | None = None
        self.commanded = False
        self.temperature_limit = 85
        self._into_s = self._duration_s = 0.0

    @property
    def counts(self) -> int:
        """Position that the servo reports, in counts.

        It can be outside the range of 0 to 1000.
        """
        return round(self._sensed + SEEN_SAG * self._sag())

    @property
    def true_counts(self) -> float:
        """True position of the output shaft, in counts."""
        return self.unbent_counts + self._sag()

    @property
    def unbent_counts(self) -> float:
        """Position that the output shaft would have without sag, in counts."""
        return 500.0 + (self._sensed - 500.0) * self._scale + self._zero + self._error

    @property
    def celsius(self) -> int:
        """Temperature of the case, °C."""
        return round(self._celsius)

    @property
    def holds(self) -> bool:
        """Whether the torque is on."""
        return self.torque_on and not self.hot

    @property
    def moving(self) -> bool:
        """Whether a move is in progress."""
        return self._into_s < self._duration_s and self.holds

    @property
    def falls(self) -> bool:
        """Whether gravity turns the unpowered servo."""
        return not self.holds and abs(self.torque) > FRICTION and STOPS[0] < self._sensed < STOPS[1]

    def move(self, counts: int, duration_ms: int) -> None:
        """Move to a position at uniform speed in the given duration.

        If the duration is too short, the servo moves at maximum speed. The torque is switched on.
        """
        self.command = (counts, duration_ms)
        self.commanded = True
        self.torque_on = True
        way = counts - self._sensed
        if abs(way) <= self._dead_band and not self.moving:
            return
        self._moves += 1
        rng = np.random.default_rng([*self._key, _MOVE, self._moves])
        stop = float(np.clip(counts + rng.uniform(-0.5, 0.5) * self._dead_band, *STOPS))
        error = float(rng.normal(0.0, 1.0)) * self._repeat - math.copysign(self._play / 2.0, way)
        self._from, self._to = (self._sensed, self._error), (stop, error)
        self._into_s = 0.0
        self._duration_s = max(duration_ms / 1000.0, abs(way) / MAX_SPEED, 1e-3)

    def load(self, on: bool) -> None:
        """Switch the torque on or off.

        When the torque is switched on, the servo moves to its last commanded position at maximum speed. If there is
        none, it keeps its present position.
        """
        if on and not self.torque_on:
            if self.commanded:
                self.move(self.command[0], 0)
            else:
                self._into_s = self._duration_s = 0.0
        self.torque_on = on

    def turn_by_hand(self, counts: float) -> None:
        """Rotate the unpowered servo to a position, in counts, as if by hand."""
        self._sensed = counts
        self.stop()

    def stop(self) -> None:
        """Stop the move, and keep the present position."""
        self._into_s = self._duration_s = 0.0

    def heat(self, celsius: float) -> None:
        """Set the temperature of the case, °C."""
        self._celsius = celsius
        self._guard()

    def cool_down(self) -> None:
        """Lower the temperature to that of a servo at rest.

        A lower temperature is not changed.
        """
        self.heat(min(self._celsius, AMBIENT_CELSIUS + self._warmth))

    def advance(self, dt_s: float) -> None:
        """Advance the model by a time step (s)."""
        moving = self.moving
        if moving and not self.stalled:
            self._into_s = min(self._into_s + dt_s, self._duration_s)
            part = self._into_s / self._duration_s
            self._sensed, self._error = (a + (b - a) * part for a, b in zip(self._from, self._to, strict=True))
        elif self.falls:
            fall = math.copysign(FALL_SPEED * (abs(self.torque) - FRICTION) * dt_s, self.torque)
            self._sensed = min(max(self._sensed + fall, STOPS[0]), STOPS[1])
        goal = AMBIENT_CELSIUS + self._warmth + (20.0 * self.torque**2 if self.holds else 0.0)
        goal += 100.0 if moving and self.stalled else 10.0 if moving else 0.0
        self._celsius += (goal - self._celsius) * (1.0 - math.exp(-dt_s / WARM_UP_S))
        self._guard()

    def _guard(self) -> None:
        """Switch the torque off if the temperature exceeds its limit.

        After cooling, switch it on again in the present position.
        """
        if self.hot and self._celsius < self.temperature_limit - COOL_BELOW:
            self.hot = False
            self.stop()
        elif self._celsius >= self.temperature_limit:
            self.hot = True

    def _sag(self) -> float:
        return self._give * self.torque if self.holds else 0.0
