"""Reader of raw pictures (DNG, such as from a Raspberry Pi camera) as linear light, through LibRaw."""

from collections.abc import Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.cameras.bayer import COLOURS, grey_from_bayer
from rhizotwin.scenes.errors import UserError, pip_install
from rhizotwin.scenes.orientation import read_orientation, turn_picture
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, read_file

SUFFIXES = (".dng",)
BITS = 16
"""Bit depth of the grey picture. It exceeds the 12 or 14 bits of the sensor, because the mean of four raw pixels has
two bits more."""


def is_raw(path: Path) -> bool:
    """Return whether the suffix of a file is that of a raw picture."""
    return path.suffix.lower() in SUFFIXES


def read_raw(path: Path, *, image_wh: tuple[int, int], gains: tuple[float, float] | None = None) -> tuple[Grey, tuple[float, float]]:
    """Read a raw picture as a grey picture of linear light.

    Parameters
    ----------
    path : Path
        DNG file of a sensor with a 2x2 colour filter.
    image_wh : tuple of int
        Width and height of the grey picture, px, after it has been turned as the orientation tag of the file states.
        Blocks of 2x2, 4x4 ... raw pixels are averaged to one pixel, so that no colour is interpolated.
    gains : tuple of float, optional
        White balance factors of red and blue, relative to green; None: factors in the file. All pictures of a set
        should be read with the factors of the first picture.

    Returns
    -------
    light : (H, W) uint16
        Values proportional to the light, scaled from the black level and white level of the sensor to 0 and full scale.
    gains : tuple of float
        White balance factors that were applied.

    Raises
    ------
    UserError
        If LibRaw is not installed, or the file is unreadable or damaged, has another colour filter or another size.
    """
    if find_spec("rawpy") is None:
        raise UserError(f"{path}: raw pictures are read with LibRaw, which is not installed; run: {pip_install('rawpy')}")
    import rawpy

    data = read_file(path, most_mib=MOST_PICTURE_MIB)
    try:
        with rawpy.imread(BytesIO(data)) as opened:
            raw = np.array(opened.raw_image_visible)
            pattern = None if opened.raw_pattern is None else np.array(opened.raw_pattern)
            names, black = opened.color_desc.decode("ascii"), [float(value) for value in opened.black_level_per_channel]
            white, balance = float(opened.white_level), [float(value) for value in opened.camera_whitebalance]
    except (rawpy.LibRawError, UnicodeDecodeError, ValueError) as error:
        raise UserError(f"{path}: the raw picture could not be read ({type(error).__name__}); copy or take the picture again") from None
    if pattern is None or pattern.shape != (2, 2) or raw.ndim != 2 or raw.dtype != np.uint16:
        raise UserError(f"{path}: the sensor has no 2x2 colour filter; convert the picture to a linear 16-bit PNG")
    orientation = read_orientation(data)
    raw_wh = (raw.shape[1], raw.shape[0]) if orientation < 5 else (raw.shape[0], raw.shape[1])
    block = _block(path, raw_wh, image_wh)
    order = "".join(names[k] for k in pattern.ravel())
    if sorted(order) != ["B", "G", "G", "R"]:
        raise UserError(f"{path}: the colour filter {order} is not supported; convert the picture to a linear 16-bit PNG")
    if gains is None:
        gains = _gains(names, balance)
    light = grey_from_bayer(raw, order=order, black=_black(order, pattern, black), white=white, colour_gains=gains, block=block, bits=BITS)
    return turn_picture(light, orientation), gains


def _block(path: Path, raw_wh: tuple[int, int], image_wh: tuple[int, int]) -> int:
    """Return the number of raw pixels along each side of one output pixel."""
    block = raw_wh[0] // image_wh[0]
    if block < 2 or block % 2 or raw_wh != (image_wh[0] * block, image_wh[1] * block):
        exact = [k for k in (2, 4) if not (raw_wh[0] % k or raw_wh[1] % k)]
        halves = " or ".join(f"{raw_wh[0] // k}x{raw_wh[1] // k}" for k in exact)
        remedy = f"set the camera's image_wh to {halves}" if exact else "convert the picture to a linear 16-bit PNG"
        raise UserError(
            f"{path}: the raw picture has {raw_wh[0]}x{raw_wh[1]} pixels, which is not an even multiple (2, 4, ...) of the scene's "
            f"image_wh {image_wh[0]}x{image_wh[1]}; {remedy}"
        )
    return block


def _black(order: str, pattern: NDArray[np.uint8], black: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the black levels of the four filter colours, in the order of `COLOURS`."""
    found = {}
    for place, colour in enumerate(order):
        row = order[2 * (place // 2) : 2 * (place // 2) + 2]
        found[colour if colour != "G" else "Gr" if "R" in row else "Gb"] = black[int(pattern.ravel()[place])]
    red, green_red, green_blue, blue = (found[colour] for colour in COLOURS)
    return red, green_red, green_blue, blue


def _gains(names: str, balance: Sequence[float]) -> tuple[float, float]:
    """Return the white balance factors of red and blue relative to green.

    They are (1, 1) if the file contains none.
    """
    of = {name: balance[place] for place, name in reversed(list(enumerate(names)))}
    if min(of.get(name, 0.0) for name in "RGB") <= 0.0:
        return 1.0, 1.0
    return of["R"] / of["G"], of["B"] / of["G"]
