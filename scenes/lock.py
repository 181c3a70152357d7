"""A file that says who works here, locked by the kernel.

A run that was killed holds nothing, whatever its file still says.
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
from rhizotwin.scenes.said import printable

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

MOST_TRIES = 100
"""Each try ends by another process that takes or leaves the same lock at the same moment."""
MOST_LETTERS = 64
"""Of each of a holder's words; names of computers have at most 64 on Linux."""
BYTES = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Opens a file for its bytes as they are (Windows translates line ends otherwise) and for this program alone."""
NO_WAIT = getattr(os, "O_NONBLOCK", 0) | BYTES
"""Opens what may be a pipe, and waits for nobody."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | NO_WAIT
"""Opens a file in a folder that may come from anybody."""
_WINDOWS_LOCK_AT = 2**30
"""Windows locks bytes against reading, too: one far behind the words of the holder."""
_NO_LOCK = "{path}: is a link or no plain file, so that this program did not make it; remove it and run again"
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}


@contextmanager
def locked(path: Path, *, what: str) -> Iterator[bool]:
    """Hold a lock file; its folder is made where it is missing, and the file is removed at the end.

    Parameters
    ----------
    path : path
        Of the file; it gets process, computer and time as JSON.
    what : str
        What is locked, for messages.

    Yields
    ------
    bool
        Whether the file was left by a run that ended without tidying up; it is taken over with a word.

    Raises
    ------
    UserError
        When another process holds it; the message names process and computer. When it is a link or no plain file.
    OSError
        When the file cannot be made.
    """
    descriptor, left = _take(path, what)
    try:
        if left is not None:
            logging.getLogger(__name__).warning("%s: %s left it unfinished; taken over", printable(what), _holder(left))
        said = {"pid": os.getpid(), "host": socket.gethostname(), "since": datetime.now(UTC).isoformat(timespec="seconds")}
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, json.dumps(said).encode())
        yield left is not None
    finally:
        remove_open(path, descriptor)


def try_lock(descriptor: int) -> bool | None:
    """Lock an open file without waiting; False where another holds it, None where this file system has no locks."""
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
    """Remove a file and close it; Windows removes no open file, so that there it is closed first."""
    if sys.platform == "win32":
        os.close(descriptor)
    with suppress(OSError):
        path.unlink()
    if sys.platform != "win32":
        os.close(descriptor)


def _take(path: Path, what: str) -> tuple[int, bytes | None]:
    """Return the locked file, and what a run that is over had written into it; None where it is new."""
    for _ in range(MOST_TRIES):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            descriptor, new = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | BYTES, 0o644), True
        except FileExistsError:
            try:
                descriptor, new = os.open(path, os.O_RDWR | NO_LINK), False
            except FileNotFoundError:  # given back meanwhile
                continue
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                    raise UserError(_NO_LOCK.format(path=path)) from None
                raise
        except FileNotFoundError:  # its folder was removed meanwhile
            continue
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
                raise UserError(_NO_LOCK.format(path=path))
            free = try_lock(descriptor)
            os.lseek(descriptor, 0, os.SEEK_SET)
            said = os.read(descriptor, 4096)
            if free is None:
                free = new or _is_over(said)
            if not free:
                raise UserError(f"{what}: {_holder(said)} works in it; wait until that ends or choose another ({path.name} says so)")
            if os.fstat(descriptor).st_nlink:
                return descriptor, None if new else said
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # given back and removed between our opening and locking it
    raise UserError(f"{what}: is taken and given back by other processes all the time; try again")


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
    """Tell by a file's words whether its process is over, where the file system has no locks."""
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
