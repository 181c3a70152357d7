"""Checks of the integrity and the size of picture files.

They use the bytes before decoding, checksums, and strict decoders. The decoders of OpenCV repair damage silently, and
return missing parts grey or black. PNG has a CRC per chunk and a checksum over all pixels, as has Deflate in TIFF.
JPEG, LZW and PackBits have no checksums. For these formats, violations of the coding are detected, as are strips of a
TIFF that do not contain exactly their pixels. For uncompressed pixels, only a wrong number of pixels is detected.
`is_sealed` returns whether a file has a checksum.
"""

import io
import logging
import re
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import simplejpeg
import tifffile

MOST_PIXELS = 2**27
"""Maximum number of pixels of a picture, 134 million. The largest sensors have 100 to 150 million pixels. In 16-bit
colour, a picture of this size requires 0.8 GB."""
_NO_PICTURE = "the file is not a supported picture; use PNG, JPEG or TIFF"
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BARE, _LZW, _DEFLATE, _PACKBITS = 1, 5, (8, 32946), 32773
"""Compression schemes of TIFF, in this order: none, LZW, Deflate, PackBits (TIFF 6.0, section 3 and supplement 2)."""
_WITHOUT_CODECS = (_BARE, *_DEFLATE, _PACKBITS)
"""Compression schemes that tifffile decodes without imagecodecs, which is an optional dependency of 80 MB."""
_MIRRORED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
"""Byte values with their bits in reverse order (TIFF 6.0, FillOrder 2)."""
_NEXT_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]")
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
"""Permitted numbers of channels and bit depths of a PNG, for each colour type (ISO/IEC 15948, table 11.1)."""
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""Passes of an interlaced PNG: first column, first row, column step and row step (ISO/IEC 15948, section 8.2)."""

logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # the messages of tifffile are replaced by one sentence


class UnfitError(Exception):
    """Raised if a file is not a picture of the required kind and size. The message is appended to the file's name."""


class DamagedError(UnfitError):
    """Raised if a picture is incomplete or damaged."""

    def __init__(self, what: str) -> None:
        super().__init__(f"the picture is {what}; copy or take it again, or exclude it")


