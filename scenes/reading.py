"""Files from anybody: regular ones only, whose size is looked at before they are read."""

import os
import stat
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import NO_WAIT

MOST_TEXT_MIB = 32
"""Of TOML, JSON, XML and tables: 20,000 pictures of a dataset or 300,000 points of roots. As Python's objects they take
up to 25 times as much (an empty list takes 3 bytes in a file, 64 in memory), which stays within 1 GiB."""
MOST_PICTURE_MIB = 1024
"""Of a picture: 20,000 pixels a side, the most that a camera may have, of two bytes take 763 MiB."""
MOST_MESH_MIB = 128
"""Of a mesh: 2.7 million triangles as binary STL."""


def read_file(path: Path | str, *, most_mib: int = MOST_TEXT_MIB) -> bytes:
    """Return the bytes of a file.

    Parameters
    ----------
    path : path
        A link is followed; whether a folder may hold one is checked for the whole folder
        (`scenes.folders.check_readable`).
    most_mib : int
        Larger files are refused.

    Raises
    ------
    UserError
        When there is none, it is no regular file, it is too large, or cannot be read.
    """
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | NO_WAIT)) as stream:
            check_size(path, os.fstat(stream.fileno()), most_mib=most_mib)
            return stream.read()
    except FileNotFoundError as error:
        raise UserError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise UserError(f"{path}: is a folder, but a file is needed") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def check_size(path: Path | str, status: os.stat_result, *, most_mib: int) -> None:
    """Refuse a file that is no regular one or too large.

    Parameters
    ----------
    path : path
        For messages.
    status : os.stat_result
        Of the file.
    most_mib : int
        Larger files are refused.
    """
    if not stat.S_ISREG(status.st_mode):
        raise UserError(f"{path}: is a pipe or device, but a regular file is needed; save what it holds as a file")
    if status.st_size > most_mib * 2**20:
        raise UserError(f"{path}: has {status.st_size / 2**20:.0f} MiB, more than the {most_mib} MiB that are read of such a file")
