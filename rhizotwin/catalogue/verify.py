"""Compare a catalogue with the files that it lists."""

from collections.abc import Iterator
from pathlib import Path

from rhizotwin.catalogue.records import Problem
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes.dataset import file_sha256, load_dataset
from rhizotwin.scenes.errors import UserError


def check(catalogue: Catalogue, *, pictures: bool = True) -> list[Problem]:
    """Return every difference between a catalogue and the files that it lists.

    Parameters
    ----------
    catalogue : Catalogue
        Its own pages and references are checked as well.
    pictures : bool
        Whether every picture is read and compared with its SHA-256 in dataset.json; False: it must be there only.
    """
    return [*_internal(catalogue), *_scans(catalogue, pictures=pictures), *_files(catalogue), *_unlisted(catalogue)]


def _internal(catalogue: Catalogue) -> Iterator[Problem]:
    for (text,) in catalogue.rows("PRAGMA integrity_check"):
        if text != "ok":
            yield Problem(
                path=catalogue.path, kind="damaged", text=f"SQLite reports: {text}; rebuild it with `rhizotwin catalogue rebuild`"
            )
    for row in catalogue.rows("PRAGMA foreign_key_check"):
        yield Problem(path=catalogue.path, kind="damaged", text=f"row {row[1]} of {row[0]} refers to a row of {row[2]} that does not exist")


def _scans(catalogue: Catalogue, *, pictures: bool) -> Iterator[Problem]:
    for scan in catalogue.scans():
        head = scan.path / "dataset.json"
        if not head.is_file():
            yield Problem(path=scan.path, kind="missing", text="the dataset is not there")
            continue
        if file_sha256(head) != scan.sha256:
            yield Problem(path=head, kind="changed", text="differs from the one that was added; add it again if that is intended")
        if not scan.complete:
            yield Problem(path=scan.path, kind="incomplete", text=f"the scan was interrupted after {scan.pictures} pictures")
        try:
            dataset = load_dataset(scan.path)
        except UserError as error:
            yield Problem(path=head, kind="damaged", text=str(error))
            continue
        for frame in dataset.frames:
            path = scan.path / frame.file
            if not path.is_file():
                yield Problem(path=path, kind="missing", text="the picture is not there")
            elif pictures and frame.sha256 and file_sha256(path) != frame.sha256.lower():
                yield Problem(path=path, kind="changed", text="is not the picture that was recorded")


def _files(catalogue: Catalogue) -> Iterator[Problem]:
    """Compare results, logs of corrections and tables of masses."""
    listed = [
        *((catalogue.full_path(path) / "result.json", digest) for path, digest in catalogue.rows("SELECT path, sha256 FROM results")),
        *((catalogue.full_path(path), digest) for path, digest in catalogue.rows("SELECT path, sha256 FROM edits")),
        *((catalogue.full_path(path), digest) for path, digest in catalogue.rows("SELECT path, sha256 FROM tables")),
    ]
    for path, digest in listed:
        if not path.is_file():
            yield Problem(path=path, kind="missing", text="is not there")
        elif file_sha256(path) != digest:
            yield Problem(path=path, kind="changed", text="differs from the one that was added; add it again if that is intended")


def _unlisted(catalogue: Catalogue) -> Iterator[Problem]:
    """Find datasets and results beside those that are listed."""
    listed = [*(one.path for one in catalogue.scans()), *(one.path for one in catalogue.results())]
    known, parents = {catalogue.stored_path(path) for path in listed}, {path.parent for path in listed}
    for parent in sorted(parents):
        folders: list[Path] = sorted(parent.iterdir()) if parent.is_dir() else []
        for folder in folders:
            head = next((name for name in ("dataset.json", "result.json") if (folder / name).is_file()), None)
            if head and not folder.name.startswith(".") and catalogue.stored_path(folder) not in known:
                kind = "dataset" if head == "dataset.json" else "result"
                yield Problem(
                    path=folder, kind="unlisted", text=f"this {kind} is not in the catalogue; add it with `rhizotwin catalogue add`"
                )
