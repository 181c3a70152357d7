"""Execution of a batch: run all unfinished jobs, and collect the failures."""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from rhizotwin.batches import jobs as listed
from rhizotwin.batches import local, places, slurm
from rhizotwin.batches.jobs import Job
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.lock import lock_file
from rhizotwin.scenes.terminal import COLOUR

LOCK = ".rhizotwin-batch-lock"
_FORM = "{percentage:3.0f} %|{bar}| {desc}, {remaining} left"


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Outcomes of the jobs of a batch."""

    kept: tuple[Job, ...]
    """Jobs that an earlier run finished."""
    done: tuple[Job, ...]
    """Jobs that this run finished."""
    failed: tuple[tuple[Job, str], ...]
    """Failed jobs with their messages."""


def run(
    jobs: Sequence[Job], folder: str, *, cluster: str | None = None, workers: int | None = None, stop: Callable[[], bool] = lambda: False
) -> Batch:
    """Run all jobs that no earlier run has finished, and show a progress bar.

    Parameters
    ----------
    jobs : sequence of Job
        Jobs of the batch.
    folder : str
        Folder or address of the outputs; a folder can be used by one batch at a time.
    cluster : str or None
        Address of a Dask scheduler, or ``slurm``; None: worker processes on this computer.
    workers : int or None
        Maximum number of concurrent jobs; None: depends on processors and memory.
    stop : callable
        Function that returns whether to stop the jobs on this computer. They are in no list of the batch, and can be
        run again.

    Returns
    -------
    Batch
        Finished and failed jobs.

    Raises
    ------
    UserError
        If another batch uses the folder, or the cluster cannot be reached.
    """
    done: list[Job] = []
    failed: list[tuple[Job, str]] = []
    with ExitStack() as stack:
        if not places.is_address(folder):
            stack.enter_context(lock_file(Path(folder) / LOCK, what=folder))
            _refuse_links(Path(folder), jobs)
        kept = [job for job in jobs if listed.is_done(job)]
        waiting = [job for job in jobs if job not in kept]
        if not waiting:
            return Batch(kept=tuple(kept), done=(), failed=())
        bar = stack.enter_context(_Bar(waiting))
        if cluster is None:
            outcomes = local.run(waiting, workers=workers, stop=stop)
        elif cluster == "slurm":
            outcomes = slurm.run(waiting, workers=workers, say=bar.say)
        else:
            from rhizotwin.batches import cluster as dask

            outcomes = dask.run(waiting, stack.enter_context(dask.connected(cluster, waiting, say=bar.say)))
        with closing(outcomes):
            for job, outcome in outcomes:
                if outcome.state == "done":
                    done.append(job)
                else:
                    failed.append((job, outcome.sentence))
                bar.step(job, outcome.sentence or f"done in {outcome.seconds:.0f} s")
    return Batch(kept=tuple(kept), done=tuple(done), failed=tuple(failed))


def _refuse_links(folder: Path, jobs: Sequence[Job]) -> None:
    """Raise UserError if the results folder contains symbolic links.

    Files outside the folder could otherwise be overwritten through such a link.
    """
    linked = next((folder / name for name in (listed.RECORDS, *(job.name for job in jobs)) if (folder / name).is_symlink()), None)
    if linked is not None:
        raise UserError(
            f"{linked}: a batch does not write through symbolic links; remove the link, or give the folder that the link points to"
        )


class _Bar:
    """Progress bar of a batch with the estimated remaining time.

    If the output is not a terminal, one line of text is printed for each job instead.
    """

    def __init__(self, jobs: Sequence[Job]) -> None:
        self._total = len(jobs)
        self._count = 0
        watched = sys.stderr.isatty()
        pixels = sum(job.pixels for job in jobs)
        self._bar = tqdm(total=pixels, bar_format=_FORM, dynamic_ncols=True, leave=False, colour=COLOUR) if watched else None

    def __enter__(self) -> "_Bar":
        if self._bar is not None:
            self._bar.set_description_str(f"0 of {self._total}")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    @staticmethod
    def say(text: str) -> None:
        """Print a line about the progress, above the bar if there is one."""
        tqdm.write(printable(text), file=sys.stderr)
        sys.stderr.flush()

    def step(self, job: Job, said: str) -> None:
        """Show that a job has ended.

        ``said`` is a sentence about its outcome.
        """
        self._count += 1
        if self._bar is None:
            self.say(f"{self._count} of {self._total}: {job.name}: {said}")
        else:
            self._bar.set_description_str(f"{self._count} of {self._total}", refresh=False)
            self._bar.update(job.pixels)
