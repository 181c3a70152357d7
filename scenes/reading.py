"""Reading of files of unknown origin. Only regular files whose size is below a limit are read."""

import codecs
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

_ENCODINGS = {
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Encodings by byte order mark. That of UTF-32 is compared first, because it begins with that of UTF-16."""


def read_file(path: Path | str, *, most_mib: int = MOST_TEXT_MIB) -> bytes:
    """Read a file of unknown origin, and return its bytes without the byte order mark of UTF-8.

    Notepad, PowerShell and Excel write this mark. No binary format that is read begins with its three bytes.

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
            return stream.read().removeprefix(codecs.BOM_UTF8)
    except FileNotFoundError as error:
        raise UserError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise UserError(f"{path}: the path is a folder, but a file is required") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: the file cannot be read ({getattr(error, 'strerror', None) or error})") from error


def read_text(path: Path | str) -> str:
    """Read a text file of unknown origin, see `read_file` and `decode_text`."""
    return decode_text(read_file(path), path)


def decode_text(data: bytes, path: Path | str) -> str:
    """Decode the content of a text file in UTF-8, or in UTF-16 or UTF-32 with a byte order mark.

    Line breaks of Windows (CR LF) become those of Unix.

    Raises
    ------
    UserError
        If the content is not text in one of these encodings.
    """
    encoding = next((name for mark, name in _ENCODINGS.items() if data.startswith(mark)), "utf-8-sig")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: the file is not UTF-8 text (see byte {error.start}); save it as UTF-8") from error
    if "\0" in text:
        raise UserError(f"{path}: the file is not UTF-8 text (it contains zero bytes); save it as UTF-8")
    return text.replace("\r\n", "\n")


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
