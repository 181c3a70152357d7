"""State of each device of the rig.

States are parsed from the output of checks and scans, and from error messages of drivers.
"""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Literal

NAMES = ("turntable", "lights", "arm", "camera", "picture", "markers", "disk")
"""Names of the devices and other items that a check reports, in the order of display."""
_ERROR = re.compile(r"(?P<name>\w+)(: |, | on )")
State = Literal["unknown", "ok", "wrong"]


@dataclass(frozen=True, kw_only=True)
class Device:
    """Device of the rig with its last known state."""

    name: str
    state: State = "unknown"
    text: str = "not checked yet"
    """Reply of the device, or the error message with advice if the device failed."""
    time: str = ""
    """Local time of the last change of the state."""


class DeviceStates:
    """Collects the states of all devices.

    Parameters
    ----------
    on_change : callable
        Function that is called after each change.
    """

    def __init__(self, on_change: Callable[[], object]) -> None:
        self._on_change = on_change
        self._devices = {name: Device(name=name) for name in NAMES}

    def plain(self) -> list[dict[str, str]]:
        """Return the states of all devices as JSON values."""
        return [asdict(device) for device in self._devices.values()]

    def read_check(self, line: str) -> None:
        """Parse an output line of `rig.bench.check`. A line consists of name, verdict and text.

        The state of what is not required, and was therefore not found, is unknown.
        """
        name, _, rest = line.partition(" ")
        verdict, _, text = rest.strip().partition(" ")
        if name in self._devices and verdict in ("ok", "WRONG"):
            known: State = "unknown" if text.strip().startswith("not required") else "ok"
            self._set(name, known if verdict == "ok" else "wrong", text.strip())

    def read_report(self, line: str) -> None:
        """Parse an output line of the checks before a scan, which consists of name and text.

        Lines without the name of a device are ignored.
        """
        name, _, text = line.partition(" ")
        if name in self._devices and text.strip():
            self._set(name, "ok", text.strip())

    def read_error(self, text: str) -> None:
        """Parse an error message of a driver. The message begins with the name of the device."""
        found = _ERROR.match(text)
        if found and found["name"] in self._devices:
            self._set(found["name"], "wrong", text.removeprefix(f"{found['name']}: "))

    def _set(self, name: str, state: State, text: str) -> None:
        self._devices[name] = Device(name=name, state=state, text=text, time=f"{datetime.now().astimezone():%H:%M:%S}")
        self._on_change()
