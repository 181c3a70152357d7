"""Modification of a scene by function arguments or command-line options."""

from dataclasses import replace
from pathlib import Path

from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Scene
from rhizotwin.scenes.specimens import MeshSpecimen, PlacedFile, RsmlSpecimen
from rhizotwin.steps.arguments import Placing

_RSML_SUFFIXES = (".rsml", ".xml")


def change_scene(
    scene: Scene,
    *,
    specimen: Path | None = None,
    specimen_unit: str | None = None,
    specimen_diameter_mm: float | None = None,
    placing: Placing | None = None,
    views: int | None = None,
    image_wh: tuple[int, int] | None = None,
    profile: str | None = None,
) -> Scene:
    """Return a copy of a scene with the given changes, which are validated.

    Parameters
    ----------
    scene : Scene
        Original scene.
    specimen : Path or None
        File of a mesh or of traced roots that replaces the specimen.
    specimen_unit, specimen_diameter_mm : (str or None), (float or None)
        Unit of the coordinates and diameter of the roots, mm, for traced roots whose file does not specify them.
    placing : Placing or None
        Position of the specimen in the canister.
    views : int or None
        Number of views per ring.
    image_wh : tuple of int or None
        Width and height of the pictures, px; the lens is scaled accordingly.
    profile : str or None
        Name or file of the profile of simulated imperfections.

    Raises
    ------
    UserError
        If a value or a combination of values is invalid.
    """
    is_rsml = specimen is not None and specimen.suffix.lower() in _RSML_SUFFIXES
    for option, value in (("--specimen-unit", specimen_unit), ("--specimen-diameter-mm", specimen_diameter_mm)):
        if value is not None and not is_rsml:
            raise UserError(f"{option} applies to traced roots only; give a file with --specimen FILE.rsml, or remove {option}")
    if specimen is not None:
        if not specimen.is_file():
            raise UserError(f"the file {specimen} does not exist; give a mesh (PLY, STL, OBJ) or traced roots (RSML)")
        file = str(specimen.resolve())
        traced = RsmlSpecimen(file=file, unit=specimen_unit, diameter_mm=specimen_diameter_mm)
        scene = replace(scene, specimen=traced if is_rsml else MeshSpecimen(file=file))
    given = {name: value for name, value in vars(placing or Placing()).items() if value is not None}
    if given:
        if not isinstance(scene.specimen, PlacedFile):
            name = next(iter(given)).replace("_", "-")
            raise UserError(f"--{name} applies to a specimen from a file only; give a file with --specimen FILE")
        if "vertical_axis" in given and not isinstance(scene.specimen, RsmlSpecimen):
            raise UserError("--vertical-axis applies to traced roots only; give a file with --specimen FILE.rsml")
        scene = replace(scene, specimen=replace(scene.specimen, **given))
    if views is not None:
        scene = replace(scene, plan=CapturePlan(rings=tuple(replace(ring, views=views) for ring in scene.plan.rings)))
    if image_wh is not None:
        scene = replace(scene, camera=scene.camera.resized(image_wh))
    if profile is not None:
        scene = replace(scene, disturbances=files.load_profile(profile))
    return files.scene_from_dict(files.scene_to_dict(scene), where=f"scene {scene.name} with changes")
