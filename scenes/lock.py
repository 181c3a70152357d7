"""Lock files that state which process uses a folder. The lock itself is managed by the operating system.

The lock of a killed process is released, even if its lock file remains.
"""

import errno
import json
import logging
import os
import socket
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

MOST_TRIES = 100
"""Maximum number of attempts to acquire a lock. An attempt fails if another process acquires or releases the lock at
the same time."""
MOST_LETTERS = 64
"""Maximum length of each word that is read from a lock file, in characters. Computer names have at most 64 characters
on Linux."""
BYTES = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Flags with which files are opened as bytes, and are not inherited by other processes. Without them, Windows converts
line ends."""
NO_WAIT = getattr(os, "O_NONBLOCK", 0) | BYTES
"""Flags with which files are opened without waiting. A pipe would otherwise block."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | NO_WAIT
"""Flags with which files in a folder of unknown origin are opened. Links are not followed."""
_WINDOWS_LOCK_AT = 2**30
"""Offset of the locked byte in a lock file. It is far beyond the content, because Windows also prevents reading of
locked bytes."""
_NO_LOCK = "{path}: the entry is not a lock file of this program, because it is {kind}; remove it and run the command again"
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}


@contextmanager
def lock_file(path: Path, *, what: str) -> Iterator[bool]:
    """Hold a lock file in a ``with`` statement, and remove it at the end. Its folder is created if it is missing.

    Parameters
    ----------
    path : path
        Path of the lock file, which contains process, computer and time as JSON.
    what : str
        Name of the locked object, used in messages.

    Yields
    ------
    bool
        Whether the lock file was left by a killed run. In this case it is reused with a warning.

    Raises
    ------
    UserError
        If another process holds the lock (the message states process and computer), or the file is a symbolic link, has
        several names (hard links), or is not a regular file.
    OSError
        If the file cannot be created.
    """
    descriptor, left = _acquire(path, what)
    try:
        if left is not None:
            logging.getLogger(__name__).warning(
                "%s: %s was stopped before it released its lock; this run takes over the lock", printable(what), _holder(left)
            )
        said = {"pid": os.getpid(), "host": socket.gethostname(), "since": datetime.now(UTC).isoformat(timespec="seconds")}
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, json.dumps(said).encode())
        yield left is not None
    finally:
        remove_open(path, descriptor)


def try_lock(descriptor: int) -> bool | None:
    """Lock an open file without waiting.

    The result is False if another process has locked the file, and None if the file system does not support locks.
    """
    if sys.platform == "win32":
        os.lseek(descriptor, _WINDOWS_LOCK_AT, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            os.lseek(descriptor, 0, os.SEEK_SET)
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return None
        raise
    return True


def remove_open(path: Path, descriptor: int) -> None:
    """Remove a file and close it. On Windows it is closed first, because open files cannot be removed."""
    if sys.platform == "win32":
        os.close(descriptor)
    with suppress(OSError):
        path.unlink()
    if sys.platform != "win32":
        os.close(descriptor)


def _acquire(path: Path, what: str) -> tuple[int, bytes | None]:
    """Lock a file, and return its descriptor and the content left by a previous process.

    The content is None if the file is new.
    """
    for _ in range(MOST_TRIES):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            descriptor, new = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | BYTES, 0o644), True
        except FileExistsError:
            try:
                descriptor, new = os.open(path, os.O_RDWR | NO_LINK), False
            except FileNotFoundError:  # released by the process that held it
                continue
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                    raise UserError(_NO_LOCK.format(path=path, kind="a link, a folder or a device")) from None
                raise
        except FileNotFoundError:  # the folder was removed
            continue
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise UserError(_NO_LOCK.format(path=path, kind="a pipe or a device"))
            if status.st_nlink > 1:
                raise UserError(_NO_LOCK.format(path=path, kind="a file that has several names (hard links)"))
            free = try_lock(descriptor)
            os.lseek(descriptor, 0, os.SEEK_SET)
            said = os.read(descriptor, 4096)
            if free is None:
                free = new or _is_over(said)
            if not free:
                raise UserError(
                    f"{what}: {_holder(said)} is using it; wait until this process has ended, or choose another path (see {path.name})"
                )
            if os.fstat(descriptor).st_nlink:
                return descriptor, None if new else said
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # released and removed between opening and locking
    raise UserError(f"{what}: other processes lock it repeatedly; try again")


def _words(said: bytes) -> dict[str, Any]:
    try:
        words = json.loads(said)
    except (ValueError, RecursionError):
        return {}
    return words if isinstance(words, dict) else {}


def _holder(said: bytes) -> str:
    words = _words(said)
    if not {"pid", "host", "since"} <= words.keys():
        return "another process"
    pid, host, since = (printable(str(words[key]))[:MOST_LETTERS] for key in ("pid", "host", "since"))
    return f"process {pid} on {host} (since {since})"


def _is_over(said: bytes) -> bool:
    """Return whether the process recorded in a lock file has ended.

    This is only needed if the file system has no locks.
    """
    words = _words(said)
    if words.get("host") != socket.gethostname() or not isinstance(words.get("pid"), int) or sys.platform == "win32":
        return False
    try:
        os.kill(words["pid"], 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
