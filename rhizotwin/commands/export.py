"""`rhizotwin export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from rhizotwin.arguments import Flag, OutputFile, Progress, named
from rhizotwin.scenes.errors import UserError


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Publication:
    """Datasets and results, or folders of them, copied to a folder that a data repository takes as it is."""

    publish: Annotated[Path | None, named("FOLDER")] = None
    """Folder to make: copies, RO-Crate metadata, tables of MIAPPE 1.1, checksums, a contact sheet. Links and damaged
    pictures are refused."""
    study: Annotated[Path | None, named("FILE")] = None
    """TOML file with title, description, licence and authors of what is published (docs/publishing.md)."""


def export(
    sources: Annotated[list[Path], named("RESULT")],
    /,
    *,
    output: OutputFile | None = None,
    dataset: Annotated[Path | None, named("DATASET")] = None,
    roots: Literal["order", "diameter"] | None = None,
    undistorted: Flag = False,
    publication: Publication = Publication(),
    progress: Progress = Progress(),
) -> None:
    """Write a result in the files of other programs, or publish datasets and results.

    The name's suffix says in which form:
      .ply .stl   the surface, mm, z up (3D printing, MeshLab)
      .glb        the surface, metres, y up as glTF asks (viewers, Blender)
      .nrrd       voxels, 0 to 255 is the share of root, mm (3D Slicer, ImageJ)
      .rsml       the roots' centre lines and diameters, mm, z up (CPlantBox, archiDART, OpenAlea)
      .csv        the traits with units and definitions (spreadsheets, R)
      .json       the cameras as nerfstudio's transforms.json, mm
      no suffix   a folder with the cameras as COLMAP's text model, mm

    With --roots a mesh is the roots as tubes, coloured by order or diameter; STL has no colours. Cameras are those in
    air: programs that follow straight rays get wrong shapes of roots from them, whatever the lens model, but are right
    outside of the canister. For them --undistorted writes pictures as a pinhole camera in the water would see them.

    Parameters
    ----------
    sources : list of Path
        Folder made by 'rhizotwin reconstruct'; with --publish several, and datasets.
    output : Path, optional
        What to write; its suffix says in which form.
    dataset : Path, optional
        The dataset that the result was made from; cameras need its lens.
    roots : str, optional
        Write the roots as tubes in colours of this, for a mesh.
    undistorted : bool
        Write pictures without refraction to a folder, with cameras for nerfstudio and COLMAP.
    publication : Publication
        What is published.
    progress : Progress
        How much is shown while pictures are written.

    Examples
    --------
    rhizotwin export my_result -o root.stl
    rhizotwin export my_result --roots diameter -o roots.glb
    rhizotwin export my_result --dataset my_dataset -o transforms.json
    rhizotwin export my_result --dataset my_dataset --undistorted -o my_undistorted
    rhizotwin export my_scans my_results --publish my_data --study my_study.toml
    """
    if publication.publish is not None:
        if output is not None or dataset is not None or roots is not None or undistorted:
            raise UserError("--publish FOLDER makes a folder of its own; leave -o, --dataset, --roots and --undistorted out")
        _publish(sources, publication.publish, publication.study, progress)
    elif output is None or len(sources) != 1:
        raise UserError("give one result and -o FILE, or --publish FOLDER for several results and datasets")
    else:
        _export(sources[0], output, dataset, roots, undistorted, progress)


def _export(result: Path, output: Path, dataset: Path | None, roots: str | None, undistorted: bool, progress: Progress) -> None:
    from rhizotwin import exports

    with progress.bar(pictures=1.0) as bar:
        written = exports.export(result, output, dataset_folder=dataset, roots=roots, undistorted=undistorted, monitor=bar)
    print(exports.describe(written))


def _publish(sources: list[Path], folder: Path, study: Path | None, progress: Progress) -> None:
    from rhizotwin.publishing.publish import publish
    from rhizotwin.publishing.study import missing_study, read_study

    if study is None:
        raise missing_study(folder)
    described = read_study(study)
    with progress.bar(copy=1.0) as bar:
        publish(sources, folder, described, monitor=bar)
    print(f"wrote {folder}: read its README.md, look at contact_sheet.png, then upload the folder")
