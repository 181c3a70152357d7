"""Reader of TIFF pictures (TIFF 6.0), which checks the integrity of the file while it decodes it.

The pixels that were checked are those that are returned, because there is only one decoder, tifffile. Deflate has a
checksum over all pixels of a strip; LZW and PackBits have none, but strips that do not contain exactly their pixels are
detected. For uncompressed pixels, only a wrong number of pixels is detected.

OpenCV 5.0 is not used, because it reads 16-bit separate planes as noise, does not invert 16-bit pictures in which white
is zero, reduces 16-bit grey with transparency to 8 bits, and multiplies 8-bit colours by the transparency.
"""

import io
import logging
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from rhizotwin.scenes.errors import pip_install
from rhizotwin.scenes.orientation import read_orientation
from rhizotwin.scenes.picture_damage import DamagedError, UnfitError, check_size

_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BARE, _LZW, _DEFLATE, _PACKBITS, _JPEG = 1, 5, (8, 32946), 32773, (6, 7)
"""Compression schemes, in this order: none, LZW, Deflate, PackBits, JPEG (TIFF 6.0, section 3 and supplement 2)."""
_WITHOUT_CODECS = (_BARE, *_DEFLATE, _PACKBITS)
"""Compression schemes that are decoded without imagecodecs, which is an optional dependency of 80 MB."""
_MIRRORED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
"""Byte values with their bits in reverse order (TIFF 6.0, FillOrder 2)."""
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR = 0, 1, 2, 3, 6
"""Supported kinds of pixels (TIFF 6.0, PhotometricInterpretation). YCbCr requires JPEG, whose decoder returns RGB."""
_ASSOCIATED = 1
"""Kind of transparency by which the colours are multiplied (TIFF 6.0, ExtraSamples)."""

Pixels = NDArray[np.uint8 | np.uint16]

logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # the messages of tifffile are replaced by one sentence


def is_tiff(data: bytes) -> bool:
    """Return whether a file is a TIFF, by its first bytes."""
    return data.startswith(_MAGIC)


def has_checksum(data: bytes) -> bool:
    """Return whether a TIFF contains a checksum of its pixels."""
    with _first_page(data) as page:
        return int(page.compression) in _DEFLATE


def check_tiff_header(data: bytes, *, image_wh: tuple[int, int] | None = None) -> None:
    """Check the size and the kind of a TIFF without decoding it.

    The parameters and errors are those of `read_tiff`.
    """
    with _first_page(data) as page:
        _check_page(data, page, image_wh)


def read_tiff(data: bytes, *, image_wh: tuple[int, int] | None = None) -> Pixels:
    """Decode the picture in a TIFF strictly, by strips or tiles.

    Parameters
    ----------
    data : bytes
        Content of the file.
    image_wh : tuple of int or None
        Required width and height after the picture has been turned as its orientation tag states.

    Returns
    -------
    ndarray
        Stored picture in the order of OpenCV: grey (H, W), grey with transparency (H, W, 2), blue, green and red
        (H, W, 3), or these with transparency (H, W, 4). White is the maximum of uint8 (up to 8 bits) or uint16.

    Raises
    ------
    UnfitError
        If the file is truncated or damaged, has a different size, several pages, or pixels of an unsupported kind.
    """
    with _first_page(data) as page:
        _check_page(data, page, image_wh)
        stored = _decode(data, page)
        image = stored[0, 0] if page.planarconfig == 1 else np.moveaxis(stored[:, 0, :, :, 0], 0, -1)
        return _to_opencv(image, page)


@contextmanager
def _first_page(data: bytes) -> Iterator[tifffile.TiffPage]:
    """Open the first page of a TIFF. Errors of tifffile and of its codecs are raised as DamagedError."""
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages[0]
            if not isinstance(page, tifffile.TiffPage):
                raise DamagedError("damaged (the directory of the TIFF file cannot be read)")
            yield page
    except UnfitError:
        raise
    except Exception as error:  # noqa: BLE001 - tifffile and its codecs raise various exceptions
        said = " ".join(str(error).split())[:100]
        raise DamagedError(f"damaged (the TIFF file cannot be decoded: {said})") from None


def _check_page(data: bytes, page: tifffile.TiffPage, image_wh: tuple[int, int] | None) -> None:
    """Raise UnfitError if the first page of a TIFF has another size, or is not the only picture of a supported kind."""
    check_size(page.imagewidth, page.imagelength, image_wh, read_orientation(data))
    bits, samples = page.bitspersample, page.samplesperpixel
    if page.dtype is None or page.dtype.kind not in "bu" or bits > 16:
        name = f"{bits}-bit" if page.dtype is None else page.dtype.name
        raise UnfitError(f"the picture has {name} pixels, but 8- or 16-bit unsigned integers are required; convert it to a 16-bit PNG")
    pages = page.parent.pages
    if page.imagedepth > 1 or (len(pages) > 1 and not _is_reduced(pages[1])):
        raise UnfitError("the TIFF file contains several pictures; save each of them as a separate file")
    kind = int(page.photometric)
    if kind not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE) and not (kind == _YCBCR and page.compression in _JPEG):
        raise UnfitError(f"the picture has pixels of the kind {_name(page.photometric)}, but grey or RGB is required; convert it to PNG")
    colours = 3 if kind in (_RGB, _YCBCR) else 1
    if samples < colours or samples > 4 or (colours == 1 and samples > 2):
        raise UnfitError(f"the picture has {samples} channels of the kind {_name(page.photometric)}; convert it to a grey or RGB PNG")
    if page.compression not in _WITHOUT_CODECS:
        _codecs(f"{_name(page.compression)} compression")
    if bits not in (1, 8, 16):
        _codecs(f"{bits} bits per pixel")


