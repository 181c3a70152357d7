"""Torsional oscillation of hanging roots when their pot is turned, and its decay after a stop."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

STILL_DEG = 1e-4
"""Smaller twists are set to zero: 0.05 um at 30 mm from the axis; pictures at rest are then identical to the last bit.
"""


@dataclass(frozen=True)
class _Piece:
    """An interval of constant acceleration."""

    seconds: float
    speed: float  # deg/s at its beginning
    gain: float  # deg/s2


class Swing:
    """Twist of the lowest tips relative to the pot.

    The motion of the table is stored by intervals, and integrated when the twist is requested.

    Parameters
    ----------
    hz : float
        Frequency without damping; 0 for no motion.
    damping : float
        Damping as a fraction of the critical one.

    Notes
    -----
    Roots hang from a pot that turns by ``W(t)``, in static water (a turn of one second moves only some millimetres of
    water at the wall). Inertia, including the added mass of water, and drag depend on the motion relative to the water,
    and the roots' stiffness on that relative to the pot. With ``d`` the damping and ``w = 2 pi hz``

        twist'' + W' + 2 d w (twist' + W) + w^2 twist = 0
    """

    def __init__(self, *, hz: float, damping: float) -> None:
        w = 2.0 * math.pi * hz
        # twist, its rate, the table's rate, the table's acceleration
        self._change = np.array(
            [[0.0, 1.0, 0.0, 0.0], [-(w**2), -2.0 * damping * w, -2.0 * damping * w, -1.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]]
        )
        self._moves = hz > 0.0
        self._state = np.zeros(4)
        self._later: list[_Piece] = []

    def turn(self, seconds: float, speed_deg_per_s: float, gain_deg_per_s2: float) -> None:
        """Turn the pot for a given time, beginning at a given speed.

        Parameters
        ----------
        seconds : float
            Duration.
        speed_deg_per_s : float
            Initial speed.
        gain_deg_per_s2 : float
            Acceleration.
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
        """Present twist of the lowest tips relative to the pot."""
        for piece in self._later:
            self._state[1] += self._state[2] - piece.speed  # a jump of the speed: the roots keep their velocity in space
            self._state[2:] = piece.speed, piece.gain
            self._state = expm(self._change * piece.seconds) @ self._state
        self._later = []
        twist = float(self._state[0])
        return twist if abs(twist) > STILL_DEG else 0.0
