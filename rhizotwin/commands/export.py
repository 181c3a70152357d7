"""Command `rhizotwin export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.arguments import Flag, OutputFile, Progress, with_metavar


@Parameter(name="*", group="Publication")
@dataclass(frozen=True, kw_only=True)
class Publication:
    """Options for the publication of datasets and results in a data repository."""

    publish: Annotated[Path | None, with_metavar("FOLDER")] = None
    """Folder to write for upload to a data repository, with copies of the data, RO-Crate metadata, MIAPPE 1.1 tables, \
checksums and an overview picture. Symbolic links and damaged pictures are rejected."""
    study: Annotated[Path | None, with_metavar("FILE")] = None
    """TOML file with title, description, licence and authors of the publication (docs/publishing.md)."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Content:
    """Options for other contents of the output than those of its suffix."""

    roots: Literal["order", "diameter"] | None = None
    """Write the roots as a mesh of tubes, coloured by order or diameter (STL has no colours)."""
    undistorted: Flag = False
    """Write pictures with the refraction removed to a folder, with cameras for nerfstudio and COLMAP."""
    rays: Flag = False
    """Write the line of sight of each pixel in the water to a folder, for programs that accept rays."""


def export(
    sources: Annotated[list[Path], with_metavar("RESULT")],
    /,
    *,
    output: OutputFile | None = None,
    dataset: Annotated[Path | None, with_metavar("DATASET")] = None,
    content: Content = Content(),
    publication: Publication = Publication(),
    progress: Progress = Progress(),
) -> None:
    """Convert a result to other file formats, or publish datasets and results.

    The suffix of the output file selects the format:
      .ply .stl .obj .3mf        surface, mm, z up (3D printing, MeshLab, slicers)
      .glb                       surface, metres, y up as glTF requires (viewers, Blender)
      .nrrd .nii .nii.gz .vtk .tif  voxels, mm; 0 to 255 is the root fraction of a voxel (3D Slicer, ParaView, ImageJ)
      .rsml                      centre lines and diameters of the roots, mm, z up (CPlantBox, archiDART, OpenAlea)
      .csv                       traits with units and definitions (spreadsheets, R)
      .json                      cameras in nerfstudio's transforms.json format, mm
      no suffix                  folder with the cameras in COLMAP's text format, mm

    The exported cameras are in air. Programs that assume straight rays cannot reconstruct roots in water with these
    cameras; for such programs, --undistorted removes the refraction from the pictures.

    Parameters
    ----------
    sources : list of Path
        Result folder, written by 'rhizotwin reconstruct'; with --publish, one or more results and datasets.
    output : Path, optional
        File or folder to write; its suffix selects the format.
    dataset : Path, optional
        Dataset of the result; required for the export of cameras.
    content : Content
        Content of the output.
    publication : Publication
        Publication in a data repository.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin export my_result --roots diameter -o roots.glb
    rhizotwin export my_result --dataset my_dataset --undistorted -o my_undistorted
    rhizotwin export my_result --dataset my_dataset --rays -o my_rays
    rhizotwin export my_scans my_results --publish my_data --study my_study.toml
    """
    if publication.publish is not None:
        if any((output, dataset, *vars(content).values())):
            raise UserError("--publish cannot be used with -o, --dataset, --roots, --undistorted or --rays; remove these options")
        _publish(sources, publication.publish, publication.study, progress)
    elif output is None or len(sources) != 1:
        raise UserError("the export needs one result and -o FILE, or for a publication --publish FOLDER with results and datasets")
    else:
        _export(sources[0], output, dataset, content, progress)


def _export(result: Path, output: Path, dataset: Path | None, content: Content, progress: Progress) -> None:
    from rhizotwin.exporter import exports

    refraction = exports.choose(undistorted=content.undistorted, rays=content.rays)
    with progress.bar(pictures=1.0) as bar:
        written = exports.export(result, output, dataset_folder=dataset, roots=content.roots, refraction=refraction, monitor=bar)
    print(exports.describe(written))


def _publish(sources: list[Path], folder: Path, study: Path | None, progress: Progress) -> None:
    from rhizotwin.publishing.publish import publish
    from rhizotwin.publishing.study import missing_study, read_study

    if study is None:
        raise missing_study(folder)
    described = read_study(study)
    with progress.bar(copy=1.0) as bar:
        notes = publish(sources, folder, described, monitor=bar)
    for note in notes:
        print(f"note: {note}")
    print(f"wrote {folder}; check README.md and contact_sheet.png in this folder, then upload the folder")
