"""Bands of the camera on the rig: which lamps and which filter each of them needs."""

from rhizotwin.rig.devices import Lights
from rhizotwin.rig.rig_file import BandPart, RigFile
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene


def part_of(rig: RigFile, band: str) -> BandPart | None:
    """Return how a band is set; None for an empty name, which is white light."""
    return next((part for part in rig.camera.bands if part.name == band), None)


def levels_of(rig: RigFile, part: BandPart | None) -> tuple[float, float]:
    """Return the levels of panel and front light in a band."""
    lights, part = rig.lights, part or BandPart()
    panel = lights.panel_level if part.panel_level is None else part.panel_level
    return panel, lights.front_level if part.front_level is None else part.front_level


def light(lights: Lights, rig: RigFile, band: str) -> None:
    """Switch the lamps on as a band needs them.

    Parameters
    ----------
    lights : Lights
        The lamps.
    rig : RigFile
        Has the band's colours and levels.
    band : str
        Its name; empty: white light.
    """
    part = part_of(rig, band)
    panel, front = levels_of(rig, part)
    lights.set(panel=panel, front=front, band=part)


def refuse_unknown(rig: RigFile, scene: Scene) -> None:
    """Refuse a scene with bands that the rig file does not know.

    Raises
    ------
    UserError
        With the section that is missing.
    """
    for band in scene.camera.bands:
        if part_of(rig, band.name) is None:
            raise UserError(
                f"the scene's camera has the band {band.name!r}, but the rig file does not say how it is set: "
                f'add [[camera.bands]] with name = "{band.name}"'
            )
