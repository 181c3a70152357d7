"""Search for the pictures in a folder, and reading of a picture.

The pictures are sorted by file name, which is assumed to be the order in which they were taken.
"""

import re
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.orientation import read_orientation
from rhizotwin.scenes.picture_codec import Grey, check_header, decode_grey, decode_grey_alpha
from rhizotwin.scenes.reading import MOST_PICTURE_MIB, read_file

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sorting key for natural order, in which view_2 precedes view_10."""
    parts = [part for part in re.split(r"([0-9]+)", path.name.lower()) if part]
    return tuple((0, int(part), part) if part[0] in "0123456789" else (1, 0, part) for part in parts)


def list_pictures(folder: Path, *, suffixes: tuple[str, ...] = SUFFIXES) -> list[Path]:
    """List the files with the given suffixes in a folder, without subfolders, in the natural order of their names.

    Raises
    ------
    UserError
        If the folder is missing, contains no picture, or contains two pictures whose names differ only in the suffix.
    """
    if not folder.is_dir():
        raise UserError(f"{folder} is not a folder; give the folder that contains the pictures")
    paths = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.is_file()),
        key=natural_key,
    )
    if not paths:
        raise UserError(f"the folder {folder} contains no picture ({', '.join(suffixes)}); give the folder that contains the pictures")
    for path in paths:
        if path.is_symlink():
            raise UserError(f"{folder} contains {path.name}, which is a symbolic link; replace the link by the picture")
        if not path.name.isprintable():  # bytes that are not UTF-8 are not printable either
            raise UserError(f"{folder} contains {path.name!a}, whose name is not printable UTF-8 text; rename the file")
    by_stem: dict[str, Path] = {}
    for path in paths:
        other = by_stem.setdefault(path.stem, path)
        if other != path:
            raise UserError(
                f"{folder} contains {other.name} and {path.name}, whose names differ only in the suffix; rename or remove one of them"
            )
    return paths


def read_picture(path: Path, *, image_wh: tuple[int, int]) -> tuple[bytes, Grey]:
    """Read and decode a picture file.

    Parameters
    ----------
    path : Path
        Picture file (PNG, JPEG or TIFF).
    image_wh : tuple of int
        Required width and height, px.

    Returns
    -------
    bytes, (H, W) uint8 or uint16 array
        Content of the file, and its grey values.

    Raises
    ------
    UserError
        If the file is unreadable, too large or incomplete, or the picture has another size.
    """
    data = read_file(path, most_mib=MOST_PICTURE_MIB)
    return data, decode_grey(data, where=str(path), image_wh=image_wh)


def read_mask(path: Path, *, image_wh: tuple[int, int]) -> tuple[Grey, Grey | None]:
    """Read the grey values and the transparency of a picture file (see `scenes.picture_codec.decode_grey_alpha`).

    The parameters and errors are those of `read_picture`.
    """
    return decode_grey_alpha(read_file(path, most_mib=MOST_PICTURE_MIB), where=str(path), image_wh=image_wh)


def check_pictures(paths: list[Path], *, image_wh: tuple[int, int]) -> list[int]:
    """Check the sizes and kinds of all pictures before any of them is decoded, which would take much longer.

    The errors are those of `read_picture`, except for damaged pixels. The result is the orientation tag of each picture
    (see `scenes.orientation`).
    """
    orientations = []
    for path in paths:
        data = read_file(path, most_mib=MOST_PICTURE_MIB)
        check_header(data, where=str(path), image_wh=image_wh)
        orientations.append(read_orientation(data))
    return orientations
