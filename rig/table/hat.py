"""Electronics of the thesis as turntable and lamps: a DRV8825 and NeoPixels on the pins of a Raspberry Pi.

The angle cannot be read back; it is the number of steps sent. It is known from `declare` until the motor loses its
current, and unknown when a program starts; then it is determined from the markers.
"""

from collections.abc import Sequence

import numpy as np

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import LEAST_DEG, MOST_DEG, check_levels
from rhizotwin.rig.errors import LostError, RigError, UnsafeError
from rhizotwin.rig.rig_file import BandPart, HatPart, LightsPart, TurntablePart
from rhizotwin.rig.table.hat_pins import Pins, Pixels
from rhizotwin.rig.table.ramp import step_times_s

SETUP_S = 1e-3
"""Time between a change of direction or current and the first step; the DRV8825 requires 650 ns, and 1.7 ms after
sleep."""
WAKE_S = 0.05
"""Waiting time after the current is switched on, because the rotor jumps to its phase."""
LATE_S = 2.0
"""Tolerance of the duration of a move: the pulses are timed by a thread, which a busy computer may delay."""
POLL_S = 0.01


class HatTurntable:
    """A `rig.devices.Turntable`."""

    def __init__(self, pins: Pins, hat: HatPart, part: TurntablePart, clock: Clock) -> None:
        self._pins, self._hat, self._part, self._clock = pins, hat, part, clock
        self._step_deg = part.full_step_deg / hat.microsteps
        self._acceleration = part.acceleration_deg_per_s2
        self._steps: int | None = None  # position of the turntable from angle 0 in microsteps; None: unknown
        self._on = False
        self._seated = False  # whether the last move approached from the common side

    def describe(self) -> str:
        """Describe the driver and the position of the turntable."""
        where = "table angle not known" if self._steps is None else f"table at {self.position_deg():.3f} deg"
        return f"DRV8825 on GPIO {self._hat.step_pin}, {1.0 / self._step_deg:.3f} microsteps a degree, {where}"

    def prepare(self) -> None:
        """Switch the motor's current on; the rotor may jump, so that the angle is not known any more.

        Raises
        ------
        RigError
            When the driver reports a fault.
        """
        self._steps, self._seated = None, False
        self._pins.output(self._hat.step_pin, 0)
        self._pins.output(self._hat.direction_pin, 0)
        self._pins.output(self._hat.enable_pin, 0)
        self._on = True
        self._clock.sleep(WAKE_S)
        self._check_fault()

    def position_deg(self) -> float:
        """Return the angle from the number of steps sent; below any valid angle if unknown."""
        return 10.0 * LEAST_DEG if self._steps is None else round(self._steps * self._step_deg, 6)

    def declare(self, angle_deg: float) -> None:
        """Set the current angle of the turntable, to the nearest microstep.

        Raises
        ------
        UnsafeError
            If the angle is outside -90 to 720.
        """
        _check_angle(angle_deg)
        if not self._on:
            raise LostError("turntable: the motor is off, so that the angle cannot be kept; connect it first")
        self._steps, self._seated = round(angle_deg / self._step_deg), False

    def knows_zero(self) -> bool:
        """Whether an angle was set since the motor was switched on."""
        return self._on and self._steps is not None

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of the following moves."""
        self._acceleration = deg_per_s2

    def move_to(self, angle_deg: float) -> float:
        """Turn by an even ramp, always arriving from below; return the angle of the nearest microstep.

        Raises
        ------
        LostError
            When the angle is not known, or the driver reports a fault during the move.
        UnsafeError
            For an angle outside -90 to 720.
        """
        _check_angle(angle_deg)
        if self._steps is None or not self._on:
            raise LostError("turntable: the angle is unknown; determine it from the markers, or set it")
        goal, room = round(angle_deg / self._step_deg), round(self._part.approach_deg / self._step_deg)
        here = self._steps
        if room and goal < (here if self._seated else here + room):
            here = self._run(here, goal - room)
        self._run(here, goal)
        self._seated = True
        return self.position_deg()

    def release(self) -> None:
        """Switch the motor off; the angle is lost."""
        self._steps, self._seated, self._on = None, False, False
        self._pins.output(self._hat.enable_pin, 1)

    def close(self) -> None:
        """Release the pins: the motor loses its current."""
        self._steps, self._on = None, False
        self._pins.close()

    def _run(self, here: int, goal: int) -> int:
        """Send the steps of one move and wait for their end.

        After an interruption the angle is unknown.
        """
        count = abs(goal - here)
        if not count:
            return goal
        self._check_fault()
        forward = (goal > here) != self._hat.reverse
        self._pins.output(self._hat.direction_pin, int(forward))
        self._clock.sleep(SETUP_S)
        speed, acceleration = (x / self._step_deg for x in (self._part.speed_deg_per_s, self._acceleration))
        due_s = step_times_s(count, speed=speed, acceleration=acceleration)
        self._steps = None
        until_s = self._clock.now_s() + float(due_s[-1]) + LATE_S
        try:
            self._pins.steps(self._hat.step_pin, np.diff(due_s, prepend=0.0).tolist())
            while self._pins.busy(self._hat.step_pin):
                if self._clock.now_s() > until_s:
                    raise LostError(
                        f"turntable: {count} steps were not sent within {LATE_S:g} s of "
                        "their scheduled time; the computer may be overloaded"
                    )
                self._clock.sleep(POLL_S)
        except BaseException:
            self.release()  # pending pulses must not move the turntable
            raise
        self._check_fault()
        self._steps = goal
        return goal

    def _check_fault(self) -> None:
        if self._pins.read(self._hat.fault_pin) == 0:
            self.release()
            raise LostError("turntable: the DRV8825 reports a fault (too hot, or too much current); check its cooling, current and wires")


class HatLights:
    """A `rig.devices.Lights`."""

    def __init__(self, pixels: Pixels, pins: Pins, part: LightsPart, clock: Clock, *, bands: Sequence[BandPart] = ()) -> None:
        self._pixels, self._pins, self._part, self._clock = pixels, pins, part, clock
        self._outputs = sorted({band.output for band in bands if band.output is not None})

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        """Set all lamps and wait until they are stable.

        Parameters
        ----------
        panel, front : float
            0 to 1, as fractions of the colours in the rig file.
        band : BandPart or None
            Colours and output of a band; None: those of ``[lights]``, and no output.
        """
        check_levels(panel=panel, front=front)
        self._fill(panel, front, band)
        self._clock.sleep(self._part.settle_s)

    def off(self) -> None:
        """Switch all lamps off."""
        self._fill(0.0, 0.0)

    def _fill(self, panel: float, front: float, band: BandPart | None = None) -> None:
        part, band = self._part, band or BandPart()
        for output in self._outputs:
            self._pins.output(output, int(output == band.output))
        for strip, level, colour in (
            (part.panel_strip, panel, band.panel_rgb or part.panel_rgb),
            (part.front_strip, front, band.front_rgb or part.front_rgb),
        ):
            red, green, blue = (round(level * share) for share in colour)
            try:
                self._pixels.fill(strip, (red, green, blue))
            except OSError as error:
                raise RigError(f"lights: the NeoPixels cannot be set ({error}); check their pins and supply") from None


def _check_angle(angle_deg: float) -> None:
    if not LEAST_DEG <= angle_deg <= MOST_DEG:
        raise UnsafeError(
            f"turntable: {angle_deg:g} deg is outside {LEAST_DEG:g} to {MOST_DEG:g} deg; choose an angle that many turns nearer"
        )
