"""Files and folders that appear whole or not at all: a temporary name beside the goal, flushed to the disk, then renamed.

On any exit before the rename, Ctrl-C included, the temporary file or folder is removed.
"""

import errno
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError

_FULL_DISK = {errno.ENOSPC, errno.EDQUOT}


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file atomically; missing parent folders are made.

    Raises
    ------
    UserError
        When the disk is full or the place cannot be written; a file that was there before is left as it was.
    """
    path = Path(path)
    temporary = beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise _explained(error, path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Write a UTF-8 text file atomically; see `write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path | str, value: Any) -> None:
    """Write a JSON file atomically; floats survive exactly; see `write_bytes`.

    Raises
    ------
    ValueError
        When the value holds NaN or infinity, which JSON does not have.
    TypeError
        When the value holds something that is not JSON.
    """
    write_text(path, json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def write_image(path: Path | str, image: NDArray[Any], *, jpeg_quality: int | None = None) -> None:
    """Write a picture atomically; the name's suffix gives the format (PNG, JPG, TIFF); see `write_bytes`.

    Parameters
    ----------
    path
        Where to.
    image
        uint8 or uint16 array (H, W) grey or (H, W, 3) RGB.
    jpeg_quality
        From 1 to 100, for JPG; None: OpenCV's own (95).
    """
    path = Path(path)
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"{image.shape=} {image.dtype=} but expected uint8 or uint16 (H, W) or (H, W, 3)")
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    settings = [] if jpeg_quality is None else [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    encoded, data = cv2.imencode(path.suffix or ".png", np.ascontiguousarray(ordered), settings)
    if not encoded:
        raise ValueError(f"OpenCV cannot encode {image.shape=} {image.dtype=} as {path.suffix!r}")
    write_bytes(path, data.tobytes())


@contextmanager
def new_folder(path: Path | str, *, replace: bool = False) -> Iterator[Path]:
    """Build a folder beside its goal and rename it into place when the block ends well; remove it when it does not.

    Parameters
    ----------
    path
        The goal. An empty folder there is replaced.
    replace
        Whether a folder that is there with something in it is replaced; it stays as it was until the new one is whole.

    Yields
    ------
    Path
        The temporary folder to write into.

    Raises
    ------
    UserError
        When something is at the goal already, the disk is full, or the place cannot be written.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise UserError(f"{path}: is a file, but a folder of this name is to be written; choose another name")
    if path.is_dir() and any(path.iterdir()) and not replace:
        raise UserError(f"{path}: exists already and is not empty; choose another name or remove it")
    path = path.absolute()
    temporary, old = beside(path), beside(path)
    try:
        try:
            temporary.mkdir(parents=True)
        except OSError as error:
            raise _explained(error, path) from error
        yield temporary
        _sync_folder(temporary)
        if path.is_dir():
            path.rename(old)
        temporary.rename(path)
        _sync_folder(path.parent)
    except UserError as error:  # named as it would be in the end
        raise UserError(str(error).replace(str(temporary), str(path))) from error
    except OSError as error:
        if error.errno in _FULL_DISK or str(temporary) in str(error.filename):
            raise _explained(error, path) from error
        raise
    finally:
        if old.is_dir() and not path.exists():
            old.rename(path)
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def beside(path: Path) -> Path:
    """Return a hidden name in the same folder that nobody else uses."""
    return path.with_name(f".{path.name[:100]}.{os.getpid()}-{secrets.token_hex(4)}.tmp")


def _sync_folder(folder: Path) -> None:
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


def _explained(error: OSError, path: Path) -> UserError:
    """Turn a failed write into one sentence."""
    if error.errno in _FULL_DISK:
        return UserError(f"{path}: the disk is full; nothing was written under this name; free some space and run again")
    reason = error.strerror or str(error)
    return UserError(f"{path}: cannot be written ({reason}); choose a place where you may write")
