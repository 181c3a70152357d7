"""G and M codes of Marlin, for a board with one axis and two LED strips."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from rhizotwin.rig.twin.adapter import Motor, Strip

IDLE_RELEASE_S = 120.0
FIRST_SPEED_DEG_PER_S = 25.0
VERSION = "2.1.2.5"
ABOUT = (
    f"FIRMWARE_NAME:Marlin {VERSION} (Dec  2 2024 12:00:00) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin PROTOCOL_VERSION:1.0 "
    "MACHINE_TYPE:rhizotwin twin KINEMATICS:Cartesian EXTRUDER_COUNT:1 UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff"
)
CAPABILITIES = ("SERIAL_XON_XOFF:0", "EEPROM:0", "AUTOREPORT_TEMP:1", "EMERGENCY_PARSER:1", "HOST_ACTION_COMMANDS:0", "BUSY_PROTOCOL:1")
STOPPED = "Printer stopped due to errors. Fix the error and use M999 to restart. (Temperature is reset. Set it after restarting)"
_SILENT = frozenset(("G21", "M82", "M83", "M108", "M111", "M154", "M155", "M201", "M203", "M205", "M211", "M220", "M410", "M500", "M501"))
"""Commands that are accepted without effect in the emulation. M108 and M410 were already executed on reception."""

Words = dict[str, float | None]
"""Letters of a command, with the numbers that follow them. The value is None for a letter without a number."""


@dataclass(frozen=True)
class Answer:
    """Output of a command, and the delay of its ``ok``."""

    texts: tuple[str, ...] = ()
    """Lines printed before the ``ok``."""
    wait_s: float = 0.0
    """Delay of the ``ok``, s."""


class MarlinCommands:
    """State of an emulated Marlin board, and implementation of its commands."""

    def __init__(self, motor: Motor, strips: tuple[Strip, Strip], outputs_on: set[int]) -> None:
        self._motor = motor
        self._outputs_on = outputs_on
        self._strips = strips
        self._firmware_steps = motor.steps_per_deg
        self._offset_deg = 0.0  # logical X minus the motor's count
        self._goal_deg = 0.0  # logical X at the end of all moves
        self._speed = FIRST_SPEED_DEG_PER_S
        self._is_relative = False
        self._idle_s = IDLE_RELEASE_S
        self._used_s = math.inf  # time of the motor's last use
        self._colours = [(0, 0, 0), (0, 0, 0)]
        self.stopped = False
        self.shutter: Callable[[int | None], None] = lambda _: None
        """Function that is called with a pin when it is switched on, and with None at M240."""
        self._table: dict[str, Callable[[Words, float], Answer]] = {
            "G0": self._move,
            "G1": self._move,
            "G4": self._dwell,
            "G90": self._absolute,
            "G91": self._relative,
            "G92": self._set_position,
            "M17": self._energise,
            "M18": self._release,
            "M42": self._set_pin,
            "M84": self._release,
            "M92": self._steps,
            "M106": self._switch,
            "M107": self._switch_off,
            "M114": self._position,
            "M115": self._about,
            "M150": self._light,
            "M204": self._accelerate,
            "M240": self._photograph,
            "M400": self._finish,
            "M999": self._restart,
        }

    def power_up(self) -> None:
        """Reset the motor, outputs and strips to the state after power-up."""
        self._motor.power_up()
        self._outputs_on.clear()
        for strip in self._strips:
            strip.power_up()

    def do(self, name: str, words: Words, now_s: float) -> Answer | None:
        """Execute a command.

        The result is None if the command is unknown.

        Parameters
        ----------
        name : str
            Name of the command, such as ``G0``.
        words : Words
            Letters of the command, with their numbers.
        now_s : float
            Time of the twin, s.

        Returns
        -------
        Answer or None
            Printed lines, and the delay of the ``ok``.
        """
        if name in _SILENT:
            return Answer()
        return self._table[name](words, now_s) if name in self._table else None

    def quick_stop(self) -> None:
        """Execute M410: stop the motor in its present position, and discard queued moves."""
        self._motor.stop()
        self._goal_deg = self._motor.steps / self._firmware_steps + self._offset_deg

    def kill(self) -> None:
        """Execute M112: switch the motor off."""
        self._motor.release()

    def next_s(self) -> float:
        """Return the time at which the motor will be switched off because it is idle, s."""
        return self._used_s + self._idle_s

    def poll(self, now_s: float) -> None:
        """Switch the motor off when its idle time has passed."""
        if now_s < self.next_s():
            return
        if self._motor.moving:
            self._used_s = now_s
        else:
            self._motor.release()
            self._used_s = math.inf

    def _move(self, words: Words, now_s: float) -> Answer:
        if self.stopped:
            return Answer((STOPPED,))
        self._used_s = now_s
        if feed := words.get("F"):
            self._speed = feed / 60.0
        if (x := words.get("X")) is not None:
            self._goal_deg = self._goal_deg + x if self._is_relative else x
            scale = self._firmware_steps / self._motor.steps_per_deg
            self._motor.queue((self._goal_deg - self._offset_deg) * scale, self._speed * scale)
        return Answer(wait_s=self._motor.remaining_s(moves=8) if self._motor.full else 0.0)

    def _finish(self, _words: Words, _now_s: float) -> Answer:
        return Answer(wait_s=self._motor.remaining_s())

    def _dwell(self, words: Words, _now_s: float) -> Answer:
        return Answer(wait_s=(words.get("P") or 0.0) / 1000.0 + (words.get("S") or 0.0) + self._motor.remaining_s())

    def _absolute(self, _words: Words, _now_s: float) -> Answer:
        self._is_relative = False
        return Answer()

    def _relative(self, _words: Words, _now_s: float) -> Answer:
        self._is_relative = True
        return Answer()

    def _set_position(self, words: Words, _now_s: float) -> Answer:
        x = words.get("X") if words else 0.0
        if x is not None:
            self._offset_deg += x - self._goal_deg
            self._goal_deg = x
        return Answer()

    def _energise(self, _words: Words, now_s: float) -> Answer:
        self._used_s = now_s
        self._motor.energise()
        return Answer()

    def _release(self, words: Words, now_s: float) -> Answer:
        if (idle_s := words.get("S")) is not None:
            self._idle_s = idle_s or math.inf
            self._used_s = now_s if self._motor.energised else math.inf
        else:
            self._motor.release()
            self._used_s = math.inf
        return Answer()

    def _steps(self, words: Words, _now_s: float) -> Answer:
        if x := words.get("X"):
            self._firmware_steps = x
        return Answer(() if words else (f"echo: M92 X{self._firmware_steps:.2f} Y80.00 Z400.00",))

    def _accelerate(self, words: Words, _now_s: float) -> Answer:
        """Execute M204, where T is the acceleration of moves without extrusion."""
        if travel := words.get("T"):
            self._motor.acceleration_deg_per_s2 = travel * self._firmware_steps / self._motor.steps_per_deg
        return Answer()

    def _position(self, _words: Words, _now_s: float) -> Answer:
        count = self._motor.steps + round(self._offset_deg * self._firmware_steps)
        return Answer((f"X:{self._goal_deg:.2f} Y:0.00 Z:0.00 E:0.00 Count X:{count} Y:0 Z:0",))

    def _about(self, _words: Words, _now_s: float) -> Answer:
        return Answer((ABOUT, *(f"Cap:{capability}" for capability in CAPABILITIES)))

    def _light(self, words: Words, _now_s: float) -> Answer:
        """Execute M150, which sets the colour of LEDs.

        A letter without a number means 255, and an omitted colour means 0 unless K is given.
        """
        values = {letter: 255 if number is None else min(max(int(number), 0), 255) for letter, number in words.items()}
        for i in (0, 1):
            if values.get("S", i) != i:
                continue
            kept = self._colours[i] if "K" in values else (0, 0, 0)
            red, green, blue = (values.get(letter, old) for letter, old in zip("RUB", kept, strict=True))
            if "P" in values:
                self._strips[i].dim(values["P"])
            if "I" in values:
                self._strips[i].show((red, green, blue), led=values["I"])
            else:
                self._colours[i] = (red, green, blue)
                self._strips[i].show((red, green, blue))
        return Answer()

    def _switch(self, words: Words, _now_s: float) -> Answer:
        """Execute M106, which sets the level of the given fan output.

        A missing level means 255.
        """
        level, output = words.get("S", 255.0), int(words.get("P") or 0)
        (self._outputs_on.add if level is None or level > 0.0 else self._outputs_on.discard)(output)
        return Answer()

    def _switch_off(self, words: Words, _now_s: float) -> Answer:
        self._outputs_on.discard(int(words.get("P") or 0))
        return Answer()

    def _set_pin(self, words: Words, _now_s: float) -> Answer:
        if (pin := words.get("P")) is not None and (words.get("S") or 0.0) > 0.0:
            self.shutter(int(pin))
        return Answer()

    def _photograph(self, _words: Words, _now_s: float) -> Answer:
        self.shutter(None)
        return Answer()

    def _restart(self, _words: Words, _now_s: float) -> Answer:
        self.stopped = False
        return Answer()
