"""Checks of the integrity and the size of picture files.

They use the bytes before decoding, checksums, and strict decoders. The decoders of OpenCV repair damage silently, and
return missing parts grey or black. PNG has a CRC per chunk and a checksum over all pixels. JPEG has no checksum, so
that only violations of the coding are detected. TIFF is checked by `scenes.tiff_pictures`, which also decodes it.
"""

import re
import struct
import zlib
from collections.abc import Iterator

import numpy as np
import simplejpeg

from rhizotwin.scenes.orientation import TURNS, read_orientation

MOST_PIXELS = 2**27
"""Maximum number of pixels of a picture, 134 million. The largest sensors have 100 to 150 million pixels. In 16-bit
colour, a picture of this size requires 0.8 GB."""
NO_PICTURE = "the file is not a supported picture; use PNG, JPEG or TIFF"
"""Message for files that are not a picture."""
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_NEXT_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]")
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
"""Permitted numbers of channels and bit depths of a PNG, for each colour type (ISO/IEC 15948, table 11.1)."""
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""Passes of an interlaced PNG: first column, first row, column step and row step (ISO/IEC 15948, section 8.2)."""


class UnfitError(Exception):
    """Raised if a file is not a picture of the required kind and size. The message is appended to the file's name."""


class DamagedError(UnfitError):
    """Raised if a picture is incomplete or damaged."""

    def __init__(self, what: str) -> None:
        super().__init__(f"the picture is {what}; copy or take it again, or exclude it")


def check_picture(data: bytes, *, image_wh: tuple[int, int] | None = None, pixels: bool = True) -> bytes:
    """Check the integrity and size of a picture file.

    Parameters
    ----------
    data : bytes
        Content of a PNG or JPEG file.
    image_wh : tuple of int or None
        Required width and height after the picture has been turned as its orientation tag states; None for any size up
        to `MOST_PIXELS`.
    pixels : bool
        Whether the pixels are checked. Without them, the check takes a tenth of the time.

    Returns
    -------
    bytes
        Content of the file. For PNG, chunks that do not affect the pixels are omitted, because libpng prints warnings
        about some of them.

    Raises
    ------
    UnfitError
        If the file is empty, truncated or damaged, or if it has a different size or kind.
    """
    if not data:
        raise DamagedError("empty (0 bytes)")
    if data.startswith(_PNG):
        return _png(data, image_wh, pixels)
    if data.startswith(_JPEG):
        end = _jpeg_end(data, image_wh)
        if pixels:
            _decode_jpeg(data[:end])
        return data
    raise UnfitError(NO_PICTURE)


def check_size(width: int, height: int, image_wh: tuple[int, int] | None, orientation: int) -> None:
    """Raise UnfitError if the size of a picture is wrong.

    Parameters
    ----------
    width, height : int
        Size of the stored picture, px.
    image_wh : tuple of int or None
        Required size after the picture has been turned, px.
    orientation : int
        Orientation tag of the picture.
    """
    stored = f"{width}x{height}"
    if orientation >= 5:
        width, height = height, width
    if image_wh is not None and (width, height) != image_wh:
        tag = f" ({stored}, {TURNS[orientation]} as its orientation tag {orientation} states)" if orientation > 1 else ""
        remedy = ", correct the tag if the camera was not turned," if orientation > 1 else ""
        raise UnfitError(
            f"the picture has {width}x{height} pixels{tag}, but the scene's camera has image_wh {image_wh[0]}x{image_wh[1]}; "
            f"correct the scene{remedy} or remove the picture"
        )
    if width < 1 or height < 1:
        raise UnfitError(f"the picture has no pixels ({width}x{height}); remove it")
    if width * height > MOST_PIXELS:
        raise UnfitError(
            f"the picture has {width}x{height} pixels, more than the maximum of {MOST_PIXELS / 1e6:.0f} million; reduce its size"
        )


