"""Command `rhizotwin import`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rhizotwin.scenes import files
from rhizotwin.scenes.formatting import count
from rhizotwin.steps.arguments import Flag, OutputDataset, Progress, SceneName, SubjectOptions, with_metavar


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Kind:
    """Options for the kind of the pictures and the source of their cameras."""

    cameras: Annotated[Path | None, with_metavar("JSON")] = None
    """File of camera poses and lens parameters in nerfstudio's format (transforms.json), or folder of a COLMAP model, \
in mm with the origin on the canister's axis at the rim and z up. The cameras are then not estimated from the \
markers."""
    masks: Flag = False
    """The pictures are silhouettes with white roots on a black background; requires --cameras."""
    no_strip: Flag = False
    """The pictures show no marker strip, and 'rhizotwin reconstruct' estimates the cameras from the edges of the \
canister and from the roots. Requires a telecentric camera (camera.kind in the scene) and one full turn; the scale is \
that of canister.outer_radius_mm in the scene."""


def import_(
    pictures: Annotated[Path, with_metavar("PICTURES")],
    /,
    *,
    scene: SceneName,
    output: OutputDataset,
    kind: Kind = Kind(),
    subject: SubjectOptions = SubjectOptions(),
    progress: Progress = Progress(),
) -> None:
    """Create a dataset from a folder of pictures.

    The pictures must have the same size, and are sorted by name. They are turned as their orientation tags state. The
    scene describes the rig on which they were taken: canister, water, marker strip (printed markers around the plant's
    net pot) and camera. If the number of pictures
    equals the number of planned views in the scene, the planned turntable angles are used.

    Parameters
    ----------
    pictures : Path
        Folder of pictures (PNG, JPG, TIFF, or raw pictures such as DNG).
    scene : str
        Scene: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        New or empty folder for the dataset.
    kind : Kind
        Kind of the pictures, and source of their cameras.
    subject : SubjectOptions
        Plant in the canister.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset --plant P7 --treatment "low N" --day 15
    rhizotwin import my_masks --scene my_rig.toml --cameras transforms.json --masks -o my_dataset
    rhizotwin import my_pictures --scene my_rig.toml --cameras sparse/0 -o my_dataset
    rhizotwin import my_gel_pictures --scene gel_cylinder --no-strip -o my_gel_scan
    """
    from rhizotwin.importer.picture_import import PictureKind, import_pictures

    described = subject.apply_to(files.load_scene(scene))
    with progress.bar(copy=1.0) as bar:
        made = import_pictures(pictures, described, output, kind=PictureKind(**vars(kind)), monitor=bar)
    for note in made.notes:
        print(f"note: {note}")
    print(f"wrote {count(len(made.dataset.frames), 'picture')} to {output}")
    print(f"next: rhizotwin reconstruct {output} -o my_result")
