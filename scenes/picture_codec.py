"""Encoding and decoding of pictures.

Damaged files, which OpenCV would repair silently, are rejected. For example, OpenCV pads truncated files without an
error. TIFF is decoded by tifffile. All pictures are turned as their orientation tag states (`scenes.orientation`).
"""

import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import picture_damage, tiff_pictures
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.orientation import read_orientation, turn_picture
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


def is_sealed(data: bytes) -> bool:
    """Return whether a picture file, which has been decoded without an error, contains a checksum of its pixels."""
    return tiff_pictures.has_checksum(data) if tiff_pictures.is_tiff(data) else data.startswith(b"\x89PNG")


def check_header(data: bytes, *, where: str, image_wh: tuple[int, int] | None = None) -> None:
    """Check the size and the kind of a picture without decoding it, which takes a tenth of the time.

    Parameters
    ----------
    data, where, image_wh : bytes, str, tuple of int or None
        See `decode_grey`.

    Raises
    ------
    UserError
        See `decode_grey`, except for damaged pixels.
    """
    try:
        if tiff_pictures.is_tiff(data):
            tiff_pictures.check_tiff_header(data, image_wh=image_wh)
        else:
            picture_damage.check_picture(data, image_wh=image_wh, pixels=False)
    except picture_damage.UnfitError as error:
        raise UserError(f"{where}: {error}") from error


def decode_grey(data: bytes, *, where: str, image_wh: tuple[int, int] | None = None) -> Grey:
    """Decode a picture to grey levels.

    Parameters
    ----------
    data : bytes
        Content of a PNG, JPEG or TIFF file.
    where : str
        File name, used in messages.
    image_wh : tuple of int or None
        Required width and height of the turned picture, which are checked before decoding.

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
    return decode_grey_alpha(data, where=where, image_wh=image_wh)[0]


def decode_grey_alpha(data: bytes, *, where: str, image_wh: tuple[int, int] | None = None) -> tuple[Grey, Grey | None]:
    """Decode a picture to grey levels and to its transparency.

    Parameters
    ----------
    data, where, image_wh : bytes, str, tuple of int or None
        See `decode_grey`.

    Returns
    -------
    grey : ndarray
        Grey levels, as from `decode_grey`.
    alpha : ndarray or None
        Opacity (H, W) of the same type, 0 where the picture is transparent. None if the file has no transparency.

    Raises
    ------
    UserError
        See `decode_grey`.
    """
    image, alpha = _decode(data, where, image_wh)
    return (image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))), alpha


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
    image, _ = _decode(data, where, image_wh)
    light = image if curve == LINEAR else curve.decode(image)
    if light.ndim == 2:
        return light
    grey = cv2.cvtColor(light, cv2.COLOR_BGR2GRAY)
    grey[(image >= np.iinfo(image.dtype).max).any(axis=2)] = np.iinfo(grey.dtype).max
    return np.asarray(grey)


def _decode(data: bytes, where: str, image_wh: tuple[int, int] | None) -> tuple[NDArray[np.uint8 | np.uint16], Grey | None]:
    """Decode a picture to grey (H, W) or to blue, green and red (H, W, 3), and to its transparency (H, W)."""
    try:
        if tiff_pictures.is_tiff(data):
            stored = tiff_pictures.read_tiff(data, image_wh=image_wh)
        else:
            stored = _decode_opencv(picture_damage.check_picture(data, image_wh=image_wh))
    except picture_damage.UnfitError as error:
        raise UserError(f"{where}: {error}") from error
    image = turn_picture(stored, read_orientation(data))
    if image.ndim == 2:
        return image, None
    colours, alpha = np.split(image, [1 if image.shape[2] < 3 else 3], axis=2)
    return np.ascontiguousarray(colours.squeeze(2) if colours.shape[2] == 1 else colours), alpha[..., 0] if alpha.size else None


def _decode_opencv(data: bytes) -> NDArray[np.uint8 | np.uint16]:
    """Decode a PNG or JPEG that has been checked, without turning it."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise picture_damage.UnfitError(picture_damage.NO_PICTURE)
    return image
