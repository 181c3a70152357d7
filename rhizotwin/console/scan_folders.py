"""Access to the scans, results and pictures in the console's folder.

Clients identify them by name, which is validated, and links are rejected, so that clients cannot access files outside
the folder. Its contents are:

- ``scans/NAME``: dataset of a scan
- ``results/NAME``: result of the reconstruction of a scan
- ``pictures/``: individual pictures
- ``queue.json``: queue of reconstructions
- ``NAME.rhizotwin``: catalogue of plants, scans and results
"""

import os
import re
import stat
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import TypeVar, cast

from rhizotwin.catalogue.adding import is_complete, is_sketch
from rhizotwin.report import words
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import error_sentence, is_expected, printable
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.subject import Subject
from rhizotwin.stored.result_files import read_summary
from rhizotwin.timelapse.reconstruction import GROWTH, growth_page

NAME = re.compile(r"\w[\w.-]{0,99}")
MOST_BYTES = 200
"""Maximum length of a name in UTF-8, bytes. File systems allow 255 bytes, but names of temporary files are longer."""
MOST_LISTED = 100
"""Maximum number of listed scans."""


@dataclass(frozen=True, kw_only=True)
class ScanEntry:
    """Scan in the console's folder."""

    name: str
    """Name of the scan and of its folder."""
    plant: str
    """Name of the plant. It is empty if the scan names none."""
    about: str
    """Text with the treatment, the age and the other properties of the plant, without its name and the date."""
    date: str
    """Date of the scan."""
    pictures: int
    """Number of views for which pictures were taken."""
    planned: int
    """Number of planned views."""
    complete: bool
    """Whether all planned views were taken."""
    sketch: bool = False
    """Whether the emulated rig made the pictures with the fidelity ``sketch``, which does not show the plant."""
    error: str = ""
    """Reason why the dataset cannot be read. It is empty if the dataset is readable."""


@dataclass(frozen=True, kw_only=True)
class ResultEntry:
    """Summary of a scan's result for the list of scans."""

    volume: str
    """Text with the volume and its 90 % interval, or with the reason why the volume is not reliable."""
    trusted: bool


Entry = TypeVar("Entry", ScanEntry, ResultEntry | None)


class ScanFolders:
    """Provides access to the scans and results of a console.

    Parameters
    ----------
    root : path
        Folder of the console, which is created if it does not exist.
    scans, results : path or None
        Folders of scans and results; None: ``scans`` and ``results`` in ``root``.
    """

    def __init__(self, root: Path, *, scans: Path | None = None, results: Path | None = None) -> None:
        self.root = root
        self.scans = scans or root / "scans"
        self.results = results or root / "results"
        self.pictures = root / "pictures"
        for folder in (self.scans, self.results, self.pictures):
            folder.mkdir(parents=True, exist_ok=True)
        self._entries: dict[Path, tuple[tuple[int, int], ScanEntry | ResultEntry | None]] = {}

    def new_name(self, subject: Subject) -> str:
        """Return an unused name for a scan. The name consists of plant and date."""
        plant = re.sub(r"[^\w.-]+", "-", subject.plant).strip("-._") or "scan"
        stem = f"{plant[:40]}-{subject.date}"
        names = chain([stem], (f"{stem}-{number}" for number in count(2)))
        return next(name for name in names if not os.path.lexists(self.scans / name))

    def new_scan(self, name: str) -> Path:
        """Return the folder for a new scan.

        Raises
        ------
        UserError
            If the name is invalid, or the scan already exists.
        """
        folder = _inside(self.scans, name)
        if (folder / "dataset.json").exists():
            raise UserError(f"the scan {name} already exists; choose another name, or finish the existing scan")
        return folder

    def scan(self, name: str) -> Path:
        """Return the folder of an existing scan.

        Raises
        ------
        UserError
            If the name is invalid, or the scan does not exist.
        """
        folder = _inside(self.scans, name)
        if not (folder / "dataset.json").is_file():
            raise UserError(f"the scan {name!r} does not exist; choose a scan from the list")
        return folder

    def picture(self, name: str, number: int) -> Grey:
        """Return the picture (H, W) of a view of a scan, in linear values. Views are numbered from 0.

        Raises
        ------
        UserError
            If the scan or the view does not exist, or the picture cannot be read.
        """
        dataset = load_dataset(self.scan(name))
        frames = list(_views(dataset).values())
        if not 0 <= number < len(frames):
            raise UserError(f"the scan {name!r} has {len(frames)} pictures, numbered from 0; there is no picture {number}")
        return read_image(dataset, frames[number])

    def result(self, name: str) -> Path:
        """Return the folder of a scan's result. The folder may not exist yet.

        Raises
        ------
        UserError
            If the name is invalid.
        """
        return _inside(self.results, name)

    def report(self, name: str) -> Path:
        """Return the path of the report of a scan's result.

        Raises
        ------
        UserError
            If the name is invalid, or the scan has no report.
        """
        path = self.result(name) / "report.html"
        if path.is_symlink() or not path.is_file():
            raise UserError(f"the scan {name!r} has no report; add the scan to the queue of reconstructions")
        return path

    def growth(self) -> Path | None:
        """Return the path of the HTML page with the growth curves. It is None if the page does not exist."""
        path = growth_page(self.results)
        return path if path.is_file() and not path.is_symlink() else None

    def list_scans(self) -> list[ScanEntry]:
        """Return up to `MOST_LISTED` scans, from latest to earliest."""
        found = [(stamp, path) for path in self.scans.glob("*/dataset.json") if (stamp := _stamp(path)) is not None]
        latest = sorted(found, key=lambda one: -one[0][0])[:MOST_LISTED]
        return [entry for _, path in latest if (entry := self._entry(path, _scan_entry)) is not None]

    def scan_entry(self, name: str) -> ScanEntry:
        """Return the entry of an existing scan.

        Raises
        ------
        UserError
            If the name is invalid, or the scan does not exist.
        """
        entry = self._entry(self.scan(name) / "dataset.json", _scan_entry)
        if entry is None:
            raise UserError(f"the scan {name!r} does not exist; choose a scan from the list")
        return entry

    def result_of(self, name: str) -> ResultEntry | None:
        """Return the entry of a scan's result. It is None if the scan has no readable result."""
        return self._entry(self.results / name / "result.json", _result_entry)

    def _entry(self, path: Path, read: Callable[[Path], Entry]) -> Entry | None:
        """Read the entry of a file, or return the stored entry if the file has not changed.

        Return None if the file does not exist.
        """
        stamp = _stamp(path)
        if stamp is None:
            return None
        if path not in self._entries or self._entries[path][0] != stamp:
            self._entries[path] = stamp, read(path)
        return cast("Entry", self._entries[path][1])


