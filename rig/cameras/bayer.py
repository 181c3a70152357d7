"""Conversion of a colour sensor's raw values to grey values that are linear in light."""

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.picture_codec import Grey

COLOURS = ("R", "Gr", "Gb", "B")
"""Order in which black levels are listed. Gr and Gb are the green pixels in the rows of red and blue pixels."""
FULL = 0.999
"""Raw value above which a pixel counts as saturated, as a fraction of ``white``. It is below 1 because converters
saturate slightly early."""


def grey_from_bayer(
    raw: NDArray[np.uint16],
    *,
    order: str,
    black: tuple[float, float, float, float],
    white: float,
    colour_gains: tuple[float, float],
    block: int,
    bits: int,
) -> Grey:
    """Average each block of raw pixels after subtracting the black level and balancing the colours.

    The gains make the four pixels of a Bayer cell (2x2 pixels) equal on a grey surface, so that they have equal
    weights. Their mean applies to the centre of the cell, without displaced or coloured edges as from interpolation.

    Parameters
    ----------
    raw : (H, W) uint16 array
        Raw values of the sensor.
    order : str
        Colours of the upper left Bayer cell, row by row, such as "RGGB".
    black : tuple of float
        Black levels in the order of `COLOURS`.
    white : float
        Value at which a pixel is saturated.
    colour_gains : tuple of float
        Gains of red and blue relative to green.
    block : int
        Side length of a block in pixels (even).
    bits : int
        Bit depth of the result: up to 8 in uint8, more left-aligned in uint16.

    Returns
    -------
    ndarray
        (H / block, W / block) values proportional to light. Full scale corresponds to the raw range above the black
        level. Blocks with a saturated pixel are set to full scale, because their light is unknown.
    """
    gains = {"R": colour_gains[0], "Gr": 1.0, "Gb": 1.0, "B": colour_gains[1]}
    floors = dict(zip(COLOURS, black, strict=True))
    light = np.zeros((raw.shape[0] // 2, raw.shape[1] // 2), np.float32)
    full: NDArray[np.bool_] = np.zeros(light.shape, np.bool_)
    for i in range(2):
        for j in range(2):
            colour = order[2 * i + j]
            if colour == "G":
                colour = "Gr" if "R" in order[2 * i : 2 * i + 2] else "Gb"
            plane = raw[i::2, j::2]
            np.logical_or(full, plane >= FULL * white, out=full)
            light += (plane.astype(np.float32) - np.float32(floors[colour])) * np.float32(gains[colour] / (4.0 * (white - floors[colour])))
    quads = block // 2
    if quads > 1:
        shape = (light.shape[0] // quads, quads, light.shape[1] // quads, quads)
        light = light.reshape(shape).mean(axis=(1, 3))
        full = np.logical_or.reduce(full.reshape(shape), axis=(1, 3))
    light[full] = 1.0
    numbers = np.rint(np.clip(light, 0.0, 1.0) * (2**bits - 1))
    if bits <= 8:
        return numbers.astype(np.uint8)
    return numbers.astype(np.uint16) << np.uint16(16 - bits)
