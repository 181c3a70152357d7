"""TIFF files with and without imagecodecs, which is an extra."""

import io
import sys

import cv2
import imagecodecs
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.scenes import picture_damage
from rhizotwin.scenes.picture_damage import UnfitError, check_picture

PICTURE = (np.arange(40 * 30, dtype=np.uint16) * 50).reshape(30, 40)


def tiff(compression: str | None) -> bytes:
    """Return a grey picture of 16 bits as a TIFF."""
    if compression == "packbits":  # tifffile reads this and does not write it
        return bytes(cv2.imencode(".tiff", PICTURE, [cv2.IMWRITE_TIFF_COMPRESSION, 32773])[1].tobytes())
    stream = io.BytesIO()
    tifffile.imwrite(stream, PICTURE, compression=compression)
    return stream.getvalue()


@pytest.mark.parametrize("compression", [None, "zlib", "packbits"])
def test_common_compressions_need_no_extra(compression: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    assert check_picture(tiff(compression)) == tiff(compression)


def test_lzw_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    data = tiff("lzw")
    assert check_picture(data) == data
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(UnfitError, match=r"TIFF with LZW compression, .* run pip install 'rhizotwin\[tiff\]', or convert it to PNG"):
        check_picture(data)


RUNS = st.tuples(st.binary(min_size=1, max_size=1), st.integers(2, 128)).map(lambda run: (bytes([257 - run[1]]) + run[0], run[0] * run[1]))
LITERALS = st.binary(min_size=1, max_size=128).map(lambda data: (bytes([len(data) - 1]) + data, data))
NOTHING = st.just((b"\x80", b""))


@given(st.lists(RUNS | LITERALS | NOTHING, min_size=1, max_size=8))
def test_packbits(pieces: list[tuple[bytes, bytes]]) -> None:
    packed = b"".join(packed for packed, _ in pieces)
    assert picture_damage._packbits(packed) == b"".join(data for _, data in pieces)


def test_bits_are_mirrored_as_imagecodecs_does() -> None:
    data = bytes(range(256))
    assert data.translate(picture_damage._MIRRORED) == bytes(imagecodecs.bitorder_decode(data))