def check_picture(data: bytes, *, image_wh: tuple[int, int] | None = None) -> bytes:
    """Check the integrity and size of a picture file.

    Parameters
    ----------
    data : bytes
        Content of a PNG, JPEG or TIFF file.
    image_wh : tuple of int or None
        Required width and height; None for any size up to `MOST_PIXELS`.

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
        return _png(data, image_wh)
    if data.startswith(_JPEG):
        _jpeg(data, image_wh)
    elif data.startswith(_TIFF):
        _tiff(data, image_wh)
    else:
        raise UnfitError(_NO_PICTURE)
    return data


def _check_size(width: int, height: int, image_wh: tuple[int, int] | None) -> None:
    if image_wh is not None and (width, height) != image_wh:
        raise UnfitError(
            f"the picture has {width}x{height} pixels, but the scene's camera has image_wh {image_wh[0]}x{image_wh[1]}; correct the scene "
            "or remove the picture"
        )
    if width < 1 or height < 1:
        raise UnfitError(f"the picture has no pixels ({width}x{height}); remove it")
    if width * height > MOST_PIXELS:
        raise UnfitError(
            f"the picture has {width}x{height} pixels, more than the maximum of {MOST_PIXELS / 1e6:.0f} million; reduce its size"
        )


def _png(data: bytes, image_wh: tuple[int, int] | None) -> bytes:
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
            _check_size(width, height, image_wh)
        elif b"IHDR" not in chunks:
            raise damaged
        chunks.setdefault(kind, []).append(content)
    if b"IHDR" not in chunks:
        raise UnfitError(_NO_PICTURE)
    width, height, depth, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", chunks[b"IHDR"][0])
    if depth not in _DEPTHS.get(colour, ()) or compression or filters or interlace > 1 or (colour == 3 and b"PLTE" not in chunks):
        raise damaged
    if len(chunks.get(b"PLTE", [b""])[0]) % 3:
        raise damaged
    sizes = [(width, height)]
    if interlace:
        sizes = [(-(-(width - x) // across), -(-(height - y) // down)) for x, y, across, down in _ADAM7]
    rows = [(1 + -(-wide * _CHANNELS[colour] * depth // 8), high) for wide, high in sizes if wide > 0 and high > 0]
    pixels = _inflate(chunks.get(b"IDAT", []), sum(row * high for row, high in rows))
    at = 0
    for row, high in rows:
        if pixels[at : at + row * high : row].max() > 4:  # filter type of each row
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


def _jpeg(data: bytes, image_wh: tuple[int, int] | None) -> None:
    """Check the segments and scans of a JPEG up to its end marker, and decode it strictly (ITU-T T.81, annex B)."""
    truncated = DamagedError("truncated (the JPEG file ends too early)")
    at = 2
    while True:
        found = _NEXT_MARKER.search(data, at)
        if found is None:
            raise truncated
        code, at = data[found.end() - 1], found.end()
        if code == 0xD9:
            break
        if code == 0x01:  # marker without a length
            continue
        if at + 2 > len(data):
            raise truncated
        (length,) = struct.unpack_from(">H", data, at)
        if 0xC0 <= code <= 0xCF and code not in (0xC4, 0xC8, 0xCC) and at + 7 <= len(data):
            height, width = struct.unpack_from(">HH", data, at + 3)
            _check_size(width, height, image_wh)
        at += length
    try:
        colours = simplejpeg.decode_jpeg_header(data)[2]
        simplejpeg.decode_jpeg(data[:at], "CMYK" if colours in ("CMYK", "YCCK") else "GRAY", strict=True)
    except ValueError as error:
        raise DamagedError(f"damaged ({error})") from None


def is_sealed(data: bytes) -> bool:
    """Return whether a picture file that `check_picture` has accepted contains a checksum of its pixels."""
    if data.startswith(_TIFF):
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            return int(file.pages.first.compression) in _DEFLATE
    return data.startswith(_PNG)


def _tiff(data: bytes, image_wh: tuple[int, int] | None) -> None:
    """Decode the first picture of a TIFF strictly, by strips or tiles (TIFF 6.0)."""
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages[0]
            if not isinstance(page, tifffile.TiffPage):
                raise DamagedError("damaged (the directory of the TIFF file cannot be read)")
            _check_size(page.imagewidth, page.imagelength, image_wh)
            if page.samplesperpixel * page.bitspersample > 128:
                raise UnfitError(
                    f"the picture has {page.samplesperpixel} times {page.bitspersample} bits per pixel; convert it to a 16-bit PNG"
                )
            codecs = None if page.compression in _WITHOUT_CODECS else _codecs(page.compression)
            for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
                if count <= 0 or offset + count > len(data):
                    raise DamagedError("truncated (the TIFF file ends too early)")
            _tiff_pieces(data, page, codecs)
            if page.compression != _PACKBITS:  # PackBits was decompressed above; newer versions of imagecodecs have no codec for it
                page.asarray()
    except UnfitError:
        raise
    except Exception as error:  # noqa: BLE001 - tifffile and its codecs raise various exceptions
        said = " ".join(str(error).split())[:100]
        raise DamagedError(f"damaged (the TIFF file cannot be decoded: {said})") from None


def _codecs(compression: int) -> Any:
    """Return the module imagecodecs, which is required for the given compression of a TIFF."""
    try:
        import imagecodecs
    except ImportError:
        name = getattr(compression, "name", compression)
        raise UnfitError(
            f"the file is a TIFF with {name} compression, which requires another package; run pip install 'rhizotwin[tiff]', or convert "
            "it to PNG"
        ) from None
    return imagecodecs


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


def _tiff_pieces(data: bytes, page: tifffile.TiffPage, codecs: Any) -> None:
    """Decompress each strip or tile, and check its size in bytes.

    Decoders would pad or truncate it without an error.
    """
    high, wide = (page.tilelength, page.tilewidth) if page.is_tiled else (page.rowsperstrip, page.imagewidth)
    across = -(-page.imagewidth // wide)
    down = -(-page.imagelength // high)
    samples = page.samplesperpixel if page.planarconfig == 1 else 1
    row = -(-wide * samples * page.bitspersample // 8)
    for k, (offset, count) in enumerate(zip(page.dataoffsets, page.databytecounts, strict=True)):
        rows = high if page.is_tiled else min(high, page.imagelength - k // across % down * high)
        packed = data[offset : offset + count]
        if page.fillorder == 2:
            packed = packed.translate(_MIRRORED)
        if page.compression in _DEFLATE:
            found = len(zlib.decompress(packed))
        elif page.compression == _LZW:
            found = len(codecs.lzw_decode(packed))
        elif page.compression == _PACKBITS:
            found = len(_packbits(packed))
        elif page.compression == _BARE:
            found = min(count, rows * row)
        else:
            return
        if found != rows * row:
            raise DamagedError(f"damaged (strip or tile {k + 1} of the TIFF file contains {found} bytes of pixels instead of {rows * row})")
