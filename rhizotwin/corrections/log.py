"""Log of manual corrections with their authors and times, stored as ``edits.json`` in the result's folder.

Corrections are applied when the log is replayed. The result itself is not changed.
"""

from __future__ import annotations

import getpass
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import file_sha256
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import read_file

SCHEMA_VERSION = 1
LOG_NAME = "edits.json"
APPLIED_NAME = "corrected.json"
"""Name of the file in a corrected result that contains the applied log."""
KINDS = {
    "delete roots": "delete roots, and their laterals if `laterals` is true",
    "restore roots": "restore deleted roots",
    "delete voxels": "delete voxels and the parts of roots inside them",
    "delete box": "delete all roots and voxels inside a box",
    "restore voxels": "restore deleted voxels",
    "restore deletion": "restore roots, parts of roots and voxels of the last deletion that was not restored",
    "cut": "cut a root at a point, beyond which it becomes a new root",
    "join": "join a root to the end of another root",
    "parent": "make a root a lateral of another root",
    "tip": "set the tip of a root and delete the part beyond",
    "base": "set the base of the plant",
    "fit": "refit centre lines and diameters to the pictures",
}
"""Description of each kind of correction. The kind determines which fields of `Edit` are used."""
Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Edit:
    """Manual correction of a result."""

    do: str
    """Kind of the correction, which is a key of `KINDS`."""
    who: str
    """User name of the author."""
    when: str
    """Time of the correction in UTC (ISO 8601)."""
    roots: tuple[int, ...] = ()
    """Numbers of the roots to correct. The roots of ``roots.rsml`` are numbered by their position in the file. New
    roots have the following numbers, in order of creation."""
    laterals: bool = False
    """Whether a deletion of roots includes their laterals."""
    runs: tuple[tuple[int, int], ...] = ()
    """Voxels to correct, as runs of rows in ``shape.npz``. A run consists of the first row and the number of rows."""
    box_mm: tuple[Triple, Triple] | None = None
    """Lowest and highest corner of the box in the canister frame, mm."""
    point_mm: Triple | None = None
    """Point at which a root is corrected, in the canister frame, mm."""


@dataclass(frozen=True, kw_only=True)
class Log:
    """Corrections of a result, in the order in which they are applied."""

    shape_sha256: str
    """SHA-256 hash of the result's ``shape.npz``. The numbers of voxels and roots in the log are valid only for this
    file."""
    edits: tuple[Edit, ...] = ()
    earlier: tuple[Log, ...] = ()
    """Logs of earlier corrections that a corrected result already contains, oldest first."""


def edit(do: str, *, roots: Sequence[int] = (), who: str | None = None, **more: Any) -> Edit:
    """Create a correction with the current time and, by default, the current user."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Edit(do=do, who=_user() if who is None else who, when=now, roots=tuple(int(root) for root in roots), **more)


def runs(rows: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Convert row numbers in ascending order to runs of consecutive rows.

    A run consists of the first row and the number of rows.
    """
    found: list[tuple[int, int]] = []
    for row in rows:
        if found and row == sum(found[-1]):
            found[-1] = (found[-1][0], found[-1][1] + 1)
        else:
            found.append((int(row), 1))
    return tuple(found)


def new(result_folder: Path) -> Log:
    """Create an empty log for a result."""
    return Log(shape_sha256=file_sha256(result_folder / "shape.npz"))


def read(path: Path, result_folder: Path | None) -> Log:
    """Read a log and check that it was written for the given result. None: the result is not checked.

    Raises
    ------
    UserError
        If the log is missing, damaged, of an unsupported version, or was written for another result.
    """
    if not path.is_file():
        raise UserError(f"{path} does not exist; make and save corrections with 'rhizotwin view RESULT' first")
    try:
        stored = json.loads(read_file(path).decode())
        if not isinstance(stored, dict) or stored.get("schema_version") != SCHEMA_VERSION:
            raise ValueError(f"schema_version is not {SCHEMA_VERSION}")
        log = replace(_log(stored), earlier=tuple(_log(one) for one in stored.get("earlier", ())))
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as error:
        raise UserError(f"{path} could not be read as a log of corrections ({error}); give a file saved by 'rhizotwin view'") from None
    if result_folder is not None and log.shape_sha256 != file_sha256(result_folder / "shape.npz"):
        raise UserError(
            f"{path} contains corrections of a different result and cannot be applied to {result_folder}; "
            "if the scan was reconstructed again, repeat the corrections"
        )
    return log


def write(path: Path, log: Log, *, follow: bool = True) -> None:
    """Write a log to a file atomically, with `scenes.atomic.write_bytes`."""
    earlier = {"earlier": [_plain(one) for one in log.earlier]} if log.earlier else {}
    atomic.write_bytes(path, atomic.json_bytes({"schema_version": SCHEMA_VERSION, **_plain(log), **earlier}), follow=follow)


def read_applied(result_folder: Path) -> tuple[Log, ...]:
    """Return the logs of all corrections that a result already contains, oldest first."""
    path = result_folder / APPLIED_NAME
    if not path.is_file():
        return ()
    log = read(path, None)
    return (*log.earlier, replace(log, earlier=()))


def _plain(log: Log) -> dict[str, Any]:
    listed = [{key: value for key, value in asdict(entry).items() if value not in ((), None, False)} for entry in log.edits]
    return {"shape_sha256": log.shape_sha256, "edits": listed}


def _log(stored: Any) -> Log:
    return Log(shape_sha256=str(stored["shape_sha256"]), edits=tuple(_edit(entry) for entry in stored["edits"]))


def _edit(entry: Any) -> Edit:
    """Validate an entry of the file and convert it to an `Edit`."""
    unknown = set(entry) - {field.name for field in fields(Edit)}
    if unknown:
        raise ValueError(f"a correction has the unknown key {sorted(unknown)[0]!r}")
    if entry["do"] not in KINDS:
        raise ValueError(f"{entry['do']!r} is not a kind of correction; the kind must be one of: {', '.join(KINDS)}")
    box = entry.get("box_mm")
    return Edit(
        do=entry["do"],
        who=str(entry["who"]),
        when=str(entry["when"]),
        roots=tuple(_whole(root) for root in entry.get("roots", ())),
        laterals=bool(entry.get("laterals", False)),
        runs=tuple((_whole(first), _whole(count)) for first, count in entry.get("runs", ())),
        box_mm=None if box is None else (_triple(box[0]), _triple(box[1])),
        point_mm=None if entry.get("point_mm") is None else _triple(entry["point_mm"]),
    )


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} is not a valid number of a root or voxel; the number must be an integer of at least 0")
    return value


def _triple(value: Any) -> Triple:
    x, y, z = (float(number) for number in value)
    if not all(math.isfinite(number) for number in (x, y, z)):
        raise ValueError(f"{value!r} is not a valid point; a point must be three finite numbers")
    return x, y, z


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # the user ID has no name
        return "unknown"
