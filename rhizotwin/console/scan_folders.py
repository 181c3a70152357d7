"""The console's folder: scans, results and single pictures by name; names cannot lead outside, and links are refused.

FOLDER/scans/NAME      dataset of a scan
FOLDER/results/NAME    its reconstruction
FOLDER/pictures/       single pictures
FOLDER/queue.json      reconstructions to do
FOLDER/NAME.rhizotwin  catalogue of plants, scans and results
"""

import json
import os
import re
import stat
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import TypeVar, cast

from rhizotwin.report import words
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import error_sentence, printable
from rhizotwin.scenes.reading import read_file
from rhizotwin.scenes.subject import Subject, from_summary
from rhizotwin.stored.result_files import read_summary
from rhizotwin.timelapse.reconstruction import GROWTH

NAME = re.compile(r"\w[\w.-]{0,99}")
MOST_BYTES = 200
"""Length of a name in UTF-8: file systems allow 255, with the endings of temporary names."""
MOST_LISTED = 100
"""Scans that are listed, the latest first."""


@dataclass(frozen=True, kw_only=True)
class ScanEntry:
    """A scan in the folder."""

    name: str
    subject: str
    """Plant, treatment and day, as words."""
    plant: str
    pictures: int
    """Number of views that were taken."""
    planned: int
    complete: bool
    sketch: bool = False
    """The pictures are sketches of the emulated rig, which show no roots."""
    error: str = ""
    """Why its dataset cannot be read."""


@dataclass(frozen=True, kw_only=True)
class ResultEntry:
    """The reconstruction of a scan."""

    volume: str
    """Volume with its interval, or why it is not reliable."""
    trusted: bool


Entry = TypeVar("Entry", ScanEntry, ResultEntry | None)


class ScanFolders:
    """Scans and results of the console's folder.

    Parameters
    ----------
    root : path
        The folder; made where it is missing.
    scans, results : path or None
        Folders of scans and results, where they have other names.
    """

    def __init__(self, root: Path, *, scans: Path | None = None, results: Path | None = None) -> None:
        self.root = root
        self.scans, self.results, self.pictures = scans or root / "scans", results or root / "results", root / "pictures"
        for folder in (self.scans, self.results, self.pictures):
            folder.mkdir(parents=True, exist_ok=True)
        self._entries: dict[Path, tuple[tuple[int, int], ScanEntry | ResultEntry | None]] = {}

    def new_name(self, subject: Subject) -> str:
        """Return an unused name for a scan: plant and date."""
        plant = re.sub(r"[^\w.-]+", "-", subject.plant).strip("-._") or "scan"
        stem = f"{plant[:40]}-{subject.date}"
        names = chain([stem], (f"{stem}-{number}" for number in count(2)))
        return next(name for name in names if not os.path.lexists(self.scans / name))

    def new_scan(self, name: str) -> Path:
        """Return the folder of a scan that does not exist yet.

        Raises
        ------
        UserError
            For a name that is not allowed, or that of a scan.
        """
        folder = _inside(self.scans, name)
        if (folder / "dataset.json").exists():
            raise UserError(f"scan {name} already exists; choose another name or resume it")
        return folder

    def scan(self, name: str) -> Path:
        """Return the folder of an existing scan.

        Raises
        ------
        UserError
            For a name that is not allowed, or that of no scan.
        """
        folder = _inside(self.scans, name)
        if not (folder / "dataset.json").is_file():
            raise UserError(f"there is no scan {name!r}")
        return folder

    def result(self, name: str) -> Path:
        """Return the folder of a scan's result, which may not exist yet.

        Raises
        ------
        UserError
            For a name that is not allowed.
        """
        return _inside(self.results, name)

    def report(self, name: str) -> Path:
        """Return the report of an existing result.

        Raises
        ------
        UserError
            For a name that is not allowed, or without a report.
        """
        path = self.result(name) / "report.html"
        if path.is_symlink() or not path.is_file():
            raise UserError(f"there is no report of {name!r}")
        return path

    def growth(self) -> Path | None:
        """Return the page with the curves of growth; None where there is none."""
        path = self.results / GROWTH / "growth.html"
        return path if path.is_file() and not path.is_symlink() else None

    def list_scans(self) -> list[ScanEntry]:
        """Return the latest scans."""
        found = [(stamp, path) for path in self.scans.glob("*/dataset.json") if (stamp := _stamp(path)) is not None]
        latest = sorted(found, key=lambda one: -one[0][0])[:MOST_LISTED]
        return [entry for _, path in latest if (entry := self._entry(path, _scan_entry)) is not None]

    def scan_entry(self, name: str) -> ScanEntry:
        """Return an existing scan; UserError as `scan`."""
        entry = self._entry(self.scan(name) / "dataset.json", _scan_entry)
        if entry is None:
            raise UserError(f"there is no scan {name!r}")
        return entry

    def result_of(self, name: str) -> ResultEntry | None:
        """Return a scan's result; None where there is none or it cannot be read."""
        return self._entry(self.results / name / "result.json", _result_entry)

    def _entry(self, path: Path, read: Callable[[Path], Entry]) -> Entry | None:
        """Read a file unless it is unchanged since the last time; None where there is none."""
        stamp = _stamp(path)
        if stamp is None:
            return None
        if path not in self._entries or self._entries[path][0] != stamp:
            self._entries[path] = stamp, read(path)
        return cast("Entry", self._entries[path][1])


def check_name(name: str) -> str:
    """Return a name of a scan.

    Raises
    ------
    UserError
        For a name that is not allowed.
    """
    if not NAME.fullmatch(name) or len(name.encode()) > MOST_BYTES or name == GROWTH:
        raise UserError(f"{name[:100]!r} is not a name of a scan: use up to 100 letters, digits, dots, hyphens and underscores")
    return name


def _inside(parent: Path, name: str) -> Path:
    """Return a folder for a name; UserError for a name that is not allowed, and for a link, which may lead anywhere."""
    folder = parent / check_name(name)
    if folder.is_symlink():
        raise UserError(f"{parent.name}/{name} is a link; put the folder itself in its place")
    return folder


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return time and size of a file in a folder with an allowed name; None for links and other files."""
    try:
        check_name(path.parent.name)
        status = path.lstat()
        is_plain = stat.S_ISREG(status.st_mode) and not path.parent.is_symlink()
    except (UserError, OSError):
        return None
    return (status.st_mtime_ns, status.st_size) if is_plain else None


def _scan_entry(path: Path) -> ScanEntry:
    name = path.parent.name
    try:
        plain = json.loads(read_file(path))
        origin = plain["origin"]
        subject = from_summary(plain["scene"], str(path))
        views = {frame["file"] if frame.get("view") is None else frame["view"] for frame in plain["frames"]}
        return ScanEntry(
            name=name,
            subject=str(subject),
            plant=subject.plant,
            pictures=len(views),
            planned=int(origin.get("planned_views", len(views))),
            complete=bool(origin.get("complete")),
            sketch=((origin.get("settings") or {}).get("twin") or {}).get("fidelity") == "sketch",
        )
    except Exception as error:  # noqa: BLE001 - a damaged file raises anything, and is listed with its error
        text = printable(f"cannot be read: {error_sentence(error)}")
        return ScanEntry(name=name, subject="", plant="", pictures=0, planned=0, complete=False, error=text)


def _result_entry(path: Path) -> ResultEntry | None:
    try:
        summary = read_summary(path.parent)
    except UserError:
        return None
    headline, beside = words.headline(summary)
    return ResultEntry(volume=f"{headline}, {beside}", trusted=bool(summary["volume_trusted"]))
