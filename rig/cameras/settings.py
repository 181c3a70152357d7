"""What every camera is told, whichever way it is connected, and how close a camera must come to it."""

from dataclasses import dataclass

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import CameraPart
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.pictures import Grey


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """The fixed settings of a camera; limits as in the rig and scene files."""

    image_wh: tuple[int, int] = bounded((800, 600), 16, 20000)
    bits: int = bounded(12, 8, 16)
    """Of a pixel: 8 in a byte, more left-aligned in 16 bits."""
    exposure_s: float = bounded(0.01, 1e-5, 100.0)
    gain: float = bounded(1.0, 0.0, 100.0)
    colour_gains: tuple[float, float] = bounded((2.0, 2.0), 0.1, 32.0)
    white_balance_kelvin: int = bounded(5000, 1000, 20000)


def settings_of(part: CameraPart, *, image_wh: tuple[int, int], bits: int) -> CameraSettings:
    """Join what the rig file says of the camera with the size and depth that the scene wants.

    Parameters
    ----------
    part : CameraPart
        What the rig file says.
    image_wh, bits : tuple of int, int
        Size and depth of the scene's camera.

    Returns
    -------
    CameraSettings
        What the camera is to be set to.
    """
    return CameraSettings(
        image_wh=image_wh,
        bits=bits,
        exposure_s=part.exposure_s,
        gain=part.gain,
        colour_gains=part.colour_gains,
        white_balance_kelvin=part.white_balance_kelvin,
    )


def check_picture(image: Grey, settings: CameraSettings, *, name: str) -> None:
    """Refuse a picture of another size or depth than was asked for.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        The picture.
    settings : CameraSettings
        What it should be.
    name : str
        The camera's, for messages.

    Raises
    ------
    RigError
        With both sizes, or both depths.
    """
    height, width = image.shape
    if (width, height) != settings.image_wh:
        wanted = f"{settings.image_wh[0]}x{settings.image_wh[1]}"
        raise RigError(
            f"{name}: gives pictures of {width}x{height} pixels, not {wanted}; set image_wh of the scene's camera to what it gives"
        )
    stored = 8 * image.dtype.itemsize
    if stored != stored_bits(settings.bits):
        raise RigError(f"{name}: gives pictures of {stored} bits, though {settings.bits} were asked for; set bits of the scene's camera")


def stored_bits(bits: int) -> int:
    """Return how many bits a pixel takes in a file."""
    return 8 if bits <= 8 else 16
