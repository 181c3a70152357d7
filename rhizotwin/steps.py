"""Steps that several commands take: the engine started, a scene as the command line changes it, a dataset reconstructed and drawn."""

from dataclasses import replace
from pathlib import Path

from rhizotwin import engine
from rhizotwin.scenes import files
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, new_folder, tidy
from rhizotwin.scenes.model import CapturePlan, Scene
from rhizotwin.scenes.specimens import MeshSpecimen, RsmlSpecimen

_RSML_SUFFIXES = (".rsml", ".xml")
_RESULT_NAMES = (
    *("result.json", "shape.npz", "shape.ply", "roots.rsml", "traits.csv", "traits.json"),
    *("silhouettes", "seen", "pictures", "report.html", "score.json"),
)
"""What a result folder may hold and still be replaced by a new result."""


def start_engine(device: str) -> None:
    """Choose what computes, and say what it is."""
    print(engine.start(device))


def change_scene(
    scene: Scene,
    *,
    specimen: Path | None = None,
    specimen_unit: str | None = None,
    specimen_diameter_mm: float | None = None,
    views: int | None = None,
    image_wh: tuple[int, int] | None = None,
    profile: str | None = None,
) -> Scene:
    """Return a scene with what the command line changes in it, checked."""
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
    if views is not None:
        scene = replace(scene, plan=CapturePlan(rings=tuple(replace(ring, views=views) for ring in scene.plan.rings)))
    if image_wh is not None:
        scene = replace(scene, camera=scene.camera.resized(image_wh))
    if profile is not None:
        scene = replace(scene, disturbances=files.load_profile(profile))
    check_scene(scene, where=f"scene {scene.name} as the command line changes it")
    return scene


def reconstruct_whole(dataset: Path, output: Path, *, voxel_mm: float, mass_g: float | None = None) -> list[Path]:
    """Reconstruct a dataset and draw its pictures; the result folder appears whole or not at all. Return the pictures' paths.

    Raises
    ------
    UserError
        If the dataset cannot be used, or ``output`` holds something that is not a result.
    """
    tidy(output)
    there = contents(output)
    if there and not (output / "result.json").is_file():
        raise UserError(f"{output} holds something that is no result; choose a new folder for the result")
    strange = [name for name in there if name not in _RESULT_NAMES]
    if strange:
        raise UserError(f"{output} holds {strange[0]} beside an earlier result, which would be lost; move it away or choose a new folder")
    if output.resolve() == dataset.resolve() or output.resolve() in dataset.resolve().parents:
        raise UserError(f"the result would overwrite the dataset {dataset}; choose another folder for the result")
    from rhizotwin.recon.reconstruct import reconstruct
    from rhizotwin.recon.results import report
    from rhizotwin.recon.results.result_files import read_mesh
    from rhizotwin.recon.scoring.score import truth_mesh_path
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.scenes.monitor import Monitor

    truth_mesh = truth_mesh_path(dataset) if (dataset / "truth" / "specimen.ply").is_file() else None
    if truth_mesh is not None:
        read_mesh(truth_mesh)  # a damaged one is named now, not after the work
    loaded = load_dataset(dataset)  # once: what happens to the folder meanwhile does not change what the result was made from
    with new_folder(output, replaces=_RESULT_NAMES) as building:
        reconstruct(loaded, settings=Settings(voxel_mm=voxel_mm), mass_g=mass_g, monitor=Monitor.on_terminal()).save(building)
        written = report.write_pictures(building, loaded, truth_mesh=truth_mesh)
        names = [path.relative_to(building) for path in written]
    return [output / name for name in names]
