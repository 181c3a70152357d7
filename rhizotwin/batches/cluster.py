"""Execution of jobs with Dask, on an existing scheduler.

The workers need this program, and access to the same folders or addresses. Dask repeats a job whose worker was lost; a
job that loses several workers fails with a message.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.batches.local import MOST_TRIES
from rhizotwin.batches.work import work
from rhizotwin.scenes.errors import UserError, pip_install
from rhizotwin.scenes.memory import MIB

if TYPE_CHECKING:
    from distributed import Client

WAIT_S = 30.0
"""Maximum time to wait for a connection to a scheduler, in seconds."""
NANNY = 0.95
"""Fraction of a worker's memory above which Dask kills the worker (distributed.worker.memory.terminate)."""


@contextmanager
def connected(where: str, jobs: Sequence[Job], *, say: Callable[[str], None]) -> Iterator[Client]:
    """Connect to a Dask scheduler, and yield its client.

    Parameters
    ----------
    where : str
        Address of the scheduler, such as ``tcp://host:8786``.
    jobs : sequence of Job
        Jobs to run; the memory of the workers is compared with that predicted for the largest job.
    say : callable
        Function that receives a line if there is no worker, or if a worker has too little memory.

    Raises
    ------
    UserError
        If Dask is not installed, or the scheduler cannot be reached.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise UserError(f"--cluster needs Dask, which is not installed; run: {pip_install('distributed')}") from None
    try:
        client = Client(where, timeout=WAIT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise UserError(
            f"--cluster {where}: the Dask scheduler could not be reached "
            f"({str(error).splitlines()[0] if str(error) else type(error).__name__}); start the scheduler, or check its address"
        ) from None
    with client:
        workers = client.scheduler_info()["workers"].values()  # of some workers
        if not workers:
            say(f"--cluster {where}: the scheduler has no worker yet; start some with: dask worker {where} --nthreads 1")
        needed_mib = max(job.memory_mib for job in jobs)
        limits_mib = [NANNY * worker["memory_limit"] / MIB for worker in workers if worker["memory_limit"]]
        if min(limits_mib, default=needed_mib) < needed_mib:
            say(
                f"--cluster {where}: a worker is killed above {min(limits_mib):.0f} MiB, but a scan may need {needed_mib:.0f} MiB; start "
                f"workers with --memory-limit {needed_mib / NANNY:.0f}MiB or more"
            )
        yield client


def run(jobs: Sequence[Job], client: Client) -> Generator[tuple[Job, Outcome], None, None]:
    """Run jobs on the workers of a scheduler, one at a time per worker, and yield each job with its final outcome."""
    from distributed import as_completed

    tries = dict.fromkeys((job.name for job in jobs), 1)
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
        sentence = (
            f"the job was lost by the cluster ({type(error).__name__}: {' '.join(str(error).split())[:200]}); if its worker lacked memory, "
            f"start workers with --memory-limit {job.memory_mib / NANNY:.0f}MiB or more"
        )
        return Outcome(name=job.name, state="again", sentence=sentence)
