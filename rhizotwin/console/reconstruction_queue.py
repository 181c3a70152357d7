"""Queue of reconstructions, kept in a file so that it survives the console; one runs at a time in its own process."""

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
"""Ended reconstructions that stay in the list."""
State = Literal["waiting", "running", "done", "failed"]


@dataclass(frozen=True, kw_only=True)
class Job:
    """One reconstruction."""

    scan: str
    """Name of the scan, and of its result."""
    state: State = "waiting"
    error: str = ""
    added: str = ""
    """UTC, ISO 8601."""
    ended: str = ""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of the running reconstruction."""

    stage: str
    fraction: float


class Queue:
    """Reconstructs scans one after the other.

    Parameters
    ----------
    folders : ScanFolders
        Scans and results; ``queue.json`` of their root holds the queue.
    on_change, on_end : callable
        Called after a change; and with each job that ended.

    Raises
    ------
    UserError
        For a damaged ``queue.json``.
    """

    def __init__(self, folders: ScanFolders, *, on_change: Callable[[], object], on_end: Callable[[Job], object]) -> None:
        self._folders = folders
        self._path = folders.root / "queue.json"
        self._on_change, self._on_end = on_change, on_end
        self._wake = threading.Condition()
        # a reconstruction that was interrupted begins again
        self._jobs = [replace(job, state="waiting") if job.state == "running" else job for job in read(self._path)]
        self._process: Any = None
        self._ended = False
        self.progress = Progress(stage="", fraction=0.0)
        self._thread = threading.Thread(target=self._run, name="queue", daemon=True)
        self._thread.start()

    def plain(self) -> list[dict[str, object]]:
        """Return the jobs as JSON values: running and waiting ones first, then the latest ended ones."""
        with self._wake:
            jobs = list(self._jobs)
        active = [job for job in jobs if job.state in ("running", "waiting")]
        ended = sorted((job for job in jobs if job not in active), key=lambda job: job.ended, reverse=True)
        running = asdict(self.progress)
        return [asdict(job) | (running if job.state == "running" else {}) for job in (*active, *ended)]

    def add(self, scan: str) -> None:
        """Add a finished scan; an earlier result is replaced.

        Raises
        ------
        UserError
            Where the scan does not exist, is not complete, is a sketch, or is in the queue.
        """
        entry = self._folders.scan_entry(scan)
        if not entry.complete:
            raise UserError(f"{scan}: {entry.error or 'the scan is not complete; finish it first'}")
        if entry.sketch:
            raise UserError(f"{scan}: sketches of the emulated rig show no roots; scan with --fidelity render")
        with self._wake:
            if any(job.scan == scan and job.state in ("waiting", "running") for job in self._jobs):
                raise UserError(f"{scan} is in the queue already")
            others = [job for job in self._jobs if job.scan != scan]
            self._keep([*others, Job(scan=scan, added=now_utc())])
            self._wake.notify_all()
        self._on_change()

    def remove(self, scan: str) -> None:
        """Remove a scan from the queue; a running reconstruction is stopped, and an earlier result stays.

        Raises
        ------
        UserError
            Where it is not in the queue.
        """
        with self._wake:
            job = next((job for job in self._jobs if job.scan == scan), None)
            if job is None:
                raise UserError(f"{scan!r} is not in the queue")
            self._keep([other for other in self._jobs if other is not job])
            if job.state == "running" and self._process is not None:
                self._process.kill()
        self._on_change()

    def close(self) -> None:
        """Stop the running reconstruction, which begins again with the next console, and end the thread."""
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
        """Run a reconstruction; return its error or an empty text."""
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
        error = "its process ended unexpectedly, perhaps because memory ran out; add it to the queue again"
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
        """Replace a job, and write the file; where the disk is full, the next console repeats the job."""
        changed = replace(job, **changes)
        jobs = [changed if other is job else other for other in self._jobs]
        try:
            self._keep(jobs)
        except UserError:
            self._jobs = jobs
        return changed

    def _keep(self, jobs: list[Job]) -> None:
        """Write the queue before it is used, so that the file is never behind."""
        active = [job for job in jobs if job.state in ("waiting", "running")]
        ended = sorted((job for job in jobs if job not in active), key=lambda job: job.ended)[-KEPT:]
        kept = [job for job in jobs if job in active or job in ended]
        write_json(self._path, {"schema_version": SCHEMA_VERSION, "jobs": [asdict(job) for job in kept]})
        self._jobs = kept


def read(path: Path) -> list[Job]:
    """Read the jobs of a queue's file; none where there is no file.

    Raises
    ------
    UserError
        For a file that this version did not write.
    """
    if not path.is_file():
        return []
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
        jobs = plain["jobs"]
        version = plain["schema_version"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(f"{path}: cannot be read as a queue of reconstructions ({error}); move it away") from None
    if version != SCHEMA_VERSION or not isinstance(jobs, list):
        raise UserError(f"{path}: has schema_version {version!r}, but this version reads {SCHEMA_VERSION}; move it away")
    found = [from_plain(Job, job, Place(str(path)).at("jobs", number)) for number, job in enumerate(jobs)]
    for job in found:
        check_name(job.scan)
    return found
