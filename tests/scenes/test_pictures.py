"""Pictures: grey levels kept, damage named."""

import struct
import zlib
from typing import Any

import cv2
import numpy as np
import pytest

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.pictures import decode_grey

RNG = np.random.default_rng(7)
GREY = RNG.integers(0, 256, (40, 60), dtype=np.uint8)


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
    "jpeg with restarts": encoded(GREY, ".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
    "jpeg with a thumbnail": with_thumbnail(encoded(GREY, ".jpg")),
}


@pytest.mark.parametrize("data", WHOLE.values(), ids=WHOLE.keys())
def test_whole_pictures_are_read(data: bytes) -> None:
    assert decode_grey(data, where="a").shape == GREY.shape
    assert decode_grey(data + b"trailer of some phone \xff\xd8\xff", where="a").shape == GREY.shape


@pytest.mark.parametrize("data", WHOLE.values(), ids=WHOLE.keys())
@pytest.mark.parametrize("kept", [0.2, 0.5, 0.9, 0.999])
def test_truncated_pictures_are_named(data: bytes, kept: float) -> None:
    with pytest.raises(UserError, match=r"view_003\.png: the picture is truncated"):
        decode_grey(data[: int(kept * len(data))], where="view_003.png")


def test_flipped_bit_in_a_png() -> None:
    data = bytearray(WHOLE["png"])
    data[len(data) // 2] ^= 1
    with pytest.raises(UserError, match="damaged"):
        decode_grey(bytes(data), where="a")


@pytest.mark.parametrize("data", [b"hello", b"\x00" * 100, b"GIF89a" + b"\x00" * 9, b"<svg/>"])
def test_what_is_no_picture(data: bytes) -> None:
    with pytest.raises(UserError, match="is not a picture"):
        decode_grey(data, where="a")


def test_empty_file() -> None:
    with pytest.raises(UserError, match="empty"):
        decode_grey(b"", where="a")


def test_png_without_pixels() -> None:
    chunk = b"IEND"
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 0) + chunk + struct.pack(">I", zlib.crc32(chunk))
    with pytest.raises(UserError, match="is not a picture"):
        decode_grey(data, where="a")


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_levels_and_depth_are_kept(kind: type) -> None:
    grey = RNG.integers(0, np.iinfo(kind).max, (6, 9), dtype=kind, endpoint=True)
    for suffix in (".png", ".tiff"):
        found = decode_grey(encoded(grey, suffix), where="a")
        assert found.dtype == kind
        np.testing.assert_array_equal(found, grey)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_colours_by_luminance_without_alpha(kind: type) -> None:
    blue_green_red = RNG.integers(0, np.iinfo(kind).max, (6, 9, 3), dtype=kind, endpoint=True)
    luminance = blue_green_red @ np.array([0.114, 0.587, 0.299])
    for image in (blue_green_red, np.concatenate([blue_green_red, np.zeros((6, 9, 1), kind)], axis=2)):
        found = decode_grey(encoded(image), where="a")
        assert found.dtype == kind
        np.testing.assert_allclose(found, luminance, atol=1.0, rtol=5e-5)  # OpenCV's weights are rounded to 14 bits


def test_floating_point_pictures_are_refused() -> None:
    with pytest.raises(UserError, match="8 or 16 bit"):
        decode_grey(encoded(np.ones((4, 4), np.float32), ".tiff"), where="a")
