"""How what hangs in the water twists when its pot is turned, and comes to rest after a stop."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

STILL_DEG = 1e-4
"""A smaller twist is none: 0.05 um at 30 mm from the axis, and pictures at rest stay the same to the last bit."""


@dataclass(frozen=True)
class _Piece:
    """A time of even speeding up."""

    seconds: float
    speed: float  # deg/s at its beginning
    gain: float  # deg/s2


class Swing:
    """The twist of the lowest tips against the pot.

    The table's motion is taken in by pieces, and worked out when somebody looks.

    Parameters
    ----------
    hz : float
        At which it would swing without damping; 0: it never moves.
    damping : float
        As a fraction of the critical one.

    Notes
    -----
    Roots hang from a pot that turns by ``W(t)``, in water that stays where it is (a turn of a second drags along some
    millimetre at the wall). Inertia, that of the water which goes with them included, and drag act on their motion in
    the room, the roots' stiffness on that against the pot, so that with ``d`` the damping and ``w = 2 pi hz``

        twist'' + W' + 2 d w (twist' + W) + w^2 twist = 0
    """

    def __init__(self, *, hz: float, damping: float) -> None:
        w = 2.0 * math.pi * hz
        # of twist, its rate, the table's rate, the table's acceleration
        self._change = np.array(
            [[0.0, 1.0, 0.0, 0.0], [-(w**2), -2.0 * damping * w, -2.0 * damping * w, -1.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]]
        )
        self._moves = hz > 0.0
        self._state = np.zeros(4)
        self._later: list[_Piece] = []

    def turn(self, seconds: float, speed_deg_per_s: float, gain_deg_per_s2: float) -> None:
        """Let the pot turn for a while, from a speed on.

        Parameters
        ----------
        seconds : float
            How long.
        speed_deg_per_s : float
            At the beginning.
        gain_deg_per_s2 : float
            By which the speed grows.
        """
        if not self._moves or seconds <= 0.0:
            return
        last = self._later[-1] if self._later else None
        if last is not None and last.gain == gain_deg_per_s2 and abs(last.speed + last.gain * last.seconds - speed_deg_per_s) < 1e-9:
            self._later[-1] = replace(last, seconds=last.seconds + seconds)
        else:
            self._later.append(_Piece(seconds, speed_deg_per_s, gain_deg_per_s2))

    @property
    def twist_deg(self) -> float:
        """How far the lowest tips are turned against the pot now."""
        for piece in self._later:
            self._state[1] += self._state[2] - piece.speed  # a jolt: what hangs goes on as it went, in the room
            self._state[2:] = piece.speed, piece.gain
            self._state = expm(self._change * piece.seconds) @ self._state
        self._later = []
        twist = float(self._state[0])
        return twist if abs(twist) > STILL_DEG else 0.0
