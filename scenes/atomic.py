"""Atomic writing of files.

A file is written under a temporary name in the same folder, flushed to the disk, and then renamed. If writing ends
before the rename, even by Ctrl-C, the temporary file is removed. A temporary file left by a killed process is removed
by the next process that writes a file of the same name.
"""

import errno
import json
import os
import re
import secrets
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import BYTES, NO_LINK, remove_open, try_lock

if TYPE_CHECKING:
    from numpy.typing import NDArray

TEMPORARY = r"\..+\.[0-9]+-[0-9a-f]{8}\.tmp"
"""Regular expression that matches the names returned by `temporary_path`."""


def write_bytes(path: Path | str, data: bytes, *, new: bool = False, follow: bool = True) -> None:
    """Write a file atomically.

    Missing parent folders are created. Devices and pipes are written to directly.

    Parameters
    ----------
    path : Path or str
        Path of the file; its folder is created if it is missing.
    data : bytes
        Complete content of the file.
    new : bool
        Raise an error instead of replacing an existing file, even if another process creates it at the same time.
    follow : bool
        Follow links, as for a path given by the user. If False, links, devices and pipes are replaced, as for files in
        a folder of unknown origin.

    Raises
    ------
    UserError
        If the disk is full or the path cannot be written. An existing file is left unchanged.
    """
    asked = Path(path)
    path = Path(os.path.realpath(asked)) if follow else Path(os.path.realpath(asked.parent), asked.name)
    try:
        if follow and path.exists() and not path.is_file() and not path.is_dir():
            if new:
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
            path.write_bytes(data)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left(path)
        temporary, descriptor = _open_beside(path)
        try:
            with open(descriptor, "wb") as stream:  # noqa: PTH123 - opens a descriptor
                stream.write(data)
                stream.flush()
                os.fsync(descriptor)
                if sys.platform != "win32":
                    _rename_file(temporary, path, new=new)
            if sys.platform == "win32":  # Windows cannot rename open files
                _rename_file(temporary, path, new=new)
            sync_folder(path.parent)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
    except OSError as error:
        if new and isinstance(error, FileExistsError) and os.path.lexists(path):
            raise UserError(f"{asked} already exists; choose another name") from error
        raise write_error(error, asked) from error


def write_text(path: Path | str, text: str, *, new: bool = False) -> None:
    """Write a UTF-8 text file atomically; see `write_bytes`.

    Parameters
    ----------
    path : Path or str
        Path of the file; its folder is created if it is missing.
    text : str
        Complete content of the file.
    new : bool
        Raise an error if the file exists.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"), new=new)  # file names may not be valid UTF-8


def write_json(path: Path | str, value: Any) -> None:
    """Write a JSON file atomically; see `write_bytes`. Floats are preserved exactly.

    Raises
    ------
    ValueError
        If the value contains NaN or infinity, which JSON does not support.
    TypeError
        If the value contains an object that JSON does not support.
    """
    write_bytes(path, json_bytes(value))


def json_bytes(value: Any) -> bytes:
    """Encode a value in the same way as `write_json`, and return the bytes."""
    try:
        return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()
    except UnicodeEncodeError:  # a path that is not UTF-8 is escaped, and reads back unchanged
        return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()


def write_image(path: Path | str, image: "NDArray[Any]", *, jpeg_quality: int | None = None) -> None:
    """Write a picture atomically; see `write_bytes`.

    The format (PNG, JPEG or TIFF) is given by the suffix of the file name.

    Parameters
    ----------
    path : path
        Path of the file.
    image : array
        Grey (H, W) or RGB (H, W, 3) picture, uint8 or uint16.
    jpeg_quality : int or None
        Quality of a JPG file from 1 to 100; None for the default of OpenCV (95).
    """
    import cv2  # imported here: loading takes half a second, and most commands write no picture
    import numpy as np

    path = Path(path)
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"{image.shape=} {image.dtype=} but a uint8 or uint16 array of shape (H, W) or (H, W, 3) is required")
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    settings = [] if jpeg_quality is None else [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    encoded, data = cv2.imencode(path.suffix or ".png", np.ascontiguousarray(ordered), settings)
    if not encoded:
        raise ValueError(f"OpenCV cannot encode {image.shape=} {image.dtype=} as {path.suffix!r}")
    write_bytes(path, data.tobytes())


def temporary_path(path: Path) -> Path:
    """Return an unused hidden path in the same folder, whose name matches `TEMPORARY`."""
    return path.with_name(f".{path.name[:100]}.{os.getpid()}-{secrets.token_hex(4)}.tmp")


def sync_folder(folder: Path) -> None:
    """Flush a rename to the disk, if the operating system supports this.

    Windows does not, because it cannot open folders.
    """
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network file systems
            raise
    finally:
        os.close(descriptor)


def is_full(error: OSError) -> bool:
    """Return whether an error indicates that the disk is full."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def write_error(error: OSError, path: Path | str) -> UserError:
    """Convert an error that occurred when a file was written to a `UserError` with an explanation."""
    if is_full(error):
        return UserError(f"{path}: the disk is full, and nothing was written under this name; free some space and run the command again")
    reason = error.strerror or str(error)
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return UserError(
            f"{path}: not written, because too many files and connections are open ({reason}); "
            "close some, or raise the limit (ulimit -n), and run the command again"
        )
    return UserError(f"{path}: this path cannot be written ({reason}); choose a folder with write permission")


def _open_beside(path: Path) -> tuple[Path, int]:
    """Create a locked temporary file beside a path, and return its path and descriptor.

    Because of the lock, other processes recognise the file as in use.
    """
    while True:
        temporary = temporary_path(path)
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | BYTES, 0o666)
        if try_lock(descriptor) is not False and os.fstat(descriptor).st_nlink:
            return temporary, descriptor
        os.close(descriptor)  # another process removed it as abandoned before it was locked


def _remove_left(path: Path) -> None:
    """Remove temporary files left by processes that were killed. These files are not locked."""
    begin = f".{path.name[:100]}."
    for name in os.listdir(path.parent):  # noqa: PTH208 - names are enough
        if name.startswith(begin) and re.fullmatch(TEMPORARY, name):
            with suppress(OSError):
                descriptor = os.open(path.parent / name, os.O_WRONLY | NO_LINK)
                if try_lock(descriptor):
                    remove_open(path.parent / name, descriptor)
                else:
                    os.close(descriptor)


def _rename_file(temporary: Path, path: Path, *, new: bool) -> None:
    """Rename a file to its final name. If ``new`` is true, raise an error if the name is already in use."""
    if new:
        _link(temporary, path)
    else:
        temporary.replace(path)


def _link(temporary: Path, path: Path) -> None:
    """Give a file its final name, or raise an error if the name is already in use."""
    try:
        path.hardlink_to(temporary)
    except FileExistsError:
        raise
    except OSError:  # file system without hard links
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        temporary.replace(path)
