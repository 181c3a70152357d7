"""Queue of reconstructions, which are executed one after another in a separate process.

The queue is stored in a file, and is continued when the console is started again.
"""

from __future__ import annotations

import json
import os
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

from rhizotwin.catalogue.store import now_utc
from rhizotwin.console.messages import explained
from rhizotwin.console.reconstruction_worker import work
from rhizotwin.console.scan_folders import ScanFolders, check_name
from rhizotwin.scenes.atomic import write_json
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain
from rhizotwin.scenes.threads import LastingThread
from rhizotwin.scenes.versioned_json import read_versioned_json
from rhizotwin.stored.save import check_place

SCHEMA_VERSION = 1
KEPT = 50
"""Maximum number of completed or failed reconstructions in the list."""
END_S = 10.0
"""Time that a process has for its end after it has sent the outcome, s. Freeing several GB of memory takes a second."""
MOST_DEATHS = 3
"""Number of times that the process of a reconstruction may end unexpectedly before the reconstruction counts as failed.
A process that was killed once is started again, and a scan that never fits into the memory ends."""
State = Literal["waiting", "running", "done", "failed"]


@dataclass(frozen=True, kw_only=True)
class Job:
    """Reconstruction of a scan."""

    scan: str
    """Name of the scan and of its result."""
    state: State = "waiting"
    error: str = ""
    """Error message for the user. It is empty if the reconstruction has not failed. For a waiting reconstruction, it is
    the reason why it starts again."""
    added: str = ""
    """Time at which the scan was added to the queue, UTC (ISO 8601)."""
    ended: str = ""
    """Time at which the reconstruction ended, UTC (ISO 8601). It is empty if the reconstruction has not ended."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Name of the current stage of the running reconstruction, and completed fraction of the work."""

    stage: str
    fraction: float


@dataclass(frozen=True, kw_only=True)
class _File:
    """Content of ``queue.json``."""

    schema_version: int
    jobs: tuple[Job, ...]


class _DeadError(Exception):
    """The process of a reconstruction ended without an outcome."""


