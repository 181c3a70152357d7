"""Silhouettes, which are pictures with white roots on black: their checks, their levels and their conversion to PNG."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.importer.picture_files import read_mask
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.picture_codec import Grey, encode_png

MASK_MARGIN = 0.1
"""Tolerance for black and white pixels in a silhouette, as a fraction of the range from black to white. A pixel that
differs more from both black and white is grey."""
MASK_GREYS = 0.05
"""Maximum fraction of grey pixels in a silhouette, and of evenly grey pixels among those of the roots. The pixels along
a soft outline are grey but not even. Evenly grey are at most 0.03 in coverages of a sphere, a wheat and wires, exact or
in JPEG or blurred by 3 px, and 0.06 to 0.3 in two labels."""
MASK_EQUAL = 0.85
"""Maximum fraction of pairs of adjacent root pixels with the same value, among those with a grey pixel. It is 0.01 to
0.26 in the coverages above, 0.5 to 0.75 in those of vertical wires, and 0.94 to 1 in labels."""
MASK_EVEN = 0.02
"""Range of values in 3x3 pixels below which the middle one is evenly grey, such as in a label in JPEG."""
MOST_WHITE = 0.5
"""Maximum fraction of white pixels in a silhouette and along its border. Roots leave the picture only at its top, which
is less than a third of the border; of inverted silhouettes the border is almost completely white."""
LEAST_WHITE = 0.5
"""Minimum brightness of the brightest pixel of a silhouette, relative to white. It is less than 1 if all roots in the
picture are thinner than a pixel."""
BINARY = 0.5
"""Fraction of the root pixels with the maximum value above which this value is white, and not a partial coverage."""
_RING = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Levels:
    """Grey values of black and white in a silhouette."""

    black: int
    """Value of the background. It is not 0 in pictures of video programs, whose black is 16."""
    white: int
    """Value of pixels that are completely covered by roots."""

    def cover(self, grey: Grey) -> NDArray[np.float32]:
        """Convert grey values (H, W) to the fractions of the pixels that are covered by roots, from 0 to 1."""
        share = (np.arange(np.iinfo(grey.dtype).max + 1) - self.black) / max(1, self.white - self.black)
        return np.asarray(np.clip(share, 0.0, 1.0).astype(np.float32)[grey])


@dataclass(frozen=True)
class _Silhouette:
    """What one picture of a set of silhouettes shows."""

    levels: Levels
    """Grey values of its background and of its brightest pixels."""
    depth: int
    """Number of bytes per pixel."""
    is_binary: bool
    """Whether most root pixels are as bright as the brightest one, which is therefore white."""


def read_levels(paths: list[Path], *, image_wh: tuple[int, int]) -> dict[Path, Levels]:
    """Check a set of silhouettes, and return their grey values of black and white.

    White is the maximum of all pictures with the same bit depth, because some programs write 1 instead of 255.

    Parameters
    ----------
    paths : list of Path
        Picture files.
    image_wh : tuple of int
        Required width and height, px.

    Returns
    -------
    dict of Path to Levels
        Levels of each picture.

    Raises
    ------
    UserError
        If a picture is unreadable, of another size, completely black, inverted, in grey levels or in its transparency,
        or if white differs between the pictures.
    """
    examined = dict(zip(paths, Monitor().each(lambda path: _examine(path, image_wh), "check", paths), strict=True))
    found = {}
    for path, one in examined.items():
        white = max(other.levels.white for other in examined.values() if other.depth == one.depth)
        if one.levels.white < (1.0 - MASK_MARGIN if one.is_binary else LEAST_WHITE) * white:
            raise UserError(
                f"{path}: the brightest pixels have the value {one.levels.white}, but white has the value {white} in other silhouettes; "
                "save all silhouettes with the same white"
            )
        found[path] = Levels(one.levels.black, white)
    return found


def _examine(path: Path, image_wh: tuple[int, int]) -> _Silhouette:
    """Read a silhouette and check it without the others."""
    grey, alpha = read_mask(path, image_wh=image_wh)
    levels = Levels(int(np.median(grey)), int(grey.max()))
    _check_transparency(grey, alpha, path)
    _check_background(grey, levels, path)
    roots = _check_greys(grey, levels, path)
    return _Silhouette(levels, grey.dtype.itemsize, is_binary=bool((grey == levels.white).sum() > BINARY * roots))


def encode_silhouette(grey: Grey, levels: Levels) -> bytes:
    """Scale a silhouette (H, W) to 0..255, and return it as a PNG file with 8 bits."""
    return encode_png(np.round(255.0 * levels.cover(grey)).astype(np.uint8))


def _check_transparency(grey: Grey, alpha: Grey | None, path: Path) -> None:
    """Raise UserError if the transparency of a picture shows other roots than its colours."""
    if alpha is None or alpha.min() == alpha.max():
        return
    if np.mean((alpha > alpha.max() / 2) != (grey > grey.max() / 2)) > 0.0:
        raise UserError(
            f"{path}: the silhouette is in the transparency of the picture; save it as white roots on black, without transparency"
        )


def _check_background(grey: Grey, levels: Levels, path: Path) -> None:
    """Raise UserError if the background of a silhouette is not black, or if the silhouette is empty."""
    if levels.white == 0:
        raise UserError(f"{path} is completely black; roots must be white. If no root is visible, remove the picture and its camera")
    white = grey > (1.0 - MASK_MARGIN) * levels.white
    border = np.concatenate([white[0], white[-1], white[1:-1, 0], white[1:-1, -1]])
    if white.mean() > MOST_WHITE or border.mean() > MOST_WHITE:
        raise UserError(
            f"{path}: {100.0 * white.mean():.0f} % of the picture and {100.0 * border.mean():.0f} % of its border are white, but roots "
            "must be white on black; invert the silhouettes, or remove --masks from photographs"
        )
    if levels.black > MASK_MARGIN * levels.white:
        raise UserError(f"{path} is not a silhouette: its background is grey. Use white roots on black, or remove --masks")


def _check_greys(grey: Grey, levels: Levels, path: Path) -> int:
    """Raise UserError if grey pixels (H, W) are no soft outline of roots.

    The result is the number of root pixels.
    """
    x, y, width, height = cv2.boundingRect((grey > levels.black).astype(np.uint8))
    cover = levels.cover(grey[y : y + height, x : x + width])
    roots = cover > MASK_MARGIN
    between = roots & (cover <= 1.0 - MASK_MARGIN)
    count = int(roots.sum())
    share = float(between.sum() / grey.size)
    if between.sum() > MASK_GREYS * count and _are_labels(cover, roots, between):
        raise UserError(
            f"{path} is not a silhouette: {100.0 * between.sum() / count:.0f} % of its root pixels have values between black and white "
            "that are not those of a soft outline, such as labels of roots. Make all root pixels white, or remove --masks"
        )
    if share > MASK_GREYS:
        raise UserError(
            f"{path} is not a silhouette: {100.0 * share:.0f} % of its pixels are neither black nor white "
            f"(maximum {100.0 * MASK_GREYS:.0f} %). Use black and white silhouettes, or remove --masks"
        )
    return count


def _are_labels(cover: NDArray[np.float32], roots: NDArray[np.bool_], grey: NDArray[np.bool_]) -> bool:
    """Return whether the grey pixels (H, W) are those of labels, which are even, and not those of soft outlines."""
    even = grey & (cv2.dilate(cover, _RING) - cv2.erode(cover, _RING) < MASK_EVEN)
    pairs = equal = 0
    for one, other in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        pair = roots[one] & roots[other] & (grey[one] | grey[other])
        pairs += int(pair.sum())
        equal += int((pair & (cover[one] == cover[other])).sum())
    return bool(even.sum() > MASK_GREYS * roots.sum() or equal > MASK_EQUAL * pairs)
