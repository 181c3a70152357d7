"""Output folders of commands, which are locked during a run, built inside the target, and recovered after a kill.

While a folder is being written, it may contain, in addition to visible files,

.rhizotwin-lock   process that holds the folder (`scenes.lock`)
.rhizotwin-new    new content, while `new_folder` builds it
.rhizotwin-old    replaced content, while it is moved away
.rhizotwin-whole  `.rhizotwin-new`, renamed when nothing remains but to move its files

All of these marks are inside the target. Thus a mount point, a linked folder or the current folder can be the target,
and a target without write permission is reported before the work starts. Recovery after a kill depends only on the
names of the marks. If there is a `.rhizotwin-whole`, its files are moved into the folder. Otherwise the files of
`.rhizotwin-old` are moved back. All remaining marks are removed (`_settle`). Since folders may be of unknown origin,
they are recovered only by a command that writes them, marks are not parsed, links are not followed, and only the
contents of marks are moved or removed. The files in `HEADS` are removed first and added last, so that their presence
implies that all files are present (`check_readable`).
"""

import errno
import logging
import os
import re
import shutil
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from rhizotwin.scenes.atomic import TEMPORARY, is_full, sync_folder, write_error
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.lock import lock_file

LOCK, NEW, OLD, WHOLE = ".rhizotwin-lock", ".rhizotwin-new", ".rhizotwin-old", ".rhizotwin-whole"
HEADS = ("dataset.json", "result.json")
"""Names of the files that identify a folder as a dataset or result."""
LEAST_FREE_MIB = 1
"""Minimum free disk space, MiB. Every dataset and every result is larger. Thus a full disk is reported before the work
starts."""
_OWN = ".rhizotwin-"
_SYSTEM = ("lost+found", "System Volume Information")
"""Names of the folders that the operating system creates on an empty disk."""

Stamp = tuple[int, int, int]


def contents(folder: Path) -> list[str]:
    """Return the sorted names in a folder, without names that this program or the operating system uses internally.

    The list is empty if the folder does not exist.
    """
    if not folder.is_dir():
        return []
    return sorted(name for name in os.listdir(folder) if not _is_own(name) and name not in _SYSTEM)  # noqa: PTH208 - names are enough


def check_readable(folder: Path, *, deep: bool = True) -> None:
    """Raise an error if files of a folder are missing. With ``deep``, also raise an error if it contains links.

    The function does not write, lock or recover the folder.

    Raises
    ------
    UserError
        If a run was killed while it moved its files into the folder, or if the folder contains links, pipes or devices.
    """
    marks = [name for name in (OLD, WHOLE) if os.path.lexists(folder / name)]
    if marks and not any((folder / head).is_file() for head in HEADS):
        raise UserError(
            f"{folder}: the folder contains {marks[0]}, because the run that wrote it was stopped while it moved its files into place; "
            "run the same command again (rhizotwin reconstruct, edit or import) to recover the files"
        )
    if deep:
        refuse_links(folder)


def refuse_links(folder: Path) -> None:
    """Raise an error if a dataset or result contains links, through which other files could be read or written.

    Raises
    ------
    UserError
        If the folder contains a link, pipe or device, or if folders are nested too deeply for the system.
    """
    try:
        for entry in _entries(folder):
            if entry.is_symlink():
                raise UserError(f"{entry.path}: the entry is a link, and links are not followed; replace it with the file or folder itself")
            if not entry.is_dir() and not entry.is_file():
                raise UserError(f"{entry.path}: the entry is a pipe or device; remove it")
    except OSError as error:
        raise UserError(f"{folder}: the folder cannot be read ({error.strerror}); check the permissions of its contents") from error


@contextmanager
def lock_folder(folder: Path | str) -> Iterator[Path]:
    """Lock a folder for exclusive use, and recover the files that a killed run has left.

    The folder is created if it is missing, and removed again if it remains empty. Files of a killed run are moved into
    place, moved back or removed.

    Yields
    ------
    Path
        Path of the folder or, if ``folder`` is a link, of its target.

    Raises
    ------
    UserError
        If the folder is being used by another process, is a file, contains links, or cannot be written.
    """
    with _lock_folder(folder) as (goal, _):
        refuse_links(goal)
        yield goal


