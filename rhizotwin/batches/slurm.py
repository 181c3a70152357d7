"""Execution of jobs by Slurm: one Slurm job for each scan or scene.

The job is passed to ``sbatch`` as a script, and its outcome is read from its record (`batches.jobs.note`), so that no
program listens on the network. Queue, account and time limit are those of Slurm's own variables, such as
``SBATCH_PARTITION``, ``SBATCH_ACCOUNT`` and ``SBATCH_TIMELIMIT``.
"""

import hashlib
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from rhizotwin.batches import places
from rhizotwin.batches.jobs import RECORDS, SLURM_JOB, Job, Outcome, read_record
from rhizotwin.batches.local import MOST_TRIES
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable

MARGIN = 1.25
"""Memory requested from Slurm, relative to the predicted peak. Slurm kills a job that exceeds the request."""
POLL_S = 5.0
"""Interval between two requests of the queue, s. Slurm's documentation asks not to call squeue in quick succession."""
RECORD_S = 90.0
"""Maximum delay of a record on a shared file system after the end of its job, s. NFS caches the contents of a folder
for up to 60 s (acdirmax)."""
CALL_S = 120.0
"""Maximum duration of a call of sbatch, squeue or scancel, s. Clients of Slurm wait up to 100 s for its controller."""
_OPEN = {
    "PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "SUSPENDED", "STOPPED", "REQUEUED", "REQUEUE_HOLD", "RESIZING", "SIGNALING",
    "STAGE_OUT",
}  # fmt: skip
_USUAL = {"None", "Priority", "Resources", "(null)"}
"""Reasons for which every job waits in a queue."""
_TOO_LONG = {"TIMEOUT", "DEADLINE"}
_ENDED_BY_ITSELF = {"COMPLETED", "FAILED"}
_KILLED = re.compile(r"oom[-_ ]?kill|exceeded (?:job |step )?memory limit|out[- ]of[- ]memory", re.IGNORECASE)
"""Sentences of slurmstepd in the log of a job that was killed for its memory. Slurm 22.05 with OverMemoryKill gives
such jobs the state FAILED (JobLaunchFailure) instead of OUT_OF_MEMORY."""


class Place(NamedTuple):
    """State of a Slurm job, in the order of the output of ``squeue -o '%i|%T|%N|%r|%l'``."""

    state: str = ""
    node: str = ""
    reason: str = ""
    limit: str = ""
    """Time limit, such as ``1-02:00:00``."""


@dataclass(kw_only=True)
class _Attempt:
    """Job and the resources that the present attempt requests."""

    job: Job
    memory_mib: float
    minutes: int | None = None
    """Time limit; None for that of Slurm."""
    tries: int = 1
    bigger: bool = False
    place: Place = field(default_factory=Place)
    ended_s: float | None = None


def run(jobs: Sequence[Job], *, workers: int | None, say: Callable[[str], None]) -> Generator[tuple[Job, Outcome], None, None]:
    """Run jobs by Slurm, and yield each job with its final outcome.

    A job that was killed for its memory or its duration is submitted once more with twice as much. A job that was
    cancelled, or whose node failed, is submitted again. If the program ends, its Slurm jobs are cancelled; those of a
    killed program are continued.

    Parameters
    ----------
    jobs : sequence of Job
        Jobs to run, the largest first.
    workers : int or None
        Maximum number of Slurm jobs at a time; None: one per job.
    say : callable
        Function that receives a line about each change.

    Raises
    ------
    UserError
        If Slurm is not installed.
    """
    if shutil.which("sbatch") is None:
        raise UserError(
            "--cluster slurm: the program sbatch was not found; run the command on a computer with Slurm, "
            "or give the address of a Dask scheduler"
        )
    waiting = [_Attempt(job=job, memory_mib=MARGIN * job.memory_mib) for job in sorted(jobs, key=lambda job: -job.pixels)]
    queue = {name: number for number, name in _names().items()}
    active = {queue[_name(one.job)]: one for one in waiting if _name(one.job) in queue}
    for number, one in active.items():
        say(f"{one.job.name}: Slurm job {number} of an earlier run is continued")
        waiting.remove(one)
    try:
        while waiting or active:
            yield from _submit_some(waiting, active, most=workers or len(jobs), say=say)
            time.sleep(POLL_S if active else 0.0)
            try:
                places_now = read_queue(_call("squeue", "-h", "-u", str(os.getuid()), "-t", "all", "-o", "%i|%T|%N|%r|%l"))
            except UserError as error:
                say(f"{error}; trying again")
                continue
            for number, one in list(active.items()):
                ended = _look(one, number, places_now.get(number), say)
                if ended is None:
                    continue
                del active[number]
                if isinstance(ended, Outcome):
                    yield one.job, ended
                else:
                    waiting.insert(0, ended)
    finally:
        if active:
            with suppress(UserError):
                _call("scancel", *active)


