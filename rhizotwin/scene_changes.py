"""A scene with what a call or the command line changes in it."""

from dataclasses import replace
from pathlib import Path

from rhizotwin.arguments import Placing
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Scene
from rhizotwin.scenes.specimens import MeshSpecimen, PlacedFile, RsmlSpecimen

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
    """Return a scene with what is changed in it, each value and all together checked.

    Parameters
    ----------
    scene : Scene
        As loaded.
    specimen : Path or None
        Mesh or traced roots that stand in the canister.
    specimen_unit, specimen_diameter_mm : (str or None), (float or None)
        Of traced roots whose file does not say.
    placing : Placing or None
        How the specimen is put.
    views : int or None
        In each ring.
    image_wh : tuple of int or None
        Size of the pictures; the lens follows.
    profile : str or None
        Where the disturbances come from.

    Returns
    -------
    Scene
        Checked as a whole.
    """
    is_rsml = specimen is not None and specimen.suffix.lower() in _RSML_SUFFIXES
    for option, value in (("--specimen-unit", specimen_unit), ("--specimen-diameter-mm", specimen_diameter_mm)):
        if value is not None and not is_rsml:
            raise UserError(f"{option} {value} is for traced roots only; give them with --specimen FILE.rsml, or leave {option} out")
    if specimen is not None:
        if not specimen.is_file():
            raise UserError(f"{specimen}: there is no such file; give the specimen's mesh (PLY, STL, OBJ) or traced roots (RSML)")
        file = str(specimen.resolve())
        traced = RsmlSpecimen(file=file, unit=specimen_unit, diameter_mm=specimen_diameter_mm)
        scene = replace(scene, specimen=traced if is_rsml else MeshSpecimen(file=file))
    told = {name: value for name, value in vars(placing or Placing()).items() if value is not None}
    if told:
        if not isinstance(scene.specimen, PlacedFile):
            raise UserError(f"--{next(iter(told)).replace('_', '-')} is for specimens from files; give one with --specimen FILE")
        scene = replace(scene, specimen=replace(scene.specimen, **told))
    if views is not None:
        scene = replace(scene, plan=CapturePlan(rings=tuple(replace(ring, views=views) for ring in scene.plan.rings)))
    if image_wh is not None:
        scene = replace(scene, camera=scene.camera.resized(image_wh))
    if profile is not None:
        scene = replace(scene, disturbances=files.load_profile(profile))
    return files.scene_from_dict(files.scene_to_dict(scene), where=f"scene {scene.name} as it is changed")
