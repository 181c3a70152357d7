"""Lamp and filter settings for the spectral bands of the camera."""

from rhizotwin.rig.devices import Arm, Lights
from rhizotwin.rig.rig_file import BandPart, RigFile
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene


def band_part(rig: RigFile, band: str) -> BandPart | None:
    """Return the settings of a band, or None if the rig file has none.

    The result is also None for white light, which has an empty name.
    """
    return next((part for part in rig.camera.bands if part.name == band), None)


def band_levels(rig: RigFile, part: BandPart | None) -> tuple[float, float]:
    """Return the brightness of the panel and of the front light in a band, each from 0 to 1."""
    lights, part = rig.lights, part or BandPart()
    panel = lights.panel_level if part.panel_level is None else part.panel_level
    return panel, lights.front_level if part.front_level is None else part.front_level


def light(lights: Lights, rig: RigFile, band: str) -> None:
    """Switch the lamps on with the settings of a band.

    Parameters
    ----------
    lights : Lights
        Lamps of the rig.
    rig : RigFile
        Rig file with colours and levels of the band.
    band : str
        Name of the band; empty for white light.
    """
    part = band_part(rig, band)
    panel, front = band_levels(rig, part)
    lights.set(panel=panel, front=front, band=part)


def turn_filter(arm: Arm | None, rig: RigFile, band: str) -> None:
    """Turn the filter wheel to the filter of a band, if it has one.

    Parameters
    ----------
    arm : Arm or None
        Arm with the filter wheel, which must be prepared; None for a rig without an arm.
    rig : RigFile
        Rig file with the filter of the band.
    band : str
        Name of the band; empty for white light.

    Raises
    ------
    RigError
        If the wheel does not reach its target.
    """
    part = band_part(rig, band)
    if part is not None and part.filter_deg is not None and arm is not None:
        arm.turn_filter(part.filter_deg)


def check_bands(rig: RigFile, scene: Scene) -> None:
    """Raise an error if the scene has bands that the rig file does not describe.

    Raises
    ------
    UserError
        If the settings of a band are missing; the message states the section to add.
    """
    for band in scene.camera.bands:
        if band_part(rig, band.name) is None:
            raise UserError(
                f"the scene's camera has the band {band.name!r}, but the rig file has no settings for it: "
                f'add [[camera.bands]] with name = "{band.name}"'
            )
