"""Comparison of a catalogue with the files that it lists."""

from collections.abc import Iterator
from pathlib import Path

from rhizotwin.catalogue.records import Problem
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes.dataset import file_sha256, load_dataset
from rhizotwin.scenes.errors import UserError


def check(catalogue: Catalogue, *, pictures: bool = True) -> list[Problem]:
    """Check the integrity of a catalogue, and compare it with the files that it lists.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    pictures : bool
        Compare the SHA-256 of each picture with dataset.json; otherwise only check that the picture exists.

    Returns
    -------
    list of Problem
        Differences and damage.
    """
    return [*_internal(catalogue), *_scans(catalogue, pictures=pictures), *_files(catalogue), *_unlisted(catalogue)]


def _internal(catalogue: Catalogue) -> Iterator[Problem]:
    for (text,) in catalogue.rows("PRAGMA integrity_check"):
        if text != "ok":
            yield Problem(
                path=catalogue.path,
                kind="damaged",
                text=f"the catalogue is damaged ({text}); create it again with `rhizotwin catalogue rebuild`",
            )
    for row in catalogue.rows("PRAGMA foreign_key_check"):
        yield Problem(path=catalogue.path, kind="damaged", text=f"row {row[1]} of table {row[0]} refers to a missing row of table {row[2]}")


def _scans(catalogue: Catalogue, *, pictures: bool) -> Iterator[Problem]:
    for scan in catalogue.scans():
        head = scan.path / "dataset.json"
        if not head.is_file():
            yield Problem(path=scan.path, kind="missing", text="the dataset does not exist")
            continue
        if file_sha256(head) != scan.sha256:
            yield Problem(path=head, kind="changed", text="the file has changed since it was added; if this is intended, add it again")
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
                yield Problem(path=path, kind="missing", text="the picture does not exist")
            elif pictures and frame.sha256 and file_sha256(path) != frame.sha256.lower():
                yield Problem(path=path, kind="changed", text="the picture has changed since it was recorded")


def _files(catalogue: Catalogue) -> Iterator[Problem]:
    """Yield each result, log of corrections and table that is missing or has been changed."""
    listed = [
        *((catalogue.full_path(path) / "result.json", digest) for path, digest in catalogue.rows("SELECT path, sha256 FROM results")),
        *((catalogue.full_path(path), digest) for path, digest in catalogue.rows("SELECT path, sha256 FROM edits")),
        *((catalogue.full_path(path), digest) for path, digest in catalogue.rows("SELECT path, sha256 FROM tables")),
    ]
    for path, digest in listed:
        if not path.is_file():
            yield Problem(path=path, kind="missing", text="the file does not exist")
        elif file_sha256(path) != digest:
            yield Problem(path=path, kind="changed", text="the file has changed since it was added; if this is intended, add it again")


def _unlisted(catalogue: Catalogue) -> Iterator[Problem]:
    """Yield each dataset or result that is not listed, although it lies in the same folder as a listed one."""
    listed = [*(one.path for one in catalogue.scans()), *(one.path for one in catalogue.results())]
    known = {catalogue.stored_path(path) for path in listed}
    parents = {path.parent for path in listed}
    for parent in sorted(parents):
        folders: list[Path] = sorted(parent.iterdir()) if parent.is_dir() else []
        for folder in folders:
            head = next((name for name in ("dataset.json", "result.json") if (folder / name).is_file()), None)
            if head and not folder.name.startswith(".") and catalogue.stored_path(folder) not in known:
                kind = "dataset" if head == "dataset.json" else "result"
                yield Problem(
                    path=folder, kind="unlisted", text=f"this {kind} is not in the catalogue; add it with `rhizotwin catalogue add`"
                )