def read_queue(text: str) -> dict[str, Place]:
    """Return the state of each Slurm job in the output of ``squeue -o '%i|%T|%N|%r|%l'``."""
    rows = [line.split("|") for line in text.splitlines() if line.count("|") == 4]
    return {number: Place(*place) for number, *place in rows}


def minutes_of(limit: str) -> int | None:
    """Return a time limit of Slurm (``[days-]hours:minutes:seconds``) in minutes, or None if there is none."""
    found = re.fullmatch(r"(?:(\d+)-)?(?:(\d+):)?(\d+):(\d+)", limit)
    if found is None:
        return None
    days, hours, minutes, seconds = (int(word or 0) for word in found.groups())
    return math.ceil((days * 24 + hours) * 60 + minutes + seconds / 60)


def _submit_some(
    waiting: list[_Attempt], active: dict[str, _Attempt], *, most: int, say: Callable[[str], None]
) -> Iterator[tuple[Job, Outcome]]:
    """Submit waiting jobs while there is room.

    If Slurm refuses a job although others are active, the limit of jobs may be reached, and it waits. Otherwise it has
    failed.
    """
    while waiting and len(active) < most:
        one = waiting[0]
        try:
            number = _submit(one)
        except UserError as error:
            if active:
                return
            waiting.pop(0)
            yield one.job, Outcome(name=one.job.name, state="failed", sentence=f"{error} (requested: {one.memory_mib:.0f} MiB)")
            continue
        waiting.pop(0)
        active[number] = one
        say(f"{one.job.name}: submitted as Slurm job {number} with {one.memory_mib:.0f} MiB")


def _submit(one: _Attempt) -> str:
    folder = _log_folder(one.job)
    folder.mkdir(parents=True, exist_ok=True)
    log = str(folder).replace("%", "%%") + "/slurm-%j.txt"  # other % are replaced by Slurm
    words = ["--parsable", f"--job-name={_name(one.job)}", f"--mem={math.ceil(one.memory_mib)}M", f"--output={log}"]
    words += [] if one.minutes is None else [f"--time={one.minutes}"]
    script = f"#!/bin/sh\nexec {shlex.quote(sys.executable)} -m {__name__} <<'JOB'\n{json.dumps(one.job.plain())}\nJOB\n"
    return _call("sbatch", *words, given=script).strip().partition(";")[0]


def _look(one: _Attempt, number: str, now: Place | None, say: Callable[[str], None]) -> Outcome | _Attempt | None:
    """Return the outcome of a Slurm job that has ended, the next attempt, or None if it has not ended."""
    name = one.job.name
    before = one.place
    if now is not None and now.state in _OPEN:
        if now.state == "RUNNING" != before.state:
            say(f"{name}: Slurm job {number} runs on {now.node}")
        elif now.state == "PENDING" and now.reason not in _USUAL and now.reason != before.reason:
            say(f"{name}: Slurm job {number} waits ({now.reason})")
        one.place = now
        return None
    outcome = _recorded(one.job, number)
    if outcome is not None:
        if outcome.state == "done":
            _log_file(one.job, number).unlink(missing_ok=True)
        return outcome if outcome.state != "again" else _again(one, number, _End(why=outcome.sentence), say)
    place = now or Place()
    said = _log(one.job, number)
    if place.state == "OUT_OF_MEMORY" or place.reason == "RaisedSignal:9(Killed)" or _KILLED.search(said):
        why = f"it needed more than the requested {one.memory_mib:.0f} MiB of memory"
        cure = "use larger voxels (--voxel-mm), or nodes with more memory"
        return _again(one, number, _End(why=why, memory_mib=2.0 * one.memory_mib, cure=cure), say)
    if place.state in _TOO_LONG:
        minutes = minutes_of(place.limit)
        why = f"it reached its time limit of {place.limit}"
        end = _End(why=why, minutes=minutes and 2 * minutes, cure="request more time with SBATCH_TIMELIMIT")
        return _again(one, number, end, say)
    if now is not None and place.state not in _ENDED_BY_ITSELF:
        return _again(one, number, _End(why=f"it was ended by Slurm ({place.state})"), say)
    one.ended_s = one.ended_s or time.monotonic()
    if place.state != "FAILED" and time.monotonic() < one.ended_s + RECORD_S:
        return None  # its record may not be visible yet
    if now is None:
        return _again(one, number, _End(why="it is no longer in the queue"), say)
    last = ([line for line in said.splitlines() if line.strip()] or ["the log is empty"])[-1]
    sentence = (
        f"Slurm job {number} ended ({place.state}) without a record ({printable(last.strip()[:200])}); check that the nodes "
        f"have this program and the same folders, and see {_log_file(one.job, number)}"
    )
    return Outcome(name=name, state="failed", sentence=sentence)


