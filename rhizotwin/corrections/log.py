"""The log of corrections, ``edits.json`` in a result's folder: what, who and when. The result is not changed."""

import getpass
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import file_sha256
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import read_file

SCHEMA_VERSION = 1
LOG_NAME = "edits.json"
KINDS = {
    "delete roots": "delete roots, with their laterals if `laterals` is true",
    "restore roots": "restore deleted roots",
    "delete voxels": "delete voxels, and the parts of roots inside them",
    "delete box": "delete everything inside a box",
    "restore voxels": "restore deleted voxels",
    "cut": "cut a root at a point: the part beyond becomes a new root",
    "join": "make a root the continuation of another",
    "parent": "make a root a lateral of another",
    "tip": "end a root at a point, which becomes its tip",
    "base": "set the base of the plant",
    "fit": "refit centre lines and diameters to the pictures",
}
"""Kinds of corrections; each uses some of the fields of `Edit`."""
Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Edit:
    """One correction."""

    do: str
    """One of `KINDS`."""
    who: str
    when: str
    """UTC, ISO 8601."""
    roots: tuple[int, ...] = ()
    """Numbers of roots: their position in ``roots.rsml``, then new roots in the order of creation."""
    laterals: bool = False
    runs: tuple[tuple[int, int], ...] = ()
    """Voxels as runs (first, count) of rows of ``shape.npz``."""
    box_mm: tuple[Triple, Triple] | None = None
    """Lowest and highest corner, canister frame."""
    point_mm: Triple | None = None
    """Canister frame."""


@dataclass(frozen=True, kw_only=True)
class Log:
    """The corrections of one result."""

    shape_sha256: str
    """Of the result's ``shape.npz``, to which the numbers of voxels and roots refer."""
    edits: tuple[Edit, ...] = ()


def edit(do: str, *, roots: Sequence[int] = (), who: str | None = None, **more: Any) -> Edit:
    """Return a correction with the current time and user."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Edit(do=do, who=_user() if who is None else who, when=now, roots=tuple(int(root) for root in roots), **more)


def runs(rows: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return ascending rows as runs (first, count)."""
    found: list[tuple[int, int]] = []
    for row in rows:
        if found and row == sum(found[-1]):
            found[-1] = (found[-1][0], found[-1][1] + 1)
        else:
            found.append((int(row), 1))
    return tuple(found)


def new(result_folder: Path) -> Log:
    """Return an empty log for a result."""
    return Log(shape_sha256=file_sha256(result_folder / "shape.npz"))


def read(path: Path, result_folder: Path) -> Log:
    """Read a log and check that it belongs to a result.

    Raises
    ------
    UserError
        If it is missing, damaged, of another version or of another result.
    """
    if not path.is_file():
        raise UserError(f"{path} does not exist; `rhizotwin view RESULT` writes it when corrections are saved")
    try:
        stored = json.loads(read_file(path).decode())
        if not isinstance(stored, dict) or stored.get("schema_version") != SCHEMA_VERSION:
            raise ValueError(f"its schema_version is not {SCHEMA_VERSION}")
        log = Log(shape_sha256=str(stored["shape_sha256"]), edits=tuple(_edit(entry) for entry in stored["edits"]))
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as error:
        raise UserError(f"{path} is not a readable log of corrections ({error})") from None
    if log.shape_sha256 != file_sha256(result_folder / "shape.npz"):
        raise UserError(
            f"{path} contains corrections of a different result than {result_folder}; they cannot be applied to a new reconstruction"
        )
    return log


def write(path: Path, log: Log, *, follow: bool = True) -> None:
    """Write a log atomically, see `scenes.atomic.write_bytes`."""
    listed = [{key: value for key, value in asdict(entry).items() if value not in ((), None, False)} for entry in log.edits]
    text = atomic.json_bytes({"schema_version": SCHEMA_VERSION, "shape_sha256": log.shape_sha256, "edits": listed})
    atomic.write_bytes(path, text, follow=follow)


def _edit(entry: Any) -> Edit:
    """Check an entry of the file and return it."""
    unknown = set(entry) - {field.name for field in fields(Edit)}
    if unknown:
        raise ValueError(f"an edit has the unknown key {sorted(unknown)[0]!r}")
    if entry["do"] not in KINDS:
        raise ValueError(f"unknown kind of edit {entry['do']!r}; known are {', '.join(KINDS)}")
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
        raise ValueError(f"{value!r} is not the number of a root or voxel")
    return value


def _triple(value: Any) -> Triple:
    x, y, z = (float(number) for number in value)
    if not all(math.isfinite(number) for number in (x, y, z)):
        raise ValueError(f"{value!r} is not a point")
    return x, y, z


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # no name for this user's number
        return "unknown"
