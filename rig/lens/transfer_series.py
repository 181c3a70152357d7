"""Input of exposure series, and output of the measured transfer curve for a scene file."""

import math
from collections.abc import Sequence
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from rhizotwin.rig.cameras.raw_files import SUFFIXES, open_raw
from rhizotwin.rig.lens.transfer_fit import TransferFit
from rhizotwin.scenes import toml_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import Grey, decode_grey
from rhizotwin.scenes.transfer import LINEAR, SRGB

_EXIF, _EXPOSURE_TIME = 0x8769, 0x829A


def read_series(paths: Sequence[Path], exposures_s: str | None) -> tuple[list[Grey], list[float]]:
    """Read pictures and their exposure times.

    The exposure times are given as a comma-separated list, or are read from the EXIF metadata.

    Parameters
    ----------
    paths : sequence of Path
        Pictures of one scene with different exposures.
    exposures_s : str or None
        Comma-separated exposure times, s; None to read EXIF metadata.

    Returns
    -------
    list of (H, W) arrays, list of float
        Pictures and exposure times in seconds.

    Raises
    ------
    UserError
        If a picture is damaged, or an exposure time is missing or not positive.
    """
    images, stated = zip(*(_read(path) for path in paths), strict=True) if paths else ((), ())
    if exposures_s is None:
        return list(images), [_known(path, time) for path, time in zip(paths, stated, strict=True)]
    try:
        times = [float(part) for part in exposures_s.split(",")]
    except ValueError:
        raise UserError(f"--exposures-s {exposures_s}: must be comma-separated numbers, such as 0.002,0.004,0.008") from None
    if len(times) != len(paths) or not all(0.0 < time < math.inf for time in times):
        raise UserError(
            f"--exposures-s {exposures_s}: {len(times)} exposure times for {len(paths)} pictures; specify a positive exposure time for "
            "each picture"
        )
    return list(images), times


def transfer_text(found: TransferFit, pictures: int) -> str:
    """Return the lines of a scene file's [camera] section that define a measured curve."""
    low, high = found.reached
    head = (
        f"# Measured from {pictures} exposures, with pixel values from {low:.2f} to {high:.2f} of full scale.\n"
        f"# Residual {100.0 * found.residual:.1f} % of the light.\n"
        "# Copy these lines to the section [camera] of the scene file.\n"
    )
    if found.curve in (LINEAR, SRGB):
        return head + toml_text.dumps({"transfer": "srgb" if found.curve == SRGB else "linear"})
    return head + toml_text.dumps({"transfer": "table", "transfer_table": [round(light, 6) for light in found.curve.light]})


def _read(path: Path) -> tuple[Grey, float | None]:
    """Read a picture, and the exposure time that its file states. A raw file is read with half its width and height."""
    data = path.read_bytes()
    if path.suffix.lower() not in SUFFIXES:
        return decode_grey(data, where=str(path)), _exif_time(path)
    raw = open_raw(data, where=str(path))
    height, width = (side // 2 for side in raw.pixels.shape)
    return raw.light(image_wh=(width, height), gains=raw.gains, bits=16, where=str(path)), raw.exposure_s


def _exif_time(path: Path) -> float | None:
    try:
        with Image.open(path) as opened:
            time = opened.getexif().get_ifd(_EXIF).get(_EXPOSURE_TIME)
    except (UnidentifiedImageError, OSError):
        time = None
    return None if time is None else float(time)


def _known(path: Path, time: float | None) -> float:
    if not time or not time > 0.0:
        raise UserError(f"{path}: the file states no exposure time; specify all exposure times with --exposures-s")
    return time
