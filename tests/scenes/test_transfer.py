"""What picture files say of their curve, and the curves themselves, against published values and Pillow's colour management."""

import io

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from rhizotwin.scenes import transfer
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.picture_codec import decode_light
from rhizotwin.scenes.transfer import LINEAR, SRGB

GREY = Image.fromarray(np.arange(256, dtype=np.uint8).reshape(16, 16))


def saved(kind: str, **options: object) -> bytes:
    out = io.BytesIO()
    GREY.convert("RGB").save(out, kind, **options)
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
