"""Encoding and decoding of pictures.

Damaged files, which OpenCV would repair silently, are rejected. For example, OpenCV pads truncated files without an
error.
"""

import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_damage import UnfitError, check_picture
from rhizotwin.scenes.transfer import LINEAR, Curve

# suppresses messages of OpenCV, because `decode_grey` raises an error
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

Grey = np.ndarray[tuple[int, int], np.dtype[np.uint8 | np.uint16]]


def encode_png(image: Grey) -> bytes:
    """Encode a picture as PNG.

    For noisy pictures, the default settings of OpenCV (a filter and weak compression) are the fastest and result in the
    smallest files.
    """
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not encoded:
        raise ValueError(f"OpenCV cannot encode {image.shape=} {image.dtype=} as PNG")
    return data.tobytes()


def encode_light_png(light: Grey) -> bytes:
    """Encode light as PNG.

    A gAMA chunk of 1 (ISO/IEC 15948, 11.3.3.2) states that pixel values are linear in light.
    """
    data, name = encode_png(light), b"gAMA" + struct.pack(">I", 100000)
    first = 8 + 25  # the signature, and IHDR, which is the first chunk
    return data[:first] + struct.pack(">I", 4) + name + struct.pack(">I", zlib.crc32(name)) + data[first:]


def decode_grey(data: bytes, *, where: str, image_wh: tuple[int, int] | None = None) -> Grey:
    """Decode a picture to grey levels.

    Parameters
    ----------
    data : bytes
        Content of a PNG, JPEG or TIFF file.
    where : str
        File name, used in messages.
    image_wh : tuple of int or None
        Required width and height, which are checked before decoding.

    Returns
    -------
    ndarray
        Grey levels (H, W), uint8 or uint16 as in the file. Colours are converted to luminance (Rec. 601), and
        transparency is ignored.

    Raises
    ------
    UserError
        If the data are empty, truncated or damaged, the size differs, or the data are not a picture with 8 or 16 bits.
    """
    image = _decode(data, where, image_wh)
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def decode_light(data: bytes, curve: Curve, *, where: str, image_wh: tuple[int, int] | None = None) -> Grey:
    """Decode a picture to values that are linear in light.

    Parameters
    ----------
    data, where, image_wh : bytes, str, tuple of int or None
        See `decode_grey`.
    curve : Curve
        Transfer curve of the picture.

    Returns
    -------
    ndarray
        Light (H, W), uint16; for a linear curve uint8 or uint16 as in the file. Colours are decoded to light, then
        weighted as in `decode_grey`. Pixels with a saturated colour are set to full scale, since their light is
        unknown.

    Raises
    ------
    UserError
        See `decode_grey`.
    """
    image = _decode(data, where, image_wh)
    light = image if curve == LINEAR else curve.decode(image)
    if light.ndim == 2:
        return light
    grey = cv2.cvtColor(light, cv2.COLOR_BGR2GRAY)
    grey[(image >= np.iinfo(image.dtype).max).any(axis=2)] = np.iinfo(grey.dtype).max
    return np.asarray(grey)


def _decode(data: bytes, where: str, image_wh: tuple[int, int] | None) -> NDArray[np.uint8 | np.uint16]:
    """Decode a picture to grey (H, W) or to blue, green and red (H, W, 3)."""
    try:
        whole = check_picture(data, image_wh=image_wh)
    except UnfitError as error:
        raise UserError(f"{where}: {error}") from error
    try:
        image = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise UserError(f"{where}: the file is not a supported picture; use PNG, JPEG or TIFF")
    if image.dtype not in (np.uint8, np.uint16):
        raise UserError(
            f"{where}: the picture has {image.dtype} pixels, but 8- or 16-bit integers are required; convert it to a 16-bit PNG"
        )
    if image.ndim == 2:
        return np.asarray(image)
    if image.shape[2] == 1:
        return np.asarray(image[:, :, 0])
    if image.shape[2] == 2:  # grey with alpha
        return np.ascontiguousarray(image[:, :, 0])
    return np.ascontiguousarray(image[:, :, :3])
