"""Short names of scans and results on pages, in tables and in folders: folder names, preceded by parents if needed."""

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path


def names_of(folders: Sequence[Path]) -> list[str]:
    """Return the name of each result's folder. If several names are equal, the folders above are prepended.

    Symbolic links keep their names.
    """
    parts = [Path(os.path.normpath(folder.absolute())).parts for folder in folders]
    return shorten([part[1:] or part for part in parts], separator="/")


def shorten(paths: Sequence[Sequence[str]], *, separator: str) -> list[str]:
    """Return the last part of each path. If the names of several paths are equal, their parents are prepended.

    Parameters
    ----------
    paths : sequence of sequence of str
        Parts of each path, from the outermost folder to the last one.
    separator : str
        Text between the parts of a name. Names of different paths can be equal only if a part contains this text.

    Returns
    -------
    list of str
        Name of each path. Equal paths have equal names.
    """
    names = {tuple(path): path[-1] for path in paths}
    for depth in range(2, max(map(len, names), default=1) + 1):
        count = Counter(names.values())
        names = {path: separator.join(path[-depth:]) if count[name] > 1 else name for path, name in names.items()}
    return [names[tuple(path)] for path in paths]