class Queue:
    """Reconstructs scans one at a time.

    Parameters
    ----------
    folders : ScanFolders
        Folders of scans and results; the queue is stored in ``queue.json`` in their root.
    on_change, on_end : callable
        Functions that are called after each change, and with each job that has ended or starts again.
    on_error : callable
        Function that is called with each exception that does not belong to a job.

    Raises
    ------
    UserError
        If ``queue.json`` is damaged.
    """

    def __init__(
        self,
        folders: ScanFolders,
        *,
        on_change: Callable[[], object],
        on_end: Callable[[Job], object],
        on_error: Callable[[BaseException], object],
    ) -> None:
        self._folders = folders
        self._path = folders.root / "queue.json"
        self._on_change, self._on_end = on_change, on_end
        self._wake = threading.Condition()
        self._jobs = read(self._path)
        """Jobs in the order in which they were added. The list is replaced at each change, so that it can be read
        without the lock, which is held while the file is written."""
        self._deaths: Counter[str] = Counter()
        """Number of times that the process of a scan's reconstruction ended unexpectedly."""
        self._process: Any = None
        self._ended = False
        self.progress = Progress(stage="", fraction=0.0)
        self._thread = LastingThread(self._run, name="queue", on_error=on_error)

    def plain(self) -> list[dict[str, object]]:
        """Return the jobs as JSON values, with active jobs first, then ended jobs from latest to earliest."""
        jobs = self._jobs
        active = [job for job in jobs if job.state in ("running", "waiting")]
        ended = sorted((job for job in jobs if job not in active), key=lambda job: job.ended, reverse=True)
        running = asdict(self.progress)
        return [asdict(job) | (running if job.state == "running" else {}) for job in (*active, *ended)]

    def add(self, scan: str) -> None:
        """Add a complete scan to the queue. The new result will replace an earlier result of the scan.

        Raises
        ------
        UserError
            If the scan does not exist, is incomplete, is a sketch or is already in the queue, or if its result would
            overwrite other files.
        """
        entry = self._folders.scan_entry(scan)
        if not entry.complete:
            raise UserError(f"{scan}: {entry.error or 'the scan is not complete; finish it first'}")
        if entry.sketch:
            raise UserError(f"{scan}: the pictures are sketches, which do not show the plant; scan with --fidelity render")
        with self._wake:
            if any(job.scan == scan and job.state in ("waiting", "running") for job in self._jobs):
                raise UserError(f"the scan {scan} is already in the queue")
            check_place(self._folders.result(scan), self._folders.scan(scan))
            others = [job for job in self._jobs if job.scan != scan]
            self._keep([*others, Job(scan=scan, added=now_utc())])
            self._deaths.pop(scan, None)
            self._wake.notify_all()
        self._on_change()

    def remove(self, scan: str) -> None:
        """Remove a scan from the queue. If its reconstruction is running, it is stopped, and an earlier result is kept.

        Raises
        ------
        UserError
            If the scan is not in the queue.
        """
        with self._wake:
            job = next((job for job in self._jobs if job.scan == scan), None)
            if job is None:
                raise UserError(f"the scan {scan!r} is not in the queue")
            self._keep([other for other in self._jobs if other is not job])
            if job.state == "running" and self._process is not None:
                self._process.kill()
        self._on_change()

    def close(self) -> None:
        """Stop the running reconstruction, and end the thread.

        The reconstruction starts again when the console is started again.
        """
        with self._wake:
            self._ended = True
            if self._process is not None:
                self._process.kill()
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        with self._wake:  # a reconstruction that was interrupted, by the end of the console or of this thread, is started again
            self._jobs = [replace(job, state="waiting") if job.state == "running" else job for job in self._jobs]
        while True:
            with self._wake:
                job = next((job for job in self._jobs if job.state == "waiting"), None)
                if self._ended:
                    return
                if job is None:
                    self._wake.wait()
                    continue
                self.progress = Progress(stage="starting", fraction=0.0)
                job = self._change(job, state="running", error="")
            self._do(job)

    def _do(self, job: Job) -> None:
        """Run a reconstruction, and record how it ended."""
        try:
            self._on_change()
            error = self._reconstruct(job)
            state: State = "failed" if error else "done"
        except _DeadError as died:
            self._deaths[job.scan] += 1
            again = self._deaths[job.scan] < MOST_DEATHS
            state = "waiting" if again else "failed"
            error = f"{died}; {'it starts again' if again else 'add the scan to the queue again'}"
        except BaseException as raised:  # noqa: BLE001 - an error of one job must not end the queue
            state = "failed"
            error = explained(raised)
        with self._wake:
            if self._ended or job not in self._jobs:  # the console ends, or the job was removed
                return
            job = self._change(job, state=state, error=error, ended="" if state == "waiting" else now_utc())
        self._on_end(job)
        self._on_change()

    def _reconstruct(self, job: Job) -> str:
        """Run a reconstruction in a separate process.

        Return the error message, or an empty string if the reconstruction succeeded.
        """
        context = get_context("spawn")
        source, output = str(self._folders.scan(job.scan)), str(self._folders.result(job.scan))
        with ExitStack() as stack:
            ours, theirs = (stack.enter_context(end) for end in context.Pipe())
            process = context.Process(target=work, args=(theirs, source, output), daemon=True)
            with self._wake:
                if self._ended or job not in self._jobs:
                    return ""
                process.start()
                self._process = process
            stack.callback(self._end_process)
            theirs.close()
            with suppress(EOFError, OSError):
                while True:
                    told = json.loads(ours.recv_bytes())
                    if isinstance(told, dict):
                        return str(told["error"])
                    self.progress = Progress(stage=str(told[0]), fraction=float(told[1]))
                    self._on_change()
            process.join()
            raise _DeadError(f"its process ended unexpectedly (exit code {process.exitcode}), perhaps because the memory was full")

    def _end_process(self) -> None:
        """End the process of the reconstruction, which has sent its outcome or failed."""
        with self._wake:
            process = self._process
            self._process = None
        process.join(END_S)
        process.kill()
        process.join()
        process.close()

    def _change(self, job: Job, **changes: Any) -> Job:
        """Replace a job in the queue, and write the queue to its file.

        If writing fails, the job is repeated after a restart of the console.
        """
        changed = replace(job, **changes)
        jobs = [changed if other is job else other for other in self._jobs]
        try:
            self._keep(jobs)
        except UserError:
            self._jobs = jobs
        return changed

    def _keep(self, jobs: list[Job]) -> None:
        """Write the queue to its file, and then replace the jobs in memory.

        If writing fails, the jobs in memory remain unchanged.
        """
        active = [job for job in jobs if job.state in ("waiting", "running")]
        ended = sorted((job for job in jobs if job not in active), key=lambda job: job.ended)[-KEPT:]
        kept = [job for job in jobs if job in active or job in ended]
        write_json(self._path, {"schema_version": SCHEMA_VERSION, "jobs": [asdict(job) for job in kept]})
        self._jobs = kept


def read(path: Path) -> list[Job]:
    """Read the jobs from the file of a queue. The list is empty if the file does not exist.

    Raises
    ------
    UserError
        If the file is damaged or was written by another version of the program.
    """
    if not os.path.lexists(path):
        return []
    try:
        found = from_plain(_File, read_versioned_json(path, SCHEMA_VERSION), Place(str(path)))
        for job in found.jobs:
            check_name(job.scan)
    except UserError as error:
        raise UserError(
            f"the queue of reconstructions could not be read ({error}); move {path} elsewhere, and start the console again"
        ) from None
    return list(found.jobs)
