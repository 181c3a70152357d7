"""Arguments of the functions of the Python interface: type checks, folders of results and datasets, and progress."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Listener, Monitor
from rhizotwin.scenes.terminal import OneBar

if TYPE_CHECKING:
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.stored.save import Result

Progress = Monitor | type[Any] | Listener | None
"""Argument of a function that receives its progress: a monitor, a tqdm class, a function ``(stage, done, total)``, or
None. A tqdm class shows a single bar for all stages."""

SHARES = {
    "read": 0.1,
    "markers": 5.0,
    "poses": 1.5,
    "canister": 0.1,
    "background": 1.8,
    "wall": 0.8,
    "silhouettes": 0.7,
    "outlines": 0.3,
    "carve": 3.6,
    "trim": 3.8,
    "search": 3.5,
    "density": 1.3,
    "trace": 0.1,
    "tubes": 1.1,
    "translucency": 3.8,
    "branches": 2.7,
    "residue": 3.7,
    "hairs": 0.8,
    "calibration": 0.6,
    "last tubes": 0.2,
    "unite": 0.4,
    "uncertainty": 0.3,
    "surface": 0.3,
    "pictures": 6.0,
}
"""Typical duration of each stage of a reconstruction, in seconds, from which progress bars are computed. The durations
were measured with radish_day05b, 20 views of 400x300, and 2 cores."""


@contextmanager
def watch(given: Progress, shares: Mapping[str, float]) -> Iterator[Monitor]:
    """Yield a monitor that reports progress in the form requested by the caller.

    Parameters
    ----------
    given : Monitor, tqdm class, callable or None
        Receiver of progress; with a tqdm class, one bar covers all stages.
    shares : mapping of str to float
        Relative duration of each stage.
    """
    if isinstance(given, type):
        with OneBar(shares, bars=given) as bar:
            yield bar
    else:
        yield Monitor.of(given)


def require(name: str, value: Any, *kinds: str) -> None:
    """Check the type of a function's argument.

    Parameters
    ----------
    name : str
        Name of the parameter, for the error message.
    value : any
        Value to check.
    kinds : str
        Allowed types: keys of `_KINDS`, or names of classes of this package.

    Raises
    ------
    UserError
        If the value has none of the allowed types.
    """
    if not any(_KINDS[kind](value) if kind in _KINDS else type(value).__name__ == kind for kind in kinds):
        shown = "None" if value is None else f"{str(value)[:40]!r} ({type(value).__name__})"
        *first, last = (kind if kind in ("None", "True or False") else f"a {kind}" for kind in kinds)
        raise UserError(f"{name} must be {' or '.join(filter(None, [', '.join(first), last]))}, not {shown}")


def require_each(name: str, given: Any, *kinds: str) -> list[Any]:
    """Return the given values as a list, after their types were checked with `require`.

    A single value becomes a list of length 1.

    Raises
    ------
    UserError
        If a value has none of the allowed types, or there is no value.
    """
    several = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    for item in several:
        require(name, item, *kinds)
    if not several:
        raise UserError(f"{name} is an empty list; it must have at least one item")
    return several


def dataset_folder(dataset: Dataset | str | Path | None) -> Path | None:
    """Return the folder of a dataset. None: no dataset."""
    if dataset is None:
        return None
    return Path(dataset) if isinstance(dataset, str | Path) else dataset.folder


@contextmanager
def result_folder(result: Result | str | Path) -> Iterator[Path]:
    """Yield the folder of a result.

    A result in memory is first saved to a temporary folder, which is removed afterwards.
    """
    if isinstance(result, str | Path):
        yield Path(result)
        return
    with tempfile.TemporaryDirectory(prefix="rhizotwin-result-") as folder:
        result.write(Path(folder))
        yield Path(folder)


_KINDS: dict[str, Callable[[Any], bool]] = {
    "path": lambda value: isinstance(value, str | os.PathLike),
    "text": lambda value: isinstance(value, str),
    "number": lambda value: not isinstance(value, bool | str) and hasattr(value, "__float__"),
    "whole number": lambda value: not isinstance(value, bool) and hasattr(value, "__index__"),
    "True or False": lambda value: isinstance(value, bool) or type(value).__name__ == "bool_",
    "monitor": lambda value: isinstance(value, Monitor | type) or callable(value),
    "Scene": lambda value: isinstance(value, Scene),
    "callable": callable,
    "None": lambda value: value is None,
}
