"""Python interface for export and publication."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rhizotwin.api.command_calls import log, paths
from rhizotwin.steps.calls import Progress, dataset_folder, result_folder, watch
from rhizotwin.steps.results import Paths

if TYPE_CHECKING:
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.stored.save import Result


def export(
    result: Result | str | Path,
    output: str | Path,
    *,
    dataset: Dataset | str | Path | None = None,
    roots: Literal["order", "diameter"] | None = None,
    undistorted: bool = False,
    rays: bool = False,
    monitor: Progress = None,
) -> list[Path]:
    """Write a result in a file format of other programs.

    The suffix of ``output`` selects the format.

    Parameters
    ----------
    result : Result or path
        Result, or folder of a saved result.
    output : path
        Output file with the suffix .ply, .stl or .glb (closed surface), .nrrd (voxels), .rsml (centre lines),
        .csv (traits) or .json (cameras for nerfstudio), or output folder (cameras for COLMAP).
    dataset : Dataset or path, optional
        Dataset of the result; required for the export of cameras.
    roots : {"order", "diameter"}, optional
        Mesh formats only: write the roots as tubes, coloured by this property.
    undistorted : bool
        Write the pictures with refraction removed, and their cameras, to the folder ``output``.
    rays : bool
        Write the line of sight in the water of each pixel to the folder ``output``.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    list of Path
        Written files.
    """
    from rhizotwin.exporter import exports

    pictures = dataset_folder(dataset)
    refraction = exports.choose(undistorted=undistorted, rays=rays)
    with watch(monitor, {"pictures": 1.0}) as bar, result_folder(result) as source:
        return exports.export(source, Path(output), dataset_folder=pictures, roots=roots, refraction=refraction, monitor=bar)


def publish(sources: Paths, output: str | Path, *, study: str | Path, monitor: Progress = None) -> Path:
    """Copy datasets and results to a folder for a data repository, with metadata and checksums.

    Parameters
    ----------
    sources : path or sequence of path
        Datasets and results, or folders of these.
    output : path
        New or empty folder for the publication.
    study : path
        File (TOML) with title, description, licence and authors, see `docs/publishing.md`.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    Path
        Folder of the publication.
    """
    from rhizotwin.publishing.publish import publish as write
    from rhizotwin.publishing.study import read_study

    copied, described = paths("sources", sources), read_study(Path(study))
    with watch(monitor, {"copy": 1.0}) as bar:
        for note in write(copied, Path(output), described, monitor=bar):
            log.info(note)
    return Path(output)
