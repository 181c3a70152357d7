"""Reading of files of unknown origin: regular files only, whose size is checked first."""

import os
import stat
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import NO_WAIT

MOST_TEXT_MIB = 32
"""Maximum size of TOML, JSON, XML and tables: 20,000 pictures of a dataset or 300,000 points of roots. Python objects
take up to 25 times as much (an empty list takes 3 bytes in a file, 64 in memory), which remains below 1 GiB."""
MOST_PICTURE_MIB = 1024
"""Maximum size of a picture: 20,000 pixels per side, the maximum for a camera, with two bytes per pixel take 763 MiB.
"""
MOST_MESH_MIB = 128
"""Maximum size of a mesh: 2.7 million triangles in binary STL."""


def read_file(path: Path | str, *, most_mib: int = MOST_TEXT_MIB) -> bytes:
    """Return the bytes of a file.

    Parameters
    ----------
    path : path
        Path of the file. Links are followed; whether a folder contains links is checked for the whole folder
        (`scenes.folders.check_readable`).
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
        raise UserError(f"{path}: is a folder, but a file is required") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def check_size(path: Path | str, status: os.stat_result, *, most_mib: int) -> None:
    """Reject a file that is not regular or is too large.

    Parameters
    ----------
    path : path
        Path, used in messages.
    status : os.stat_result
        Status of the file.
    most_mib : int
        Maximum size of the file.
    """
    if not stat.S_ISREG(status.st_mode):
        raise UserError(f"{path}: is a pipe or device, but a regular file is required; save its content as a file")
    if status.st_size > most_mib * 2**20:
        raise UserError(f"{path}: has {status.st_size / 2**20:.0f} MiB, more than the maximum of {most_mib} MiB for such a file")
