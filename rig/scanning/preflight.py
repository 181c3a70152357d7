"""What is looked at before a scan, one line for each: each function returns what is well, or raises what is not."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rhizotwin.rig.devices import Arm, Camera, Lights, Turntable
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import LightsPart
from rhizotwin.rig.scanning.markers import read_strip, why_unread
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera as Lens
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey

BRIGHT_SHARE = 0.25
"""The brightest part of a picture, by which its exposure is judged: the panel fills more than this, the white of the
strip less."""
DIMMEST = 0.2
"""Below this fraction of full scale the panel is too dark: noise would hide thin roots."""
FULL = 0.99
"""Above this fraction of full scale a pixel says nothing any more."""
MOST_SATURATED = 0.05
SPARE_BYTES = 64 * 2**20


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """How a picture fills the camera's range, as fractions."""

    bright: float
    """Grey level that only `BRIGHT_SHARE` of the pixels exceed, of full scale."""
    saturated: float
    """Share of the pixels at full scale."""


def exposure_of(image: Grey) -> Exposure:
    """Judge a picture by every third pixel of every third row."""
    sample = image[1::3, 1::3]
    full = np.iinfo(image.dtype).max
    return Exposure(
        bright=float(np.percentile(sample, 100.0 * (1.0 - BRIGHT_SHARE))) / full, saturated=float(np.mean(sample >= int(FULL * full)))
    )


def check_table(table: Turntable) -> str:
    """Connect to the turntable and say what answers."""
    table.prepare()
    return table.describe()


def check_lights(lights: Lights, part: LightsPart) -> str:
    """Switch both lamps on."""
    lights.set(panel=part.panel_level, front=part.front_level)
    return f"panel at {100.0 * part.panel_level:.0f} %, front at {100.0 * part.front_level:.0f} %"


def check_arm(arm: Arm) -> str:
    """Connect to the arm, torque on where it stands; refuse one that is too warm or badly supplied."""
    arm.prepare()
    arm.health()
    joints = ", ".join(f"{angle:.1f}" for angle in arm.read_joints())
    return f"{arm.describe()}; joints at {joints} deg"


def check_camera(camera: Camera) -> str:
    """Open the camera with its fixed settings."""
    camera.prepare()
    return camera.describe()


def check_size(image: Grey, lens: Lens) -> None:
    """Refuse pictures of another size than the scene's camera."""
    height, width = image.shape
    if (width, height) != lens.image_wh:
        raise RigError(
            f"camera: its pictures have {width}x{height} pixels, but the scene's camera has image_wh "
            f"{lens.image_wh[0]}x{lens.image_wh[1]}; set the camera, or calibrate it at this size and correct the scene"
        )


def check_picture(image: Grey, lens: Lens) -> str:
    """Judge size and exposure of a picture with the lights on."""
    check_size(image, lens)
    found = exposure_of(image)
    if found.bright < DIMMEST:
        raise RigError(
            f"camera: the picture is too dark: the panel reaches {100.0 * found.bright:.0f} % of full scale, at least "
            f"{100.0 * DIMMEST:.0f} % are needed; check that the panel is lit and before the camera, or raise exposure_s"
        )
    if found.saturated > MOST_SATURATED:
        raise RigError(
            f"camera: {100.0 * found.saturated:.0f} % of the picture are at full scale, at most {100.0 * MOST_SATURATED:.0f} % may be; "
            "lower exposure_s or panel_level"
        )
    return f"panel at {100.0 * found.bright:.0f} % of full scale, {100.0 * found.saturated:.1f} % saturated"


def check_markers(image: Grey, scene: Scene) -> str:
    """Say what the strip in a picture shows."""
    seen = read_strip(image, scene)
    if seen is None:
        raise RigError(f"markers: {why_unread(image, scene)}")
    return f"{seen.markers} read, {seen.reprojection_px:.2f} px off"


def check_disk(folder: Path, pictures: int, lens: Lens) -> str:
    """Refuse to begin what does not fit on the disk: pictures are reckoned as if they could not be compressed.

    Parameters
    ----------
    folder : Path
        Where the pictures go.
    pictures : int
        How many.
    lens : Lens
        Their size and depth.

    Returns
    -------
    str
        What is free and what is needed, for people.
    """
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    free = shutil.disk_usage(there).free
    width, height = lens.image_wh
    needed = pictures * width * height * (1 if lens.bits <= 8 else 2) + SPARE_BYTES
    if free < needed:
        raise UserError(f"{folder}: the disk has {free / 2**20:.0f} MiB free, but {pictures} pictures may need {needed / 2**20:.0f} MiB")
    return f"{free / 2**30:.1f} GiB free, {pictures} pictures need {needed / 2**30:.2f} GiB at most"
