"""Jobs of a batch (reconstruction of a scan or rendering of a scene), and the records of their outcomes.

A job is identified by a hash of all inputs that affect its outcome.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from rhizotwin.batches import places
from rhizotwin.scenes.atomic import json_bytes
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.result_names import shorten

Kind = Literal["reconstruct", "simulate"]
State = Literal["done", "failed", "again"]

RECORDS = ".rhizotwin-jobs"
"""Name of the hidden folder, inside the folder of the outputs, in which the records of jobs are stored."""
HEADS: dict[str, str] = {"reconstruct": "result.json", "simulate": "dataset.json"}
"""Name of the file whose existence shows that an output is complete. The key is the kind of job."""

_NOT_FIRST = ".=@"
"""Characters with which the name of a job does not begin."""

SLURM_JOB = "slurm_job"
"""Key of a record with the number of the Slurm job that has run the job. It is empty outside Slurm."""

BASE_MIB, MIB_PER_MPX, LEAST_MIB = 900.0, 120.0, 1800.0
"""Coefficients of the estimated peak memory of a reconstruction: constant part in MiB, MiB per million pixels, and the
minimum of the sum in MiB.

The constant part is the memory of the process with its libraries and compiled kernels: 12 pictures of 320x240 needed
886 to 922 MiB, and 980 MiB as the second scan of a process. The hull of few pictures is large: 4 pictures of 200x150 of
a printed phantom needed 1658 and 1721 MiB, so that the minimum is not lower. The sum is an upper bound over the
accuracy ladder.
Reconstructions of 18 plants with 38.4 million pixels (two rings of 40 views, 800x600) used up to 4953 MiB, and those of
printed phantoms with 19.2 million pixels 1336 MiB. Voxels smaller than the default of 0.27 mm need more memory; voxels
of 0.07 mm used twice as much.
"""
RENDER_MIB = 1000.0
"""Upper bound of the peak memory of a rendering, in MiB. A rendering at 800x600 needs 414 MiB, to which the mesh of the
largest plant in the library is added."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Reconstruction of one scan, or rendering of one scene."""

    name: str
    """Name of the job and of its output folder."""
    kind: Kind
    source: str
    """Path or address of the dataset to reconstruct, or JSON text of the scene to render."""
    output: str
    """Path or address of the output folder."""
    key: str
    """SHA-256 of all inputs that affect the outcome: dataset or scene, settings, and code."""
    pixels: float
    """Total number of pixels in all pictures. The memory and duration of the job are predicted from it."""
    options: dict[str, Any]
    """Arguments of the reconstruction or rendering, as JSON values."""

    @property
    def memory_mib(self) -> float:
        """Predicted upper bound of the job's peak memory."""
        return RENDER_MIB if self.kind == "simulate" else max(LEAST_MIB, BASE_MIB + MIB_PER_MPX * self.pixels / 1e6)

    @property
    def record(self) -> str:
        """Path or address of the job's record."""
        beside = self.output.rstrip("/").rpartition("/")[0]
        return places.join(beside or ".", RECORDS, f"{self.name}.json")

    def plain(self) -> dict[str, Any]:
        """Convert the job to JSON values, which can be sent to another process."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of one attempt to run a job."""

    name: str
    """Name of the job."""
    state: State
    """``done``, ``failed`` or ``again``. The state ``again`` means that the job should be repeated, because it failed
    for an external reason (lost worker, full disk)."""
    sentence: str = ""
    """Reason for a failure, for the user."""
    seconds: float = 0.0
    """Duration of the attempt."""
    peak_mib: float = 0.0
    """Peak memory of the process."""


def key_of(settings: Mapping[str, Any], *, code: str) -> str:
    """Return the SHA-256 of a job's settings and of the code.

    ``settings`` are JSON values, and ``code`` is the digest of the code.
    """
    text = json.dumps({"settings": settings, "code": code}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def is_done(job: Job) -> bool:
    """Return whether an earlier run has finished a job with the same key, and its output still exists."""
    record = read_record(job)
    same = record.get("key") == job.key and record.get("state") == "done"
    return same and places.exists(places.join(job.output, HEADS[job.kind]))


def read_record(job: Job) -> dict[str, Any]:
    """Return the record of a job, as written by `note`. It is empty if there is none, or if it is damaged."""
    try:
        record = json.loads(places.read(job.record) or b"")
    except (ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def note(job: Job, outcome: Outcome) -> None:
    """Write the record of a job with its outcome, key and source."""
    known = {"key": job.key, "source": job.source if job.kind == "reconstruct" else job.name, SLURM_JOB: os.environ.get("SLURM_JOB_ID", "")}
    places.write(job.record, json_bytes(asdict(outcome) | known))


def named(sources: Sequence[str]) -> list[str]:
    """Return a unique name for each source.

    The name is that of the source's folder, without the characters ``.``, ``=`` and ``@`` at its beginning, because
    results in hidden folders are not found, and spreadsheets read = and @ as formulas. If two names are equal, the
    names of parent folders are prepended.

    Raises
    ------
    UserError
        If two sources have equal names even with all parent folders.
    """
    paths = [[part.lstrip(_NOT_FIRST) for part in source.replace("://", "/").split("/")] for source in sources]
    last = [places.name_of(source).lstrip(_NOT_FIRST) or "scan" for source in sources]  # also of . and ..
    names = shorten([[*filter(None, path)] or [name] for path, name in zip(paths, last, strict=True)], separator="-")
    same = sorted({name for name in names if names.count(name) > 1})
    if same:
        raise UserError(f"two scans have the same name {same[0]}; rename the folder of one of them")
    return names
