"""Turntable and lights with the electronics of the thesis.

A DRV8825 motor driver and NeoPixels are connected to the pins of a Raspberry Pi. The electronics cannot report the
table angle. The driver computes it from the number of steps that were sent. The angle is known from `declare` until the
motor is switched off. After the start of a program it must be determined from the markers.
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import LEAST_DEG, SHUTTER_S, check_angle, check_levels
from rhizotwin.rig.errors import LostError, RigError
from rhizotwin.rig.rig_file import BandPart, HatPart, LightsPart, TurntablePart
from rhizotwin.rig.table.hat_pins import Pins, Pixels
from rhizotwin.rig.table.ramp import step_times_s

SETUP_S = 1e-3
"""Delay between a change of direction or current and the first step, s. The DRV8825 requires only 650 ns, or 1.7 ms
after its sleep mode."""
WAKE_S = 0.05
"""Delay after the current was switched on, s. During this time the rotor jumps to its position."""
LATE_S = 2.0
"""Time that is added to the computed duration of a move to obtain its timeout, s. The pulses are timed by a thread,
which other programs can delay."""
POLL_S = 0.01


class HatTurntable:
    """Turntable driven by a DRV8825.

    It implements `rig.devices.Turntable`.
    """

    def __init__(self, pins: Pins, hat: HatPart, part: TurntablePart, clock: Clock) -> None:
        self._pins, self._hat, self._part, self._clock = pins, hat, part, clock
        self._step_deg = part.full_step_deg / hat.microsteps
        self._acceleration = part.acceleration_deg_per_s2
        self._steps: int | None = None  # position from angle 0, in microsteps; None if unknown
        self._on = False
        self._seated = False  # whether the last move arrived from the usual side

    def describe(self) -> str:
        """Return a description of the motor driver and the table angle."""
        where = "table angle unknown" if self._steps is None else f"table at {self.position_deg():.3f} deg"
        return f"DRV8825 on GPIO {self._hat.step_pin}, {1.0 / self._step_deg:.3f} microsteps per degree, {where}"

    def prepare(self) -> None:
        """Switch the current of the motor on.

        The rotor may jump, so that the table angle is unknown afterwards.

        Raises
        ------
        RigError
            If the DRV8825 reports a fault.
        """
        self._steps, self._seated = None, False
        self._pins.output(self._hat.step_pin, 0)
        self._pins.output(self._hat.direction_pin, 0)
        self._pins.output(self._hat.enable_pin, 0)
        self._on = True
        self._clock.sleep(WAKE_S)
        self._check_fault()

    def position_deg(self) -> float:
        """Return the table angle computed from the number of steps, deg.

        If the angle is unknown, the result is below the smallest valid angle.
        """
        return 10.0 * LEAST_DEG if self._steps is None else round(self._steps * self._step_deg, 6)

    def declare(self, angle_deg: float) -> None:
        """Declare that the table is at the given angle, without moving it.

        The angle is rounded to the nearest microstep.

        Raises
        ------
        UnsafeError
            If the angle is below -90 deg.
        """
        check_angle(angle_deg)
        if not self._on:
            raise LostError("turntable: the motor is off, so that the angle would be lost; switch it on first")
        self._steps, self._seated = round(angle_deg / self._step_deg), False

    def knows_zero(self) -> bool:
        """Return whether an angle was declared after the motor was switched on."""
        return self._on and self._steps is not None

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of subsequent moves, deg/s2."""
        self._acceleration = deg_per_s2

    def move_to(self, angle_deg: float) -> float:
        """Rotate the table to an angle and return the angle of the nearest microstep, deg.

        The final angle is always approached from below.

        Raises
        ------
        LostError
            If the angle is unknown, or the DRV8825 reports a fault during the move.
        UnsafeError
            If the angle is below -90 deg.
        """
        check_angle(angle_deg)
        if self._steps is None or not self._on:
            raise LostError("turntable: the table's angle is unknown; determine it from the markers, or declare it")
        goal, room = round(angle_deg / self._step_deg), round(self._part.approach_deg / self._step_deg)
        here = self._steps
        if room and goal < (here if self._seated else here + room):
            here = self._run(here, goal - room)
        self._run(here, goal)
        self._seated = True
        return self.position_deg()

    def release(self) -> None:
        """Switch the motor off.

        The table angle is unknown afterwards.
        """
        self._steps, self._seated, self._on = None, False, False
        self._pins.output(self._hat.enable_pin, 1)

    def close(self) -> None:
        """Switch the motor off, and release the pins.

        The level of a released pin may change, and the DRV8825 is on unless its enable pin is high.
        """
        if self._on:
            with suppress(RigError):
                self.release()
        self._pins.close()

    def _run(self, here: int, goal: int) -> int:
        """Send the steps of one move, wait for its end, and return the new position in microsteps.

        If the move is interrupted, the table angle becomes unknown.
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
                        f"turntable: {count} steps were delayed by more than {LATE_S:g} s, because the computer is overloaded; close "
                        "other programs"
                    )
                self._clock.sleep(POLL_S)
        except BaseException:
            self.release()  # remaining pulses must not turn the table
            raise
        self._check_fault()
        self._steps = goal
        return goal

    def _check_fault(self) -> None:
        if self._pins.read(self._hat.fault_pin) == 0:
            self.release()
            raise LostError(
                "turntable: the DRV8825 reports a fault (overheating or overcurrent); check its cooling, current limit and wiring"
            )


class HatLights:
    """Lamps driven by the pins of a Raspberry Pi.

    The class implements `rig.devices.Lights`.
    """

    def __init__(self, pixels: Pixels, pins: Pins, part: LightsPart, clock: Clock, *, bands: Sequence[BandPart] = ()) -> None:
        self._pixels, self._pins, self._part, self._clock = pixels, pins, part, clock
        self._outputs = sorted({band.output for band in bands if band.output is not None})

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        """Set all lamps and wait until their light is steady.

        Parameters
        ----------
        panel, front : float
            Levels from 0 to 1, as fractions of the colours in the rig file.
        band : BandPart or None
            Colours and switched output of a band; None for the colours of ``[lights]``, without a switched output.
        """
        check_levels(panel=panel, front=front)
        self._fill(panel, front, band)
        self._clock.sleep(self._part.settle_s)

    def release_shutter(self, pin: int | None) -> None:
        """Release the shutter of a camera by a pulse on a GPIO pin."""
        if pin is None:
            raise ValueError("pin=None but must be a GPIO pin")
        self._pins.output(pin, 1)
        try:
            self._clock.sleep(SHUTTER_S)
        finally:  # an interrupted scan must not leave the contact closed
            self._pins.output(pin, 0)

    def off(self) -> None:
        """Switch all lamps off."""
        self._fill(0.0, 0.0)

    def _fill(self, panel: float, front: float, band: BandPart | None = None) -> None:
        for output in self._outputs:
            self._pins.output(output, int(band is not None and output == band.output))
        for strip, colour, level in self._part.strips(panel, front, band):
            red, green, blue = (round(level * share) for share in colour)
            self._pixels.fill(strip, (red, green, blue))
