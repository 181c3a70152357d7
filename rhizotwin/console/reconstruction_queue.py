"""Queue of reconstructions, which are executed one after another in a separate process.

The queue is stored in a file, and is continued when the console is started again.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

from rhizotwin.catalogue.store import now_utc
from rhizotwin.console.reconstruction_worker import work
from rhizotwin.console.scan_folders import ScanFolders, check_name
from rhizotwin.scenes.atomic import write_json
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain

SCHEMA_VERSION = 1
KEPT = 50
"""Maximum number of completed or failed reconstructions in the list."""
State = Literal["waiting", "running", "done", "failed"]


@dataclass(frozen=True, kw_only=True)
class Job:
    """Reconstruction of a scan."""

    scan: str
    """Name of the scan and of its result."""
    state: State = "waiting"
    error: str = ""
    """Error message for the user. It is empty if the reconstruction has not failed."""
    added: str = ""
    """Time at which the scan was added to the queue, UTC (ISO 8601)."""
    ended: str = ""
    """Time at which the reconstruction ended, UTC (ISO 8601). It is empty if the reconstruction has not ended."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Name of the current stage of the running reconstruction, and completed fraction of the work."""

    stage: str
    fraction: float


class Queue:
    """Reconstructs scans one at a time.

    Parameters
    ----------
    folders : ScanFolders
        Folders of scans and results; the queue is stored in ``queue.json`` in their root.
    on_change, on_end : callable
        Functions that are called after each change, and with each job that has ended.

    Raises
    ------
    UserError
        If ``queue.json`` is damaged.
    """

    def __init__(self, folders: ScanFolders, *, on_change: Callable[[], object], on_end: Callable[[Job], object]) -> None:
        self._folders = folders
        self._path = folders.root / "queue.json"
        self._on_change, self._on_end = on_change, on_end
        self._wake = threading.Condition()
        # an interrupted reconstruction is started again
        self._jobs = [replace(job, state="waiting") if job.state == "running" else job for job in read(self._path)]
        self._process: Any = None
        self._ended = False
        self.progress = Progress(stage="", fraction=0.0)
        self._thread = threading.Thread(target=self._run, name="queue", daemon=True)
        self._thread.start()

    def plain(self) -> list[dict[str, object]]:
        """Return the jobs as JSON values, with active jobs first, then ended jobs from latest to earliest."""
        with self._wake:
            jobs = list(self._jobs)
        active = [job for job in jobs if job.state in ("running", "waiting")]
        ended = sorted((job for job in jobs if job not in active), key=lambda job: job.ended, reverse=True)
        running = asdict(self.progress)
        return [asdict(job) | (running if job.state == "running" else {}) for job in (*active, *ended)]

    def add(self, scan: str) -> None:
        """Add a complete scan to the queue. The new result will replace an earlier result of the scan.

        Raises
        ------
        UserError
            If the scan does not exist, is incomplete, is a sketch, or is already in the queue.
        """
        entry = self._folders.scan_entry(scan)
        if not entry.complete:
            raise UserError(f"{scan}: {entry.error or 'the scan is not complete; finish it first'}")
        if entry.sketch:
            raise UserError(f"{scan}: the pictures are sketches of the emulated rig, which show no roots; scan with --fidelity render")
        with self._wake:
            if any(job.scan == scan and job.state in ("waiting", "running") for job in self._jobs):
                raise UserError(f"the scan {scan} is already in the queue")
            others = [job for job in self._jobs if job.scan != scan]
            self._keep([*others, Job(scan=scan, added=now_utc())])
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
        while True:
            with self._wake:
                job = next((job for job in self._jobs if job.state == "waiting"), None)
                if self._ended:
                    return
                if job is None:
                    self._wake.wait()
                    continue
                self.progress = Progress(stage="starting", fraction=0.0)
                job = self._change(job, state="running")
            self._on_change()
            error = self._reconstruct(job)
            with self._wake:
                if self._ended or job not in self._jobs:  # the console ends, or the job was removed
                    continue
                job = self._change(job, state="failed" if error else "done", error=error, ended=now_utc())
            self._on_end(job)
            self._on_change()

    def _reconstruct(self, job: Job) -> str:
        """Run a reconstruction in a separate process.

        Return the error message, or an empty string if the reconstruction succeeded.
        """
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        source, output = str(self._folders.scans / job.scan), str(self._folders.result(job.scan))
        process = context.Process(target=work, args=(theirs, source, output, os.getpid()), daemon=True)
        with self._wake:
            if self._ended or job not in self._jobs:
                return ""
            process.start()
            self._process = process
        theirs.close()
        error = "the process ended unexpectedly, perhaps because the memory was full; add the scan to the queue again"
        try:
            while True:
                told = json.loads(ours.recv_bytes())
                if isinstance(told, dict):
                    error = str(told["error"])
                    break
                self.progress = Progress(stage=str(told[0]), fraction=float(told[1]))
                self._on_change()
        except (EOFError, OSError):
            pass
        process.join()
        with self._wake:
            self._process = None
        ours.close()
        return error

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
    if not path.is_file():
        return []
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
        jobs = plain["jobs"]
        version = plain["schema_version"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(
            f"{path}: the queue of reconstructions could not be read ({error}); move the file elsewhere, and start the console again"
        ) from None
    if version != SCHEMA_VERSION or not isinstance(jobs, list):
        raise UserError(
            f"{path}: the file has schema_version {version!r}, but this program reads {SCHEMA_VERSION}; "
            "move the file elsewhere, and start the console again"
        )
    found = [from_plain(Job, job, Place(str(path)).at("jobs", number)) for number, job in enumerate(jobs)]
    for job in found:
        check_name(job.scan)
    return found
