"""Folders that commands make.

Held against others from the start, built inside, put in place at the end, recovered after a kill.

A folder that is being made may hold, beside what people see,

    .rhizotwin-lock   who works in it (`scenes.lock`)
    .rhizotwin-new    what `new_folder` is building
    .rhizotwin-old    what it replaces, while that is moved away
    .rhizotwin-whole  `.rhizotwin-new` under the name that it gets when nothing but moving its files is left to do

Everything lies inside the goal, so that a mount point, a linked folder and the current folder can be goals, and a place
that cannot be written is reported before the work. The names of the marks are all that is known of a killed run: where
there is a `.rhizotwin-whole`, its files are moved into the folder, else those of `.rhizotwin-old` are moved back, and
the rest is removed (`_settle`). A folder may come from anybody: only a command that writes a folder recovers it,
nothing in a mark is parsed, no link is followed, and nothing is moved or removed but what lies in the marks. `HEADS`
leave first and come last, so that who only reads knows by them that all files are there (`check_readable`).
"""

import errno
import logging
import os
import re
import shutil
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from rhizotwin.scenes.atomic import TEMPORARY, explained, is_full, sync_folder
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import locked
from rhizotwin.scenes.said import printable

LOCK, NEW, OLD, WHOLE = ".rhizotwin-lock", ".rhizotwin-new", ".rhizotwin-old", ".rhizotwin-whole"
HEADS = ("dataset.json", "result.json")
"""What a folder is known by."""
LEAST_FREE_MIB = 1
"""No dataset or result is smaller: a full disk is reported before the work, not when its first file is written."""
_OWN = ".rhizotwin-"
_SYSTEM = ("lost+found", "System Volume Information")
"""What an empty disk holds."""

Stamp = tuple[int, int, int]


def contents(folder: Path) -> list[str]:
    """Return the sorted names in a folder that are neither this program's own marks nor the system's.

    None where there is no folder.
    """
    if not folder.is_dir():
        return []
    return sorted(name for name in os.listdir(folder) if not _is_own(name) and name not in _SYSTEM)  # noqa: PTH208 - names are enough


def check_readable(folder: Path, *, deep: bool = True) -> None:
    """Refuse to read a folder whose files are not all in place, or (``deep``) lie elsewhere.

    Nothing is written, locked or recovered.

    Raises
    ------
    UserError
        When a run was killed while it moved its files into the folder, or the folder holds links, pipes or devices.
    """
    marks = [name for name in (OLD, WHOLE) if os.path.lexists(folder / name)]
    if marks and not any((folder / head).is_file() for head in HEADS):
        raise UserError(
            f"{folder}: holds {marks[0]}, so that the run that wrote it was stopped while it put its files in place; "
            "run that command again (rhizotwin reconstruct, edit or import), which brings them back"
        )
    if deep:
        refuse_links(folder)


def refuse_links(folder: Path) -> None:
    """Refuse a dataset or result through which something else would be read or written.

    Raises
    ------
    UserError
        When a link, pipe or device lies in it, or folders are nested deeper than the system can name.
    """
    try:
        for entry in _entries(folder):
            if entry.is_symlink():
                raise UserError(f"{entry.path}: is a link, and what it leads to is left alone; put the file or folder itself in its place")
            if not entry.is_dir() and not entry.is_file():
                raise UserError(f"{entry.path}: is no file but a pipe or device; remove it")
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror}); check your rights to it and what it holds") from error


@contextmanager
def held(folder: Path | str) -> Iterator[Path]:
    """Work in a folder alone; it is made where it is missing, and removed again if it stays empty.

    What a killed run left there is put in place, put back or removed first.

    Yields
    ------
    Path
        The folder itself, where ``folder`` is a link to it.

    Raises
    ------
    UserError
        When another process works in it, it is a file, it holds links, or it cannot be written.
    """
    with _held(folder) as (goal, _):
        refuse_links(goal)
        yield goal


@contextmanager
def new_folder(goal: Path | str, *, replaces: Collection[str] = ()) -> Iterator[Path]:
    """Build a folder that appears whole or not at all.

    Parameters
    ----------
    goal : path
        New, empty, or with nothing in it but what may be replaced.
    replaces : collection of str
        Names that the goal may hold and that are replaced. What is there stays until the new is whole; what was not
        there at the start, or is changed meanwhile, stays for good.

    Yields
    ------
    Path
        The folder inside the goal to write into.

    Raises
    ------
    UserError
        When the goal holds anything else, another process works in it, the disk is full, or the place cannot be
        written; when something that others put there meanwhile has the name of something new, which is then kept under
        another name.
    """
    with _held(goal) as (folder, finished):
        strange = [name for name in contents(folder) if name not in replaces]
        if strange and finished:
            raise UserError(f"{goal}: is whole, although the run that made it was stopped; use it, or choose another name for another one")
        if strange:
            beside = f"holds {strange[0]}" if replaces else "already exists and is not empty"
            raise UserError(f"{goal}: {beside}; choose another name or remove it")
        before = _files(folder)
        building = folder / NEW
        try:
            building.mkdir()
            try:
                yield building
            except UserError as error:  # named as it would be in the end
                raise UserError(str(error).replace(str(building), str(goal))) from error
            except OSError as error:
                if is_full(error) or str(building) in str(error.filename):
                    raise explained(error, goal) from error
                raise
            try:
                _put_in_place(folder, before, goal=str(goal))
            except OSError as error:
                raise explained(error, goal) from error
        except BaseException as error:
            if not (isinstance(error, KeyboardInterrupt) and (folder / WHOLE).is_dir()):
                with suppress(OSError, UserError):  # the next run does it
                    _settle(folder)
                raise
            _settle(folder)  # too late to stop


