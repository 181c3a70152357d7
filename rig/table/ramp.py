"""Times of the steps of a stepper motor.

The motor accelerates at a constant rate, continues at constant speed, and decelerates at a constant rate.
"""

import numpy as np

from rhizotwin.scenes.frames import Array


def move_s(way: float, *, speed: float, acceleration: float) -> float:
    """Return the duration of a move that begins and ends at rest, s.

    Parameters
    ----------
    way, speed, acceleration : float
        Distance, maximum speed and acceleration of the move, with the same unit of length.

    Returns
    -------
    float
        Duration, s.
    """
    ramp = min(speed**2 / (2.0 * acceleration), way / 2.0)
    top = np.sqrt(2.0 * acceleration * ramp)
    return float(2.0 * top / acceleration + (way - 2.0 * ramp) / max(top, 1e-12))


def step_times_s(steps: int, *, speed: float, acceleration: float) -> Array:
    """Return the times of the steps of a move, s, relative to its beginning.

    Parameters
    ----------
    steps : int
        Number of steps, at least 0.
    speed : float
        Maximum speed, steps per second.
    acceleration : float
        Acceleration at the beginning and deceleration at the end, steps per second squared.

    Returns
    -------
    (steps,) float64 array
        Increasing times in seconds. In a move that is too short to reach the maximum speed, acceleration changes to
        deceleration at half the distance.

    Notes
    -----
    From s = a t^2 / 2, the time of step s in the first ramp is sqrt(2 s / a). The last ramp is its mirror image.
    """
    s = np.arange(1, steps + 1, dtype=np.float64)
    ramp = min(speed**2 / (2.0 * acceleration), steps / 2.0)
    top = np.sqrt(2.0 * acceleration * ramp)
    ramp_s = top / acceleration
    whole_s = move_s(steps, speed=speed, acceleration=acceleration)
    up = np.sqrt(2.0 * np.minimum(s, ramp) / acceleration)
    down = whole_s - np.sqrt(2.0 * np.clip(steps - s, 0.0, ramp) / acceleration)
    level = ramp_s + (s - ramp) / max(top, 1e-12)
    return np.asarray(np.where(s <= ramp, up, np.where(s >= steps - ramp, down, level)))
