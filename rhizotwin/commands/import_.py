"""`rhizotwin import`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import Flag, OutputDataset, SceneName, named
from rhizotwin.scenes import files


def import_(
    pictures: Annotated[Path, named("PICTURES")],
    /,
    *,
    scene: SceneName,
    output: OutputDataset,
    cameras: Annotated[Path | None, named("JSON")] = None,
    masks: Flag = False,
) -> None:
    """Make a dataset of a folder of pictures taken elsewhere.

    The pictures are PNG, JPG or TIFF, of one size, in the natural order of their names. The scene describes the rig they were taken on:
    canister, water, strip, camera. If the scene's plan has as many views as there are pictures, its table angles are assumed.

    Parameters
    ----------
    pictures : Path
        Folder of pictures.
    scene : str
        A scene file (TOML) or a name from 'rhizotwin scenes'.
    output : Path
        Folder to make the dataset in: new or empty.
    cameras : Path, optional
        Poses and lens in nerfstudio's form (transforms.json), its world the canister frame in millimetres: no markers are needed then.
    masks : bool
        The pictures are silhouettes already: white root on black; needs --cameras, they show no markers.

    Examples
    --------
    rhizotwin import my_pictures --scene my_rig.toml -o my_dataset
    rhizotwin import my_masks --scene my_rig.toml --cameras transforms.json --masks -o my_dataset
    """
    from rhizotwin.importer import import_pictures

    made = import_pictures(pictures, files.load_scene(scene), output, cameras=cameras, masks=masks)
    for note in made.notes:
        print(f"note: {note}")
    print(f"{len(made.dataset.frames)} pictures in {output}")
    print(f"next: rhizotwin reconstruct {output} -o my_result")
