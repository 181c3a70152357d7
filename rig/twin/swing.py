"""Torsional oscillation of hanging roots.

It is excited by the rotation of their pot and decays after the rotation.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

STILL_DEG = 1e-4
"""Twist that is treated as zero, deg. At 30 mm from the axis it is a displacement of 0.05 um. Thus pictures at rest are
identical to the last bit."""


@dataclass(frozen=True)
class _Piece:
    """Interval of constant acceleration of the pot."""

    seconds: float
    speed: float  # deg/s at its beginning
    gain: float  # deg/s2


class Swing:
    """Model of the twist of the lowest root tips relative to the pot.

    The motion of the table is stored as intervals of constant acceleration. It is integrated when the twist is
    requested.

    Parameters
    ----------
    hz : float
        Undamped frequency, Hz; 0 for no motion.
    damping : float
        Damping as a fraction of critical damping.

    Notes
    -----
    Roots hang from a pot that rotates by ``W(t)`` in static water (a rotation of one second moves only some millimetres
    of water at the wall). Inertia, including the added mass of water, and drag depend on the motion relative to the
    water. The roots' stiffness depends on the motion relative to the pot. With damping ``d`` and ``w = 2 pi hz``

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
        """Rotate the pot with constant acceleration, beginning at a given speed.

        Parameters
        ----------
        seconds : float
            Duration, s.
        speed_deg_per_s : float
            Initial speed, deg/s.
        gain_deg_per_s2 : float
            Acceleration, deg/s2.
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
        """Present twist of the lowest root tips relative to the pot, deg."""
        for piece in self._later:
            self._state[1] += self._state[2] - piece.speed  # a jump of the speed: the roots keep their velocity in space
            self._state[2:] = piece.speed, piece.gain
            self._state = expm(self._change * piece.seconds) @ self._state
        self._later = []
        twist = float(self._state[0])
        return twist if abs(twist) > STILL_DEG else 0.0
