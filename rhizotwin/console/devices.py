"""State of each device of the rig, from the lines of checks and scans and from the errors of the drivers."""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Literal

NAMES = ("turntable", "lights", "arm", "camera", "picture", "markers", "disk")
"""Devices and other parts that a check reports, in the order in which they are shown."""
_ERROR = re.compile(r"(?P<name>\w+)(: |, | on )")
State = Literal["unknown", "ok", "wrong"]


@dataclass(frozen=True, kw_only=True)
class Device:
    """A device and what is known about it."""

    name: str
    state: State = "unknown"
    text: str = "not checked yet"
    """Reply of the device, or the error with what to do."""
    time: str = ""
    """Local time of the last change."""


class DeviceStates:
    """State of all devices.

    Parameters
    ----------
    on_change : callable
        Called after a change.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self._on_change = on_change
        self._devices = {name: Device(name=name) for name in NAMES}

    def plain(self) -> list[dict[str, str]]:
        """Return the devices as JSON values."""
        return [asdict(device) for device in self._devices.values()]

    def read_check(self, line: str) -> None:
        """Read a line of `rig.bench.check`: name, verdict and text."""
        name, _, rest = line.partition(" ")
        verdict, _, text = rest.strip().partition(" ")
        if name in self._devices and verdict in ("ok", "WRONG"):
            self._set(name, "ok" if verdict == "ok" else "wrong", text.strip())

    def read_report(self, line: str) -> None:
        """Read a line of a scan's preflight: name and text; other lines are ignored."""
        name, _, text = line.partition(" ")
        if name in self._devices and text.strip():
            self._set(name, "ok", text.strip())

    def read_error(self, text: str) -> None:
        """Read an error of a driver, which begins with the device's name."""
        found = _ERROR.match(text)
        if found and found["name"] in self._devices:
            self._set(found["name"], "wrong", text.removeprefix(f"{found['name']}: "))

    def _set(self, name: str, state: State, text: str) -> None:
        self._devices[name] = Device(name=name, state=state, text=text, time=f"{datetime.now().astimezone():%H:%M:%S}")
        self._on_change()