def _png(data: bytes, image_wh: tuple[int, int] | None, pixels: bool) -> bytes:
    """Check the chunks and pixels of a PNG (ISO/IEC 15948, sections 5, 9 and 10).

    Return the PNG without the chunks that are not required.
    """
    damaged = DamagedError("damaged (the content of the PNG file is inconsistent)")
    chunks: dict[bytes, list[memoryview]] = {}
    for kind, content in _chunks(data):
        if kind == b"IHDR":
            if chunks or len(content) != 13:
                raise damaged
            width, height = struct.unpack(">II", content[:8])
            check_size(width, height, image_wh, read_orientation(data))
        elif b"IHDR" not in chunks:
            raise damaged
        chunks.setdefault(kind, []).append(content)
    if b"IHDR" not in chunks:
        raise UnfitError(NO_PICTURE)
    width, height, depth, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", chunks[b"IHDR"][0])
    if depth not in _DEPTHS.get(colour, ()) or compression or filters or interlace > 1 or (colour == 3 and b"PLTE" not in chunks):
        raise damaged
    if len(chunks.get(b"PLTE", [b""])[0]) % 3:
        raise damaged
    if not pixels:
        return data
    sizes = [(width, height)]
    if interlace:
        sizes = [(-(-(width - x) // across), -(-(height - y) // down)) for x, y, across, down in _ADAM7]
    rows = [(1 + -(-wide * _CHANNELS[colour] * depth // 8), high) for wide, high in sizes if wide > 0 and high > 0]
    unpacked = _inflate(chunks.get(b"IDAT", []), sum(row * high for row, high in rows))
    at = 0
    for row, high in rows:
        if unpacked[at : at + row * high : row].max() > 4:  # filter type of each row
            raise damaged
        at += row * high
    kept = [(b"IHDR", chunks[b"IHDR"][0]), *((kind, chunks[kind][0]) for kind in (b"PLTE", b"tRNS") if colour == 3 and kind in chunks)]
    packed = b"".join(chunks[b"IDAT"])
    return _PNG + b"".join(_chunk(kind, bytes(content)) for kind, content in [*kept, (b"IDAT", packed), (b"IEND", b"")])


def _chunks(data: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Yield the type and the content of each chunk of a PNG up to IEND."""
    view = memoryview(data)
    at = len(_PNG)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if crc != zlib.crc32(view[at + 4 : end - 4]):
            raise DamagedError("damaged (a checksum in the PNG file is wrong)")
        kind = data[at + 4 : at + 8]
        if kind == b"IEND":
            return
        yield kind, view[at + 8 : end - 4]
        at = end
    raise DamagedError("truncated (the PNG file ends too early)")


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(content, zlib.crc32(kind)))


def _inflate(packed: list[memoryview], count: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    """Decompress the rows of a PNG, and check their number of bytes and their checksum."""
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(b"".join(packed), count + 1)
        if len(found) == count and not unpacker.eof:
            found += unpacker.decompress(unpacker.unconsumed_tail, 1)
    except zlib.error:
        raise DamagedError("damaged (the pixels cannot be decompressed)") from None
    if len(found) < count and not unpacker.eof:
        raise DamagedError("truncated (the PNG file ends too early)")
    if len(found) != count or not unpacker.eof:
        raise DamagedError("damaged (the number of pixels does not match the header)")
    return np.frombuffer(found, np.uint8)


def _jpeg_end(data: bytes, image_wh: tuple[int, int] | None) -> int:
    """Check the segments and scans of a JPEG (ITU-T T.81, annex B), and return the position after its end marker."""
    truncated = DamagedError("truncated (the JPEG file ends too early)")
    at = 2
    while True:
        found = _NEXT_MARKER.search(data, at)
        if found is None:
            raise truncated
        code, at = data[found.end() - 1], found.end()
        if code == 0xD9:
            return at
        if code == 0x01:  # marker without a length
            continue
        if at + 2 > len(data):
            raise truncated
        (length,) = struct.unpack_from(">H", data, at)
        if 0xC0 <= code <= 0xCF and code not in (0xC4, 0xC8, 0xCC) and at + 7 <= len(data):
            height, width = struct.unpack_from(">HH", data, at + 3)
            check_size(width, height, image_wh, read_orientation(data))
        at += length


def _decode_jpeg(data: bytes) -> None:
    """Decode a JPEG strictly, which detects violations of the coding."""
    try:
        colours = simplejpeg.decode_jpeg_header(data)[2]
        simplejpeg.decode_jpeg(data, "CMYK" if colours in ("CMYK", "YCCK") else "GRAY", strict=True)
    except ValueError as error:
        raise DamagedError(f"damaged ({error})") from None
