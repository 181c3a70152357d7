"""Modification of a scene by function arguments or command-line options."""

from dataclasses import replace

from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Scene
from rhizotwin.scenes.specimens import MeshSpecimen, PlacedFile, RsmlSpecimen
from rhizotwin.steps.arguments import SceneChanges

_RSML_SUFFIXES = (".rsml", ".xml")


def change_scene(scene: Scene, changes: SceneChanges) -> Scene:
    """Return a copy of a scene with the given changes, which are validated.

    Parameters
    ----------
    scene : Scene
        Original scene.
    changes : SceneChanges
        Changes; None leaves a value unchanged. The lens is scaled with the size of the pictures.

    Raises
    ------
    UserError
        If a value or a combination of values is invalid.
    """
    specimen = changes.specimen
    is_rsml = specimen is not None and specimen.suffix.lower() in _RSML_SUFFIXES
    unit, diameter_mm = changes.specimen_unit, changes.specimen_diameter_mm
    for option, value in (("--specimen-unit", unit), ("--specimen-diameter-mm", diameter_mm)):
        if value is not None and not is_rsml:
            raise UserError(f"{option} applies to traced roots only; give a file with --specimen FILE.rsml, or remove {option}")
    if specimen is not None:
        if not specimen.is_file():
            raise UserError(f"the file {specimen} does not exist; give a mesh (PLY, STL, OBJ) or traced roots (RSML)")
        file = str(specimen.resolve())
        traced = RsmlSpecimen(file=file, unit=unit, diameter_mm=diameter_mm)
        scene = replace(scene, specimen=traced if is_rsml else MeshSpecimen(file=file))
    given = {name: value for name, value in vars(changes.placing).items() if value is not None}
    if given:
        if not isinstance(scene.specimen, PlacedFile):
            name = next(iter(given)).replace("_", "-")
            raise UserError(f"--{name} applies to a specimen from a file only; give a file with --specimen FILE")
        if "vertical_axis" in given and not isinstance(scene.specimen, RsmlSpecimen):
            raise UserError("--vertical-axis applies to traced roots only; give a file with --specimen FILE.rsml")
        scene = replace(scene, specimen=replace(scene.specimen, **given))
    if changes.views is not None:
        scene = replace(scene, plan=CapturePlan(rings=tuple(replace(ring, views=changes.views) for ring in scene.plan.rings)))
    if changes.image_wh is not None:
        scene = replace(scene, camera=scene.camera.resized(changes.image_wh))
    if changes.profile is not None:
        scene = replace(scene, disturbances=files.load_profile(changes.profile))
    return files.scene_from_dict(files.scene_to_dict(scene), where=f"scene {scene.name} with changes")
