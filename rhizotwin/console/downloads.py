"""Dataset folders as ZIP archives, which are written while they are sent."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile, ZipInfo

BLOCK = 1 << 20
"""Number of bytes that are read at a time."""


class _Sent:
    """Stream without positions, from which written bytes are taken."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def write(self, data: bytes, /) -> int:
        """Append bytes, and return their number."""
        self._waiting += data
        return len(data)

    def flush(self) -> None:
        """Do nothing: all bytes can be taken at once."""

    def close(self) -> None:
        """Do nothing: the bytes are taken after the archive is complete."""

    def take(self) -> bytes:
        """Return and forget the bytes that were written."""
        taken = bytes(self._waiting)
        self._waiting.clear()
        return taken


def zip_folder(folder: Path) -> Iterator[bytes]:
    """Yield the parts of a ZIP archive that contains a folder with its subfolders.

    Pictures are compressed already, and therefore stored as they are. Links and hidden files, such as locks, are
    omitted.
    """
    sent = _Sent()
    with ZipFile(sent, "w", ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder.parent)
            if path.is_symlink() or not path.is_file() or any(part.startswith(".") for part in inside.parts):
                continue
            with path.open("rb") as source, archive.open(ZipInfo.from_file(path, inside), "w", force_zip64=True) as target:
                while block := source.read(BLOCK):
                    target.write(block)
                    yield sent.take()
    yield sent.take()