def check_name(name: str) -> str:
    """Validate the name of a scan, and return it.

    Raises
    ------
    UserError
        If the name is invalid.
    """
    if not NAME.fullmatch(name) or len(name.encode()) > MOST_BYTES or name == GROWTH:
        raise UserError(f"{name[:100]!r} is not a valid name of a scan; use up to 100 letters, digits, dots, hyphens and underscores")
    return name


def _inside(parent: Path, name: str) -> Path:
    """Return the subfolder with the given name.

    Raises
    ------
    UserError
        If the name is invalid, or the folder is a file, or a link, which may point outside the parent folder.
    """
    folder = parent / check_name(name)
    if folder.is_symlink():
        raise UserError(f"{parent.name}/{name} is a symbolic link; replace the link by the folder")
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{parent.name}/{name} is not a folder; move it elsewhere")
    return folder


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return the modification time, in nanoseconds, and the size of a dataset or result file.

    Return None if it is a link or its folder has an invalid name.
    """
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
        dataset = load_dataset(path.parent)
        subject = dataset.scene.subject
        origin = dataset.origin
        views = _views(dataset)
        return ScanEntry(
            name=name,
            plant=subject.plant or subject.species,
            about=str(replace(subject, plant="", species="", date="")),
            date=subject.date,
            pictures=len(views),
            planned=int(origin.get("planned_views", len(views))),
            complete=is_complete(origin),
            sketch=is_sketch(origin),
        )
    except Exception as error:  # noqa: BLE001 - a damaged file raises anything, and is listed with its error
        reason = error_sentence(error) if is_expected(error) else f"dataset.json is damaged ({type(error).__name__}: {str(error)[:100]})"
        text = printable(f"the dataset cannot be read: {reason}")
        return ScanEntry(name=name, plant="", about="", date="", pictures=0, planned=0, complete=False, error=text)


def _views(dataset: Dataset) -> dict[object, Frame]:
    """Return the first frame of each view, keyed by view."""
    found: dict[object, Frame] = {}
    for frame in dataset.frames:
        found.setdefault(frame.file if frame.view is None else frame.view, frame)
    return found


def _result_entry(path: Path) -> ResultEntry | None:
    try:
        summary = read_summary(path.parent)
    except UserError:
        return None
    headline, beside = words.headline(summary)
    return ResultEntry(volume=f"{headline}, {beside}", trusted=bool(summary["volume_trusted"]))
