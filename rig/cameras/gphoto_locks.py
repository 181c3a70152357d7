"""Settings of system cameras that must not change between pictures, by the names of libgphoto2.

The names of settings and their values differ between manufacturers (camlibs/ptp2/config.c of libgphoto2). Each lock has
a function for the distance of a value from the required one.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rhizotwin.rig.cameras.settings import CameraSettings

UNKNOWN = -2
"""Error code GP_ERROR_BAD_PARAMETERS, which libgphoto2 returns for a setting that the camera does not have."""
LISTS = 5, 6
"""Types of settings that have a list of values, GP_WIDGET_RADIO and GP_WIDGET_MENU."""
F_NUMBER_TOLERANCE = 0.05
"""Relative tolerance of f-numbers, which differ by 12 % in thirds of a stop."""
_NUMBER = re.compile(r"(?:f/|ISO ?)?(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*s?", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Lock:
    """Setting with its required value."""

    name: str
    widgets: tuple[str, ...]
    """Names of the setting in libgphoto2. The first that the camera has is used."""
    wanted: str
    """Required value, for messages."""
    distance: Callable[[str], float]
    """Function that returns the distance of a value from the required one. It is infinite if the value is
    unsuitable."""
    remedy: str
    needed: bool = False
    """Whether a camera without this setting is rejected."""

    def fits(self, value: Any) -> bool:
        """Return whether a value is suitable."""
        return self.distance(str(value)) < math.inf

    def better(self, widget: Any) -> str | None:
        """Return the most suitable value that a setting offers, or None if the present value is as suitable."""
        offered = _offered(widget)
        best = min(offered, key=self.distance, default="")
        return best if offered and self.distance(best) < self.distance(str(widget.get_value())) else None

    def hold(self, widget: Any) -> "Lock":
        """Return the lock with the present value as the required one, if any value was suitable before."""
        if self.wanted or widget is None:
            return self
        kept = str(widget.get_value())
        return replace(self, wanted=kept, distance=lambda value: 0.0 if value == kept else math.inf)

    def fault(self, widget: Any) -> str:
        """Return a description of the difference from the required value. It is empty if there is none."""
        if widget is None:
            return f"the camera does not report {self.name} ({self.remedy})" if self.needed else ""
        value = str(widget.get_value())
        if self.fits(value):
            return ""
        offered = _offered(widget)
        near = f", available: {', '.join(offered[:40])}" if self.needed and offered and not any(map(self.fits, offered)) else ""
        return f"{self.name} is {value} instead of {self.wanted}{near} ({self.remedy})"


def locks_for(settings: CameraSettings, *, tolerance: float) -> tuple[Lock, ...]:
    """Return the settings to lock, in the order in which they must be set.

    Parameters
    ----------
    settings : CameraSettings
        Required settings.
    tolerance : float
        Relative tolerance of exposure time and sensitivity.

    Returns
    -------
    tuple of Lock
        Settings with their required values.
    """
    return (
        *_exposure_locks(settings, tolerance),
        Lock(
            name="the focus mode",
            widgets=("focusmode", "focusmode2"),
            wanted="manual",
            distance=_word(r"manual|mf|manual focus"),
            remedy="switch the lens or the body to MF",
            needed=True,
        ),
        Lock(name="focusing at release", widgets=("autofocus",), wanted="Off", distance=_word("off"), remedy="switch it off"),
        Lock(
            name="the white balance",
            widgets=("whitebalance",),
            wanted="Daylight",
            distance=_preferred(r"daylight|sunny|direct sunlight") if settings.linear else _word(r"daylight|sunny|direct sunlight"),
            remedy="set it to daylight",
            needed=not settings.linear,  # raw files are balanced with colour_gains
        ),
        Lock(name="the memory", widgets=("capturetarget",), wanted="internal", distance=_preferred(r"internal ram|sdram"), remedy=""),
        Lock(
            name="the file format",
            widgets=("imageformat", "imagequality"),
            wanted="raw" if settings.linear else "JPEG",
            distance=_word(r"raw|nef \(raw\)|nef") if settings.linear else _word(r"(?!.*(raw|nef|\+|tiff)).*"),
            remedy="select raw files without JPEG" if settings.linear else "select JPEG files without raw",
        ),
    )


def _exposure_locks(settings: CameraSettings, tolerance: float) -> tuple[Lock, ...]:
    f_number = settings.f_number
    return (
        Lock(
            name="the exposure mode",
            widgets=("expprogram", "autoexposuremode", "autoexposuremodedial", "exposureprogram"),
            wanted="M (manual)",
            distance=_word(r"m|manual"),
            remedy="turn the mode dial to M",
        ),
        Lock(
            name="the exposure time",
            widgets=("shutterspeed2", "shutterspeed"),
            wanted=f"{settings.exposure_s:g} s",
            distance=_number(settings.exposure_s, tolerance),
            remedy="set exposure_s to a time that the camera has",
            needed=True,
        ),
        Lock(name="automatic ISO", widgets=("autoiso", "isoauto"), wanted="Off", distance=_word("off"), remedy="switch it off"),
        Lock(
            name="the ISO",
            widgets=("iso",),
            wanted=f"{100.0 * settings.gain:g}",
            distance=_number(100.0 * settings.gain, tolerance),
            remedy="gain = 1 in the rig file is ISO 100",
            needed=True,
        ),
        Lock(
            name="the aperture",
            widgets=("aperture", "f-number"),
            wanted="" if f_number is None else f"f/{f_number:g}",
            distance=(lambda _: 0.0) if f_number is None else _number(f_number, F_NUMBER_TOLERANCE),
            remedy="set f_number to one that the lens has" if f_number is not None else "do not change it during a scan",
            needed=f_number is not None,
        ),
    )


def read_widget(library: Any, camera: Any, lock: Lock) -> Any:
    """Return the setting of a camera, or None if it has none of the lock's names.

    Parameters
    ----------
    library : module
        Module ``gphoto2``.
    camera : Camera
        Open camera.
    lock : Lock
        Setting to read.

    Returns
    -------
    widget or None
        Setting with its value.
    """
    for name in lock.widgets:
        try:
            return camera.get_single_config(name)
        except library.GPhoto2Error as error:
            if error.code != UNKNOWN:
                raise
    return None


def _offered(widget: Any) -> list[str]:
    """Return the values that a setting offers. Texts and numbers have no list of values."""
    return [str(choice) for choice in widget.get_choices()] if widget.get_type() in LISTS else []


def parse_number(value: str) -> float | None:
    """Return the number in a value such as "1/125", "0.0080s", "f/8" or "100", or None if there is none."""
    found = _NUMBER.fullmatch(value.strip())
    if found is None or (found[2] and not float(found[2])):
        return None
    return float(found[1]) / float(found[2] or 1.0)


def _number(wanted: float, tolerance: float) -> Callable[[str], float]:
    def distance(value: str) -> float:
        number = parse_number(value)
        off = math.inf if number is None else abs(number / wanted - 1.0)
        return off if off <= tolerance else math.inf

    return distance


def _preferred(pattern: str) -> Callable[[str], float]:
    """Return a distance with which every value is suitable, but those that match the pattern are set if possible."""
    word = _word(pattern)
    return lambda value: min(word(value), 1.0)


def _word(pattern: str) -> Callable[[str], float]:
    allowed = re.compile(pattern, re.IGNORECASE)
    return lambda value: 0.0 if allowed.fullmatch(value.strip()) else math.inf
