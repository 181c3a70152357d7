"""`rhizotwin score`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rhizotwin import command_steps, front_door
from rhizotwin.arguments import DatasetFolder, Flag, Progress, ResultFolder, VolumeMl, named
from rhizotwin.scenes.errors import UserError

_OF_PICTURES = ("read", "markers", "poses", "canister", "background", "wall", "silhouettes")
"""Stages that pictures go through before they are compared."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ForeignFile:
    """What another method wrote, scored in place of a result."""

    mesh: Annotated[Path | None, named("FILE")] = None
    """Score this triangle mesh: PLY, STL or OBJ in mm with z up, GLB in metres with y up."""
    voxels: Annotated[Path | None, named("FILE")] = None
    """Score these occupancies: NRRD, or NPZ with occupancy, origin_mm and voxel_mm."""
    points: Annotated[Path | None, named("FILE")] = None
    """Score these surface points: PLY, or lines of x y z (XYZ)."""
    rsml: Annotated[Path | None, named("FILE")] = None
    """Score these centre lines."""
    traits: Annotated[Path | None, named("FILE")] = None
    """Score this table: CSV with the columns trait and value, and low and high for 90 % intervals."""
    registered: Flag = False
    """Lay the mesh onto the truth first; otherwise it is in the canister's frame."""

    @property
    def given(self) -> dict[front_door.FileKind, Path]:
        """Return the files that are given, by kind."""
        every: dict[front_door.FileKind, Path | None] = {
            "mesh": self.mesh,
            "voxels": self.voxels,
            "points": self.points,
            "rsml": self.rsml,
            "traits": self.traits,
        }
        return {kind: file for kind, file in every.items() if file is not None}

    def one(self, *others: object) -> tuple[front_door.FileKind, Path]:
        """Return kind and file; UserError where there are several, or something else is given beside."""
        if len(self.given) > 1 or any(other is not None for other in others):
            raise UserError("give one file of another method and the simulated dataset, and nothing else to score")
        return next(iter(self.given.items()))


def score(
    result: ResultFolder,
    dataset: DatasetFolder | None = None,
    /,
    *,
    foreign: ForeignFile = ForeignFile(),
    truth: Annotated[Path | None, named("FILE")] = None,
    volume_ml: VolumeMl | None = None,
    pictures: Annotated[Path | None, named("DATASET")] = None,
    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False,
    progress: Progress = Progress(),
) -> None:
    """Compare a result with a simulated dataset's truth, a scanned part, a measured volume, or unseen pictures.

    With a simulated DATASET: volume, extents, voxels, surface distances, every trait, poses and silhouettes. With
    --truth: volume, extents and surface distances to a solid that is laid onto the result first. With --volume-ml: the
    volume alone. With --pictures: area, outlines and centre lines that the result would show in pictures that it was
    not made from, in pixels. Errors are signed fractions: found / true - 1; of angles, differences in degrees.

    With --mesh, --voxels, --points, --rsml or --traits, a file of another method is scored, and the only folder is the
    simulated dataset.

    Parameters
    ----------
    result : Path
        Folder made by 'rhizotwin reconstruct'; with a file of another method the simulated dataset.
    dataset : Path, optional
        The simulated dataset that the result was made from.
    foreign : ForeignFile
        What another method wrote.
    truth : Path, optional
        The part that was scanned, as a closed mesh in mm (PLY, STL, OBJ).
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
    rhizotwin score --mesh shape.stl my_dataset
    rhizotwin score --rsml roots.rsml my_dataset --json
    """
    shares = {"score": 1.0} if pictures is None else {name: command_steps.SHARES[name] for name in _OF_PICTURES} | {"score": 5.0}
    with progress.bar(**shares) as bar:
        if foreign.given:
            kind, file = foreign.one(dataset, truth, volume_ml, pictures)
            found: Any = front_door.score_file(file, result, kind=kind, registered=foreign.registered, progress=bar)
        else:
            found = front_door.score(result, dataset, truth=truth, volume_ml=volume_ml, pictures=pictures, progress=bar)
    print(json.dumps(found.to_dict(), indent=1) if as_json else found.table())
