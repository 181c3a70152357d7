"""Jobs (reconstruct a scan, render a scene) and the records of their outcomes.

A job is identified by everything that decides its outcome.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from rhizotwin.batches import places
from rhizotwin.scenes.atomic import json_bytes
from rhizotwin.scenes.errors import UserError

Kind = Literal["reconstruct", "simulate"]
State = Literal["done", "failed", "again"]

RECORDS = ".rhizotwin-jobs"
"""Folder of the records beside the outputs; hidden, so that it is not mistaken for an output."""
HEADS: dict[str, str] = {"reconstruct": "result.json", "simulate": "dataset.json"}
"""The file that marks an output as complete, by kind of job."""

BASE_MIB, MIB_PER_MPX = 700.0, 120.0
"""Peak memory of a reconstruction: that of the process with its libraries, plus an amount per million pixels.

An upper bound over the accuracy ladder: 18 plants of 38.4 million pixels (two rings of 40 views, 800x600) took up to
4953 MiB, printed phantoms of 19.2 million pixels 1336 MiB. Voxels below the default of 0.27 mm need more: 0.07 mm
took twice as much.
"""
RENDER_MIB = 1000.0
"""Peak memory of a rendering: 414 MiB at 800x600, plus the solid of the largest plant of the library."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One scan to reconstruct, or one scene to render."""

    name: str
    """Name of the output folder."""
    kind: Kind
    source: str
    """Dataset, or scene as JSON text."""
    output: str
    key: str
    """SHA-256 of everything that decides the outcome: dataset or scene, settings, code."""
    pixels: float
    """Number of pixels of all pictures, which determines memory and time."""
    options: dict[str, Any]
    """Arguments of the step, as JSON values."""

    @property
    def memory_mib(self) -> float:
        """Return the maximum of its peak memory."""
        return RENDER_MIB if self.kind == "simulate" else BASE_MIB + MIB_PER_MPX * self.pixels / 1e6

    @property
    def record(self) -> str:
        """Return the path or address of its record."""
        beside = self.output.rstrip("/").rpartition("/")[0]
        return places.join(beside or ".", RECORDS, f"{self.name}.json")

    def plain(self) -> dict[str, Any]:
        """Convert to JSON values, for another process."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a job."""

    name: str
    state: State
    """again: failed for an external reason (a worker that died, a full disk); it is repeated."""
    sentence: str = ""
    """Reason of the failure."""
    seconds: float = 0.0
    peak_mib: float = 0.0


def key_of(settings: Mapping[str, Any], *, code: str) -> str:
    """Return the key of a job from its settings (JSON values) and the digest of the code."""
    text = json.dumps({"settings": settings, "code": code}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def is_done(job: Job) -> bool:
    """Return whether an earlier run finished the job with the same key, and its output exists."""
    data = places.read(job.record)
    try:
        record = {} if data is None else json.loads(data)
    except (ValueError, RecursionError):
        record = {}
    same = isinstance(record, dict) and record.get("key") == job.key and record.get("state") == "done"
    return same and places.exists(places.join(job.output, HEADS[job.kind]))


def note(job: Job, outcome: Outcome) -> None:
    """Write the record of a job."""
    places.write(
        job.record, json_bytes(asdict(outcome) | {"key": job.key, "source": job.source if job.kind == "reconstruct" else job.name})
    )


def named(sources: Sequence[str]) -> list[str]:
    """Return a name for each source: the name of its folder, preceded by those of its parents where two are the same.

    Raises
    ------
    UserError
        If two sources would have the same name.
    """
    parts = [
        [part for part in source.replace("://", "/").split("/") if part not in ("", ".", "..")] or [places.name_of(source)]
        for source in sources
    ]
    names = [part[-1] for part in parts]
    for depth in range(2, max((len(part) for part in parts), default=1) + 1):
        twice = {name for name in names if names.count(name) > 1}
        names = ["-".join(part[-depth:]) if name in twice else name for name, part in zip(names, parts, strict=True)]
    same = sorted({name for name in names if names.count(name) > 1})
    if same:
        raise UserError(f"two scans would have the name {same[0]}; rename one of their folders")
    return names
