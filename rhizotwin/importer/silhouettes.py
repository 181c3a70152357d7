"""Silhouettes, which are pictures with white roots on black: their white level, check and conversion to PNG."""

from pathlib import Path

import numpy as np

from rhizotwin.picture_files import read_picture
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import Grey, encode_png

MASK_MARGIN = 0.1
"""Tolerance for black and white pixels in a silhouette, as a fraction of the grey range. A pixel that differs more from
both black and white is grey."""
MASK_GREYS = 0.05
"""Maximum fraction of grey pixels in a silhouette. The pixels along a soft outline are grey."""


def white_level(paths: list[Path], *, image_wh: tuple[int, int]) -> int:
    """Return the grey value of white pixels in a set of silhouettes.

    It is the largest value in all of them, because some programs write 1 instead of 255.

    Parameters
    ----------
    paths : list of Path
        Picture files.
    image_wh : tuple of int
        Required width and height, px.

    Returns
    -------
    int
        Grey value of white, at least 1.

    Raises
    ------
    UserError
        If a picture is unreadable or of another size, or all pictures are black.
    """
    white = max(int(read_picture(path, image_wh=image_wh)[1].max()) for path in paths)
    if white == 0:
        raise UserError(f"{paths[0].parent}: all silhouettes are completely black; roots must be white")
    return white


def encode_silhouette(grey: Grey, white: int, path: Path) -> bytes:
    """Scale a silhouette to 0..255, and return it as a PNG file.

    Parameters
    ----------
    grey : (H, W) uint8 or uint16 array
        Decoded silhouette.
    white : int
        Grey value of white pixels.
    path : Path
        Picture file, for messages.

    Returns
    -------
    bytes
        PNG file with 8 bits.

    Raises
    ------
    UserError
        If the picture is not a silhouette.
    """
    _check_mask(grey, white, path)
    return encode_png(np.round(grey * (255.0 / white)).astype(np.uint8))


def _check_mask(grey: Grey, white: int, path: Path) -> None:
    """Raise UserError if a silhouette has too many grey pixels.

    The maximum is `MASK_GREYS`.
    """
    level = grey / white
    between = float(np.mean((level > MASK_MARGIN) & (level < 1.0 - MASK_MARGIN)))
    if between > MASK_GREYS:
        raise UserError(
            f"{path} is not a silhouette: {100.0 * between:.0f} % of its pixels are neither black nor white "
            f"(maximum {100.0 * MASK_GREYS:.0f} %). Use black and white silhouettes, or remove --masks"
        )
