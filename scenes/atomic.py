"""Files that appear whole or not at all: a temporary name beside the goal, flushed to the disk, then renamed.

On any exit before the rename, Ctrl-C included, the temporary file is removed; what a kill left is removed by the next
writer of the name.
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
"""What the names of `beside` look like."""


def write_bytes(path: Path | str, data: bytes, *, new: bool = False, follow: bool = True) -> None:
    """Write a file atomically.

    Missing parent folders are made, a device or pipe is written to as it is.

    Parameters
    ----------
    path : Path or str
        The file; its folder is made where it is missing.
    data : bytes
        Its whole content.
    new : bool
        Refuse to replace a file, also one that appears at this very moment.
    follow : bool
        Follow a link, as for a name that a person gives; else it is replaced, as for a name in a folder that may come
        from anybody, and so is a device or pipe.

    Raises
    ------
    UserError
        When the disk is full or the place cannot be written; a file that was there before is left as it was.
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
            with open(descriptor, "wb") as stream:  # noqa: PTH123 - of a descriptor
                stream.write(data)
                stream.flush()
                os.fsync(descriptor)
                if sys.platform != "win32":
                    _put(temporary, path, new=new)
            if sys.platform == "win32":  # which renames no open file
                _put(temporary, path, new=new)
            sync_folder(path.parent)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
    except OSError as error:
        if new and isinstance(error, FileExistsError) and os.path.lexists(path):
            raise UserError(f"{asked}: already exists; choose another name") from error
        raise explained(error, asked) from error


def write_text(path: Path | str, text: str, *, new: bool = False) -> None:
    """Write a UTF-8 text file atomically; see `write_bytes`.

    Parameters
    ----------
    path : Path or str
        The file; its folder is made where it is missing.
    text : str
        Its whole content.
    new : bool
        Refuse to replace a file that is there.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"), new=new)  # names of files may be no UTF-8


def write_json(path: Path | str, value: Any) -> None:
    """Write a JSON file atomically; floats survive exactly; see `write_bytes`.

    Raises
    ------
    ValueError
        When the value holds NaN or infinity, which JSON does not have.
    TypeError
        When the value holds something that is not JSON.
    """
    write_bytes(path, json_bytes(value))


def json_bytes(value: Any) -> bytes:
    """Return what `write_json` writes."""
    try:
        return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()
    except UnicodeEncodeError:  # a path that is no UTF-8: escaped, it reads back as it was
        return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()


def write_image(path: Path | str, image: "NDArray[Any]", *, jpeg_quality: int | None = None) -> None:
    """Write a picture atomically; the name's suffix gives the format (PNG, JPG, TIFF); see `write_bytes`.

    Parameters
    ----------
    path : path
        Where to.
    image : array
        uint8 or uint16 array (H, W) grey or (H, W, 3) RGB.
    jpeg_quality : int or None
        From 1 to 100, for JPG; None: OpenCV's own (95).
    """
    import cv2  # here, because it takes half a second to load and much of the command line writes no picture
    import numpy as np

    path = Path(path)
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"{image.shape=} {image.dtype=} but expected uint8 or uint16 (H, W) or (H, W, 3)")
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    settings = [] if jpeg_quality is None else [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    encoded, data = cv2.imencode(path.suffix or ".png", np.ascontiguousarray(ordered), settings)
    if not encoded:
        raise ValueError(f"OpenCV cannot encode {image.shape=} {image.dtype=} as {path.suffix!r}")
    write_bytes(path, data.tobytes())


def beside(path: Path) -> Path:
    """Return a hidden name in the same folder that nobody else uses; it matches `TEMPORARY`."""
    return path.with_name(f".{path.name[:100]}.{os.getpid()}-{secrets.token_hex(4)}.tmp")


def sync_folder(folder: Path) -> None:
    """Flush a rename to the disk, where the system can (Windows cannot open folders)."""
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
    """Tell whether nothing more fits on the disk."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def explained(error: OSError, path: Path | str) -> UserError:
    """Turn a failed write into one sentence."""
    if is_full(error):
        return UserError(f"{path}: the disk is full; nothing was written under this name; free some space and run again")
    reason = error.strerror or str(error)
    return UserError(f"{path}: cannot be written ({reason}); choose a place where you may write")


def _open_beside(path: Path) -> tuple[Path, int]:
    """Open a new file beside a path, locked, so that others see that it is in use."""
    while True:
        temporary = beside(path)
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | BYTES, 0o666)
        if try_lock(descriptor) is not False and os.fstat(descriptor).st_nlink:
            return temporary, descriptor
        os.close(descriptor)  # another writer took it for one that was left, before it was locked


def _remove_left(path: Path) -> None:
    """Remove what killed writers of a file left beside it: what nobody holds the lock of."""
    begin = f".{path.name[:100]}."
    for name in os.listdir(path.parent):  # noqa: PTH208 - names are enough
        if name.startswith(begin) and re.fullmatch(TEMPORARY, name):
            with suppress(OSError):
                descriptor = os.open(path.parent / name, os.O_WRONLY | NO_LINK)
                if try_lock(descriptor):
                    remove_open(path.parent / name, descriptor)
                else:
                    os.close(descriptor)


def _put(temporary: Path, path: Path, *, new: bool) -> None:
    """Give a file its name; ``new``: unless that is taken."""
    if new:
        _link(temporary, path)
    else:
        temporary.replace(path)


def _link(temporary: Path, path: Path) -> None:
    """Give a file its name unless that is taken."""
    try:
        path.hardlink_to(temporary)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        temporary.replace(path)
