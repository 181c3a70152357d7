"""`rhizotwin export`."""

from pathlib import Path
from typing import Annotated, Literal

from rhizotwin.arguments import Flag, OutputFile, Progress, ResultFolder, named


def export(
    result: ResultFolder,
    /,
    *,
    output: OutputFile,
    dataset: Annotated[Path | None, named("DATASET")] = None,
    roots: Literal["order", "diameter"] | None = None,
    undistorted: Flag = False,
    progress: Progress = Progress(),
) -> None:
    """Write a result in the files of other programs.

    The name's suffix says in which form:
      .ply .stl   the surface, mm, z up (3D printing, MeshLab)
      .glb        the surface, metres, y up as glTF asks (viewers, Blender)
      .nrrd       voxels, 0 to 255 is the share of root, mm (3D Slicer, ImageJ)
      .rsml       the roots' centre lines and diameters, mm, z up (CPlantBox, archiDART, OpenAlea)
      .csv        the traits with units and definitions (spreadsheets, R)
      .json       the cameras as nerfstudio's transforms.json, mm
      no suffix   a folder with the cameras as COLMAP's text model, mm

    With --roots a mesh is the roots as tubes, coloured by order or diameter, instead of the surface; STL has no
    colours.

    Cameras are those in air, and the pictures were taken through a round wall and water, which magnify the roots by
    about a third and bend them. Programs that follow straight rays (photogrammetry, NeRF, Gaussian splatting) get wrong
    shapes of the roots from them, whatever the lens model; they are right for what is outside the canister. For such
    programs --undistorted writes pictures as a pinhole camera in the water would see them.

    Parameters
    ----------
    result : Path
        Folder made by 'rhizotwin reconstruct'.
    output : Path
        What to write; its suffix says in which form.
    dataset : Path, optional
        The dataset that the result was made from; cameras need its lens.
    roots : str, optional
        Write the roots as tubes in colours of this, for a mesh.
    undistorted : bool
        Write pictures without refraction to a folder, with cameras for nerfstudio and COLMAP.
    progress : Progress
        How much is shown while undistorted pictures are written.

    Examples
    --------
    rhizotwin export my_result -o root.stl
    rhizotwin export my_result -o root.nrrd
    rhizotwin export my_result -o roots.rsml
    rhizotwin export my_result --roots diameter -o roots.glb
    rhizotwin export my_result --dataset my_dataset -o transforms.json
    rhizotwin export my_result --dataset my_dataset --undistorted -o my_undistorted
    """
    from rhizotwin import exports

    with progress.bar(pictures=1.0) as bar:
        written = exports.export(result, output, dataset_folder=dataset, roots=roots, undistorted=undistorted, monitor=bar)
    print(exports.describe(written))
