"""`rhizotwin import`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import Flag, OutputDataset, Progress, SceneName, SubjectOptions, named
from rhizotwin.scenes import files


def import_(
    pictures: Annotated[Path, named("PICTURES")],
    /,
    *,
    scene: SceneName,
    output: OutputDataset,
    cameras: Annotated[Path | None, named("JSON")] = None,
    masks: Flag = False,
    no_strip: Flag = False,
    subject: SubjectOptions = SubjectOptions(),
    progress: Progress = Progress(),
) -> None:
    """Make a dataset of a folder of pictures taken elsewhere.

    The pictures are PNG, JPG or TIFF, of one size, in the natural order of their names. The scene describes the rig
    they were taken on: canister, water, strip, camera. If the scene's plan has as many views as there are pictures, its
    table angles are assumed.

    Parameters
    ----------
    pictures : Path
        Folder of pictures.
    scene : str
        A scene file (TOML) or a name from 'rhizotwin scenes'.
    output : Path
        Folder to make the dataset in: new or empty.
    cameras : Path, optional
        Poses and lens in nerfstudio's form (transforms.json), its world the canister frame in millimetres: no markers
        are needed then.
    masks : bool
        The pictures are silhouettes already: white root on black; needs --cameras, they show no markers.
    no_strip : bool
        There is no marker strip: 'reconstruct' finds the cameras by the canister's edges and the roots. For a
        telecentric camera (camera.kind in the scene) and one turn; the scene's canister.outer_radius_mm gives the
        scale.
    subject : SubjectOptions
        Whose roots they are.
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset --plant P7 --treatment "low N" --day 15
    rhizotwin import my_masks --scene my_rig.toml --cameras transforms.json --masks -o my_dataset
    rhizotwin import my_gel_pictures --scene gel_cylinder --no-strip -o my_gel_scan
    """
    from rhizotwin.importer import import_pictures

    told = subject.told(files.load_scene(scene))
    with progress.bar(copy=1.0) as bar:
        made = import_pictures(pictures, told, output, cameras=cameras, masks=masks, no_strip=no_strip, monitor=bar)
    for note in made.notes:
        print(f"note: {note}")
    print(f"{len(made.dataset.frames)} pictures in {output}")
    print(f"next: rhizotwin reconstruct {output} -o my_result")
