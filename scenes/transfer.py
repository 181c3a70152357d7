"""Transfer curves from pixel values to light.

Cameras apply nonlinear curves to light (sRGB, a gamma, or a custom curve), but the reconstruction requires values that
are linear in light. A file states its curve in an ICC profile, in the sRGB or gAMA chunk of PNG, or in the colour space
or gamma of EXIF. If the file states no curve, the curve of the scene's camera is used.
"""

import io
import logging
import struct
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from rhizotwin.scenes.model import Camera

Array = NDArray[np.float64]

_STEPS = 4097
"""Number of samples of a transfer curve that is defined by a formula. With this number of samples, linear interpolation
is exact to 1e-7."""
_SAME = 0.004
"""Maximum difference between two transfer curves that are considered equal. It is one step of 8 bits."""
_EXIF, _COLOUR_SPACE, _GAMMA, _INTEROPERABILITY = 0x8769, 0xA001, 0xA500, 0xA005
"""Exif 2.3 tags, in this order: pointer to the Exif block, colour space, gamma, and pointer to a block whose tag 1 is
"R03" for Adobe RGB (DCF 2.0)."""
_ADOBE_GAMMA = 563 / 256
"""Exponent of Adobe RGB (Adobe RGB (1998) Color Image Encoding, section 4.3.1.2)."""
_TIFF_PROFILE = 34675
"""TIFF tag of the ICC profile."""


@dataclass(frozen=True)
class Curve:
    """Transfer curve: light as a function of the pixel value."""

    name: str
    light: tuple[float, ...]
    """Light at equally spaced pixel values from 0 to full scale, as a fraction of full scale. The light increases with
    the pixel value."""

    def decode(self, numbers: NDArray[np.uint8 | np.uint16]) -> NDArray[np.uint16]:
        """Convert pixel values (...) to light of the same shape. The full scale of light is 65535."""
        return _table(self, int(np.iinfo(numbers.dtype).max))[numbers]

    def of(self, share: Array) -> Array:
        """Convert pixel values (...), as fractions of full scale, to light of the same shape."""
        return np.asarray(np.interp(share, np.linspace(0.0, 1.0, len(self.light)), self.light))

    def number(self, light: Array) -> Array:
        """Convert light (...) to pixel values of the same shape, as fractions of full scale. Inverse of `of`."""
        return np.asarray(np.interp(light, self.light, np.linspace(0.0, 1.0, len(self.light))))

    def same(self, other: "Curve") -> bool:
        """Return whether another curve is the same, except for differences due to rounding."""
        share = np.linspace(0.0, 1.0, 257)
        return bool(np.abs(self.of(share) - other.of(share)).max() < _SAME)


@lru_cache(maxsize=8)
def _table(curve: Curve, full: int) -> NDArray[np.uint16]:
    return np.rint(65535.0 * curve.of(np.arange(full + 1) / full)).astype(np.uint16)


def _formula(name: str, light: Array) -> Curve:
    return Curve(name, tuple(light.tolist()))


def _srgb() -> Array:
    """Return the light (N,) of the sRGB curve (IEC 61966-2-1, equations 5 and 6)."""
    v = np.linspace(0.0, 1.0, _STEPS)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


LINEAR = Curve("linear", (0.0, 1.0))
SRGB = _formula("sRGB", _srgb())


def power(exponent: float) -> Curve:
    """Return the curve ``light = number ** exponent``."""
    return _formula(f"a gamma of {exponent:.3g}", np.linspace(0.0, 1.0, _STEPS) ** exponent)


def camera_curve(camera: Camera) -> Curve:
    """Return the transfer curve of a scene's camera."""
    if camera.transfer == "table":
        return Curve("the scene's table", camera.transfer_table)
    return SRGB if camera.transfer == "srgb" else LINEAR


