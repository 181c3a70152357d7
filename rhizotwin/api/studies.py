"""Python interface for many scans: batches, growth, biomass and benchmarks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rhizotwin.api.command_calls import existing, logged, paths
from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.front_door import Device
from rhizotwin.steps.results import Paths, read_table

if TYPE_CHECKING:
    from rhizotwin.experiment.biomass import Model


def batch(
    datasets: Paths,
    output: str | Path,
    *,
    voxel_mm: float | None = None,
    settings: str | Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    device: Device = "auto",
) -> Any:
    """Reconstruct many datasets.

    Datasets that an earlier call has already reconstructed are not reconstructed again.

    Parameters
    ----------
    datasets : path or sequence of path
        Datasets, folders of datasets, or patterns such as ``scans/day_*``.
    output : path
        Folder for the results, ``traits.csv`` and ``overview.html``.
    voxel_mm : float, optional
        Edge length of the smallest voxels, mm.
    settings : path, optional
        File with settings of the reconstruction (TOML).
    workers : int, optional
        Number of worker processes; default: number of processors, limited by the available memory.
    cluster : str, optional
        Address of a Dask scheduler, or ``slurm`` to start the workers as Slurm jobs.
    device : {"auto", "cpu", "cuda"}
        Device for the computation.

    Returns
    -------
    pandas.DataFrame
        Content of ``traits.csv``, one row per result.

    Raises
    ------
    UserError
        If an argument is invalid, or, after all other datasets were reconstructed, if the reconstruction of one failed.
    """
    from rhizotwin.batches.places import is_address
    from rhizotwin.commands.batch import Workforce
    from rhizotwin.commands.batch import batch as run

    scans = [str(path) for path in paths("datasets", datasets)]
    if is_address(str(output)):
        raise UserError(f"output must be a folder, not the address {output}; use the command: rhizotwin batch")
    work = Workforce(workers=workers, cluster=cluster, device=device)
    with logged():
        run(scans, output=str(output), voxel_mm=voxel_mm, settings=None if settings is None else Path(settings), work=work)
    return read_table(Path(output) / "traits.csv")


def growth(results: Paths, output: str | Path) -> dict[str, Any]:
    """Compute growth curves of plants and roots from scans of several days, and compare treatments.

    Parameters
    ----------
    results : path or sequence of path
        Results, folders of results, trait tables (.csv), or tables of masses or of the nutrient solution (.csv).
    output : path
        New or empty folder for the tables, the figures and the page ``growth.html``.

    Returns
    -------
    dict of str to pandas.DataFrame
        Tables by name: ``traits``, ``roots``, ``treatments``, and further tables that depend on the data.
    """
    found = existing("results", results)
    from rhizotwin.commands.growth import growth as run

    with logged():
        run(found, output=Path(output))
    return {path.stem: read_table(path) for path in sorted(Path(output).glob("*.csv"))}


def biomass(results: Paths, *, masses: str | Path | None = None, model: str | Path | None = None, output: str | Path) -> Model | Any:
    """Fit a model of plant mass to weighed plants, or predict the mass of plants with a fitted model.

    Exactly one of ``masses`` and ``model`` must be given.

    Parameters
    ----------
    results : path or sequence of path
        Results, folders of results, or trait tables (.csv).
    masses : path, optional
        Table of weighed masses (.csv), to which a model is fitted.
    model : path, optional
        Fitted model (.json), with which masses are predicted.
    output : path
        Output file: the fitted model (.json) or the table of predicted masses (.csv).

    Returns
    -------
    Model or pandas.DataFrame
        Fitted model, or predicted masses with 90 % intervals.
    """
    if (masses is None) == (model is None):
        raise UserError("exactly one of masses and model is needed; give masses to fit a model, or model to predict masses")
    found = existing("results", results)
    from rhizotwin.commands import biomass as commands

    with logged():
        if masses is not None:
            commands.fit([*found, Path(masses)], output=Path(output))
        else:
            commands.predict(found, model=Path(str(model)), table=Path(output))
    if model is not None:
        return read_table(Path(output))
    from rhizotwin.experiment import model_file

    return model_file.load_model(Path(output))


def benchmark(
    name: str,
    folder: str | Path,
    *,
    method: str,
    output: str | Path,
    cases: Sequence[str] = (),
    cameras: Literal["estimated", "true"] = "estimated",
    device: Device = "auto",
) -> Any:
    """Run a method on each case of a benchmark, and score its output.

    Datasets that are missing in ``folder`` are rendered first. Cases that an earlier call has finished are not
    repeated.

    Parameters
    ----------
    name : str
        Name of the benchmark, see ``rhizotwin bench list``.
    folder : path
        Folder for the datasets of the benchmark.
    method : str
        Command line of the method, in which ``{dataset}`` and ``{output}`` are replaced by folders, or ``ours``,
        ``thesis``, ``regularised`` or ``hull``.
    output : path
        File for the results (JSON).
    cases : sequence of str
        Names of the cases; default: all.
    cameras : {"estimated", "true"}
        Cameras in the method's input: estimated from the markers, or those of the simulation.
    device : {"auto", "cpu", "cuda"}
        Device for the computation.

    Returns
    -------
    pandas.DataFrame
        One row per case, with the state of the run and one column per quantity. Relative errors are fractions.
    """
    import pandas as pd

    from rhizotwin.bench import results
    from rhizotwin.commands import bench as commands
    from rhizotwin.steps.arguments import Computing

    computing = Computing(device=device, quiet=True)
    options = commands.RunOptions(cases=tuple(cases), cameras=cameras)
    with logged():
        commands.make(name, output=Path(folder), cases=options.cases, computing=computing)
        commands.run(name, Path(folder), method=method, output=Path(output), options=options, computing=computing)
    rows = results.read(Path(output)).rows
    numbers = {case: {one.name: results.value(row, one) for one in results.QUANTITIES} for case, row in rows.items()}
    return pd.DataFrame([{"case": case, "state": row["state"], **numbers[case]} for case, row in rows.items()])
