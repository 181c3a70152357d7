"""Find the pictures in a folder from any source, in the order in which they were taken."""

import re
from pathlib import Path

from rhizotwin.scenes.errors import UserError

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sorting key that puts view_2 before view_10."""
    parts = [part for part in re.split(r"([0-9]+)", path.name.lower()) if part]
    return tuple((0, int(part), part) if part[0] in "0123456789" else (1, 0, part) for part in parts)


def list_pictures(folder: Path, *, suffixes: tuple[str, ...] = SUFFIXES) -> list[Path]:
    """Return the pictures of a folder (not of its subfolders), by their suffixes, in natural order.

    Raises
    ------
    UserError
        If the folder is missing, contains no picture, or contains two that differ only in extension.
    """
    if not folder.is_dir():
        raise UserError(f"{folder} is not a folder; give the folder that contains the pictures")
    paths = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.is_file()),
        key=natural_key,
    )
    if not paths:
        raise UserError(f"{folder} contains no picture ({', '.join(suffixes)}); give the folder that contains them")
    for path in paths:
        if path.is_symlink():
            raise UserError(f"{folder} contains {path.name}, which is a link; replace it by the picture")
        if not path.name.isprintable():  # bytes that are not UTF-8 are not printable either
            raise UserError(f"{folder} contains {path.name!a}, whose name is not printable UTF-8 text; rename it")
    by_stem: dict[str, Path] = {}
    for path in paths:
        other = by_stem.setdefault(path.stem, path)
        if other != path:
            raise UserError(f"{folder} contains {other.name} and {path.name}, which differ only in extension; rename or remove one")
    return paths
