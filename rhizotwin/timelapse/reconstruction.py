"""Reconstruction of an experiment's finished scans, and update of its growth curves."""

import time
from collections.abc import Callable
from pathlib import Path

from rhizotwin.catalogue import adding
from rhizotwin.catalogue.records import Scan
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.experiment import growth_files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.timelapse.experiment import SHORT, Experiment

GROWTH = "growth"
"""Name of the subfolder of growth curves in the folder of the results."""


def growth_page(results: Path) -> Path:
    """Return the path of the page with the growth curves in a folder of results."""
    return results / GROWTH / growth_files.PAGE


class Reconstructor:
    """Reconstructs the finished scans of an experiment, and updates its growth curves.

    Parameters
    ----------
    experiment : Experiment
        Experiment with the options of the reconstruction.
    say : callable
        Function that is called with each line of output.
    """

    def __init__(self, experiment: Experiment, *, say: Callable[[str], object]) -> None:
        self._experiment, self._say = experiment, say
        self._longest_s = 0.0
        """Longest duration of a reconstruction so far, also if it was stopped. It predicts the next one."""
        self._tried: set[Path] = set()
        """Datasets whose reconstruction ended, also if it failed, or that are sketches."""
        self._charted: list[Path] = []
        """Results for which growth curves were computed last."""

    def step(self, catalogue: Catalogue, *, stop: Callable[[], bool], left_s: float | None = None) -> bool:
        """Reconstruct one scan if there is time, or else update the growth curves if they are older than a result.

        A reconstruction that is stopped is repeated in a later call, when there is more time.

        Parameters
        ----------
        catalogue : Catalogue
            Catalogue of the scans, to which the results are added.
        stop : callable
            Function that returns whether the reconstruction is to be stopped.
        left_s : float or None
            Time until the next scan, in seconds; None: unlimited, and all scans are reconstructed together.

        Returns
        -------
        bool
            Whether there was something to do.
        """
        if not self._experiment.reconstruction.run:
            return False
        waiting = self._waiting(catalogue)
        if waiting and (left_s is None or self._longest_s < left_s):
            self._reconstruct(catalogue, waiting if left_s is None else waiting[:1], stop)
            return True
        return self._update_growth(catalogue)

    def _waiting(self, catalogue: Catalogue) -> list[Scan]:
        """Return the complete scans without a result whose pictures show the plant."""
        known = {one.scan for one in catalogue.results()} | self._tried
        waiting = [one for one in catalogue.scans() if one.complete and one.path not in known and (one.path / "dataset.json").is_file()]
        waiting = [one for one in waiting if not one.path.name.endswith(SHORT)]
        if sketches := [one for one in waiting if one.sketch]:
            self._say(f"the reconstruction of {count(len(sketches), 'scan')} was skipped, because sketches do not show the plant")
            self._tried.update(one.path for one in sketches)
        return [one for one in waiting if not one.sketch]

    def _reconstruct(self, catalogue: Catalogue, scans: list[Scan], stop: Callable[[], bool]) -> None:
        """Reconstruct scans as `rhizotwin batch` does."""
        from rhizotwin.batches import collect
        from rhizotwin.batches.run import run

        folder = str(self._experiment.results_folder)
        voxel_mm = self._experiment.reconstruction.voxel_mm
        begin_s = time.monotonic()
        try:
            jobs = collect.reconstructions([str(one.path) for one in scans], folder, voxel_mm=voxel_mm, settings=None, device="auto")
            made = run(jobs, folder, workers=1 if len(jobs) == 1 else None, stop=stop)
        except UserError as error:  # for example, another batch uses the folder
            self._say(f"the reconstruction of {count(len(scans), 'scan')} failed: {error}")
            self._tried.update(one.path for one in scans)
            return
        self._longest_s = max(self._longest_s, time.monotonic() - begin_s)
        for job in (*made.kept, *made.done):
            try:
                adding.add_result(catalogue, Path(job.output))
            except UserError as error:
                self._say(f"{job.name}: {error}")
        for job, sentence in made.failed:
            self._say(f"the reconstruction of {job.name} failed: {sentence}")
        if not stop():
            self._tried.update(one.path for one in scans)

    def _update_growth(self, catalogue: Catalogue) -> bool:
        """Update the growth curves if they are older than a result, and return whether they were."""
        phantoms = {one.name for one in self._experiment.plants if one.phantom}
        results = [one.path for one in catalogue.chosen_results() if not phantoms.intersection(one.plants)]
        page = growth_page(self._experiment.results_folder)
        written = page.stat().st_mtime_ns if page.is_file() else 0
        heads = [path / "result.json" for path in results]
        is_new = any(head.is_file() and head.stat().st_mtime_ns > written for head in heads)
        if results == self._charted or not (self._charted or is_new):  # later results are new whatever the computer's clock says
            return False
        self._charted = results
        try:
            growth_files.write(results, page.parent, replace=True)
        except UserError as error:
            self._say(f"the growth curves could not be computed: {error}")
        return True
