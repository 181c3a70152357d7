"""Pictures from bytes, refusing what OpenCV would silently repair: a truncated file comes back padded, not as an error."""

import re
import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.transfer import LINEAR, Curve

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_NEXT_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]")

cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # OpenCV's own complaints: `decode_grey` says them in a sentence

Grey = np.ndarray[tuple[int, int], np.dtype[np.uint8 | np.uint16]]


def encode_png(image: Grey) -> bytes:
    """Encode a picture; OpenCV's own setting (a filter, then little compression) is the fastest and the smallest for noisy pictures."""
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not encoded:
        raise ValueError(f"OpenCV cannot encode {image.shape=} {image.dtype=} as PNG")
    return data.tobytes()


def decode_grey(data: bytes, *, where: str) -> Grey:
    """Decode a picture to grey levels.

    Parameters
    ----------
    data
        Content of a PNG, JPEG, TIFF or other file that OpenCV reads.
    where
        File name, for messages.

    Returns
    -------
    ndarray
        (H, W), uint8 or uint16 as in the file; colours by luminance (Rec. 601), transparency dropped.

    Raises
    ------
    UserError
        When the data are empty, truncated, damaged, or no picture of 8 or 16 bits.
    """
    image = _decoded(data, where)
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def decode_light(data: bytes, curve: Curve, *, where: str) -> Grey:
    """Decode a picture to light.

    Parameters
    ----------
    data, where
        As in `decode_grey`.
    curve
        What its numbers stand for.

    Returns
    -------
    ndarray
        (H, W), uint16, or for a linear curve uint8 or uint16 as in the file. Colours weigh as in `decode_grey`, each as light; where one is
        at full scale, the pixel is, as its light is not known.

    Raises
    ------
    UserError
        As `decode_grey`.
    """
    image = _decoded(data, where)
    light = image if curve == LINEAR else curve.decode(image)
    if light.ndim == 2:
        return light
    grey = cv2.cvtColor(light, cv2.COLOR_BGR2GRAY)
    grey[(image >= np.iinfo(image.dtype).max).any(axis=2)] = np.iinfo(grey.dtype).max
    return np.asarray(grey)


def _decoded(data: bytes, where: str) -> NDArray[np.uint8 | np.uint16]:
    """Decode a picture to (H, W) grey or (H, W, 3) blue, green, red."""
    damage = _damage(data)
    if damage:
        raise UserError(f"{where}: the picture is {damage}; copy or take it again, or leave it out")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise UserError(f"{where}: is not a picture that can be read; PNG, JPEG and TIFF can")
    if image.dtype not in (np.uint8, np.uint16):
        raise UserError(f"{where}: has {image.dtype} pixels, but 8 or 16 bit whole numbers are needed; convert it to a 16-bit PNG")
    if image.ndim == 2:
        return np.asarray(image)
    if image.shape[2] == 1:
        return np.asarray(image[:, :, 0])
    if image.shape[2] == 2:  # grey and alpha
        return np.ascontiguousarray(image[:, :, 0])
    return np.ascontiguousarray(image[:, :, :3])


def _damage(data: bytes) -> str:
    """Say what is wrong with a file's structure, or nothing."""
    if not data:
        return "empty (0 bytes)"
    if data.startswith(_PNG):
        return _png_damage(data)
    if data.startswith(_JPEG):
        return _jpeg_damage(data)
    return ""


def _png_damage(data: bytes) -> str:
    """Walk the chunks of a PNG up to IEND, checking each one's CRC (ISO/IEC 15948, section 5)."""
    at = len(_PNG)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if crc != zlib.crc32(memoryview(data)[at + 4 : end - 4]):
            return "damaged (a checksum inside the PNG file is wrong)"
        if data[at + 4 : at + 8] == b"IEND":
            return ""
        at = end
    return "truncated (the PNG file ends too early)"


def _jpeg_damage(data: bytes) -> str:
    """Walk the segments and scans of a JPEG up to its end marker (ITU-T T.81, annex B); what follows it is ignored."""
    truncated = "truncated (the JPEG file ends too early)"
    at = 2
    while found := _NEXT_MARKER.search(data, at):
        code = data[found.end() - 1]
        at = found.end()
        if code == 0xD9:
            return ""
        if code == 0x01:  # stands alone, without a length
            continue
        if at + 2 > len(data):
            break
        (length,) = struct.unpack_from(">H", data, at)
        at += length
    return truncated
