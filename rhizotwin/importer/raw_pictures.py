"""Reader of raw pictures (DNG, such as from a Raspberry Pi camera, CR2, NEF ...) as linear light."""

from pathlib import Path

from rhizotwin.rig.cameras.raw_files import SUFFIXES, open_raw
from rhizotwin.scenes.orientation import turn_picture
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, read_file

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
        Raw file of a sensor with a 2x2 colour filter.
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
    raw = open_raw(read_file(path, most_mib=MOST_PICTURE_MIB), where=str(path))
    gains = raw.gains if gains is None else gains
    light = raw.light(image_wh=image_wh, gains=gains, bits=BITS, where=str(path), turned=raw.orientation >= 5)
    return turn_picture(light, raw.orientation), gains
