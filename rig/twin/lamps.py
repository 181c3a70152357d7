"""Model of a lamp: a strip of LEDs with individual colours and a common brightness.

When the LEDs are changed, the light approaches its new level at a constant rate. The model is independent of protocols.
"""

import numpy as np

from rhizotwin.rig.twin.imperfections import Imperfections, Key

LEDS = 30
Rgb = tuple[int, int, int]


class Lamp:
    """Strip of LEDs whose light changes gradually.

    Parameters
    ----------
    full_rgb
        Colour that corresponds to level 1 at full brightness.
    imperfections
        Ramp and error of the brightness.
    key
        Key of the random stream of the lamp.
    """

    def __init__(self, *, full_rgb: Rgb, imperfections: Imperfections, key: Key) -> None:
        error = float(np.random.default_rng(key).uniform(-1.0, 1.0)) * imperfections.lamp_level_error
        self._sum = max(sum(full_rgb), 1)
        self._full = self._sum / (1.0 + error)
        self._ramp_s = imperfections.lamp_ramp_s
        self._rgb = [(0, 0, 0)] * LEDS
        self._brightness = 255
        self._level = 0.0

    @property
    def level(self) -> float:
        """Present light, as a fraction of the light at full brightness in the colour ``full_rgb``."""
        return self._level

    @property
    def goal(self) -> float:
        """Level that the light approaches, in the same unit as `level`."""
        return sum(sum(rgb) for rgb in self._rgb) / LEDS * self._brightness / 255.0 / self._full

    def share_of(self, rgb: Rgb) -> float | None:
        """Return the ratio of the light of ``full_rgb`` to that of a given colour.

        Multiplied by the ratio, `level` is a fraction of the full light in the given colour. The result is None if the
        lamp is dark or shows a different colour.
        """
        shown = self._brightness > 0 and all(led == rgb for led in self._rgb) and sum(rgb) > 0
        return self._sum / sum(rgb) if shown else None

    def show(self, rgb: Rgb, *, led: int | None = None) -> None:
        """Set the colour of all LEDs, or of a single LED.

        Each component of the colour is from 0 to 255. The number of a missing LED is ignored.
        """
        if led is None:
            self._rgb = [rgb] * LEDS
        elif 0 <= led < LEDS:
            self._rgb[led] = rgb
        self._settle()

    def dim(self, brightness: int) -> None:
        """Set the common brightness of all LEDs, from 0 to 255.

        It remains until it is changed.
        """
        self._brightness = brightness
        self._settle()

    def power_up(self) -> None:
        """Switch all LEDs off, as when their board is switched on."""
        self._rgb = [(0, 0, 0)] * LEDS
        self._brightness = 255
        self._settle()

    def advance(self, dt_s: float) -> None:
        """Advance the light by a time step (s)."""
        if self._level != self.goal:
            step = dt_s / self._ramp_s if self._ramp_s > 0.0 else np.inf
            self._level += float(np.clip(self.goal - self._level, -step, step))

    def _settle(self) -> None:
        if self._ramp_s == 0.0:
            self._level = self.goal
