"""Raw files of cameras (DNG, CR2, CR3, NEF, ARW ...), read through LibRaw as light.

LibRaw applies the linearisation table of a file and leaves the sensor's values otherwise unchanged. They are linear in
light between the black and the white level.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.cameras.bayer import COLOURS, grey_from_bayer
from rhizotwin.scenes.errors import UserError, pip_install
from rhizotwin.scenes.picture_codec import Grey

SUFFIXES = (".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".raf", ".rw2", ".srw")
_ORIENTATIONS = (1, 2, 4, 3, 5, 8, 6, 7)
"""Orientation tag for each value of LibRaw's ``flip``, whose bits mean: mirrored, upside down, rows and columns
exchanged (LibRaw's identify.cpp states the inverse table)."""


@dataclass(frozen=True, kw_only=True)
class RawFile:
    """Values of a sensor with a 2x2 colour filter."""

    pixels: NDArray[np.uint16]
    """Values (H, W) as the sensor was read out, not turned."""
    order: str
    """Colours of the upper left 2x2 pixels, row by row, such as "RGGB"."""
    black: tuple[float, float, float, float]
    """Black levels in the order of `bayer.COLOURS`."""
    white: float
    """Value at which a pixel is saturated."""
    gains: tuple[float, float]
    """White balance factors of red and blue relative to green that the file states, (1, 1) if it states none."""
    orientation: int
    """Orientation tag, from 1 (not turned) to 8."""
    exposure_s: float | None
    """Exposure time stated by the file, s. It is None if the file states none."""
    iso: float | None
    """Sensitivity stated by the file. It is None if the file states none."""

    def light(self, *, image_wh: tuple[int, int], gains: tuple[float, float], bits: int, where: str, turned: bool = False) -> Grey:
        """Return the grey picture of linear light, as the sensor was read out.

        Blocks of 2x2, 4x4 ... raw pixels are averaged to one pixel, so that no colour is interpolated.

        Parameters
        ----------
        image_wh : tuple of int
            Width and height of the picture, px.
        gains : tuple of float
            White balance factors of red and blue.
        bits : int
            Bit depth of the picture.
        where : str
            Name of file or camera, used in messages.
        turned : bool
            Whether ``image_wh`` is the size after the picture has been turned by a quarter.

        Raises
        ------
        UserError
            If the size is not that of the raw pixels divided by 2, 4 ...; the message lists possible sizes.
        """
        raw_wh = self.pixels.shape[::-1]
        block = _block(where, (raw_wh[1], raw_wh[0]) if turned else (raw_wh[0], raw_wh[1]), image_wh)
        height, width = (block * (side // block) for side in self.pixels.shape)
        raw = self.pixels[:height, :width]
        return grey_from_bayer(raw, order=self.order, black=self.black, white=self.white, colour_gains=gains, block=block, bits=bits)


def open_raw(data: bytes, *, where: str) -> RawFile:
    """Decode a raw file.

    Parameters
    ----------
    data : bytes
        Content of the file.
    where : str
        Name of file or camera, used in messages.

    Returns
    -------
    RawFile
        Values of the sensor, with exposure and colours.

    Raises
    ------
    UserError
        If LibRaw is not installed, or the file is unreadable, damaged or has another colour filter.
    """
    if find_spec("rawpy") is None:
        raise UserError(f"{where}: raw pictures are read with LibRaw, which is not installed; run: {pip_install('rawpy')}")
    import rawpy

    try:
        with rawpy.imread(BytesIO(data)) as opened:
            raw = np.array(opened.raw_image_visible)
            pattern = None if opened.raw_pattern is None else np.array(opened.raw_pattern)
            names, black = opened.color_desc.decode("ascii"), [float(value) for value in opened.black_level_per_channel]
            white, balance = float(opened.white_level), [float(value) for value in opened.camera_whitebalance]
            flip, stated = int(opened.sizes.flip), opened.other
    except (rawpy.LibRawError, UnicodeDecodeError, ValueError) as error:
        raise UserError(f"{where}: the raw picture could not be read ({type(error).__name__}); copy or take the picture again") from None
    if pattern is None or pattern.shape != (2, 2) or raw.ndim != 2 or raw.dtype != np.uint16:
        raise UserError(f"{where}: the sensor has no 2x2 colour filter; convert the picture to a linear 16-bit PNG")
    order = "".join(names[k] for k in pattern.ravel())
    if sorted(order) != ["B", "G", "G", "R"]:
        raise UserError(f"{where}: the colour filter {order} is not supported; convert the picture to a linear 16-bit PNG")
    return RawFile(
        pixels=raw,
        order=order,
        black=_black(order, pattern, black),
        white=white,
        gains=_gains(names, balance),
        orientation=_ORIENTATIONS[flip] if 0 <= flip < len(_ORIENTATIONS) else 1,
        exposure_s=float(f"{stated.shutter_speed:.6g}") or None,  # LibRaw has single precision
        iso=float(stated.iso_speed) or None,
    )


def _block(where: str, raw_wh: tuple[int, int], image_wh: tuple[int, int]) -> int:
    """Return the number of raw pixels along each side of one output pixel.

    Raw pixels at the right and lower edge that do not fill a block are left out.
    """
    block = raw_wh[0] // image_wh[0]
    if block < 2 or block % 2 or image_wh != (raw_wh[0] // block, raw_wh[1] // block):
        sizes = " or ".join(f"{raw_wh[0] // k}x{raw_wh[1] // k}" for k in (2, 4))
        raise UserError(
            f"{where}: the raw picture has {raw_wh[0]}x{raw_wh[1]} pixels, which is not an even multiple (2, 4, ...) of the scene's "
            f"image_wh {image_wh[0]}x{image_wh[1]}; set the camera's image_wh to {sizes}"
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
