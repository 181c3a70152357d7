"""Emulation of python-gphoto2 with one camera, for the twin and for tests of `rig.cameras.gphoto`.

It has the calls, names and values of the library with a Canon EOS, whose raw files are DNG. As the library does, it
accepts a value that the camera does not have, and sets another one.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.twin.raw_file import encode_dng
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.transfer import SRGB

PORT = "usb:001,004"
READOUT_S = 0.4
"""Time from the end of an exposure until the file can be read, s."""
SPEEDS = ("bulb", "1", "0.5", "0.3", "1/4", "1/8", "1/15", "1/30", "1/60", "1/100", "1/125", "1/200", "1/250", "1/500")


@dataclass
class Setting:
    """Setting of the emulated camera."""

    value: str
    choices: tuple[str, ...]
    """Values that the camera offers. A setting without a list of values is a text."""
    readonly: bool = False
    stuck: bool = False
    """Whether the camera keeps its value although setting it succeeds."""


def canon_settings() -> dict[str, Setting]:
    """Return the settings of a camera in its automatic modes."""
    return {
        "autoexposuremode": Setting("Manual", ("P", "TV", "AV", "Manual"), readonly=True),
        "shutterspeed": Setting("1/60", SPEEDS),
        "iso": Setting("Auto", ("Auto", "100", "200", "400", "800")),
        "aperture": Setting("5.6", ("4", "5.6", "8", "11")),
        "focusmode": Setting("Manual", ("One Shot", "AI Focus", "AI Servo", "Manual"), readonly=True),
        "whitebalance": Setting("Auto", ("Auto", "Daylight", "Shadow", "Cloudy")),
        "capturetarget": Setting("Memory card", ("Internal RAM", "Memory card")),
        "imageformat": Setting("Large Fine JPEG", ("Large Fine JPEG", "RAW + Large Fine JPEG", "RAW")),
    }


class EmulatedError(Exception):
    """Error of the emulated library, as ``gphoto2.GPhoto2Error``."""

    def __init__(self, code: int, string: str) -> None:
        super().__init__(f"[{code}] {string}")
        self.code = code
        self.string = string


@dataclass
class EmulatedBody:
    """Camera body with its settings, files and shutter."""

    look: Callable[[float], Grey]
    """Function that returns the picture of an exposure, which is relative to the nominal one."""
    clock: Clock
    nominal_s: float
    """Exposure time at ISO 100 with which ``look`` has its nominal brightness, s."""
    bits: int = 12
    """Bit depth of the pictures of ``look``, which are left-aligned in 16 bits if it is above 8."""
    settings: dict[str, Setting] = field(default_factory=canon_settings)
    connected: bool = True
    dead_shutter: bool = False
    in_use: bool = False
    files: dict[str, bytes] = field(default_factory=dict)
    events: deque[str] = field(default_factory=deque)
    released: int = 0

    def release(self, _pin: int | None = None) -> None:
        """Release the shutter. The file is announced by an event."""
        if self.connected and not self.dead_shutter:
            self.released += 1
            self.events.append("")

    def expose(self) -> str:
        """Take a picture with the present settings, and return the name of its file."""
        exposure_s, iso = _seconds(self.settings["shutterspeed"].value), self.settings["iso"].value
        speed = 800 if iso == "Auto" else int(iso)
        image = self.look(exposure_s * speed / (100.0 * self.nominal_s))
        self.clock.sleep(exposure_s + READOUT_S)
        share = (image >> (8 * image.dtype.itemsize - self.bits)) / (2.0**self.bits - 1.0)
        is_raw = self.settings["imageformat"].value == "RAW"
        name = f"capt{self.released:04d}.{'cr2' if is_raw else 'jpg'}"
        self.files[name] = encode_dng(share, exposure_s=exposure_s) if is_raw else _encode_jpeg(share)
        return name


class EmulatedLibrary:
    """Replacement of the module ``gphoto2``."""

    GPhoto2Error = EmulatedError
    GP_CAPTURE_IMAGE, GP_FILE_TYPE_NORMAL = 0, 1
    GP_WIDGET_TEXT, GP_WIDGET_RADIO = 2, 5
    GP_EVENT_UNKNOWN, GP_EVENT_TIMEOUT, GP_EVENT_FILE_ADDED = 0, 1, 2

    def __init__(self, body: EmulatedBody) -> None:
        self.Camera = type("Camera", (_Camera,), {"body": body})
        self.PortInfoList = _Ports


class _Ports:
    def load(self) -> None:
        pass

    def lookup_path(self, path: str) -> int:
        if path != PORT:
            raise EmulatedError(-5, "Unknown port")
        return 0

    def __getitem__(self, index: int) -> str:
        return PORT


class _Names:
    def __init__(self, pairs: list[tuple[str, str]]) -> None:
        self._pairs = pairs

    def count(self) -> int:
        return len(self._pairs)

    def get_name(self, index: int) -> str:
        return self._pairs[index][0]

    def get_value(self, index: int) -> str:
        return self._pairs[index][1]


class _Widget:
    def __init__(self, name: str, setting: Setting) -> None:
        self._name, self._setting, self._value = name, setting, setting.value

    def get_name(self) -> str:
        return self._name

    def get_value(self) -> str:
        return self._value

    def set_value(self, value: str) -> None:
        self._value = value

    def get_type(self) -> int:
        return EmulatedLibrary.GP_WIDGET_RADIO if self._setting.choices else EmulatedLibrary.GP_WIDGET_TEXT

    def get_choices(self) -> tuple[str, ...]:
        if not self._setting.choices:
            raise EmulatedError(-2, "Bad parameters")
        return self._setting.choices

    def get_readonly(self) -> bool:
        return self._setting.readonly


class _Camera:
    body: EmulatedBody

    @classmethod
    def autodetect(cls) -> _Names:
        return _Names([("Canon EOS 80D", PORT)] if cls.body.connected else [])

    def set_port_info(self, _info: str) -> None:
        pass

    def init(self) -> None:
        if self.body.in_use:
            raise EmulatedError(-53, "Could not claim the USB device")
        self._check()

    def exit(self) -> None:
        pass

    def get_single_config(self, name: str) -> _Widget:
        self._check()
        if name not in self.body.settings:
            raise EmulatedError(-2, "Bad parameters")
        return _Widget(name, self.body.settings[name])

    def set_single_config(self, name: str, widget: _Widget) -> None:
        self._check()
        setting = self.body.settings[name]
        if not setting.stuck:
            setting.value = widget.get_value() if widget.get_value() in setting.choices else setting.choices[0]

    def capture(self, _kind: int) -> Any:
        self._check()
        self.body.release()
        if not self.body.events:
            raise EmulatedError(-1, "Unspecified error")
        self.body.events.popleft()
        return SimpleNamespace(folder="/", name=self.body.expose())

    def wait_for_event(self, wait_ms: int) -> list[Any]:
        self._check()
        if not self.body.events:
            self.body.clock.sleep(wait_ms / 1000.0)
            return [EmulatedLibrary.GP_EVENT_TIMEOUT, None]
        self.body.events.popleft()
        return [EmulatedLibrary.GP_EVENT_FILE_ADDED, SimpleNamespace(folder="/", name=self.body.expose())]

    def file_get(self, _folder: str, name: str, _kind: int) -> Any:
        self._check()
        return SimpleNamespace(get_data_and_size=lambda: self.body.files[name])

    def file_delete(self, _folder: str, name: str) -> None:
        self._check()
        del self.body.files[name]

    def _check(self) -> None:
        if not self.body.connected:
            raise EmulatedError(-52, "Could not find the requested device on the USB port")


def _encode_jpeg(share: NDArray[np.float64]) -> bytes:
    return bytes(cv2.imencode(".jpg", np.rint(255.0 * SRGB.number(share)).astype(np.uint8))[1].tobytes())


def _seconds(value: str) -> float:
    above, _, below = value.partition("/")
    return float(above) / float(below or 1.0)
