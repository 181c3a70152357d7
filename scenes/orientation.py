"""Orientation of pictures: how the stored pixels must be turned for display, as stated by the file.

Cameras store pixels in the order of their sensor, and state in a tag how the camera was held: in the Exif block of JPEG
(Exif 2.3, section 4.6.4) and of PNG (chunk eXIf), and in the first directory of TIFF (TIFF 6.0, section 8). All formats
use tag 274 with the same eight values. Pictures are always turned as stated, so that their size, their lens and the
positions in them are those of the picture that viewers show.
"""

import struct

import numpy as np
from numpy.typing import NDArray

_TAG = 274
_MOST_TAGS = 4096
"""Maximum number of tags that are read of a directory. Those of cameras have fewer than 100."""
_KINDS = {1: "B", 3: "H", 4: "I"}
"""Integer types of a tag (TIFF 6.0, section 2). The standard requires 3."""

TURNS = {
    1: "unchanged",
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "mirrored and turned by 180 degrees",
    5: "mirrored and turned by 270 degrees",
    6: "turned clockwise by 90 degrees",
    7: "mirrored and turned by 90 degrees",
    8: "turned clockwise by 270 degrees",
}
"""Change of the stored picture for display, for each value of the tag. Mirroring (of left and right) is done first."""


def read_orientation(data: bytes) -> int:
    """Return the orientation tag of a PNG, JPEG or TIFF file.

    The result is 1 (unchanged) if the file has no valid tag.
    """
    try:
        value = _tag_value(_first_directory(data))
    except struct.error:
        return 1
    return value if value in TURNS else 1


def turn_picture(image: NDArray[np.uint8 | np.uint16], orientation: int) -> NDArray[np.uint8 | np.uint16]:
    """Turn a stored picture (H, W) or (H, W, C) as its orientation tag states.

    The result has the shape (W, H) or (W, H, C) if the orientation is 5 to 8.
    """
    turned = image.swapaxes(0, 1) if orientation >= 5 else image
    if orientation in (2, 3, 6, 7):
        turned = turned[:, ::-1]
    if orientation in (3, 4, 7, 8):
        turned = turned[::-1]
    return np.ascontiguousarray(turned)


def _first_directory(data: bytes) -> bytes:
    """Return the part of a file that is structured as a TIFF. It is empty if there is none."""
    if data.startswith(b"\x89PNG"):
        at = 8
        while at + 12 <= len(data):
            (length,) = struct.unpack_from(">I", data, at)
            if data[at + 4 : at + 8] == b"eXIf":
                return data[at + 8 : at + 8 + length]
            at += 12 + length
        return b""
    if data.startswith(b"\xff\xd8"):
        at = 2
        while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:  # up to the first scan
            (length,) = struct.unpack_from(">H", data, at + 2)
            if data[at + 1] == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
                return data[at + 10 : at + 2 + length]
            at += 1 if data[at + 1] == 0xFF else 2 + length  # 0xFF may be repeated before a marker
        return b""
    return data


def _tag_value(tiff: bytes) -> int:
    """Return the value of the tag in the first directory of a TIFF or BigTIFF structure, or 1 if there is none."""
    order = "<" if tiff[:2] == b"II" else ">"
    is_big = tiff[2:4] in (b"+\0", b"\0+")
    at_format, at_place, count_format, entry, value_place = ("Q", 8, "Q", 20, 12) if is_big else ("I", 4, "H", 12, 8)
    (at,) = struct.unpack_from(order + at_format, tiff, at_place)
    (count,) = struct.unpack_from(order + count_format, tiff, at)
    at += struct.calcsize(count_format)
    for start in range(at, at + entry * min(count, _MOST_TAGS), entry):
        tag, kind = struct.unpack_from(f"{order}HH", tiff, start)
        if tag == _TAG and kind in _KINDS:
            return int(struct.unpack_from(order + _KINDS[kind], tiff, start + value_place)[0])
    return 1
