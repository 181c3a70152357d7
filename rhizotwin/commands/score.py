"""`rhizotwin score`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rhizotwin import calls, front_door
from rhizotwin.arguments import DatasetFolder, Flag, Progress, ResultFolder, VolumeMl, with_metavar
from rhizotwin.scenes.errors import UserError

_OF_PICTURES = ("read", "markers", "poses", "canister", "background", "wall", "silhouettes")
"""Processing stages of the pictures before the comparison."""


@Parameter(name="*", group="Output of another method")
@dataclass(frozen=True, kw_only=True)
class ForeignFile:
    """File of another method, scored instead of a result."""

    mesh: Annotated[Path | None, with_metavar("FILE")] = None
    """Score a triangle mesh: PLY, STL or OBJ in mm with z up, or GLB in metres with y up."""
    voxels: Annotated[Path | None, with_metavar("FILE")] = None
    """Score voxel occupancies: NRRD, or NPZ with the arrays occupancy, origin_mm and voxel_mm."""
    points: Annotated[Path | None, with_metavar("FILE")] = None
    """Score surface points: PLY, or a text file with x y z on each line (XYZ)."""
    rsml: Annotated[Path | None, with_metavar("FILE")] = None
    """Score centre lines (RSML)."""
    traits: Annotated[Path | None, with_metavar("FILE")] = None
    """Score a table of traits: CSV with the columns trait and value, and optionally low and high (90 % interval)."""
    registered: Flag = False
    """Register the mesh to the ground truth by a rigid motion first; otherwise its coordinates are those of the \
canister frame."""

    @property
    def given(self) -> dict[front_door.FileKind, Path]:
        """Return the given files by kind."""
        every: dict[front_door.FileKind, Path | None] = {
            "mesh": self.mesh,
            "voxels": self.voxels,
            "points": self.points,
            "rsml": self.rsml,
            "traits": self.traits,
        }
        return {kind: file for kind, file in every.items() if file is not None}

    def one(self, *others: object) -> tuple[front_door.FileKind, Path]:
        """Return kind and file; raise UserError if several files or other references are given."""
        if len(self.given) > 1 or any(other is not None for other in others):
            raise UserError("give exactly one file of another method and the simulated dataset, without other options of the reference")
        return next(iter(self.given.items()))


def score(
    result: ResultFolder,
    dataset: DatasetFolder | None = None,
    /,
    *,
    foreign: ForeignFile = ForeignFile(),
    truth: Annotated[Path | None, with_metavar("FILE")] = None,
    volume_ml: VolumeMl | None = None,
    pictures: Annotated[Path | None, with_metavar("DATASET")] = None,
    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False,
    progress: Progress = Progress(),
) -> None:
    """Compare a result with ground truth, a known part, a measured volume or other pictures.

    The reference is one of the following:
      DATASET      a simulated dataset: volume, extents, voxels, surface distances, traits, camera poses, silhouettes
      --truth      the mesh of a known part, registered to the result first: volume, extents, surface distances
      --volume-ml  a measured volume: volume only
      --pictures   pictures that were not used in the reconstruction: area, outlines and centre lines, in pixels

    Relative errors are estimate / true - 1; errors of angles are differences in degrees. To score the output of another
    method, give one of --mesh, --voxels, --points, --rsml or --traits, and the simulated dataset as the only folder.

    Parameters
    ----------
    result : Path
        Result folder; for the file of another method, the simulated dataset.
    dataset : Path, optional
        Simulated dataset from which the result was reconstructed.
    foreign : ForeignFile
        File of another method.
    truth : Path, optional
        Closed mesh of the scanned part, in mm (PLY, STL, OBJ).
    volume_ml : float, optional
        Measured volume of the specimen in ml, for example by water displacement.
    pictures : Path, optional
        Dataset of the same plant and rig, with pictures that were not used in the reconstruction.
    as_json : bool
        Print all numbers as JSON instead of a table.
    progress : Progress
        Progress output.

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
    shares = {"score": 1.0} if pictures is None else {name: calls.SHARES[name] for name in _OF_PICTURES} | {"score": 5.0}
    with progress.bar(**shares) as bar:
        if foreign.given:
            kind, file = foreign.one(dataset, truth, volume_ml, pictures)
            found: Any = front_door.score_file(file, result, kind=kind, registered=foreign.registered, progress=bar)
        else:
            found = front_door.score(result, dataset, truth=truth, volume_ml=volume_ml, pictures=pictures, progress=bar)
    print(json.dumps(found.to_dict(), indent=1) if as_json else found.table())
