"""What is to be done, and the record of what became of it.

A job is a scan or a rendering, known by everything that decides its outcome.
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
"""Folder of the records beside the outputs; hidden, so that it is not taken for one."""
HEADS: dict[str, str] = {"reconstruct": "result.json", "simulate": "dataset.json"}
"""The file that tells that an output is whole."""

BASE_MIB, MIB_PER_MPX = 700.0, 120.0
"""Peak memory of a reconstruction: of the process with its libraries, and for each million pixels of all pictures.

An upper bound over the accuracy ladder: 18 plants of 38.4 million pixels (two rings of 40 views, 800x600) took up to
4953 MiB, printed phantoms of 19.2 million pixels 1336 MiB. Voxels below the default 0.27 mm are not told by it: 0.07 mm
took twice as much.
"""
RENDER_MIB = 1000.0
"""Of a rendering: 414 MiB at 800x600, and the solid of the largest library plant."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One scan to reconstruct, or one scene to render."""

    name: str
    """Of the output's folder."""
    kind: Kind
    source: str
    """Dataset, or scene as JSON text."""
    output: str
    key: str
    """SHA-256 of all that decides the outcome: dataset or scene, settings, code."""
    pixels: float
    """Of all pictures: what memory and time grow with."""
    options: dict[str, Any]
    """What the step is called with, as JSON values."""

    @property
    def memory_mib(self) -> float:
        """Return the peak memory that it will need at most."""
        return RENDER_MIB if self.kind == "simulate" else BASE_MIB + MIB_PER_MPX * self.pixels / 1e6

    @property
    def record(self) -> str:
        """Return where its record lies."""
        beside = self.output.rstrip("/").rpartition("/")[0]
        return places.join(beside or ".", RECORDS, f"{self.name}.json")

    def plain(self) -> dict[str, Any]:
        """Return it as JSON values, for another process."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a job."""

    name: str
    state: State
    """again: not the job's fault (a worker that died, a full disk); it is tried again."""
    sentence: str = ""
    """Why it failed."""
    seconds: float = 0.0
    peak_mib: float = 0.0


def key_of(settings: Mapping[str, Any], *, code: str) -> str:
    """Return the key of what a job is made from: JSON values and the digest of the code."""
    text = json.dumps({"settings": settings, "code": code}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def is_done(job: Job) -> bool:
    """Tell whether the job was done by an earlier run, with the same key, and its output is there."""
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
    """Return a name for each source: its last one, with those above it where two have the same.

    Raises
    ------
    UserError
        Where two sources cannot be told apart.
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
