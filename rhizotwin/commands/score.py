"""`rhizotwin score`."""

import json
from typing import Annotated

from cyclopts import Parameter

from rhizotwin import front_door
from rhizotwin.arguments import DatasetFolder, Progress, ResultFolder


def score(
    result: ResultFolder,
    dataset: DatasetFolder,
    /,
    *,
    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False,
    progress: Progress = Progress(),
) -> None:
    """Compare a result with the truth of a simulated dataset.

    Compare volume, extents, voxels, surface distances, and poses and silhouettes stage by stage, and every trait. Errors are signed
    fractions: found / true - 1; of angles, differences in degrees.

    Parameters
    ----------
    result : Path
        Folder made by 'rhizotwin reconstruct'.
    dataset : Path
        The simulated dataset that the result was made from.
    as_json : bool
        Print every number as JSON instead of a table.
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin score my_result my_dataset
    rhizotwin score my_result my_dataset --json > score.json
    """
    with progress.bar(score=1.0) as bar, bar.stage("score"):
        found = front_door.score(result, dataset)
    print(json.dumps(found.to_dict(), indent=1) if as_json else found.table())