def recover(folder: Path) -> None:
    """Put in place, put back or remove what a killed run left in a folder that is to be written.

    Raises
    ------
    UserError
        When another process works in it, or it cannot be done.
    """
    if any(os.path.lexists(folder / name) for name in (LOCK, NEW, OLD, WHOLE)):
        with _held(folder):
            pass


@contextmanager
def _held(folder: Path | str) -> Iterator[tuple[Path, bool]]:
    """Do what `held` says; also yield whether a killed run had finished what it made."""
    goal = Path(os.path.realpath(folder))
    if os.path.lexists(goal) and not goal.is_dir():
        raise UserError(f"{folder}: is a file, but a folder of this name is to be written; choose another name")
    new = not goal.exists()
    try:
        with ExitStack() as stack:
            try:
                left = stack.enter_context(locked(goal / LOCK, what=str(folder)))
                if left:
                    _clear(goal)
                finished = _settle(goal) or (left and not set(HEADS).isdisjoint(contents(goal)))
                room = shutil.disk_usage(goal)
                if room.total and room.free < LEAST_FREE_MIB * 2**20:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError as error:
                raise explained(error, folder) from error
            except RecursionError:
                raise UserError(
                    f"{folder}: a killed run left folders that are nested too deep to be removed; remove them yourself"
                ) from None
            yield goal, finished
    finally:
        if new:
            with suppress(OSError):
                goal.rmdir()


def _put_in_place(folder: Path, before: dict[Path, Stamp], *, goal: str) -> None:
    """Replace what was there before by what was built, unless others changed it meanwhile."""
    building, now = folder / NEW, _files(folder)
    made = list(_files(building))
    theirs = [path for path in now if before.get(path) != now[path]]
    in_the_way = [path for path in theirs if any(path == one or path in one.parents or one in path.parents for one in made)]
    if in_the_way:
        number = next(k for k in range(1, 1000) if not os.path.lexists(folder / f"made-{k}"))
        building.rename(folder / f"made-{number}")
        raise UserError(
            f"{goal}: {in_the_way[0]} was put there or changed while the work went on, and is left as it is; what was made is in "
            f"{goal}/made-{number}"
        )
    for path in theirs:
        logging.getLogger(__name__).warning("%s: %s was put there or changed meanwhile and stays", printable(goal), printable(str(path)))
    replaced = [path for path in now if path not in theirs]
    if replaced:
        (folder / OLD).mkdir()
    for path in sorted(replaced, key=lambda path: path.name not in HEADS):
        _move(path, folder, folder / OLD)
    for place in sorted({parent for path in replaced for parent in path.parents}, key=lambda path: -len(path.parts)):
        if place.parts:
            with suppress(OSError):  # somebody's file is in it
                (folder / place).rmdir()
    for place in [building, *(path for path in building.rglob("*") if path.is_dir()), folder]:
        sync_folder(place)
    building.rename(folder / WHOLE)
    sync_folder(folder)
    _settle(folder)


def _settle(folder: Path) -> bool:
    """Go on from wherever a run stopped, forwards or back; return whether what it made is in place now.

    Each step may be done again.
    """
    marks = [folder / name for name in (OLD, NEW, WHOLE) if os.path.lexists(folder / name)]
    for mark in marks:
        if mark.is_symlink() or not mark.is_dir():
            raise UserError(f"{mark}: is no folder that this program made; remove it and run again")
    whole = folder / WHOLE in marks
    moved = folder / (WHOLE if whole else OLD)
    if moved in marks:
        for path in sorted(_files(moved), key=lambda path: (path.name in HEADS, path)):
            _move(path, moved, folder)
        sync_folder(folder)
    for mark in marks:  # that which says what to do is the last
        shutil.rmtree(mark)
    if marks:
        sync_folder(folder)
    return whole


def _move(path: Path, source: Path, goal: Path) -> None:
    """Move a file or link from a folder to the same place in another one, through no link and over nothing.

    Raises
    ------
    UserError
        When something is in the way.
    """
    place = goal
    for name in path.parts[:-1]:
        place /= name
        if place.is_symlink() or not place.is_dir():
            if os.path.lexists(place):
                raise UserError(f"{place}: is in the way of the folder of the same name in {source}; move it away and run again")
            place.mkdir()
    if os.path.lexists(goal / path):
        raise UserError(f"{goal / path}: is in the way of the file of the same name in {source}; move it away and run again")
    (source / path).rename(goal / path)


def _clear(folder: Path) -> None:
    """Remove the temporary files that a killed run was writing."""
    for entry in [entry for entry in _entries(folder) if re.fullmatch(TEMPORARY, entry.name)]:
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.path, ignore_errors=True)
        else:
            Path(entry.path).unlink(missing_ok=True)


def _files(folder: Path) -> dict[Path, Stamp]:
    """Return everything in a folder that is no folder, by relative path, with what changes when it is written anew."""
    found = {}
    for entry in _entries(folder):
        if not entry.is_dir(follow_symlinks=False) and not _is_own(entry.name):
            status = entry.stat(follow_symlinks=False)
            found[Path(entry.path).relative_to(folder)] = (status.st_ino, status.st_size, status.st_mtime_ns)
    return dict(sorted(found.items()))


def _entries(folder: Path) -> Iterator["os.DirEntry[str]"]:
    """Return what lies in a folder, at any depth, this program's own marks and the system's folders left out.

    Links are not followed.
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
