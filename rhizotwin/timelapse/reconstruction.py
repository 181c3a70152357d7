"""Reconstruction of an experiment's finished scans, and update of its growth curves."""

from collections.abc import Callable
from pathlib import Path

from rhizotwin.catalogue import adding
from rhizotwin.catalogue.records import Scan
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.experiment import growth_files
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.experiment import Experiment

GROWTH = "growth"
"""Name of the subfolder of growth curves in the folder of the results."""


def reconstruct_scans(experiment: Experiment, catalogue: Catalogue, *, leave_out: set[Path], say: Callable[[str], object]) -> set[Path]:
    """Reconstruct all complete scans that have no result, and then update the growth curves.

    The growth curves are updated if they are older than a result, also if an earlier run was killed before it updated
    them. The scans are reconstructed as by `rhizotwin batch`.

    Parameters
    ----------
    experiment : Experiment
        Experiment with the options of the reconstruction.
    catalogue : Catalogue
        Catalogue of the scans, to which the results are added.
    leave_out : set of Path
        Datasets to skip, because an earlier attempt failed.
    say : callable
        Function that is called with each line of output.

    Returns
    -------
    set of Path
        Datasets whose reconstruction was attempted.
    """
    known = {one.scan for one in catalogue.results()}
    waiting = [one for one in catalogue.scans() if one.complete and one.path not in known and one.path not in leave_out]
    sketches, pictures = [one for one in waiting if one.sketch], [one for one in waiting if not one.sketch]
    if sketches:
        say(f"the reconstruction of {_count(sketches)} was skipped, because sketches of the emulated rig show no roots")
    if pictures:
        _reconstruct(experiment, catalogue, pictures, say)
    _update_growth(experiment, catalogue, say)
    return {one.path for one in waiting}


def _reconstruct(experiment: Experiment, catalogue: Catalogue, scans: list[Scan], say: Callable[[str], object]) -> None:
    from rhizotwin.batches import collect
    from rhizotwin.batches.run import run

    folder = str(experiment.results_folder)
    sources = [str(one.path) for one in scans]
    jobs = collect.reconstructions(sources, folder, voxel_mm=experiment.reconstruction.voxel_mm, settings=None, device="auto")
    made = run(jobs, folder)
    for job in (*made.kept, *made.done):
        try:
            adding.add_result(catalogue, Path(job.output))
        except UserError as error:
            say(f"{job.name}: {error}")
    for job, sentence in made.failed:
        say(f"the reconstruction of {job.name} failed: {sentence}")


def _update_growth(experiment: Experiment, catalogue: Catalogue, say: Callable[[str], object]) -> None:
    phantoms = {one.name for one in experiment.plants if one.phantom}
    results = [one.path for one in catalogue.chosen_results() if not phantoms.intersection(one.plants)]
    page = experiment.results_folder / GROWTH / growth_files.PAGE
    written = page.stat().st_mtime_ns if page.is_file() else 0
    heads = [path / "result.json" for path in results]
    if not any(head.is_file() and head.stat().st_mtime_ns > written for head in heads):
        return
    try:
        growth_files.write(results, experiment.results_folder / GROWTH, replace=True)
    except UserError as error:
        say(f"the growth curves could not be computed: {error}")


def _count(scans: list[Scan]) -> str:
    return f"{len(scans)} scan{'' if len(scans) == 1 else 's'}"
