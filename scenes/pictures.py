"""Pictures from bytes, refusing what OpenCV would silently repair.

A truncated file comes back padded, not as an error.
"""

import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_damage import UnfitError, checked
from rhizotwin.scenes.transfer import LINEAR, Curve

# OpenCV's own complaints: `decode_grey` says them in a sentence
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

Grey = np.ndarray[tuple[int, int], np.dtype[np.uint8 | np.uint16]]


def encode_png(image: Grey) -> bytes:
    """Encode a picture.

    OpenCV's own setting (a filter, then little compression) is the fastest and the smallest for noisy pictures.
    """
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not encoded:
        raise ValueError(f"OpenCV cannot encode {image.shape=} {image.dtype=} as PNG")
    return data.tobytes()


def encode_light_png(light: Grey) -> bytes:
    """Encode light as a PNG whose own word is that its numbers are light.

    A gAMA chunk of 1 (ISO/IEC 15948, 11.3.3.2).
    """
    data, name = encode_png(light), b"gAMA" + struct.pack(">I", 100000)
    first = 8 + 25  # the signature, and IHDR, which comes first
    return data[:first] + struct.pack(">I", 4) + name + struct.pack(">I", zlib.crc32(name)) + data[first:]


def decode_grey(data: bytes, *, where: str, image_wh: tuple[int, int] | None = None) -> Grey:
    """Decode a picture to grey levels.

    Parameters
    ----------
    data : bytes
        Content of a PNG, JPEG or TIFF file.
    where : str
        File name, for messages.
    image_wh : tuple of int or None
        The size that it must have, which is looked at before anything is decoded.

    Returns
    -------
    ndarray
        (H, W), uint8 or uint16 as in the file; colours by luminance (Rec. 601), transparency dropped.

    Raises
    ------
    UserError
        When the data are empty, truncated, damaged, of another size, or no picture of 8 or 16 bits.
    """
    image = _decoded(data, where, image_wh)
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def decode_light(data: bytes, curve: Curve, *, where: str, image_wh: tuple[int, int] | None = None) -> Grey:
    """Decode a picture to light.

    Parameters
    ----------
    data, where, image_wh : bytes, str, tuple of int or None
        As in `decode_grey`.
    curve : Curve
        What its numbers stand for.

    Returns
    -------
    ndarray
        (H, W), uint16, or for a linear curve uint8 or uint16 as in the file. Colours weigh as in `decode_grey`, each as
        light; where one is at full scale, the pixel is, as its light is not known.

    Raises
    ------
    UserError
        As `decode_grey`.
    """
    image = _decoded(data, where, image_wh)
    light = image if curve == LINEAR else curve.decode(image)
    if light.ndim == 2:
        return light
    grey = cv2.cvtColor(light, cv2.COLOR_BGR2GRAY)
    grey[(image >= np.iinfo(image.dtype).max).any(axis=2)] = np.iinfo(grey.dtype).max
    return np.asarray(grey)


def _decoded(data: bytes, where: str, image_wh: tuple[int, int] | None) -> NDArray[np.uint8 | np.uint16]:
    """Decode a picture to (H, W) grey or (H, W, 3) blue, green, red."""
    try:
        whole = checked(data, image_wh=image_wh)
    except UnfitError as error:
        raise UserError(f"{where}: {error}") from error
    try:
        image = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_UNCHANGED)
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
