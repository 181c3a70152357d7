"""Writer of raw files for the emulated camera: DNG (Adobe DNG 1.4) of a sensor with a 2x2 colour filter."""

from io import BytesIO

import numpy as np
import tifffile
from numpy.typing import NDArray

BLACK, WHITE = 512, 512 + 4 * 4095
"""Black level and white level of the sensor. Pictures of 12 bits are stored without loss, except in the uppermost
thousandth, which counts as saturated."""
GAINS = 2.0, 2.0
"""White balance factors of red and blue for white light. They are the defaults of the rig file."""
_PATTERN = bytes([2, 1, 1, 0])
"""Colours of the filter, row by row: blue, green, green, red."""


def encode_dng(light: NDArray[np.float64], *, exposure_s: float, gains: tuple[float, float] = GAINS, orientation: int = 1) -> bytes:
    """Encode a picture of white light as a raw file.

    Parameters
    ----------
    light : (H, W) float array
        Light as a fraction of full scale. Each pixel becomes 2x2 raw pixels.
    exposure_s : float
        Exposure time that the file states, s.
    gains : tuple of float
        White balance factors of red and blue for white light.
    orientation : int
        Orientation tag.

    Returns
    -------
    bytes
        Content of the file.
    """
    share = (1.0 / gains[1], 1.0, 1.0, 1.0 / gains[0])
    raw = np.zeros((2 * light.shape[0], 2 * light.shape[1]), np.uint16)
    for place, part in enumerate(share):
        raw[place // 2 :: 2, place % 2 :: 2] = np.rint(BLACK + np.clip(part * light, 0.0, 1.0) * (WHITE - BLACK))
    neutral = [round(10000 / gains[0]), 10000, 10000, 10000, round(10000 / gains[1]), 10000]
    tags = [
        (274, 3, 1, orientation, True),
        (33421, 3, 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, 1, 4, _PATTERN, True),  # CFAPattern
        (33434, 5, 1, (round(1e6 * exposure_s), 1_000_000), True),  # ExposureTime
        (50706, 1, 4, (1, 4, 0, 0), True),  # DNGVersion
        (50708, 2, 0, "rhizotwin twin", True),  # UniqueCameraModel
        (50714, 4, 1, BLACK, True),  # BlackLevel
        (50717, 4, 1, WHITE, True),  # WhiteLevel
        (50721, 10, 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),  # ColorMatrix1: the identity
        (50728, 5, 3, neutral, True),  # AsShotNeutral
        (50778, 3, 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    stream = BytesIO()
    tifffile.imwrite(stream, raw, photometric=32803, extratags=tags, metadata=None)
    return stream.getvalue()