def read_stated_curve(picture: bytes | Path) -> Curve | None:
    """Return the transfer curve that is stated in a picture file.

    The result is None if no curve is stated, or if it cannot be read.
    """
    for name in ("PIL", "tifffile"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # unreadable pictures are reported elsewhere
    try:
        with io.BytesIO(picture) if isinstance(picture, bytes) else picture.open("rb") as stream:
            is_tiff = stream.read(2) in (b"II", b"MM")
            stream.seek(0)
            return _read_tiff_curve(stream) if is_tiff else _read_curve(stream)
    except Exception:  # noqa: BLE001 - unreadable pictures are reported elsewhere, and have various exceptions
        return None


def _read_tiff_curve(stream: IO[bytes]) -> Curve | None:
    """Return the transfer curve in the ICC profile or Exif block of a TIFF. Pillow does not open all kinds of TIFF."""
    with tifffile.TiffFile(stream) as file:
        tags = file.pages.first.tags
        profile, exif = tags.get(_TIFF_PROFILE), tags.get(_EXIF)
        named = exif.value if exif is not None and isinstance(exif.value, dict) else {}
        return _chosen_curve(profile and profile.value, named.get("Gamma"), named.get("ColorSpace"))


def _read_curve(stream: IO[bytes]) -> Curve | None:
    """Return the transfer curve in the ICC profile, chunks or Exif block of a PNG or JPEG."""
    # Pillow warns about a damaged EXIF block, which only means that the block states no curve
    with warnings.catch_warnings(action="ignore"), Image.open(stream) as opened:
        info = opened.info
        if "icc_profile" not in info and info.get("srgb") is not None:
            return SRGB
        if "icc_profile" not in info and (gamma := info.get("gamma")):
            return _gamma_curve(1.0 / gamma)
        block = opened.getexif()
        exif = block.get_ifd(_EXIF)
        is_adobe = block.get_ifd(_INTEROPERABILITY).get(1) == "R03"
    return _chosen_curve(info.get("icc_profile"), exif.get(_GAMMA) or (_ADOBE_GAMMA if is_adobe else None), exif.get(_COLOUR_SPACE))


def _chosen_curve(profile: bytes | None, gamma: Any, colour_space: Any) -> Curve | None:
    """Return the curve of an ICC profile or, if it has none, of an Exif block."""
    if profile and (curve := _profile_curve(profile)):
        return curve
    if isinstance(gamma, tuple):  # numerator and denominator
        gamma = gamma[0] / gamma[1]
    if gamma:
        return _gamma_curve(float(gamma))
    return SRGB if colour_space == 1 else None


def _gamma_curve(exponent: float) -> Curve:
    if abs(exponent - 1.0) < 0.01:
        return LINEAR
    return power(exponent)


def _profile_curve(profile: bytes) -> Curve | None:
    """Return the curve of the green or grey channel of an ICC profile (ICC.1:2022, 7.3, 10.6 and 10.18).

    The result is None if the profile uses lookup tables.
    """
    try:
        (count,) = struct.unpack_from(">I", profile, 128)
        tags = {profile[at : at + 4]: struct.unpack_from(">II", profile, at + 4) for at in range(132, 132 + 12 * min(count, 200), 12)}
        start, size = tags.get(b"gTRC") or tags[b"kTRC"]
        return _parse_trc(profile[start : start + size])
    except (struct.error, KeyError):
        return None


def _parse_trc(data: bytes) -> Curve | None:
    """Parse a ``curveType`` or ``parametricCurveType`` of an ICC profile. Return None if its type is not supported."""
    v = np.linspace(0.0, 1.0, _STEPS)
    if data[:4] == b"curv":
        (count,) = struct.unpack_from(">I", data, 8)
        if count == 0:
            return LINEAR
        numbers = np.array(struct.unpack_from(f">{count}H", data, 12), np.float64)
        light = v ** (numbers[0] / 256.0) if count == 1 else np.maximum.accumulate(numbers) / 65535.0
    elif data[:4] == b"para":
        (kind,) = struct.unpack_from(">H", data, 8)
        if kind > 4:
            return None
        g, a, b, c, d, e, f = np.pad(np.array(struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", data, 12)) / 65536.0, (0, 6))[:7]
        if kind == 0:
            a, d = 1.0, -1.0
        elif kind in (1, 2):
            c, d, e, f = 0.0, -b / a, c, c
        light = np.clip(np.where(v >= d, np.maximum(a * v + b, 0.0) ** g + e, c * v + f), 0.0, 1.0)
    else:
        return None
    found = _formula("the ICC profile's", np.asarray(light))
    return next((known for known in (LINEAR, SRGB) if known.same(found)), found)
