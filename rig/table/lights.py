"""Lamps of a Marlin board, which are two NeoPixel strips and lamps on its fan outputs."""

from collections.abc import Sequence
from contextlib import suppress

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import SHUTTER_S, check_levels
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.rig_file import BandPart, LightsPart
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.marlin_lines import POSITION

_FULL = 255


class MarlinLights:
    """Lamps driven by a Marlin board.

    The class implements `rig.devices.Lights`. The link to the board is shared with the turntable.
    """

    def __init__(self, link: MarlinLink, part: LightsPart, clock: Clock, *, bands: Sequence[BandPart] = ()) -> None:
        self._link = link
        self._part = part
        self._clock = clock
        self._outputs = sorted({band.output for band in bands if band.output is not None})

    def set(self, *, panel: float, front: float, band: BandPart | None = None) -> None:
        """Set the levels of the lamps, and wait until their light is steady.

        Parameters
        ----------
        panel, front : float
            Levels from 0 to 1, as fractions of the colours in the rig file.
        band : BandPart or None
            Colours and switched output of a band; None for the colours of ``[lights]``, without a switched output.
        """
        check_levels(panel=panel, front=front)
        if not self._link.ready:
            self._link.start()
        self._show(panel, front, band)
        self._clock.sleep(self._part.settle_s)

    def off(self) -> None:
        """Switch all lamps off, whatever the state of the board.

        A lost connection is restored.

        Raises
        ------
        NoAnswerError
            If the board does not confirm that the lamps are off. The command was sent nevertheless.
        LostError
            If the board is no longer connected.
        """
        try:
            self._switch_off()
        except NoAnswerError:
            strips = (f"M150 S{strip} R0 U0 B0 P0" for strip in (self._part.panel_strip, self._part.front_strip))
            self._link.send_unheard(*strips, *(f"M107 P{output}" for output in self._outputs))
            raise

    def release_shutter(self, pin: int | None) -> None:
        """Release the shutter of a camera, by M42 at a pin, or by M240.

        Raises
        ------
        RigError
            If the firmware has no M240 (PHOTO_GCODE), or the connection is lost.
        """
        pulse = (f"M42 P{pin} S{_FULL}", f"G4 P{round(1000.0 * SHUTTER_S)}", f"M42 P{pin} S0")
        try:
            for command in ("M240",) if pin is None else pulse:
                self._link.command(command, expect_s=SHUTTER_S)
        except BaseException:
            if pin is not None:  # an interrupted scan must not leave the contact closed
                with suppress(RigError):
                    self._link.send_unheard(pulse[-1])
            raise
        self._link.ask("M114", POSITION)

    def close(self) -> None:
        """Close the port, which the turntable and the lights share."""
        self._link.close()

    def _switch_off(self) -> None:
        if not self._link.ready:
            self._link.start()
        try:
            self._show(0.0, 0.0)
        except LostError:  # the board was reset, and replies after its restart
            self._link.start()
            self._show(0.0, 0.0)

    def _show(self, panel: float, front: float, band: BandPart | None = None) -> None:
        self._link.command("M400")  # M150 does not wait for moves, and its interrupt lock would disturb their steps
        for strip, rgb, level in self._part.strips(panel, front, band):
            red, green, blue = rgb if level > 0.0 else (0, 0, 0)
            self._link.command(f"M150 S{strip} R{red} U{green} B{blue} P{round(_FULL * level)}")
        for output in self._outputs:
            self._link.command(f"M106 P{output} S{_FULL}" if band and output == band.output else f"M107 P{output}")
        self._link.ask("M114", POSITION)  # all previous commands are complete when the board replies to this command
