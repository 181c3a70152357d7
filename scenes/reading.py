"""Reading of files of unknown origin. Only regular files whose size is below a limit are read."""

import os
import stat
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import NO_WAIT

MOST_TEXT_MIB = 32
"""Maximum size of TOML, JSON, XML and table files, MiB. It is sufficient for a dataset of 20,000 pictures, or for roots
with 300,000 points. Python objects require up to 25 times as much memory as the file (an empty list takes 3 bytes in
the file and 64 in memory), which is below 1 GiB."""
MOST_PICTURE_MIB = 1024
"""Maximum size of a picture file, MiB. A picture with the maximum side length of 20,000 pixels and two bytes per pixel
has 763 MiB."""
MOST_MESH_MIB = 128
"""Maximum size of a mesh file, MiB. It is sufficient for 2.7 million triangles in binary STL."""


def read_file(path: Path | str, *, most_mib: int = MOST_TEXT_MIB) -> bytes:
    """Read a file of unknown origin, and return its bytes.

    Parameters
    ----------
    path : path
        Path of the file. Links are followed. `scenes.folders.check_readable` checks whether a folder contains links.
    most_mib : int
        Maximum size of the file.

    Raises
    ------
    UserError
        If the file does not exist, is not a regular file, is too large, or cannot be read.
    """
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | NO_WAIT)) as stream:
            check_size(path, os.fstat(stream.fileno()), most_mib=most_mib)
            return stream.read()
    except FileNotFoundError as error:
        raise UserError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise UserError(f"{path}: the path is a folder, but a file is required") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: the file cannot be read ({getattr(error, 'strerror', None) or error})") from error


def check_size(path: Path | str, status: os.stat_result, *, most_mib: int) -> None:
    """Raise an error if a file is too large, or is not a regular file.

    Parameters
    ----------
    path : path
        Path of the file, used in messages.
    status : os.stat_result
        Status of the file.
    most_mib : int
        Maximum size of the file.
    """
    if not stat.S_ISREG(status.st_mode):
        raise UserError(f"{path}: the path is a pipe or device, but a regular file is required; save the content as a file")
    if status.st_size > most_mib * 2**20:
        raise UserError(
            f"{path}: the file has {status.st_size / 2**20:.0f} MiB, more than the maximum of {most_mib} MiB for this type of file"
        )
