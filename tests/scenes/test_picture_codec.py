"""Pictures: grey levels kept, damage named, TIFF with and without imagecodecs; curves against published values and Pillow."""

import io
import struct
import sys
import tracemalloc
import zlib
from io import BytesIO
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps
from PIL.PngImagePlugin import PngInfo

from rhizotwin.scenes import transfer
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.picture_codec import decode_grey, decode_light
from rhizotwin.scenes.transfer import LINEAR, SRGB

RNG = np.random.default_rng(7)
GREY = RNG.integers(0, 256, (40, 60), dtype=np.uint8)


def tiff(image: Any, **options: Any) -> bytes:
    file = BytesIO()
    tifffile.imwrite(file, image, **options)
    return file.getvalue()


def encoded(image: Any, suffix: str = ".png", *options: int) -> bytes:
    ok, data = cv2.imencode(suffix, image, options)
    assert ok
    return bytes(data.tobytes())


def with_thumbnail(jpeg: bytes) -> bytes:
    """Put a small whole JPEG into an application segment, as cameras do: its end marker is not the picture's."""
    inner = encoded(GREY[:8, :8], ".jpg")
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(inner) + 2) + inner + jpeg[2:]


WHOLE = {
    "png": encoded(GREY),
    "jpeg": encoded(GREY, ".jpg"),
    "progressive jpeg": encoded(GREY, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "jpeg with a thumbnail": with_thumbnail(encoded(GREY, ".jpg")),
}


@pytest.mark.parametrize("data", WHOLE.values(), ids=WHOLE)
def test_whole_pictures_are_read_and_truncated_ones_named(data: bytes) -> None:
    assert decode_grey(data, where="a").shape == GREY.shape
    assert decode_grey(data + b"trailer of some phone \xff\xd8\xff", where="a").shape == GREY.shape
    for kept in (0.2, 0.5, 0.9, 0.999):
        with pytest.raises(UserError, match=r"view_003\.png: the picture is truncated"):
            decode_grey(data[: int(kept * len(data))], where="view_003.png")


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes(b ^ 0x41 for b in data[at : at + 2]) + data[at + 2 :]


NO_PICTURE = {
    "flipped bit": (flipped(WHOLE["png"], len(WHOLE["png"]) // 2), "damaged"),
    "half a jpeg with an end marker": (WHOLE["jpeg"][: len(WHOLE["jpeg"]) // 2] + b"\xff\xd9", "the picture is damaged"),
    "gif": (b"GIF89a" + b"\x00" * 9, "is not a supported picture"),
    "empty": (b"", "empty"),
    "png without pixels": (b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sI", 0, b"IEND", zlib.crc32(b"IEND")), "is not a supported picture"),
    "floats": (encoded(np.ones((4, 4), np.float32), ".tiff"), "8- or 16-bit"),
    "signed": (tiff(np.ones((4, 4), np.int16)), "int16 pixels"),
    "stack": (tiff(np.ones((3, 4, 4), np.uint8), photometric="minisblack"), "several pictures"),
    "three grey planes": (tiff(np.ones((3, 9, 9), np.uint8), photometric="minisblack", planarconfig="separate"), "3 channels"),
    "CMYK": (tiff(np.ones((4, 4, 4), np.uint8), photometric="separated"), "SEPARATED"),
    "multiplied by alpha": (tiff(np.ones((4, 4, 4), np.uint8), photometric="rgb", extrasamples=["assocalpha"]), "transparency"),
}


@pytest.mark.parametrize(("data", "says"), NO_PICTURE.values(), ids=NO_PICTURE)
def test_what_is_no_picture(data: bytes, says: str) -> None:
    with pytest.raises(UserError, match=says):
        decode_grey(data, where="a")


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_levels_and_depth_are_kept_and_colours_are_luminance(kind: type) -> None:
    blue_green_red = RNG.integers(0, np.iinfo(kind).max, (6, 9, 3), dtype=kind, endpoint=True)
    grey, with_alpha = decode_grey(encoded(blue_green_red[..., 0]), where="a"), np.concatenate([blue_green_red, 0 * blue_green_red], axis=2)
    found = np.stack([decode_grey(encoded(image), where="a") for image in (blue_green_red, with_alpha[..., :4])])
    assert grey.dtype == found.dtype == kind
    np.testing.assert_array_equal(grey, blue_green_red[..., 0])
    # OpenCV's weights are rounded to 14 bits
    np.testing.assert_allclose(found, [blue_green_red @ np.array([0.114, 0.587, 0.299])] * 2, atol=1.0, rtol=5e-5)


COMPRESSIONS = {"bare": 1, "LZW": 5, "Deflate": 8, "PackBits": 32773}


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_tiffs_are_read_whole_and_refused_truncated(compression: str, kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
    grey = RNG.integers(0, np.iinfo(kind).max, (40, 60), dtype=kind, endpoint=True)
    grey[10:20, 5:50] = 7  # PackBits has runs and literals
    data = encoded(grey, ".tiff", cv2.IMWRITE_TIFF_COMPRESSION, COMPRESSIONS[compression])
    found = decode_grey(data, where="a")
    assert found.dtype == kind
    np.testing.assert_array_equal(found, grey)
    for kept in (0.2, 0.5, 0.9):
        with pytest.raises(UserError, match=r"the picture is (truncated|damaged)"):
            decode_grey(data[: int(kept * len(data))], where="a")
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    if compression == "LZW":
        with pytest.raises(UserError, match=r"TIFF with LZW compression, .* run .* -m pip install imagecodecs, or convert it to PNG"):
            decode_grey(data, where="a")
    else:
        np.testing.assert_array_equal(decode_grey(data, where="a"), grey)


DEEP = RNG.integers(0, 65536, (40, 60, 4), dtype=np.uint16)
WEIGHTS = np.array([0.299, 0.587, 0.114])
LUMINANCE = DEEP[..., :3] @ WEIGHTS
PLANES = np.moveaxis(DEEP, -1, 0)
TIFFS: dict[str, tuple[Any, dict[str, Any], Any]] = {
    "planes": (PLANES[:3], {"photometric": "rgb", "planarconfig": "separate", "compression": "lzw", "predictor": True}, LUMINANCE),
    "four planes in tiles": (PLANES, {"photometric": "rgb", "planarconfig": "separate", "tile": (16, 32)}, LUMINANCE),
    "big-endian BigTIFF": (DEEP[..., :3], {"photometric": "rgb", "byteorder": ">", "bigtiff": True, "rowsperstrip": 7}, LUMINANCE),
    "white is zero": (DEEP[..., 0], {"photometric": "miniswhite"}, 65535 - DEEP[..., 0]),
    "grey and alpha": (DEEP[..., :2], {"photometric": "minisblack", "extrasamples": ["unassalpha"]}, DEEP[..., 0]),
    "8-bit colours and alpha": ((DEEP >> 8).astype(np.uint8), {"photometric": "rgb"}, (DEEP[..., :3] >> 8) @ WEIGHTS),
    "12 bits": (DEEP[..., 0] >> 4, {"bitspersample": 12}, np.rint((DEEP[..., 0] >> 4) * (65535 / 4095))),
    "one bit": (GREY > 99, {"photometric": "miniswhite"}, 255 * (GREY <= 99)),
    "palette": (GREY, {"photometric": "palette", "colormap": np.tile(np.arange(256)[::-1] * 257, (3, 1)).astype(np.uint16)}, 255 - GREY),
}


@pytest.mark.parametrize(("stored", "options", "expected"), TIFFS.values(), ids=TIFFS)
def test_every_kind_of_tiff_has_its_value(stored: Any, options: dict[str, Any], expected: Any) -> None:
    np.testing.assert_allclose(decode_grey(tiff(stored, **options), where="a"), expected, atol=1.0, rtol=5e-5)


ORIENTED = {"PNG": "exif", "JPEG": "exif", "TIFF": "tiffinfo"}


@pytest.mark.parametrize("kind", ORIENTED)
@pytest.mark.parametrize("tag", range(1, 9))
def test_all_formats_are_turned_as_their_tag_states(tag: int, kind: str) -> None:
    said = Image.Exif()
    said[274] = tag
    file = BytesIO()
    Image.fromarray(GREY).save(file, kind, **{ORIENTED[kind]: said})
    shown = np.array(ImageOps.exif_transpose(Image.open(file)))
    np.testing.assert_array_equal(decode_grey(file.getvalue(), where="a", image_wh=(60, 40) if tag < 5 else (40, 60)), shown)
    if tag >= 5:
        with pytest.raises(UserError, match=rf"40x60 pixels \(60x40, .*orientation tag {tag} states\), but .* 60x40; correct the scene"):
            decode_grey(file.getvalue(), where="a", image_wh=(60, 40))


def test_flipped_bytes_in_a_compressed_tiff() -> None:
    """OpenCV gives the rows black that it cannot unpack."""
    data = encoded(RNG.integers(100, 140, (120, 160), dtype=np.uint8), ".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 8)
    assert decode_grey(data, where="a").min() >= 100
    for at in range(100, len(data) - 500, 997):
        with pytest.raises(UserError, match=r"a\.tiff: the picture is damaged"):
            decode_grey(flipped(data, at), where="a.tiff")


def png_of(header: bytes, pixels: bytes) -> bytes:
    chunks = [(b"IHDR", header), (b"tEXt", b"Comment\0x" * 20), (b"iCCP", b"nonsense"), (b"IDAT", pixels), (b"IEND", b"")]
    coded = [struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(c, zlib.crc32(k))) for k, c in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(coded)


def test_a_png_that_lies_with_right_checksums(capfd: pytest.CaptureFixture[str]) -> None:
    rows = b"".join(b"\0" + bytes(range(60)) for _ in range(40))
    header = struct.pack(">IIBBBBB", 60, 40, 8, 0, 0, 0, 0)
    assert decode_grey(png_of(header, zlib.compress(rows)), where="a").shape == (40, 60)
    for bad in (
        png_of(header, zlib.compress(rows[:-5])),
        png_of(header, zlib.compress(rows)[:-4]),
        png_of(header, zlib.compress(b"\x09" + rows[1:])),
        png_of(struct.pack(">IIBBBBB", 60, 40, 8, 3, 0, 0, 0), zlib.compress(rows)),
    ):
        with pytest.raises(UserError, match=r"the picture is (damaged|truncated)"):
            decode_grey(bad, where="a")
    said = capfd.readouterr()
    assert said.out == said.err == ""  # libpng's own lines


def test_interlaced_and_palette_pngs_are_read() -> None:
    for wide, high in ((60, 40), (1, 1), (3, 9)):
        picture = Image.fromarray(GREY[:high, :wide]).convert("P")
        stored = BytesIO()
        picture.save(stored, "PNG")
        np.testing.assert_allclose(decode_grey(stored.getvalue(), where="a"), GREY[:high, :wide], atol=1.0)
    # Adam7 with one bit a pixel, the passes of an 8x8 chessboard written by hand
    board = np.indices((8, 8)).sum(axis=0) % 2
    passes = [board[y::down, x::across] for x, y, across, down in
              ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))]  # fmt: skip
    rows = b"".join(b"\0" + np.packbits(row.astype(np.uint8)).tobytes() for part in passes for row in part)
    header = struct.pack(">IIBBBBB", 8, 8, 1, 0, 0, 0, 1)
    np.testing.assert_array_equal(decode_grey(png_of(header, zlib.compress(rows)), where="a"), 255 * board)


def test_size_is_looked_at_before_the_pixels() -> None:
    """A small file of a huge picture is refused at once; a decoder would fill the memory."""
    tracemalloc.start()
    huge = struct.pack(">IIBBBBB", 30000, 30000, 16, 2, 0, 0, 0)
    jpeg = WHOLE["jpeg"]
    frame = jpeg.index(b"\xff\xc0") + 5
    large = cv2.imencode(".tiff", GREY, [cv2.IMWRITE_TIFF_COMPRESSION, 8])[1].tobytes()
    for data in (
        png_of(huge, zlib.compress(bytes(1000))),
        jpeg[:frame] + struct.pack(">HH", 30000, 30000) + jpeg[frame + 4 :],
        large.replace(struct.pack("<HHIHH", 256, 3, 1, 60, 0), struct.pack("<HHIHH", 256, 3, 1, 60000, 0)).replace(
            struct.pack("<HHIHH", 257, 3, 1, 40, 0), struct.pack("<HHIHH", 257, 3, 1, 60000, 0)
        ),
    ):
        with pytest.raises(UserError, match=r"[36]0000x[36]0000 pixels"):
            decode_grey(data, where="a")
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()
    with pytest.raises(UserError, match=r"60x40 pixels, but the scene's camera has image_wh 64x48"):
        decode_grey(WHOLE["png"], where="a", image_wh=(64, 48))


RAMP = Image.fromarray(np.arange(256, dtype=np.uint8).reshape(16, 16))


def saved(kind: str, **options: object) -> bytes:
    out = io.BytesIO()
    RAMP.convert("RGB").save(out, kind, **options)
    return out.getvalue()


def png_with(chunk: bytes, data: bytes) -> bytes:
    said = PngInfo()
    said.add(chunk, data)
    return saved("PNG", pnginfo=said)


def exif(tag: int, value: object) -> Image.Exif:
    made = Image.Exif()
    made.get_ifd(0x8769)[tag] = value
    return made


def test_srgb_has_the_published_values() -> None:
    # IEC 61966-2-1: 8-bit 10, 118, 188 are 0.003035, 0.181164, 0.502886 of full light
    np.testing.assert_allclose(SRGB.of(np.array([10, 118, 188]) / 255.0), [0.003035, 0.181164, 0.502886], atol=2e-6)
    np.testing.assert_allclose(SRGB.number(SRGB.of(np.linspace(0, 1, 57))), np.linspace(0, 1, 57), atol=1e-6)
    np.testing.assert_array_equal(SRGB.decode(np.array([0, 118, 255], np.uint8)), [0, round(0.181164 * 65535), 65535])
    np.testing.assert_array_equal(LINEAR.decode(np.array([0, 51, 255], np.uint8)), [0, 13107, 65535])


CURVE = b"curv\x00\x00\x00\x00\x00\x00\x00\x01" + round(1.8 * 256).to_bytes(2, "big") + b"\x00\x00"
GAMMA = bytes(128) + (1).to_bytes(4, "big") + b"kTRC" + (144).to_bytes(4, "big") + len(CURVE).to_bytes(4, "big") + CURVE


def tiff_with_profile() -> bytes:
    out = io.BytesIO()
    tifffile.imwrite(out, np.zeros((9, 9, 2), np.uint16), photometric="minisblack", extrasamples=["unassalpha"], iccprofile=GAMMA)
    return out.getvalue()


STATED: dict[str, tuple[bytes, transfer.Curve | None]] = {
    "png": (saved("PNG"), None),
    "srgb": (png_with(b"sRGB", b"\x00"), SRGB),
    "gama 1/2.2": (png_with(b"gAMA", (45455).to_bytes(4, "big")), transfer.power(2.2)),
    "exif srgb": (saved("JPEG", exif=exif(0xA001, 1)), SRGB),
    "icc with a plain gamma": (saved("PNG", icc_profile=GAMMA), transfer.power(1.8)),
    "icc in a kind of tiff that Pillow does not open": (tiff_with_profile(), transfer.power(1.8)),
    "exif adobe rgb": (saved("JPEG", exif=exif(0xA005, {1: "R03"})), transfer.power(2.2)),
    "icc damaged": (saved("JPEG", icc_profile=b"no profile at all" * 20), None),
}


@pytest.mark.parametrize(("data", "expected"), STATED.values(), ids=STATED.keys())
def test_a_file_says_its_curve(data: bytes, expected: transfer.Curve | None) -> None:
    found = transfer.read_stated_curve(data)
    assert (found is None) == (expected is None)
    assert found is None or expected is None or found.same(expected)


def test_colours_are_decoded_each_before_they_are_mixed() -> None:
    colour = np.full((16, 16, 3), (188, 118, 10), np.uint8)  # blue, green, red
    colour[3, 4] = (100, 100, 255)
    light = decode_light(cv2.imencode(".png", colour)[1].tobytes(), SRGB, where="a")
    expected = 0.114 * 0.502886 + 0.587 * 0.181164 + 0.299 * 0.003035
    full = np.argwhere(light == 65535)
    assert full.tolist() == [[3, 4]], "one full colour makes a pixel full"
    light[3, 4] = light[0, 0]
    np.testing.assert_allclose(light / 65535.0, expected, atol=2e-5)


def test_a_table_is_interpolated() -> None:
    camera = Camera(transfer="table", transfer_table=(0.0, 0.1, 1.0))
    np.testing.assert_allclose(transfer.camera_curve(camera).of(np.array([0.25, 0.5, 0.75])), [0.05, 0.1, 0.55])
