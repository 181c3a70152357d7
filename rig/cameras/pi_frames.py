"""What libcamera says of the ways to read a sensor, and of a frame; and the picture that comes of a frame."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.cameras.bayer import grey_from_bayer
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.errors import RigError
from rhizotwin.scenes.pictures import Grey

LARGEST_BLOCK = 8
STEP_US = 50.0
"""More than the time of a row, in whose multiples the sensor exposes."""
RELATIVE = 0.02
"""Tolerance of exposure and gains, which have steps."""
_RAW_FORMAT = re.compile(r"S(RGGB|GRBG|GBRG|BGGR)(10|12|14|16)")


@dataclass(frozen=True, kw_only=True)
class RawMode:
    """How the sensor is read for a size of picture."""

    size: tuple[int, int]
    bits: int
    """Of the converter."""
    format: str
    """libcamera's name of the unpacked raw pixels, asked for; the stream may have another."""
    block: int
    """Raw pixels of a side that become one."""


def choose_mode(modes: Sequence[Mapping[str, Any]], image_wh: tuple[int, int], *, name: str) -> RawMode:
    """Choose the finest way of reading the sensor whose pixels make whole blocks of the wanted picture.

    Parameters
    ----------
    modes : sequence of mapping of object
        picamera2's ``sensor_modes``.
    image_wh : tuple of int
        Size of the picture.
    name : str
        The camera's, for messages.

    Returns
    -------
    RawMode
        Size, depth and format of the raw pictures, and how many pixels make one of the wanted.

    Raises
    ------
    RigError
        With the sizes that can be had.
    """
    raw = [mode for mode in modes if "size" in mode and _RAW_FORMAT.fullmatch(str(mode.get("unpacked")))]
    found = [
        RawMode(size=(width, height), bits=int(mode["bit_depth"]), format=str(mode["unpacked"]), block=block)
        for mode in raw
        for width, height in [mode["size"]]
        for block in range(2, LARGEST_BLOCK + 1, 2)
        if (width, height) == (image_wh[0] * block, image_wh[1] * block)
    ]
    if not found:
        sizes = sorted({(mode["size"][0] // 2, mode["size"][1] // 2) for mode in raw}, reverse=True)
        offer = ", ".join(f"{width}x{height}" for width, height in sizes) or "nothing: it has no Bayer colour sensor"
        raise RigError(
            f"{name}: cannot make pictures of {image_wh[0]}x{image_wh[1]}, but of {offer} (a pixel of each 2x2 raw ones); set image_wh of "
            "the scene's camera, and calibrate at that size"
        )
    return max(found, key=lambda mode: (mode.size, mode.bits))


def metadata_faults(metadata: Mapping[str, Any], settings: CameraSettings) -> list[str]:
    """Return what a frame's metadata say against the settings, with numbers; nothing when they hold."""
    exposure_us = 1e6 * settings.exposure_s
    red, blue = settings.colour_gains
    gains = metadata.get("ColourGains") or (None, None)
    wanted = [
        ("ExposureTime", metadata.get("ExposureTime"), exposure_us, max(STEP_US, RELATIVE * exposure_us)),
        ("AnalogueGain", metadata.get("AnalogueGain"), settings.gain, RELATIVE * settings.gain),
        ("ColourGains red", gains[0], red, RELATIVE * red),
        ("ColourGains blue", gains[1], blue, RELATIVE * blue),
        # It makes up for the steps of exposure and gain; anything more is an automatic at work.
        ("DigitalGain", metadata.get("DigitalGain"), 1.0, 2.0 * RELATIVE + STEP_US / exposure_us),
    ]
    return [
        f"{key} is {'missing' if value is None else format(value, 'g')} instead of {target:g}"
        for key, value, target, tolerance in wanted
        if value is None or not abs(value - target) <= tolerance
    ]


def grey_of_frame(
    raw: NDArray[np.uint8], stream: Mapping[str, Any], metadata: Mapping[str, Any], *, mode: RawMode, settings: CameraSettings, name: str
) -> Grey:
    """Make the picture of a frame.

    Parameters
    ----------
    raw : (H, stride) uint8 array
        Bytes of the raw stream.
    stream : mapping of object
        Its ``format`` and ``size``, as configured.
    metadata : mapping of object
        The frame's; ``SensorBlackLevels`` are R, Gr, Gb, B in 16 bits whatever the format.
    mode, settings : RawMode, CameraSettings
        What was asked for.
    name : str
        The camera's, for messages.

    Returns
    -------
    (H, W) uint16 array
        Each pixel the mean of a block, its black level taken away, as many bits as the settings say.

    Raises
    ------
    RigError
        For a format that is not known, or no black level.
    """
    found = _RAW_FORMAT.fullmatch(str(stream["format"]))
    if found is None or tuple(stream["size"]) != mode.size:
        size = "x".join(str(n) for n in stream["size"])
        raise RigError(
            f"{name}: gives raw pixels as {stream['format']} {size}, not {mode.format} {mode.size[0]}x{mode.size[1]}, which alone can be "
            "read; update python3-picamera2 and libcamera"
        )
    levels = metadata.get("SensorBlackLevels")
    if levels is None or len(levels) != 4:
        raise RigError(f"{name}: does not report its black level; update python3-picamera2 and libcamera")
    # Unpacked numbers are aligned to the right in the format's bits: 12 of a Pi 4, 16 of a Pi 5, which puts the
    # converter's own on top.
    below = 2 ** (16 - int(found[2]))
    width, height = mode.size
    return grey_from_bayer(
        np.ascontiguousarray(raw).view(np.uint16)[:height, :width],
        order=found[1],
        black=(levels[0] / below, levels[1] / below, levels[2] / below, levels[3] / below),
        white=((2**mode.bits - 1) << (16 - mode.bits)) / below,
        colour_gains=settings.colour_gains,
        block=mode.block,
        bits=settings.bits,
    )
