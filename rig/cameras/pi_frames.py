"""Sensor modes, frame metadata, and conversion of frames to pictures, for libcamera."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.cameras.bayer import grey_from_bayer
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.errors import RigError
from rhizotwin.scenes.picture_codec import Grey

LARGEST_BLOCK = 8
STEP_US = 50.0
"""Tolerance of the exposure time, us. The sensor rounds the exposure time to multiples of the readout time of one row,
which is shorter than the tolerance."""
RELATIVE = 0.02
"""Relative tolerance of the exposure time and the gains. The sensor rounds them to discrete values."""
_RAW_FORMAT = re.compile(r"S(RGGB|GRBG|GBRG|BGGR)(10|12|14|16)")


@dataclass(frozen=True, kw_only=True)
class RawMode:
    """Readout mode of the sensor for a picture size."""

    size: tuple[int, int]
    bits: int
    """Bit depth of the analogue-to-digital converter."""
    format: str
    """Name of the requested raw format (unpacked) in libcamera. The format of the stream may differ."""
    block: int
    """Side length, in raw pixels, of a block that becomes one pixel of the picture."""


def choose_mode(modes: Sequence[Mapping[str, Any]], image_wh: tuple[int, int], *, name: str) -> RawMode:
    """Choose the sensor mode with the highest resolution that is a multiple of the required picture size.

    Parameters
    ----------
    modes : sequence of mapping of object
        Attribute ``sensor_modes`` of picamera2.
    image_wh : tuple of int
        Width and height of the picture in pixels.
    name : str
        Name of the camera, used in messages.

    Returns
    -------
    RawMode
        Size, bit depth and format of the raw pictures, and the block size.

    Raises
    ------
    RigError
        If no mode fits the picture size; the message lists the available sizes.
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
        offer = ", ".join(f"{width}x{height}" for width, height in sizes) or "none, because the camera has no Bayer colour sensor"
        raise RigError(
            f"{name}: cannot take pictures of {image_wh[0]}x{image_wh[1]} pixels; available sizes: {offer} (2x2 raw pixels per pixel). "
            "Set image_wh of the scene's camera to one of them, and calibrate the camera at that size"
        )
    return max(found, key=lambda mode: (mode.size, mode.bits))


def metadata_faults(metadata: Mapping[str, Any], settings: CameraSettings) -> list[str]:
    """Return a description of each difference between the metadata of a frame and the settings.

    The list is empty if they agree.
    """
    exposure_us = 1e6 * settings.exposure_s
    red, blue = settings.colour_gains
    gains = metadata.get("ColourGains") or (None, None)
    wanted = [
        ("ExposureTime", metadata.get("ExposureTime"), exposure_us, max(STEP_US, RELATIVE * exposure_us)),
        ("AnalogueGain", metadata.get("AnalogueGain"), settings.gain, RELATIVE * settings.gain),
        ("ColourGains red", gains[0], red, RELATIVE * red),
        ("ColourGains blue", gains[1], blue, RELATIVE * blue),
        # the digital gain compensates for the steps of exposure and gain; larger values indicate an automatic function
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
    """Convert a frame to a picture.

    Parameters
    ----------
    raw : (H, stride) uint8 array
        Bytes of the raw stream.
    stream : mapping of object
        Configuration of the stream, with ``format`` and ``size``.
    metadata : mapping of object
        Metadata of the frame; ``SensorBlackLevels`` are R, Gr, Gb, B in 16 bits for any format.
    mode, settings : RawMode, CameraSettings
        Requested mode and settings.
    name : str
        Name of the camera, used in messages.

    Returns
    -------
    (H, W) uint16 array
        Mean of each block minus the black level, with the bit depth of the settings.

    Raises
    ------
    RigError
        If the raw format is unknown or the black level missing.
    """
    found = _RAW_FORMAT.fullmatch(str(stream["format"]))
    if found is None or tuple(stream["size"]) != mode.size:
        size = "x".join(str(n) for n in stream["size"])
        raise RigError(
            f"{name}: the camera delivers raw pixels as {stream['format']} {size}, but only {mode.format} "
            f"{mode.size[0]}x{mode.size[1]} is supported; update python3-picamera2 and libcamera"
        )
    levels = metadata.get("SensorBlackLevels")
    if levels is None or len(levels) != 4:
        raise RigError(f"{name}: the camera does not report its black level; update python3-picamera2 and libcamera")
    # Unpacked values are right-aligned in the format's bits: 12 on a Pi 4, and 16 on a Pi 5, where the converter's own
    # bits are the upper ones.
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
