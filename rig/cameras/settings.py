"""Settings that all types of cameras have in common, and the comparison of pictures with these settings."""

from dataclasses import dataclass, field

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import CameraPart
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.picture_codec import Grey


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """Fixed camera settings. The limits are the same as those in rig and scene files."""

    image_wh: tuple[int, int] = bounded((800, 600), 16, 20000)
    bits: int = bounded(12, 8, 16)
    """Bit depth of a pixel. Values of up to 8 bits are stored in one byte. Values of more bits are stored in two bytes,
    left-aligned."""
    exposure_s: float = bounded(0.01, 1e-5, 100.0)
    gain: float = bounded(1.0, 0.0, 100.0)
    colour_gains: tuple[float, float] = bounded((2.0, 2.0), 0.1, 32.0)
    white_balance_kelvin: int = bounded(5000, 1000, 20000)
    f_number: float | None = field(default=None, metadata={"limits": (0.5, 128.0)})
    linear: bool = True
    """Whether the scene states that pixel values are linear in light."""


def combine_settings(part: CameraPart, *, image_wh: tuple[int, int], bits: int, linear: bool = True) -> CameraSettings:
    """Combine the camera settings of the rig file with the size and bit depth of the scene's camera.

    Parameters
    ----------
    part : CameraPart
        Section of the rig file.
    image_wh, bits : tuple of int, int
        Picture size and bit depth of the scene's camera.
    linear : bool
        Whether the scene's camera is linear in light.

    Returns
    -------
    CameraSettings
        Settings of the camera.
    """
    return CameraSettings(
        image_wh=image_wh,
        bits=bits,
        exposure_s=part.exposure_s,
        gain=part.gain,
        colour_gains=part.colour_gains,
        white_balance_kelvin=part.white_balance_kelvin,
        f_number=part.f_number,
        linear=linear,
    )


def check_picture(image: Grey, settings: CameraSettings, *, name: str) -> None:
    """Raise an error if a picture differs from the settings in size or bit depth.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture to check.
    settings : CameraSettings
        Required settings.
    name : str
        Name of the camera, used in messages.

    Raises
    ------
    RigError
        If the size or the bit depth differs; the message states both values.
    """
    height, width = image.shape
    if (width, height) != settings.image_wh:
        wanted = f"{settings.image_wh[0]}x{settings.image_wh[1]}"
        raise RigError(
            f"{name}: the pictures have {width}x{height} pixels instead of {wanted}; set image_wh of the scene's camera to this size"
        )
    stored = 8 * image.dtype.itemsize
    if stored != stored_bits(settings.bits):
        raise RigError(f"{name}: the pictures have {stored} bits instead of {settings.bits}; set bits of the scene's camera")


def stored_bits(bits: int) -> int:
    """Return the number of bits with which a pixel is stored in a file."""
    return 8 if bits <= 8 else 16