def _is_reduced(page: Any) -> bool:
    """Return whether a further page of a TIFF is a thumbnail or a mask of the first (TIFF 6.0, NewSubfileType)."""
    return bool(page.aspage().subfiletype & 0b101)


def _name(value: int) -> str:
    """Return the name of a value in a TIFF, or the value if it is unknown to tifffile."""
    return str(getattr(value, "name", value))


def _codecs(what: str) -> Any:
    """Return the module imagecodecs, which is required for TIFF with some properties (``what``, for the message)."""
    try:
        import imagecodecs
    except ImportError:
        raise UnfitError(
            f"the file is a TIFF with {what}, which requires another package; run {pip_install('imagecodecs')}, or convert it to PNG"
        ) from None
    return imagecodecs


def _decode(data: bytes, page: tifffile.TiffPage) -> NDArray[Any]:
    """Return the numbers in a page, with the shape ``page.shaped`` (planes, depth, length, width, channels).

    Decoders would pad or truncate strips and tiles of a wrong size without an error. Hence they are decompressed here,
    and tifffile unpacks the decompressed bytes.
    """
    high, wide = (page.tilelength, page.tilewidth) if page.is_tiled else (page.rowsperstrip, page.imagewidth)
    across, down = -(-page.imagewidth // wide), -(-page.imagelength // high)
    planes, _, length, width, channels = page.shaped
    row = -(-wide * channels * page.bitspersample // 8)
    pieces = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    if len(pieces) != planes * across * down:
        raise DamagedError(f"damaged (the TIFF file has {len(pieces)} strips or tiles instead of {planes * across * down})")
    if any(count <= 0 or offset + count > len(data) for offset, count in pieces):
        raise DamagedError("truncated (the TIFF file ends too early)")
    compression, is_mirrored = int(page.compression), page.fillorder == 2
    if compression not in (*_WITHOUT_CODECS, _LZW):
        return np.asarray(page.asarray(squeeze=False))
    page.compression, page.fillorder = _BARE, 1  # of the bytes that tifffile receives
    found = np.zeros(page.shaped, page.dtype)
    for k, (offset, count) in enumerate(pieces):
        rows = high if page.is_tiled else min(high, length - k // across % down * high)
        packed = data[offset : offset + count]
        unpacked = _decompress(packed.translate(_MIRRORED) if is_mirrored else packed, compression, rows * row)
        if len(unpacked) != rows * row:
            raise DamagedError(
                f"damaged (strip or tile {k + 1} of the TIFF file contains {len(unpacked)} bytes of pixels instead of {rows * row})"
            )
        piece, (plane, _, y, x, _), _ = page.decode(unpacked, k)
        part = np.asarray(piece)[0, : length - y, : width - x]
        found[plane, 0, y : y + part.shape[0], x : x + part.shape[1]] = part
    return found


def _decompress(packed: bytes, compression: int, size: int) -> bytes:
    """Decompress a strip or tile. Only the first ``size`` bytes of uncompressed pixels are returned."""
    if compression in _DEFLATE:
        return zlib.decompress(packed)
    if compression == _LZW:
        return bytes(_codecs("LZW compression").lzw_decode(packed))
    return _packbits(packed) if compression == _PACKBITS else packed[:size]


def _packbits(packed: bytes) -> bytes:
    """Decompress data in the PackBits format (TIFF 6.0, section 9).

    If the data are damaged, return what can be decompressed.
    """
    found, at = bytearray(), 0
    while at < len(packed):
        header, at = packed[at], at + 1
        if header < 128:
            found += packed[at : at + header + 1]
            at += header + 1
        elif header > 128:
            found += packed[at : at + 1] * (257 - header)
            at += 1
    return bytes(found)


def _to_opencv(image: NDArray[Any], page: tifffile.TiffPage) -> Pixels:
    """Convert the numbers (H, W, C) of a page to the channels that `read_tiff` returns."""
    kind, bits = int(page.photometric), page.bitspersample
    full = 255 if bits <= 8 else 65535
    if bits not in (8, 16) and kind != _PALETTE:
        image = (image.astype(np.uint32) * full + (1 << bits) // 2 - 1) // ((1 << bits) - 1)
    image = image.astype(np.uint8 if full == 255 else np.uint16, copy=False)
    colours, alpha = image[..., : 3 if kind in (_RGB, _YCBCR) else 1], image[..., 3 if kind in (_RGB, _YCBCR) else 1 :]
    if kind == _WHITE_IS_ZERO:
        colours = full - colours
    if kind == _PALETTE:
        levels = np.asarray(page.colormap)
        levels = levels if levels.max() < 256 else levels >> 8  # some programs write 8 bits
        colours = np.moveaxis(levels[:, colours[..., 0]].astype(np.uint8), 0, -1)
    if alpha.size and page.extrasamples and int(page.extrasamples[0]) == _ASSOCIATED and alpha.min() < full:
        raise UnfitError("the colours of the picture are multiplied by its transparency; save it without transparency")
    if alpha.size == 0 and colours.shape[-1] == 1:
        return np.ascontiguousarray(colours[..., 0])
    return np.ascontiguousarray(np.concatenate([colours[..., ::-1], alpha], axis=-1))
