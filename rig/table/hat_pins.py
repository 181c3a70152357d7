"""Access to the digital pins and the NeoPixels of a Raspberry Pi.

The packages `lgpio` and `rpi_ws281x` are imported when they are first used.
"""

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any, Protocol

from rhizotwin.rig.errors import NoAnswerError, RigError
from rhizotwin.scenes.errors import pip_install

PIXEL_HZ = 800_000
"""Bit rate of WS2812B pixels, Hz."""
BRIGHTNESS = 255
"""Factor of all colours, from 0 to 255. The default of rpi_ws281x depends on its version; it was 128 in some."""
DMA = (10, 11)
"""Numbers of the DMA channels of the two strips. They are those of the rpi_ws281x example for two strips."""
HIGH_S = 2e-6
"""Duration of a step pulse, s. The DRV8825 requires 1.9 us (data sheet, timing requirements)."""


class Pins(Protocol):
    """Interface of digital pins, addressed by GPIO number."""

    def output(self, pin: int, level: int) -> None:
        """Configure a pin as an output, or change its level."""

    def read(self, pin: int) -> int:
        """Return the level of an input pin.

        The pull-up resistor sets the level to 1 unless the pin is connected to ground.
        """

    def steps(self, pin: int, pauses_s: Sequence[float]) -> None:
        """Begin to send pulses, each followed by its pause, and return immediately.

        The pulses are timed by a thread of the library.
        """

    def busy(self, pin: int) -> bool:
        """Return whether pulses are still being sent."""

    def close(self) -> None:
        """Release all pins."""


class Pixels(Protocol):
    """Interface of two NeoPixel strips."""

    def fill(self, strip: int, rgb: tuple[int, int, int]) -> None:
        """Set all pixels of strip 0 (panel) or strip 1 (front light) to a colour."""


class LgpioPins:
    """Digital pins that are accessed through lgpio.

    The class implements `Pins`.
    """

    def __init__(self) -> None:
        self._library = _load("lgpio", f"sudo apt install python3-lgpio, or {pip_install('lgpio')}")
        self._outputs: set[int] = set()
        self._inputs: set[int] = set()
        try:
            self._chip = self._library.gpiochip_open(0)
        except self._library.error as error:
            raise NoAnswerError(
                f"hat: the pins cannot be opened ({error}); the pins require a Raspberry Pi, and your membership in the group gpio"
            ) from None

    def output(self, pin: int, level: int) -> None:
        """Configure a pin as an output, or change its level."""
        if pin in self._outputs:
            self._call("gpio_write", pin, level)
        else:
            self._call("gpio_claim_output", pin, level)
            self._outputs.add(pin)

    def read(self, pin: int) -> int:
        """Return the level of an input pin with a pull-up resistor."""
        if pin not in self._inputs:
            self._call("gpio_claim_input", pin, self._library.SET_PULL_UP)
            self._inputs.add(pin)
        return int(self._call("gpio_read", pin))

    def steps(self, pin: int, pauses_s: Sequence[float]) -> None:
        """Begin to send pulses as a wave.

        In each pulse the pin is high for a short time, and then low for the rest of the pause.
        """
        pulse, high_us = self._library.pulse, round(1e6 * HIGH_S)
        wave = []
        for pause_s in pauses_s:
            wave += [pulse(1, 1, high_us), pulse(0, 1, max(round(1e6 * pause_s) - high_us, high_us))]
        self._call("tx_wave", pin, wave)

    def busy(self, pin: int) -> bool:
        """Return whether the wave is still being sent."""
        return bool(self._call("tx_busy", pin, self._library.TX_WAVE))

    def close(self) -> None:
        """Release all pins.

        If they are already released, nothing happens.
        """
        with suppress(self._library.error):
            self._library.gpiochip_close(self._chip)

    def _call(self, name: str, *arguments: Any) -> Any:
        try:
            return getattr(self._library, name)(self._chip, *arguments)
        except self._library.error as error:
            raise RigError(f"hat: {name} of GPIO {arguments[0]} failed ({error}); check that no other program uses this pin") from None


class Ws281xPixels:
    """NeoPixel strips that are accessed through rpi_ws281x.

    The class implements `Pixels`.
    """

    def __init__(self, pins: tuple[int, int], counts: tuple[int, int]) -> None:
        library = _load("rpi_ws281x", f"{pip_install('rpi-ws281x')} (not available for a Raspberry Pi 5, which requires a Marlin board)")
        self._colour = library.Color
        self._strips = [
            library.PixelStrip(count, pin, PIXEL_HZ, DMA[strip], brightness=BRIGHTNESS, channel=strip)
            for strip, (pin, count) in enumerate(zip(pins, counts, strict=True))
        ]
        for strip in self._strips:
            try:
                strip.begin()
            except RuntimeError as error:
                raise RigError(
                    f"hat: the NeoPixels cannot be driven ({error}); they require root permissions and dtparam=audio=off"
                ) from None

    def fill(self, strip: int, rgb: tuple[int, int, int]) -> None:
        """Set all pixels of a strip to a colour."""
        one = self._strips[strip]
        for pixel in range(one.numPixels()):
            one.setPixelColor(pixel, self._colour(*rgb))
        try:
            one.show()
        except RuntimeError as error:
            raise RigError(f"lights: the NeoPixels cannot be set ({error}); check their pins and supply") from None


def _load(name: str, install: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise RigError(f"hat: the library {name} is missing; install it with {install}") from None
