"""`rhizotwin score`."""

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rhizotwin import front_door
from rhizotwin.arguments import DatasetFolder, Progress, ResultFolder, VolumeMl, named


def score(
    result: ResultFolder,
    dataset: DatasetFolder | None = None,
    /,
    *,
    truth: Annotated[Path | None, named("FILE")] = None,
    volume_ml: VolumeMl | None = None,
    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False,
    progress: Progress = Progress(),
) -> None:
    """Compare a result with the truth of a simulated dataset, a scanned part, or a measured volume.

    With a simulated DATASET: volume, extents, voxels, surface distances, poses and silhouettes stage by stage, and
    every trait. With --truth: volume, extents and surface distances to a solid that is laid onto the result first,
    wherever its file has it. With --volume-ml: the volume alone. Errors are signed fractions: found / true - 1; of
    angles, differences in degrees.

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
    """
    with progress.bar(score=1.0) as bar, bar.stage("score"):
        found = front_door.score(result, dataset, truth=truth, volume_ml=volume_ml)
    print(json.dumps(found.to_dict(), indent=1) if as_json else found.table())
