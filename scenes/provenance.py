"""Versions of the program and its libraries, recorded in output files."""

import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version


def versions(names: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of rhizotwin, Python and the named distributions.

    Parameters
    ----------
    names : iterable of str
        Names of distributions in pip, such as ``opencv-python-headless``.

    Returns
    -------
    dict
        ``rhizotwin`` and ``python`` first; ``unknown`` for a distribution that is not installed.
    """
    return {"rhizotwin": _version("rhizotwin"), "python": platform.python_version()} | {name: _version(name) for name in names}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
