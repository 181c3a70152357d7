"""The console's folder: scans, results and single pictures by name, without any way out of it.

FOLDER/scans/NAME      dataset of a scan
FOLDER/results/NAME    its reconstruction
FOLDER/pictures/       single pictures
FOLDER/queue.json      reconstructions to do
FOLDER/NAME.rhizotwin  catalogue of plants, scans and results
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject, from_summary
from rhizotwin.timelapse.reconstruction import GROWTH

NAME = re.compile(r"\w[\w.-]{0,99}")
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
        self._read: dict[Path, tuple[tuple[int, int], Any]] = {}

    def new_name(self, subject: Subject) -> str:
        """Return an unused name for a scan: plant and date."""
        plant = re.sub(r"[^\w.-]+", "-", subject.plant).strip("-._") or "scan"
        stem = f"{plant[:60]}-{subject.date}"
        names = (stem, *(f"{stem}-{number}" for number in range(2, 1000)))
        return next(name for name in names if not (self.scans / name).exists())

    def scan(self, name: str) -> Path:
        """Return the folder of an existing scan.

        Raises
        ------
        UserError
            For a name that is not allowed or not there.
        """
        folder = self.scans / check_name(name)
        if folder.is_symlink() or not (folder / "dataset.json").is_file():
            raise UserError(f"there is no scan {name!r}")
        return folder

    def result(self, name: str) -> Path:
        """Return the folder of a scan's result, which may not exist yet."""
        folder = self.results / check_name(name)
        if folder.is_symlink():
            raise UserError(f"results/{name} is a link; put the folder itself in its place")
        return folder

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
        found = [(path, path.stat().st_mtime_ns) for path in self.scans.glob("*/dataset.json") if _is_plain(path)]
        latest = sorted(found, key=lambda one: -one[1])[:MOST_LISTED]
        return [self._scan_entry(path) for path, _ in latest]

    def result_of(self, name: str) -> ResultEntry | None:
        """Return a scan's result; None where there is none or it cannot be read."""
        path = self.results / name / "result.json"
        if not _is_plain(path):
            return None
        try:
            found: ResultEntry = self._cached(path, _result_entry)
        except (UserError, OSError, ValueError, KeyError, TypeError):
            return None
        return found

    def _scan_entry(self, path: Path) -> ScanEntry:
        name = path.parent.name
        try:
            found: ScanEntry = self._cached(path, _scan_entry)
        except (UserError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            return ScanEntry(name=name, subject="", plant="", pictures=0, planned=0, complete=False, error=f"cannot be read: {error}")
        return found

    def _cached(self, path: Path, read: Any) -> Any:
        """Read a file unless it is unchanged since the last time."""
        status = path.stat()
        stamp = (status.st_mtime_ns, status.st_size)
        if path not in self._read or self._read[path][0] != stamp:
            self._read[path] = stamp, read(path)
        return self._read[path][1]


def check_name(name: str) -> str:
    """Return a name of a scan.

    Raises
    ------
    UserError
        For a name that is not allowed.
    """
    if not NAME.fullmatch(name):
        raise UserError(f"{name[:100]!r} is not a name of a scan: use up to 100 letters, digits, dots, hyphens and underscores")
    return name


def _is_plain(path: Path) -> bool:
    return NAME.fullmatch(path.parent.name) is not None and not path.parent.is_symlink() and not path.is_symlink() and path.is_file()


def _scan_entry(path: Path) -> ScanEntry:
    plain = json.loads(path.read_text(encoding="utf-8"))
    origin = plain["origin"]
    subject = from_summary(plain["scene"], str(path))
    views = {frame["file"] if frame.get("view") is None else frame["view"] for frame in plain["frames"]}
    return ScanEntry(
        name=path.parent.name,
        subject=str(subject),
        plant=subject.plant,
        pictures=len(views),
        planned=int(origin.get("planned_views", len(views))),
        complete=bool(origin.get("complete")),
        sketch=((origin.get("settings") or {}).get("twin") or {}).get("fidelity") == "sketch",
    )


def _result_entry(path: Path) -> ResultEntry:
    from rhizotwin.report import words

    summary = json.loads(path.read_text(encoding="utf-8"))
    headline, beside = words.headline(summary)
    return ResultEntry(volume=f"{headline}, {beside}", trusted=bool(summary["volume_trusted"]))
