"""`rhizotwin import`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import Flag, OutputDataset, Progress, SceneName, SubjectOptions, with_metavar
from rhizotwin.scenes import files


def import_(
    pictures: Annotated[Path, with_metavar("PICTURES")],
    /,
    *,
    scene: SceneName,
    output: OutputDataset,
    cameras: Annotated[Path | None, with_metavar("JSON")] = None,
    masks: Flag = False,
    no_strip: Flag = False,
    subject: SubjectOptions = SubjectOptions(),
    progress: Progress = Progress(),
) -> None:
    """Create a dataset from a folder of pictures.

    The pictures (PNG, JPG or TIFF) must have the same size; they are ordered by name. The scene describes the rig on
    which they were taken: canister, water, marker strip and camera. If the capture plan of the scene has as many views
    as there are pictures, its turntable angles are used.

    Parameters
    ----------
    pictures : Path
        Folder of pictures.
    scene : str
        Name of a scene (listed by 'rhizotwin scenes') or path of a scene file (TOML).
    output : Path
        Dataset folder to write: new or empty.
    cameras : Path, optional
        Camera poses and lens in nerfstudio's format (transforms.json), in the canister frame in mm; markers are not
        used then.
    masks : bool
        The pictures are binary silhouettes (white root on black background); requires --cameras.
    no_strip : bool
        The pictures show no marker strip; 'rhizotwin reconstruct' then estimates the cameras from the edges of the
        canister and from the roots. Requires a telecentric camera (camera.kind in the scene) and one full turn; the
        scale is given by canister.outer_radius_mm of the scene.
    subject : SubjectOptions
        Plant in the canister.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset --plant P7 --treatment "low N" --day 15
    rhizotwin import my_masks --scene my_rig.toml --cameras transforms.json --masks -o my_dataset
    rhizotwin import my_gel_pictures --scene gel_cylinder --no-strip -o my_gel_scan
    """
    from rhizotwin.importer import import_pictures

    described = subject.apply_to(files.load_scene(scene))
    with progress.bar(copy=1.0) as bar:
        made = import_pictures(pictures, described, output, cameras=cameras, masks=masks, no_strip=no_strip, monitor=bar)
    for note in made.notes:
        print(f"note: {note}")
    print(f"wrote {len(made.dataset.frames)} pictures to {output}")
    print(f"next: rhizotwin reconstruct {output} -o my_result")
