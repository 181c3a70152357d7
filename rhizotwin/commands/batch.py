"""Reconstruct many scans, locally or on a cluster."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count, was
from rhizotwin.scenes.solution import Factors
from rhizotwin.steps.arguments import (
    Device,
    SceneChanges,
    SceneName,
    Seed,
    VoxelMm,
    list_of,
    option,
    output,
    read_day,
    read_integer,
    read_number,
    with_metavar,
)

if TYPE_CHECKING:
    from rhizotwin.batches.run import Batch

Outputs = Annotated[str, output("FOLDER")]
Workers = Annotated[int, option(lambda text: read_integer(text, 1, 10000, "give 1 to 10000"), "N")]
Cluster = Annotated[str, with_metavar("ADDRESS|slurm")]


def read_treatment(text: str) -> tuple[str, float, Factors]:
    """Convert a treatment such as ``low N:0.85:N=0.5`` to three values.

    They are the name of the treatment, its growth factor, and the factor for the concentration of each element.
    """
    name, *words = (word.strip() for word in text.split(":"))
    if not words or not name or not all("=" in word for word in words[1:]):
        raise ValueError(f"{text!r} is not a treatment; write name and growth factor, such as 'low N:0.85' or 'low K:0.9:K=0.5'")
    parts = (word.partition("=") for word in words[1:])
    factors = tuple((element.strip(), read_number(factor, (0.0, 100.0), f"times {element}", "times")) for element, _, factor in parts)
    return name, read_number(words[0], (0.1, 10.0), "times the scene's growth", "times"), factors


@Parameter(name="*", group="Computing")
@dataclass(frozen=True, kw_only=True)
class Workforce:
    """Options for the computing resources."""

    workers: Workers | None = None
    """Maximum number of scans processed in parallel; default: number of processors, limited by the memory."""
    cluster: Cluster | None = None
    """Address of a Dask scheduler, such as tcp://host:8786, or slurm to start Slurm jobs. The workers need this \
program and access to the same folders."""
    device: Device = "auto"
    """Device for the computation: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available)."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Series:
    """Options for the plants, ages and treatments of each scene."""

    plants: Annotated[int, option(lambda text: read_integer(text, 1, 1000, "give 1 to 1000"), "N")] = 1
    """Number of plants per scene and treatment."""
    days: Annotated[tuple[float, ...] | None, option(list_of(read_day), "D,D,...")] = None
    """Ages of each plant in days, separated by commas; default: as in the scene."""
    treatments: Annotated[tuple[tuple[str, float, Factors], ...] | None, option(list_of(read_treatment), "LIST")] = None
    """Comma-separated treatments, each NAME:FACTOR, where FACTOR multiplies the growth rate, such as 'control:1,low \
N:0.85'. If the scene has a nutrient solution, factors for its elements may follow, such as 'low N:0.85:N=0.5'."""


