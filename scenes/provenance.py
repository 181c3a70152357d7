"""Versions of the program and its libraries, which are recorded in output files."""

import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version


def versions(names: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of rhizotwin, Python and the given distributions. The keys are names.

    Parameters
    ----------
    names : iterable of str
        Names of distributions in the package index, such as ``opencv-python-headless``.

    Returns
    -------
    dict
        Versions, beginning with ``rhizotwin`` and ``python``; ``unknown`` for a distribution that is not installed.
    """
    return {"rhizotwin": _version("rhizotwin"), "python": platform.python_version()} | {name: _version(name) for name in names}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