@dataclass(frozen=True, kw_only=True)
class _End:
    """Reason for which a Slurm job did not finish."""

    why: str
    """Reason as a sentence without its end."""
    memory_mib: float | None = None
    """Memory that the next attempt needs; None: as before."""
    minutes: int | None = None
    """Time that the next attempt needs; None: as before."""
    cure: str = "run the same command again"
    """What to do if it does not finish again."""


def _again(one: _Attempt, number: str, end: _End, say: Callable[[str], None]) -> Outcome | _Attempt:
    """Return the next attempt, or the final outcome if there were enough attempts.

    More memory or time is requested only once.
    """
    why, memory_mib, minutes = end.why, end.memory_mib, end.minutes
    more = memory_mib is not None or minutes is not None
    if one.bigger if more else one.tries >= MOST_TRIES:
        return Outcome(name=one.job.name, state="failed", sentence=f"Slurm job {number} did not finish, because {why}; {end.cure}")
    requested = "" if not more else f" with {memory_mib:.0f} MiB" if memory_mib is not None else f" with {minutes} min"
    say(f"{one.job.name}: Slurm job {number} did not finish, because {why}; it is submitted again{requested}")
    return replace(
        one,
        memory_mib=memory_mib or one.memory_mib,
        minutes=minutes or one.minutes,
        tries=one.tries + 1,
        bigger=one.bigger or more,
        place=Place(),
        ended_s=None,
    )


def _recorded(job: Job, number: str) -> Outcome | None:
    """Return the outcome that a Slurm job has recorded, or None if there is none."""
    with suppress(UserError, OSError, TypeError):  # TypeError: a field is missing
        record = read_record(job)
        if record.get(SLURM_JOB) == number:
            return Outcome(**{name: record[name] for name in Outcome.__dataclass_fields__ if name in record})
    return None


def _log_file(job: Job, number: str) -> Path:
    return _log_folder(job) / f"slurm-{number}.txt"


def _log_folder(job: Job) -> Path:
    """Return the folder for the logs of Slurm, which the nodes must share."""
    return Path.home() / ".cache" / "rhizotwin" if places.is_address(job.output) else Path(job.output).absolute().parent / RECORDS


def _log(job: Job, number: str) -> str:
    try:
        return _log_file(job, number).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _name(job: Job) -> str:
    """Return the name of a Slurm job, by which it is found after the program was killed."""
    return "rhizotwin-" + hashlib.sha256(f"{job.output}\0{job.key}".encode(errors="surrogateescape")).hexdigest()[:16]


def _names() -> dict[str, str]:
    """Return the names of all open Slurm jobs of the user."""
    rows = [line.partition("|") for line in _call("squeue", "-h", "-u", str(os.getuid()), "-o", "%i|%j").splitlines()]
    return {number: name for number, _, name in rows}


def _call(program: str, *words: str, given: str | None = None) -> str:
    """Call a program of Slurm, and return its output."""
    try:
        done = subprocess.run([program, *words], input=given, capture_output=True, text=True, timeout=CALL_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UserError(f"{program} failed ({error})") from None
    if done.returncode:
        lines = [line.removeprefix(f"{program}: error: ") for line in done.stderr.splitlines() if line.strip()]
        raise UserError(f"{program} failed: {printable(lines[-1] if lines else f'exit code {done.returncode}')}")
    return done.stdout


if __name__ == "__main__":
    from rhizotwin.batches.work import work

    work(json.load(sys.stdin), threads=int(os.environ.get("SLURM_CPUS_PER_TASK") or os.environ.get("SLURM_CPUS_ON_NODE", "1")))
