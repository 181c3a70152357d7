"""Folders that commands make.

Held against others from the start, built inside, put in place at the end, recovered after a kill.

A folder that is being made may hold, beside what people see,

    .rhizotwin-lock    who works in it (`scenes.lock`)
    .rhizotwin-new     what `new_folder` is building
    .rhizotwin-whole   the same when it is whole and on the disk; the files that it replaces are being removed
    .rhizotwin-moving  the same when they are removed; its files are being moved into the folder

Everything lies inside the goal, so that a mount point, a linked folder and the current folder can be goals, and a place
that cannot be written is told before the work. A kill at any moment leaves the old files or all of the new ones;
whoever opens the folder next finishes the move (`tidy`). What others put into the folder meanwhile stays.
"""

import json
import logging
import os
import re
import shutil
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from rhizotwin.scenes.atomic import TEMPORARY, explained, is_full, sync_folder, write_json
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import locked

LOCK, NEW, WHOLE, MOVING = ".rhizotwin-lock", ".rhizotwin-new", ".rhizotwin-whole", ".rhizotwin-moving"
_REPLACED = ".rhizotwin-replaced.json"
_HEADS = ("dataset.json", "result.json")
"""What a folder is known by goes first and comes last."""
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


@contextmanager
def held(folder: Path | str) -> Iterator[Path]:
    """Work in a folder alone; it is made where it is missing, and removed again if it stays empty.

    What a killed run left there is put in place or removed first, with a word.

    Yields
    ------
    Path
        The folder itself, where ``folder`` is a link to it.

    Raises
    ------
    UserError
        When another process works in it, it is a file, or it cannot be written.
    """
    goal = Path(os.path.realpath(folder))
    if goal.exists() and not goal.is_dir():
        raise UserError(f"{folder}: is a file, but a folder of this name is to be written; choose another name")
    new = not goal.exists()
    try:
        with ExitStack() as stack:
            try:
                if stack.enter_context(locked(goal / LOCK, what=str(folder))):
                    _clear(goal)
                _finish(goal)
            except OSError as error:
                raise explained(error, folder) from error
            yield goal
    finally:
        if new:
            with suppress(OSError):
                goal.rmdir()


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
    with held(goal) as folder:
        strange = [name for name in contents(folder) if name not in replaces]
        if strange:
            beside = f"holds {strange[0]}" if replaces else "exists already and is not empty"
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
        finally:
            shutil.rmtree(building, ignore_errors=True)


def tidy(folder: Path) -> None:
    """Finish what a killed run left half-way in a folder, before it is read.

    Raises
    ------
    UserError
        When another process is just moving its work into the folder, or it cannot be finished.
    """
    left = [name for name in (LOCK, NEW, WHOLE, MOVING) if os.path.lexists(folder / name)]
    if left:
        try:
            with held(folder):
                pass
        except UserError:
            if WHOLE in left or MOVING in left:
                raise


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
        logging.getLogger(__name__).warning("%s: %s was put there or changed meanwhile and stays", goal, path)
    write_json(building / _REPLACED, [str(path) for path in now if path not in theirs])
    for place in [building, *(path for path in building.rglob("*") if path.is_dir())]:
        sync_folder(place)
    building.rename(folder / WHOLE)
    sync_folder(folder)
    _finish(folder)


def _finish(folder: Path) -> None:
    """Go on from wherever a move stopped; each step may be done again."""
    whole, moving = folder / WHOLE, folder / MOVING
    if whole.is_dir():
        replaced = [Path(name) for name in json.loads((whole / _REPLACED).read_text(encoding="utf-8"))]
        for path in sorted(replaced, key=lambda path: path.name not in _HEADS):
            (folder / path).unlink(missing_ok=True)
        for place in sorted({parent for path in replaced for parent in path.parents}, key=lambda path: -len(path.parts)):
            if place.parts:
                with suppress(OSError):  # somebody's file is in it
                    (folder / place).rmdir()
        whole.rename(moving)
        sync_folder(folder)
    if moving.is_dir():
        for path in sorted(_files(moving), key=lambda path: (path.name in _HEADS, path)):
            target = folder / path
            if os.path.lexists(target):
                raise UserError(f"{target}: is in the way of the file of the same name in {moving}; move it away and run again")
            target.parent.mkdir(parents=True, exist_ok=True)
            (moving / path).rename(target)
        shutil.rmtree(moving)
        sync_folder(folder)


def _clear(folder: Path) -> None:
    """Remove what a killed run was building or writing."""
    shutil.rmtree(folder / NEW, ignore_errors=True)
    for path in [path for path in folder.rglob(".*.tmp") if re.fullmatch(TEMPORARY, path.name)]:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _files(folder: Path) -> dict[Path, Stamp]:
    """Return everything in a folder that is no folder, by relative path, with what changes when it is written anew."""
    found = {}
    for place, names, files in os.walk(folder):
        names[:] = [name for name in names if not _is_own(name) and name not in _SYSTEM]
        links = [name for name in names if os.path.islink(os.path.join(place, name))]  # noqa: PTH114, PTH118 - walk gives text
        for name in [*files, *links]:
            if not _is_own(name):
                path = Path(place, name)
                status = path.lstat()
                found[path.relative_to(folder)] = (status.st_ino, status.st_size, status.st_mtime_ns)
    return dict(sorted(found.items()))


def _is_own(name: str) -> bool:
    return name.startswith(".rhizotwin-") or re.fullmatch(TEMPORARY, name) is not None
