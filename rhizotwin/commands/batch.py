"""Reconstruct many scans, here or on a cluster."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin.arguments import Device, SceneChanges, SceneName, Seed, VoxelMm, between, list_of, named, option, output, read_day, whole
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.solution import Factors

if TYPE_CHECKING:
    from rhizotwin.batch.run import Batch

Outputs = Annotated[str, output("FOLDER")]
Workers = Annotated[int, option(lambda text: whole(text, 1, 10000, "give 1 to 10000"), "N")]
Cluster = Annotated[str, named("ADDRESS|slurm")]


def read_treatment(text: str) -> tuple[str, float, Factors]:
    """Read a treatment as NAME:GROWTH, or with factors of the nutrient solution NAME:GROWTH:ELEMENT=FACTOR:..."""
    name, *words = (word.strip() for word in text.split(":"))
    if not words or not name or not all("=" in word for word in words[1:]):
        raise ValueError(f"{text!r} is no treatment, write it as NAME:GROWTH or NAME:GROWTH:K=0.5, such as 'low N:0.85'")
    parts = (word.partition("=") for word in words[1:])
    factors = tuple((element.strip(), between(factor, (0.0, 100.0), f"times {element}", "times")) for element, _, factor in parts)
    return name, between(words[0], (0.1, 10.0), "times the scene's growth", "times"), factors


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Workforce:
    """Who does the work."""

    workers: Workers | None = None
    """Most scans at once; default: one a processor, as many as memory allows."""
    cluster: Cluster | None = None
    """A Dask scheduler's address (tcp://host:8786), or slurm; workers need this program and the same folders."""
    device: Device = "auto"
    """What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one)."""


def batch(
    scans: Annotated[list[str], named("SCANS")],
    /,
    *,
    output: Outputs,
    voxel_mm: VoxelMm | None = None,
    settings: Annotated[Path | None, named("FILE")] = None,
    work: Workforce = Workforce(),
) -> None:
    """Reconstruct many scans, here or on a cluster.

    Every dataset that is found is reconstructed into a folder of its name. What is finished (same dataset, settings,
    code) is kept, so that the same command goes on after Ctrl-C or a power cut. A scan that fails is told at the end,
    with its sentence. At the end there are traits.csv and overview.html, a row and a picture for each scan.

    Parameters
    ----------
    scans : list of str
        Datasets, folders that hold some, patterns in quotes, addresses (s3://...), or a catalogue (.rhizotwin).
    output : str
        Folder or address for the results.
    voxel_mm : float, optional
        Edge of the smallest voxels, as of 'reconstruct'.
    settings : Path, optional
        TOML file of what may be set, as of 'reconstruct'.
    work : Workforce
        Who does the work.

    Examples
    --------
    rhizotwin batch my_scans -o my_results
    rhizotwin batch 'my_scans/day_*' other_scans/plant_7 -o my_results --workers 2
    rhizotwin batch my_scans -o my_results --cluster tcp://scheduler:8786
    rhizotwin batch s3://my_bucket/scans -o s3://my_bucket/results --cluster slurm
    """
    from rhizotwin.batch import collect, places
    from rhizotwin.batch.run import run
    from rhizotwin.catalogue import sources

    jobs = collect.reconstructions(sources.expand_scans(scans), output, voxel_mm=voxel_mm, settings=settings, device=work.device)
    made = run(jobs, output, cluster=work.cluster, workers=work.workers)
    if not places.is_address(output):
        from rhizotwin.batch import overview

        written, refused = overview.write(Path(output), [*made.kept, *made.done], made.failed)
        for path in written:
            print(f"wrote {path}")
        if refused:
            print(f"warning: {refused}")
    _tell(made, "reconstructed")


def simulate(
    scenes: Annotated[list[SceneName], named("SCENES")],
    /,
    *,
    output: Outputs,
    changes: SceneChanges = SceneChanges(),
    plants: Annotated[int, option(lambda text: whole(text, 1, 1000, "give 1 to 1000"), "N")] = 1,
    days: Annotated[tuple[float, ...] | None, option(list_of(read_day), "D,D,...")] = None,
    treatments: Annotated[tuple[tuple[str, float, Factors], ...] | None, option(list_of(read_treatment), "NAME:GROWTH[:K=0.5],...")] = None,
    seed: Seed = 0,
    work: Workforce = Workforce(),
) -> None:
    """Render many scenes: plants, days, treatments, profiles and seeds.

    Each scene is rendered into a dataset of its name. A grown plant can have sisters of other seeds, other days (the
    older one holds the younger), and treatments under which its roots grow by a factor faster and longer; the datasets
    say which is which.

    Parameters
    ----------
    scenes : list of str
        Names from 'rhizotwin scenes', or scene files (TOML).
    output : str
        Folder or address for the datasets.
    changes : SceneChanges
        What is changed in every scene.
    plants : int
        Plants of each scene and treatment.
    days : tuple of float, optional
        Ages of each plant; default: the scene's.
    treatments : tuple of (str, float, Factors), optional
        Names, each with the factor of growth and, where the scene has a [solution], factors of elements in it, such as
        control:1,low N:0.85:N=0.5.
    seed : int
        Random seed for all simulated errors and noise.
    work : Workforce
        Who does the work.

    Examples
    --------
    rhizotwin batch simulate printed_8ml sphere_20mm -o my_scans --profile bench
    rhizotwin batch simulate radish_day15b -o my_scans --plants 3 --days 5,10,15 --treatments 'control:1,low N:0.85'
    """
    from rhizotwin import front_door
    from rhizotwin.batch import collect
    from rhizotwin.batch.run import run
    from rhizotwin.batch.series import vary

    loaded = [front_door.load_scene(scene, **vars(changes)) for scene in scenes]
    varied = {name: scene for one in loaded for name, scene in vary(one, plants=plants, days=days, treatments=treatments).items()}
    if len(varied) < len(loaded):
        raise UserError("two scenes have one name; give each a name of its own in its file")
    jobs = collect.renderings(varied, output, profile=changes.profile or "scene", seed=seed, device=work.device)
    made = run(jobs, output, cluster=work.cluster, workers=work.workers)
    _tell(made, "rendered")


def _tell(made: "Batch", what: str) -> None:
    """Print what became of a batch.

    Raises
    ------
    UserError
        Where something failed, after all the rest was told.
    """
    for job, sentence in made.failed:
        print(f"failed: {job.name}: {sentence}")
    kept = f", {len(made.kept)} were finished before" if made.kept else ""
    print(f"{len(made.done)} scans {what}{kept}")
    if made.failed:
        raise UserError(
            f"{len(made.failed)} of {len(made.failed) + len(made.done) + len(made.kept)} scans failed; the same command tries them again"
        )