@contextmanager
def new_folder(goal: Path | str, *, replaces: Collection[str] = ()) -> Iterator[Path]:
    """Build a folder atomically, so that it is either complete or unchanged.

    Parameters
    ----------
    goal : path
        Target folder, which must be new or empty, or contain only files in ``replaces``.
    replaces : collection of str
        Names of files in the target that are replaced. They remain until the new folder is complete. Files that are
        added or changed by other programs in the meantime are kept.

    Yields
    ------
    Path
        Folder inside the target, into which the caller writes.

    Raises
    ------
    UserError
        If the target contains other files, is being used by another process or cannot be written, or the disk is full.
        Also if another program has added a file with the same name as a new file, which is then kept under a different
        name.
    """
    with _lock_folder(goal) as (folder, finished):
        strange = [name for name in contents(folder) if name not in replaces]
        if strange and finished:
            raise UserError(f"{goal}: the output is complete, although the run that wrote it was stopped; use it, or choose another name")
        if strange:
            beside = f"the folder contains {strange[0]}" if replaces else "the folder already exists and is not empty"
            raise UserError(f"{goal}: {beside}; choose another name or remove it")
        before = _files(folder)
        building = folder / NEW
        try:
            building.mkdir()
            try:
                yield building
            except UserError as error:  # state the final name in the message
                raise UserError(str(error).replace(str(building), str(goal))) from error
            except OSError as error:
                if is_full(error) or str(building) in str(error.filename):
                    raise write_error(error, goal) from error
                raise
            try:
                _put_in_place(folder, before, goal=str(goal))
            except OSError as error:
                raise write_error(error, goal) from error
        except BaseException as error:
            if not (isinstance(error, KeyboardInterrupt) and (folder / WHOLE).is_dir()):
                with suppress(OSError, UserError):  # otherwise the next run does this
                    _settle(folder)
                raise
            _settle(folder)  # the output is already complete


def recover(folder: Path) -> None:
    """Recover a folder after a killed run. Its files are moved into place, moved back or removed.

    Raises
    ------
    UserError
        If the folder is being used by another process, or the recovery fails.
    """
    if any(os.path.lexists(folder / name) for name in (LOCK, NEW, OLD, WHOLE)):
        with _lock_folder(folder):
            pass


@contextmanager
def _lock_folder(folder: Path | str) -> Iterator[tuple[Path, bool]]:
    """Implement `lock_folder`. Also yield whether a killed run had completed its output."""
    goal = Path(os.path.realpath(folder))
    if os.path.lexists(goal) and not goal.is_dir():
        raise UserError(f"{folder}: the path is a file, but the output is a folder; choose another name")
    new = not goal.exists()
    try:
        with ExitStack() as stack:
            try:
                left = stack.enter_context(lock_file(goal / LOCK, what=str(folder)))
                if left:
                    _clear(goal)
                finished = _settle(goal) or (left and not set(HEADS).isdisjoint(contents(goal)))
                room = shutil.disk_usage(goal)
                if room.total and room.free < LEAST_FREE_MIB * 2**20:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError as error:
                raise write_error(error, folder) from error
            except RecursionError:
                raise UserError(
                    f"{folder}: a killed run left folders that are nested too deeply to be removed automatically; remove them manually"
                ) from None
            yield goal, finished
    finally:
        if new:
            with suppress(OSError):
                goal.rmdir()


