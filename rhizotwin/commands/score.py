"""Command `rhizotwin score`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps import calls, front_door
from rhizotwin.steps.arguments import DatasetFolder, Flag, Progress, ResultFolder, VolumeMl, with_metavar

_OF_PICTURES = ("read", "markers", "poses", "canister", "background", "wall", "silhouettes")
"""Stages of the reconstruction that are repeated before a result is compared with pictures. The progress bar takes
their durations into account."""


@Parameter(name="*", group="Output of another program")
@dataclass(frozen=True, kw_only=True)
class ForeignFile:
    """Options for scoring the output file of another program."""

    mesh: Annotated[Path | None, with_metavar("FILE")] = None
    """Triangle mesh to score: PLY, STL or OBJ in mm with z up, or GLB in metres with y up."""
    voxels: Annotated[Path | None, with_metavar("FILE")] = None
    """Voxel occupancies to score: NRRD, or NPZ with the arrays occupancy, origin_mm and voxel_mm."""
    points: Annotated[Path | None, with_metavar("FILE")] = None
    """Surface points to score: PLY, or a text file with x y z on each line (XYZ)."""
    rsml: Annotated[Path | None, with_metavar("FILE")] = None
    """Centre lines of roots to score (RSML)."""
    traits: Annotated[Path | None, with_metavar("FILE")] = None
    """Trait table to score: CSV with the columns trait and value, and optionally low and high (90 % interval)."""
    registered: Flag = False
    """Rotate and translate the mesh to fit the true roots before the comparison; by default its coordinates must have \
their origin on the canister's axis at the rim."""

    @property
    def given(self) -> dict[front_door.FileKind, Path]:
        """Files that were given on the command line, keyed by file type."""
        every: dict[front_door.FileKind, Path | None] = {
            "mesh": self.mesh,
            "voxels": self.voxels,
            "points": self.points,
            "rsml": self.rsml,
            "traits": self.traits,
        }
        return {kind: file for kind, file in every.items() if file is not None}

    def one(self, *others: object) -> tuple[front_door.FileKind, Path]:
        """Return the type and the path of the only file that was given.

        Raises
        ------
        UserError
            If no file, several files, or other references were given.
        """
        if not self.given:
            raise UserError("--registered can be used with --mesh only; remove --registered, or give the mesh with --mesh")
        if len(self.given) > 1 or any(other is not None for other in others):
            raise UserError("the score of another program's output needs exactly one file and the simulated dataset; remove other options")
        return next(iter(self.given.items()))


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Reference:
    """Options for references other than a simulated dataset."""

    truth: Annotated[Path | None, with_metavar("FILE")] = None
    """Closed mesh of the scanned part in mm (PLY, STL, OBJ)."""
    volume_ml: VolumeMl | None = None
    """Volume of the specimen in ml, measured for example by water displacement."""
    pictures: Annotated[Path | None, with_metavar("DATASET")] = None
    """Dataset of the same plant on the same rig, with pictures that the reconstruction did not use."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Shown:
    """Options for the printed numbers."""

    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False
    """Print all numbers as JSON instead of a table."""
    every: Annotated[bool, Parameter(name="--all", show_default=False)] = False
    """Print every number of a comparison with the true roots, not only the most important ones."""

    def show(self, found: Any) -> None:
        """Print a score."""
        from rhizotwin.scoring.score import Score

        short = isinstance(found, Score) and not self.every
        print(json.dumps(found.to_dict(), indent=1) if self.as_json else found.table(every=False) if short else found.table())


def score(
    result: ResultFolder,
    dataset: DatasetFolder | None = None,
    /,
    *,
    foreign: ForeignFile = ForeignFile(),
    reference: Reference = Reference(),
    shown: Shown = Shown(),
    progress: Progress = Progress(),
) -> None:
    """Compute the errors of a result with respect to the true roots or another reference.

    Give exactly one reference:
      DATASET      simulated dataset with known true roots: errors of all quantities
      --truth      mesh of a known part: errors of volume and shape
      --volume-ml  measured volume: error of the volume
      --pictures   pictures that the reconstruction did not use: errors in pixels

    Relative errors are estimated value / true value - 1; angle errors are in degrees. To score the output of another
    program, give one of --mesh, --voxels, --points, --rsml or --traits, and the simulated dataset as the only folder.

    Parameters
    ----------
    result : Path
        Result folder; to score the output of another program, the simulated dataset.
    dataset : Path, optional
        Simulated dataset from which the result was reconstructed.
    foreign : ForeignFile
        Output file of another program.
    reference : Reference
        Other reference.
    shown : Shown
        Numbers to print.
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
    shares = {"score": 1.0} if reference.pictures is None else {name: calls.SHARES[name] for name in _OF_PICTURES} | {"score": 5.0}
    with progress.bar(**shares) as bar:
        if foreign.given or foreign.registered:
            kind, file = foreign.one(dataset, *vars(reference).values())
            found: Any = front_door.score_file(file, result, kind=kind, registered=foreign.registered, monitor=bar)
        else:
            found = front_door.score(result, dataset, **vars(reference), monitor=bar)
    shown.show(found)