def batch(
    scans: Annotated[list[str], with_metavar("SCANS")],
    /,
    *,
    output: Outputs,
    voxel_mm: VoxelMm | None = None,
    settings: Annotated[Path | None, with_metavar("FILE")] = None,
    work: Workforce = Workforce(),
) -> None:
    """Reconstruct many scans, locally or on a cluster.

    Each dataset (folder with the pictures of a scan) is reconstructed to a result folder of the same name. Results that
    an earlier run computed from the same dataset with the same settings and program version are kept, so that an
    interrupted run can be continued with the same command. Failed scans are listed at the end with the reason. The
    traits of all scans are written to traits.csv, and overview.html shows each scan with a picture.

    Parameters
    ----------
    scans : list of str
        Datasets, folders that contain datasets, quoted patterns such as 'scans/day_*', addresses (s3://...), or a
        catalogue (.rhizotwin).
    output : str
        Folder or address for the results.
    voxel_mm : float, optional
        Edge length of the smallest voxels in mm, see 'rhizotwin reconstruct'.
    settings : Path, optional
        TOML file with settings of the reconstruction, see 'rhizotwin reconstruct'.
    work : Workforce
        Computing resources.

    Examples
    --------
    rhizotwin batch my_scans -o my_results
    rhizotwin batch 'my_scans/day_*' other_scans/plant_7 -o my_results --workers 2
    rhizotwin batch my_scans -o my_results --cluster tcp://scheduler:8786
    rhizotwin batch s3://my_bucket/scans -o s3://my_bucket/results --cluster slurm
    """
    from rhizotwin.batches import collect, places
    from rhizotwin.batches.run import run
    from rhizotwin.catalogue import sources

    if not places.is_address(output) and (Path(output) / "dataset.json").is_file():
        raise UserError(f"{output} is a dataset, but the output is a folder for results; choose another folder")
    jobs = collect.reconstructions(sources.expand_scans(scans), output, voxel_mm=voxel_mm, settings=settings, device=work.device)
    made = run(jobs, output, cluster=work.cluster, workers=work.workers)
    if not places.is_address(output):
        from rhizotwin.batches import overview

        written, summary = overview.write(Path(output), [*made.kept, *made.done], made.failed)
        for path in written:
            print(f"wrote {path}")
        print(summary)
    _print_outcome(made, "reconstructed")


def simulate(
    scenes: Annotated[list[SceneName], with_metavar("SCENES")],
    /,
    *,
    output: Outputs,
    changes: SceneChanges = SceneChanges(),
    series: Series = Series(),
    seed: Seed = 0,
    work: Workforce = Workforce(),
) -> None:
    """Render many scenes, optionally for several plants, ages and treatments.

    Each scene (description of canister, plant and rig) is rendered to a dataset of the same name. A scene with a
    simulated plant can be rendered for several plants, which grow from different random seeds, for several ages of each
    plant, and for several treatments, which change the growth rate of the roots. Plant, age and treatment are stored in
    the datasets.

    Parameters
    ----------
    scenes : list of str
        Names listed by 'rhizotwin scenes', or scene files (TOML).
    output : str
        Folder or address for the datasets.
    changes : SceneChanges
        Changes to every scene.
    series : Series
        Plants, ages and treatments.
    seed : int
        Random seed for all simulated errors and noise.
    work : Workforce
        Computing resources.

    Examples
    --------
    rhizotwin batch simulate printed_8ml sphere_20mm -o my_scans --profile bench
    rhizotwin batch simulate radish_day15b -o my_scans --plants 3 --days 5,10,15 --treatments 'control:1,low N:0.85'
    """
    from rhizotwin.batches import collect
    from rhizotwin.batches.run import run
    from rhizotwin.batches.series import vary
    from rhizotwin.steps import front_door

    loaded = [front_door.load_scene(scene, **vars(changes)) for scene in scenes]
    each = [vary(one, **vars(series)) for one in loaded]
    varied = {name: scene for one in each for name, scene in one.items()}
    if len(varied) < sum(map(len, each)):
        raise UserError("two scenes have the same name; change the name in one of the scene files")
    jobs = collect.renderings(varied, output, profile=changes.profile or "scene", seed=seed, device=work.device)
    made = run(jobs, output, cluster=work.cluster, workers=work.workers)
    _print_outcome(made, "rendered")


def _print_outcome(made: "Batch", what: str) -> None:
    """Print how many scans are finished, and why other scans failed.

    Raises
    ------
    UserError
        If a scan failed; raised after the outcome was printed.
    """
    for job, sentence in made.failed:
        print(f"failed: {job.name}: {sentence}")
    kept = f", and {len(made.kept)} {was(len(made.kept))} already finished" if made.kept else ""
    print(f"{count(len(made.done), 'scan')} {was(len(made.done))} {what}{kept}")
    if made.failed:
        total = len(made.failed) + len(made.done) + len(made.kept)
        raise UserError(f"{len(made.failed)} of {count(total, 'scan')} failed; run the same command again to retry them")
