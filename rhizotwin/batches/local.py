"""Execution of jobs in several worker processes on this computer.

The number of processes is limited by the memory. If a process dies, its job is repeated.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from typing import Any

from rhizotwin.batches.jobs import Job, Outcome
from rhizotwin.scenes.memory import available_mib
from rhizotwin.scenes.monitor import threads
from rhizotwin.scenes.threads import end_with_parent

MOST_TRIES = 3
"""Maximum number of attempts to run a job that fails for an external reason, such as a full disk."""
LEFT_FREE = 0.1
"""Fraction of the available memory that batches leave free for other programs."""
LOOK_S = 1.0
"""Interval at which the main process checks whether the jobs are to be stopped, s."""


@dataclass
class _Worker:
    """Worker process that runs one job at a time."""

    process: Any
    line: Connection
    job: Job | None = None


def run(
    jobs: Sequence[Job], *, workers: int | None = None, memory_mib: float | None = None, stop: Callable[[], bool] = lambda: False
) -> Generator[tuple[Job, Outcome], None, None]:
    """Run jobs, the largest first, and yield each job with its final outcome.

    Parameters
    ----------
    workers : int or None
        Maximum number of processes; None: number of processors.
    memory_mib : float or None
        Maximum total memory of all processes; None: 90 % of the available memory. A job that needs more memory runs
        alone.
    stop : callable
        Function that returns whether to kill all jobs and end.
    """
    most = workers or threads()
    allowed = memory_mib or available_mib() * (1.0 - LEFT_FREE)
    waiting = sorted(jobs, key=lambda job: -job.pixels)
    tries: dict[str, int] = {}
    crew: list[_Worker] = []
    try:
        while (waiting or any(worker.job for worker in crew)) and not stop():
            _hand_out(waiting, crew, most, allowed)
            busy = [worker for worker in crew if worker.job]
            ready = connection.wait([worker.line for worker in busy], timeout=LOOK_S)
            for worker in [worker for worker in busy if worker.line in ready]:
                job = worker.job
                outcome = _hear(worker, crew)
                if job is None:
                    continue
                tries[job.name] = tries.get(job.name, 0) + 1
                if outcome.state == "again" and tries[job.name] < MOST_TRIES:
                    waiting.append(job)
                else:
                    yield job, outcome
    finally:
        for worker in crew:
            worker.process.kill()  # the next run removes its unfinished output
            worker.process.join()
            worker.line.close()


def _hand_out(waiting: list[Job], crew: list[_Worker], most: int, allowed_mib: float) -> None:
    """Assign waiting jobs to idle or new workers.

    At most ``most`` workers are busy, and the predicted memory of their jobs is at most ``allowed_mib``. A job that
    needs more memory runs only if no other job is running.
    """
    for job in list(waiting):
        busy = [worker.job for worker in crew if worker.job]
        if len(busy) >= most:
            return
        if busy and sum(one.memory_mib for one in busy) + job.memory_mib > allowed_mib:
            continue
        worker = next((worker for worker in crew if worker.job is None), None)
        if worker is None:
            worker = _hire(max(1, threads() // most))
            crew.append(worker)
        waiting.remove(job)
        worker.job = job
        with suppress(OSError):  # the worker died while idle, which `_hear` reports
            worker.line.send(job.plain())


def _hire(threads_each: int) -> _Worker:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, threads_each), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process, ours)


def _hear(worker: _Worker, crew: list[_Worker]) -> Outcome:
    """Receive and return the outcome of a worker's job.

    If the worker has died, it is removed from ``crew``.
    """
    job = worker.job
    worker.job = None
    name = "" if job is None else job.name
    try:
        return Outcome(**worker.line.recv())
    except (EOFError, OSError):
        worker.process.join()
        code = worker.process.exitcode
        crew.remove(worker)
        worker.line.close()
        names = {one.value: one.name for one in signal.Signals}  # real-time signals have no names
        how = f"signal {names.get(-code, -code)}" if code is not None and code < 0 else f"exit code {code}"
        return Outcome(name=name, state="again", sentence=f"the process of the job died ({how}), perhaps because the memory was full")


def _serve(line: Connection, threads_each: int) -> None:
    """Receive and run jobs until the main process closes the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process handles Ctrl-C and ends its workers
    end_with_parent()
    from rhizotwin.batches.work import work

    while True:
        try:
            plain = line.recv()
        except (EOFError, OSError):
            return
        line.send(work(plain, threads_each))