def _put_in_place(folder: Path, before: dict[Path, Stamp], *, goal: str) -> None:
    """Replace the previous files by the new files. Files that other programs have changed in the meantime are kept."""
    building, now = folder / NEW, _files(folder)
    made = list(_files(building))
    theirs = [path for path in now if before.get(path) != now[path]]
    in_the_way = [path for path in theirs if any(path == one or path in one.parents or one in path.parents for one in made)]
    if in_the_way:
        number = next(k for k in range(1, 1000) if not os.path.lexists(folder / f"made-{k}"))
        building.rename(folder / f"made-{number}")
        raise UserError(
            f"{goal}: {in_the_way[0]} was added or changed by another program during the run, and is left unchanged; the output is in "
            f"{goal}/made-{number}"
        )
    for path in theirs:
        logging.getLogger(__name__).warning(
            "%s: %s was added or changed by another program during the run, and is kept", printable(goal), printable(str(path))
        )
    replaced = [path for path in now if path not in theirs]
    if replaced:
        (folder / OLD).mkdir()
    for path in sorted(replaced, key=lambda path: path.name not in HEADS):
        _move(path, folder, folder / OLD)
    for place in sorted({parent for path in replaced for parent in path.parents}, key=lambda path: -len(path.parts)):
        if place.parts:
            with suppress(OSError):  # the folder contains a file of another user
                (folder / place).rmdir()
    for place in [building, *(path for path in building.rglob("*") if path.is_dir()), folder]:
        sync_folder(place)
    building.rename(folder / WHOLE)
    sync_folder(folder)
    _settle(folder)


def _settle(folder: Path) -> bool:
    """Complete or revert an interrupted run, and return whether its output is now in place.

    The function can itself be interrupted and called again.
    """
    marks = [folder / name for name in (OLD, NEW, WHOLE) if os.path.lexists(folder / name)]
    for mark in marks:
        if mark.is_symlink() or not mark.is_dir():
            raise UserError(f"{mark}: the entry was not created by this program; remove it and run the command again")
    whole = folder / WHOLE in marks
    moved = folder / (WHOLE if whole else OLD)
    if moved in marks:
        for path in sorted(_files(moved), key=lambda path: (path.name in HEADS, path)):
            _move(path, moved, folder)
        sync_folder(folder)
    for mark in marks:  # the mark that determines the action is removed last
        shutil.rmtree(mark)
    if marks:
        sync_folder(folder)
    return whole


def _move(path: Path, source: Path, goal: Path) -> None:
    """Move a file or link to the same relative path in another folder.

    Links are not followed, and existing files are not replaced.

    Raises
    ------
    UserError
        If a file with the same name already exists there.
    """
    place = goal
    for name in path.parts[:-1]:
        place /= name
        if place.is_symlink() or not place.is_dir():
            if os.path.lexists(place):
                raise UserError(
                    f"{place}: the entry has the same name as a folder in {source}; move it to another place and run the command again"
                )
            place.mkdir()
    if os.path.lexists(goal / path):
        raise UserError(
            f"{goal / path}: the entry has the same name as a file in {source}; move it to another place and run the command again"
        )
    (source / path).rename(goal / path)


def _clear(folder: Path) -> None:
    """Remove the temporary files of a killed run."""
    for entry in [entry for entry in _entries(folder) if re.fullmatch(TEMPORARY, entry.name)]:
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.path, ignore_errors=True)
        else:
            Path(entry.path).unlink(missing_ok=True)


def _files(folder: Path) -> dict[Path, Stamp]:
    """Return the stamps of all files in a folder.

    The keys are relative paths, and a stamp changes when its file is written.
    """
    found = {}
    for entry in _entries(folder):
        if not entry.is_dir(follow_symlinks=False) and not _is_own(entry.name):
            status = entry.stat(follow_symlinks=False)
            found[Path(entry.path).relative_to(folder)] = (status.st_ino, status.st_size, status.st_mtime_ns)
    return dict(sorted(found.items()))


def _entries(folder: Path) -> Iterator["os.DirEntry[str]"]:
    """Yield the entries of a folder at any depth, without names that are used internally.

    Such names are used by this program or by the operating system. Links are yielded but not followed.
    """
    waiting = [str(folder)]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.name.startswith(_OWN) or entry.name in _SYSTEM:
                    continue
                yield entry
                if entry.is_dir(follow_symlinks=False) and not _is_own(entry.name):
                    waiting.append(entry.path)


def _is_own(name: str) -> bool:
    return name.startswith(_OWN) or re.fullmatch(TEMPORARY, name) is not None
