"""Checks before a scan. Each function returns a text that describes the state, or raises an error."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rhizotwin.rig.devices import Arm, Camera, Lights, Turntable
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import LightsPart
from rhizotwin.rig.scanning.markers import read_strip, unread_reason
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera as Lens
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

BRIGHT_SHARE = 0.25
"""Fraction of the pixels, beginning with the brightest, from which the exposure is determined. The panel covers more
than this fraction of the picture, whereas the white parts of the strip cover less."""
DIMMEST = 0.2
"""Minimum brightness of the panel, as a fraction of full scale. In a darker picture, noise would hide thin roots."""
FULL = 0.99
"""Brightness above which a pixel counts as saturated, as a fraction of full scale."""
MOST_SATURATED = 0.05
"""Maximum fraction of saturated pixels in a picture."""
SPARE_BYTES = 64 * 2**20


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """Brightness of a picture relative to the camera's range."""

    bright: float
    """Grey level that is exceeded by the fraction `BRIGHT_SHARE` of the pixels, as a fraction of full scale."""
    saturated: float
    """Fraction of the pixels that are saturated."""


def measure_exposure(image: Grey) -> Exposure:
    """Measure the exposure of a picture, using every third pixel of every third row."""
    sample = image[1::3, 1::3]
    full = np.iinfo(image.dtype).max
    return Exposure(
        bright=float(np.percentile(sample, 100.0 * (1.0 - BRIGHT_SHARE))) / full, saturated=float(np.mean(sample >= int(FULL * full)))
    )


def check_table(table: Turntable) -> str:
    """Connect to the turntable, and return its description."""
    table.prepare()
    return table.describe()


def check_lights(lights: Lights, part: LightsPart) -> str:
    """Switch on the panel and the front light, and return a description of their levels."""
    lights.set(panel=part.panel_level, front=part.front_level)
    return f"panel at {100.0 * part.panel_level:.0f} %, front at {100.0 * part.front_level:.0f} %"


def check_arm(arm: Arm) -> str:
    """Connect to the arm, check it, and return its description. The torque is on afterwards."""
    arm.prepare()
    arm.health()
    joints = ", ".join(f"{angle:.1f}" for angle in arm.read_joints())
    return f"{arm.describe()}; joints at {joints} deg"


def check_camera(camera: Camera) -> str:
    """Open the camera with its fixed settings, and return its description."""
    camera.prepare()
    return camera.describe()


def check_size(image: Grey, lens: Lens) -> None:
    """Raise an error if a picture's size differs from that of the scene's camera."""
    height, width = image.shape
    if (width, height) != lens.image_wh:
        raise RigError(
            f"camera: the pictures have {width}x{height} pixels, but the scene's camera has image_wh "
            f"{lens.image_wh[0]}x{lens.image_wh[1]}; change the camera's settings, or calibrate it at this size and correct the scene"
        )


def check_picture(image: Grey, lens: Lens) -> str:
    """Check the size and exposure of a picture taken with the lamps on. Return a description of the exposure."""
    check_size(image, lens)
    found = measure_exposure(image)
    if found.bright < DIMMEST:
        raise RigError(
            f"camera: the picture is too dark: the panel is at {100.0 * found.bright:.0f} % of full scale, but at least "
            f"{100.0 * DIMMEST:.0f} % are required; check that the panel is lit and in front of the camera, or increase exposure_s"
        )
    if found.saturated > MOST_SATURATED:
        raise RigError(
            f"camera: {100.0 * found.saturated:.0f} % of the picture is at full scale, but at most {100.0 * MOST_SATURATED:.0f} % are "
            "permitted; "
            "reduce exposure_s or panel_level"
        )
    return f"panel at {100.0 * found.bright:.0f} % of full scale, {100.0 * found.saturated:.1f} % saturated"


def check_markers(image: Grey, scene: Scene) -> str:
    """Read the strip in a picture and return a description. Raise an error if the strip cannot be read."""
    seen = read_strip(image, scene)
    if seen is None:
        raise RigError(f"markers: {unread_reason(image, scene)}")
    return f"{seen.markers} markers, reprojection error {seen.reprojection_px:.2f} px"


def check_disk(folder: Path, pictures: int, lens: Lens) -> str:
    """Check for sufficient disk space, assuming that pictures cannot be compressed.

    Parameters
    ----------
    folder : Path
        Folder in which the pictures will be written.
    pictures : int
        Number of pictures.
    lens : Lens
        Camera with size and bit depth of the pictures.

    Returns
    -------
    str
        Text with the free and the required space.
    """
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    free = shutil.disk_usage(there).free
    width, height = lens.image_wh
    needed = pictures * width * height * (1 if lens.bits <= 8 else 2) + SPARE_BYTES
    if free < needed:
        raise UserError(
            f"{folder}: the disk has {free / 2**20:.0f} MiB of free space, but {pictures} pictures may need {needed / 2**20:.0f} MiB; "
            "free some space, or choose another disk"
        )
    return f"{free / 2**30:.1f} GiB free, {pictures} pictures need {needed / 2**30:.2f} GiB at most"
