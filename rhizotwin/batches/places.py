"""Access to files in local folders, and at addresses such as ``s3://...``, which are opened with fsspec."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError, pip_install
from rhizotwin.scenes.reading import read_file

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

HEAD = "dataset.json"
"""Name of the file by which a dataset is recognised."""


def is_address(place: str) -> bool:
    """Return whether a text is an address such as ``s3://bucket/scans`` rather than a local path."""
    return "://" in place


def join(place: str, *names: str) -> str:
    """Append folder or file names to a path or address."""
    return "/".join([place.rstrip("/"), *names]) if is_address(place) else str(Path(place, *names))


def name_of(place: str) -> str:
    """Return the last component of a path or address.

    For ``.`` it is the name of the current folder.
    """
    return place.rstrip("/").rpartition("/")[2] if is_address(place) else Path(os.path.realpath(place)).name


def find_datasets(source: str) -> list[str]:
    """Search for datasets, and return their paths or addresses in sorted order.

    Hidden folders are searched only if they are given.

    Parameters
    ----------
    source : str
        Dataset, folder of datasets, address, or pattern of paths with the wildcards ``*``, ``?`` and ``**``.

    Raises
    ------
    UserError
        If no dataset is found.
    """
    if is_address(source):
        system, path = _system(source)
        heads = {*system.glob(f"{path}/{HEAD}"), *system.glob(f"{path}/**/{HEAD}")}
        found = sorted(system.unstrip_protocol(head.rpartition("/")[0]) for head in heads)
    else:
        folders = _matches(Path(source))
        heads = {head for folder in folders for head in ([folder / HEAD] if (folder / HEAD).exists() else folder.rglob(HEAD))}
        start = next(path for path in (Path(source), *Path(source).parents) if path.exists())  # may itself be hidden
        found = sorted(str(head.parent) for head in heads if not any(part.startswith(".") for part in head.relative_to(start).parts))
    if not found:
        raise UserError(f"{source}: no dataset was found; give datasets, folders that contain datasets, or a pattern in quotes")
    return found


def _matches(pattern: Path) -> list[Path]:
    """Return the existing paths that match a pattern.

    If the pattern itself is an existing path, only this path is returned.
    """
    if pattern.exists():
        return [pattern]
    try:
        return list(Path(pattern.anchor).glob(str(pattern.relative_to(pattern.anchor))))
    except ValueError:  # not a valid pattern, such as "a**"
        return []


def read(place: str) -> bytes | None:
    """Return the content of a file, or None if the file does not exist."""
    if not is_address(place):
        return read_file(place) if os.path.lexists(place) else None
    system, path = _system(place)
    try:
        return bytes(system.cat_file(path))
    except FileNotFoundError:
        return None


def write(place: str, data: bytes) -> None:
    """Write a file, and create its folder if necessary."""
    if is_address(place):
        system, path = _system(place)
        system.makedirs(path.rpartition("/")[0], exist_ok=True)
        system.pipe_file(path, data)
    else:
        atomic.write_bytes(place, data, follow=False)


def exists(place: str) -> bool:
    """Return whether a file exists at a path or address."""
    if is_address(place):
        system, path = _system(place)
        return bool(system.exists(path))
    return Path(place).exists()


def fetch(address: str, folder: Path) -> None:
    """Copy the folder at an address to a local folder."""
    system, path = _system(address)
    folder.mkdir(parents=True, exist_ok=True)
    system.get(f"{path.rstrip('/')}/", f"{folder}/", recursive=True)


def put(folder: Path, address: str, *, last: str, replaces: Sequence[str] = ()) -> None:
    """Copy a local folder to an address.

    The file ``last``, which marks the folder as complete, is written after all other files.

    Parameters
    ----------
    folder, address : Path, str
        Local folder, and address of the copy.
    last : str
        Name of the file that is removed first and written last.
    replaces : sequence of str
        Names of files and folders of an earlier copy, which are removed.
    """
    system, path = _system(address)
    system.makedirs(path, exist_ok=True)
    for name in (last, *replaces):
        if system.exists(f"{path}/{name}"):
            system.rm(f"{path}/{name}", recursive=True)
    files = sorted((file for file in folder.rglob("*") if file.is_file()), key=lambda file: file == folder / last)
    for file in files:
        goal = f"{path}/{file.relative_to(folder).as_posix()}"
        system.makedirs(goal.rpartition("/")[0], exist_ok=True)
        system.put_file(str(file), goal)


def _system(address: str) -> tuple[AbstractFileSystem, str]:
    """Return the fsspec file system of an address, and the path within this file system."""
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError:
        raise UserError(
            f"{address}: remote folders require fsspec, which is not installed; install it with: {pip_install('fsspec')}"
        ) from None
    try:
        found: tuple[Any, str] = url_to_fs(address)
    except (ImportError, ValueError) as error:
        raise UserError(f"{address}: the address could not be opened ({error}); check its protocol, such as s3:// or sftp://") from None
    return found
