"""Model of the turntable.

A stepper motor with a gear is driven in microsteps and executes a queue of moves. The model is independent of
protocols. Angles are in degrees of the table. The motor's step count starts at 0 at power-up, and the corresponding
position of the table is stored in the world.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.twin.imperfections import Imperfections, Key

MICROSTEPS = 32
ACCELERATION_DEG_PER_S2 = 60.0
MAX_SPEED_DEG_PER_S = 360.0
QUEUE = 16
"""Maximum number of moves that wait in the queue while another move is executed."""


@dataclass(frozen=True)
class _Move:
    """Move that begins and ends at rest.

    It consists of constant acceleration, constant speed and constant deceleration.
    """

    start_steps: int
    goal_steps: int
    speed: float  # maximum speed, steps/s
    ramp_s: float
    duration_s: float

    def at(self, t_s: float) -> float:
        """Return the position ``t_s`` after the start of the move, in steps."""
        if t_s >= self.duration_s:
            return float(self.goal_steps)
        way = abs(self.goal_steps - self.start_steps)
        gain = self.speed / self.ramp_s
        if t_s < self.ramp_s:
            done = gain * t_s**2 / 2.0
        elif t_s < self.duration_s - self.ramp_s:
            done = self.speed * (t_s - self.ramp_s / 2.0)
        else:
            done = way - gain * (self.duration_s - t_s) ** 2 / 2.0
        return self.start_steps + math.copysign(done, self.goal_steps - self.start_steps)

    def pieces(self) -> Iterator[tuple[float, float, float, float]]:
        """Yield the three phases of the move.

        Each has a start time, an end time, an initial speed and an acceleration.
        """
        top = math.copysign(self.speed, self.goal_steps - self.start_steps)
        gain, last_s = top / self.ramp_s, self.duration_s - self.ramp_s
        yield 0.0, self.ramp_s, 0.0, gain
        yield self.ramp_s, last_s, top, 0.0
        yield last_s, self.duration_s, top, -gain


class Stepper:
    """Emulated stepper motor with its turntable.

    Parameters
    ----------
    full_step_deg
        Table angle of one full step of the motor, deg.
    imperfections
        Periodic error within the steps, backlash, and jump at power-up.
    key
        Key of the motor's random stream.
    """

    def __init__(self, *, full_step_deg: float, imperfections: Imperfections, key: Key) -> None:
        self.steps_per_deg = MICROSTEPS / full_step_deg
        self._full_step_deg = full_step_deg
        self._wrong = imperfections
        self._key = key
        rng = np.random.default_rng(key)
        self._phase_rad = rng.uniform(0.0, 2.0 * np.pi)
        self._steps = 0.0
        self._moves: deque[_Move] = deque()
        self._into_s = 0.0  # time since the start of the first move
        self._shift_deg = 0.0  # sum of the rotor's jumps
        self._aligned = False  # whether the rotor has found its phase since power-up
        self._output_deg = 0.0
        self._power_ups = 0
        self.acceleration_deg_per_s2 = ACCELERATION_DEG_PER_S2
        self.energised = False
        self._turn_output()

    @property
    def steps(self) -> int:
        """Number of microsteps that were sent since power-up.

        Backward steps are counted as negative.
        """
        return round(self._steps)

    @property
    def goal_steps(self) -> int:
        """Number of microsteps since power-up after all queued moves."""
        return self._moves[-1].goal_steps if self._moves else self.steps

    @property
    def true_deg(self) -> float:
        """True angle of the table relative to its angle at power-up, deg."""
        return self._output_deg

    @property
    def moving(self) -> bool:
        """Whether a move is in progress."""
        return bool(self._moves)

    @property
    def full(self) -> bool:
        """Whether the queue of moves is full."""
        return len(self._moves) > QUEUE

    def remaining_s(self, *, moves: int = 0) -> float:
        """Return the time until at most ``moves`` moves remain in the queue, s."""
        left = list(self._moves)[: max(len(self._moves) - moves, 0)]
        return max(sum(move.duration_s for move in left) - self._into_s, 0.0) if left else 0.0

    def queue(self, goal_deg: float, speed_deg_per_s: float) -> None:
        """Add a move to the queue and switch the motor on.

        The target is a table angle in degrees, relative to that at power-up.
        """
        self.energise()
        start, goal = self.goal_steps, round(goal_deg * self.steps_per_deg)
        if start == goal:
            return
        way = abs(goal - start)
        gain = self.acceleration_deg_per_s2 * self.steps_per_deg
        speed = min(max(speed_deg_per_s, 0.01), MAX_SPEED_DEG_PER_S) * self.steps_per_deg
        speed = min(speed, math.sqrt(gain * way))
        self._moves.append(_Move(start, goal, speed, speed / gain, way / speed + speed / gain))

    def energise(self) -> None:
        """Switch the coils on.

        When they are switched on for the first time after power-up, the rotor jumps to the position that corresponds to
        the driver's currents.
        """
        if self.energised:
            return
        self.energised = True
        if not self._aligned:
            self._aligned = True
            rng = np.random.default_rng([*self._key, self._power_ups])
            self._shift_deg += float(rng.uniform(-1.0, 1.0)) * self._wrong.table_jump_steps * self._full_step_deg
        self._turn_output()

    def release(self) -> None:
        """Switch the coils off. The rotor moves to the nearest full step."""
        self.stop()
        self.energised = False
        self._turn_output()

    def stop(self) -> None:
        """Stop immediately, and clear the queue."""
        self._steps = float(round(self._steps))
        self._moves.clear()
        self._into_s = 0.0
        self._turn_output()

    def power_up(self) -> None:
        """Reset the state to that after power-up.

        The count of steps is 0 and the coils are off, but the table does not move.
        """
        stood_deg = self._output_deg
        self.stop()
        self._steps = 0.0
        self.energised = False
        self._aligned = False
        self.acceleration_deg_per_s2 = ACCELERATION_DEG_PER_S2
        self._power_ups += 1
        self._shift_deg = 0.0
        self._shift_deg = stood_deg - self._motor_deg()
        self._turn_output()

    def advance(self, dt_s: float) -> None:
        """Advance the model by a time step (s)."""
        if not self._moves:
            return
        self._into_s += dt_s
        while self._moves and self._into_s >= self._moves[0].duration_s:
            move = self._moves.popleft()
            self._into_s -= move.duration_s
            self._steps = float(move.goal_steps)
            self._turn_output()
        if self._moves:
            self._steps = self._moves[0].at(self._into_s)
        else:
            self._into_s = 0.0
        self._turn_output()

    def motion(self, dt_s: float) -> Iterator[tuple[float, float, float]]:
        """Yield the motion of the table in the next ``dt_s`` as intervals of constant acceleration.

        Each has a duration (s), an initial speed (deg/s) and an acceleration (deg/s2).
        """
        into_s, left_s = self._into_s, dt_s
        for move in self._moves:
            for begin_s, end_s, speed, gain in move.pieces():
                from_s = max(begin_s, into_s)
                seconds = min(end_s - from_s, left_s)
                if seconds > 0.0:
                    left_s -= seconds
                    yield seconds, (speed + gain * (from_s - begin_s)) / self.steps_per_deg, gain / self.steps_per_deg
            into_s = max(into_s - move.duration_s, 0.0)
        if left_s > 0.0:
            yield left_s, 0.0, 0.0

    def _motor_deg(self) -> float:
        """Return the angle of the rotor, deg.

        Its error is periodic, with the electrical period of four full steps.
        """
        steps = self._steps
        if not self.energised:
            steps = round(steps / MICROSTEPS) * MICROSTEPS
        electrical_rad = 2.0 * math.pi * steps / (4 * MICROSTEPS) + self._phase_rad
        return self._shift_deg + steps / self.steps_per_deg + self._wrong.table_microstep_deg * math.sin(electrical_rad)

    def _turn_output(self) -> None:
        """Update the table angle from the angle of the rotor, taking the backlash into account."""
        motor_deg, half_deg = self._motor_deg(), self._wrong.table_play_deg / 2.0
        self._output_deg = min(max(self._output_deg, motor_deg - half_deg), motor_deg + half_deg)
