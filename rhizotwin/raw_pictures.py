"""Raw pictures (DNG, as a Raspberry Pi writes them beside its JPEGs) as light, through LibRaw."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.cameras.bayer import COLOURS, grey_from_bayer
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import Grey

SUFFIXES = (".dng",)
BITS = 16
"""Depth of the light: a quad's mean has two bits more than the converter's 12 or 14."""


def is_raw(path: Path) -> bool:
    """Tell a raw picture by its name."""
    return path.suffix.lower() in SUFFIXES


def read_raw(path: Path, *, image_wh: tuple[int, int], gains: tuple[float, float] | None = None) -> tuple[Grey, tuple[float, float]]:
    """Read a raw picture as light.

    Parameters
    ----------
    path : Path
        A DNG with a colour filter of 2x2 pixels.
    image_wh : tuple of int
        Size of the grey picture: blocks of 2x2, 4x4 ... raw pixels become one, so that no colour is interpolated.
    gains : tuple of float, optional
        Factors of red and blue; None: as the file has them. A set of pictures has the gains of its first.

    Returns
    -------
    light : (H, W) uint16
        Proportional to light; the converter's range above black is full scale.
    gains : tuple of float
        The factors used.

    Raises
    ------
    UserError
        Where LibRaw is not installed, or the file is damaged, has no such filter or another size.
    """
    if find_spec("rawpy") is None:
        raise UserError(f"{path}: raw pictures are read by LibRaw, which is not installed; type: pip install 'rhizotwin[raw]'")
    import rawpy

    try:
        with rawpy.imread(str(path)) as opened:
            raw = np.array(opened.raw_image_visible)
            pattern = None if opened.raw_pattern is None else np.array(opened.raw_pattern)
            names, black = opened.color_desc.decode("ascii"), [float(value) for value in opened.black_level_per_channel]
            white, balance = float(opened.white_level), [float(value) for value in opened.camera_whitebalance]
    except (rawpy.LibRawError, UnicodeDecodeError, ValueError) as error:
        raise UserError(f"{path}: cannot be read as a raw picture ({type(error).__name__}); copy or take it again") from None
    if pattern is None or pattern.shape != (2, 2) or raw.ndim != 2 or raw.dtype != np.uint16:
        raise UserError(f"{path}: its sensor has no colour filter of 2x2 pixels; convert it to a linear 16-bit PNG")
    block = _block(path, (raw.shape[1], raw.shape[0]), image_wh)
    order = "".join(names[k] for k in pattern.ravel())
    if sorted(order) != ["B", "G", "G", "R"]:
        raise UserError(f"{path}: its colour filter is {order}, not of red, green and blue; convert it to a linear 16-bit PNG")
    if gains is None:
        gains = _gains(names, balance)
    light = grey_from_bayer(raw, order=order, black=_black(order, pattern, black), white=white, colour_gains=gains, block=block, bits=BITS)
    return light, gains


def _block(path: Path, raw_wh: tuple[int, int], image_wh: tuple[int, int]) -> int:
    """Return the number of raw pixels along each side of one output pixel."""
    block = raw_wh[0] // image_wh[0]
    if block < 2 or block % 2 or raw_wh != (image_wh[0] * block, image_wh[1] * block):
        halves = " or ".join(f"{raw_wh[0] // k}x{raw_wh[1] // k}" for k in (2, 4))
        raise UserError(
            f"{path}: has {raw_wh[0]}x{raw_wh[1]} raw pixels; they must be an even multiple (2, 4, ...) of the scene's image_wh "
            f"{image_wh[0]}x{image_wh[1]}; set the camera's image_wh to {halves}"
        )
    return block


def _black(order: str, pattern: NDArray[np.uint8], black: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the numbers without light in the order of `COLOURS`."""
    found = {}
    for place, colour in enumerate(order):
        row = order[2 * (place // 2) : 2 * (place // 2) + 2]
        found[colour if colour != "G" else "Gr" if "R" in row else "Gb"] = black[int(pattern.ravel()[place])]
    red, green_red, green_blue, blue = (found[colour] for colour in COLOURS)
    return red, green_red, green_blue, blue


def _gains(names: str, balance: Sequence[float]) -> tuple[float, float]:
    """Return the factors of red and blue that the file has; 1 where it has none."""
    of = {name: balance[place] for place, name in reversed(list(enumerate(names)))}
    if min(of.get(name, 0.0) for name in "RGB") <= 0.0:
        return 1.0, 1.0
    return of["R"] / of["G"], of["B"] / of["G"]
