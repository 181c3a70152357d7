"""Execution of jobs with Dask, on an existing scheduler or a Slurm cluster.

The workers need this program, and access to the same folders or addresses. Dask repeats a job whose worker was lost; a
job that loses several workers fails with a message.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.batches.local import MOST_TRIES
from rhizotwin.batches.work import work
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

SLURM = "slurm"
WAIT_S = 30.0
"""Maximum time to wait for a connection to a scheduler, in seconds."""


@contextmanager
def connected(where: str, jobs: Sequence[Job], *, workers: int | None) -> Iterator[Client]:
    """Connect to a Dask scheduler, and yield its client.

    Parameters
    ----------
    where : str
        Address of the scheduler, such as ``tcp://host:8786``, or ``slurm`` to start a scheduler whose workers are Slurm
        jobs. Slurm's queue, account and time limits are read from Dask's configuration
        (``~/.config/dask/jobqueue.yaml``).
    jobs : sequence of Job
        Jobs to run; the memory requested from Slurm is the largest predicted memory of a job.
    workers : int or None
        Maximum number of Slurm workers; None: one per job.

    Raises
    ------
    UserError
        If Dask or Slurm is not installed, or the scheduler cannot be reached.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise UserError("--cluster needs Dask, which is not installed; run: pip install 'rhizotwin[cluster]'") from None
    if where == SLURM:
        if shutil.which("sbatch") is None:
            raise UserError(
                "--cluster slurm: the program sbatch was not found; run the command on a computer with Slurm, "
                "or give the address of a Dask scheduler"
            )
        with slurm(jobs) as cluster, Client(cluster) as client:
            cluster.scale(jobs=min(len(jobs), workers or len(jobs)))
            yield client
        return
    try:
        client = Client(where, timeout=WAIT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise UserError(
            f"--cluster {where}: the Dask scheduler could not be reached "
            f"({str(error).splitlines()[0] if str(error) else type(error).__name__}); start the scheduler, or check its address"
        ) from None
    with client:
        yield client


def slurm(jobs: Sequence[Job]) -> Any:
    """Return a Dask cluster whose workers run as Slurm jobs.

    Each worker has enough memory for the largest of the given jobs.
    """
    from dask_jobqueue.slurm import SLURMCluster

    memory_mib = max((job.memory_mib for job in jobs), default=1000.0)
    try:
        return SLURMCluster(cores=1, processes=1, memory=f"{memory_mib:.0f}MiB")
    except ValueError as error:
        raise UserError(f"--cluster slurm: {error}") from None


def run(jobs: Sequence[Job], client: Client) -> Iterator[tuple[Job, Outcome]]:
    """Run jobs on the workers of a scheduler, one at a time per worker, and yield each job with its final outcome."""
    from distributed import as_completed

    memory = {job.name: job for job in jobs}
    tries = dict.fromkeys(memory, 1)
    doing = {_submit(client, job, 1): job for job in sorted(jobs, key=lambda job: -job.pixels)}
    waiting = as_completed(list(doing))
    for future in waiting:
        job = doing.pop(future)
        outcome = _outcome(future, job)
        if outcome.state == "again" and tries[job.name] < MOST_TRIES:
            tries[job.name] += 1
            again = _submit(client, job, tries[job.name])
            doing[again] = job
            waiting.add(again)
        else:
            yield job, outcome


def _submit(client: Client, job: Job, attempt: int) -> Any:
    """Submit a job to the scheduler.

    The scheduler runs only one of several tasks with equal keys, also if they are from different clients. The key
    therefore contains the output.
    """
    output = hashlib.sha256(job.output.encode(errors="surrogateescape")).hexdigest()
    return client.submit(work, job.plain(), key=f"rhizotwin-{job.name}-{job.key[:12]}-{output[:12]}-{attempt}", pure=False)


def _outcome(future: Any, job: Job) -> Outcome:
    """Return the outcome of a finished job.

    `work` raises no exceptions. An exception therefore comes from Dask, and means that the job was lost.
    """
    try:
        return Outcome(**future.result())
    except Exception as error:  # noqa: BLE001 - Dask raises KilledWorker, CancelledError, CommClosedError and others
        sentence = f"the job was lost by the cluster ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
        return Outcome(name=job.name, state="again", sentence=sentence)
