"""`rhizotwin score`."""

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rhizotwin import front_door, steps
from rhizotwin.arguments import DatasetFolder, Progress, ResultFolder, VolumeMl, named

_OF_PICTURES = ("read", "markers", "poses", "canister", "background", "wall", "silhouettes")
"""Stages that pictures go through before they are compared."""


def score(
    result: ResultFolder,
    dataset: DatasetFolder | None = None,
    /,
    *,
    truth: Annotated[Path | None, named("FILE")] = None,
    volume_ml: VolumeMl | None = None,
    pictures: Annotated[Path | None, named("DATASET")] = None,
    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False,
    progress: Progress = Progress(),
) -> None:
    """Compare a result with a simulated dataset's truth, a scanned part, a measured volume, or unseen pictures.

    With a simulated DATASET: volume, extents, voxels, surface distances, poses and silhouettes stage by stage, and
    every trait. With --truth: volume, extents and surface distances to a solid that is laid onto the result first,
    wherever its file has it. With --volume-ml: the volume alone. With --pictures: what the result would show in
    pictures that it was not made from, against what they show: area, outlines and centre lines, in pixels. Errors are
    signed fractions: found / true - 1; of angles, differences in degrees.

    Parameters
    ----------
    result : Path
        Folder made by 'rhizotwin reconstruct'.
    dataset : Path, optional
        The simulated dataset that the result was made from.
    truth : Path, optional
        The part that was scanned, as a closed mesh in mm (PLY, STL, OBJ), such as 'rhizotwin scenes printed_8ml
        --specimen-stl' writes.
    volume_ml : float, optional
        The specimen's volume, measured by displacement or weight.
    pictures : Path, optional
        A dataset of the same plant on the same rig: another scan, or the whole one of which a part was reconstructed.
        What was used is left out.
    as_json : bool
        Print every number as JSON instead of a table.
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin score my_result my_dataset
    rhizotwin score my_result my_dataset --json > score.json
    rhizotwin score my_result --truth my_part.stl
    rhizotwin score my_result --volume-ml 8.0
    rhizotwin score my_result --pictures my_other_scan
    """
    shares = {"score": 1.0} if pictures is None else {name: steps.SHARES[name] for name in _OF_PICTURES} | {"score": 5.0}
    with progress.bar(**shares) as bar:
        found = front_door.score(result, dataset, truth=truth, volume_ml=volume_ml, pictures=pictures, progress=bar)
    print(json.dumps(found.to_dict(), indent=1) if as_json else found.table())
