"""Output of the benchmarks: lines of progress, tables of numbers, and the description of a run."""

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks import cache
from benchmarks.metric import Metric
from benchmarks.targets import TARGETS
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.provenance import versions
from rhizotwin.stored import sources

VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh", "manifold3d")
"""Libraries on whose versions results depend."""


def say(text: str) -> None:
    """Write a line of progress."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def about(command: str, device: str) -> dict[str, Any]:
    """Return the command and the device of measurements, with the versions that they depend on."""
    code = sources.digest(("rhizotwin.recon.reconstruct",))[:12]
    return {"command": command, "device": device, "reconstruction": code, **versions(VERSIONED)}


def results_table(metrics: Sequence[Metric]) -> str:
    """Return the numbers as text, with their targets."""
    width = max((len(metric.key) for metric in metrics), default=0)
    lines = [f"{'metric':<{width}}  {'value':>12} unit  target"]
    for metric in metrics:
        target = ""
        if metric.key in TARGETS:
            wanted = TARGETS[metric.key]
            target = f"{wanted.text}: {'reached' if wanted.reached(metric.value) else 'NOT REACHED'}"
        lines.append(f"{metric.key:<{width}}  {metric.value:>12.5g} {metric.unit:<4}  {target}".rstrip())
    return "\n".join(lines)


def markdown(titles: str, rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; the titles are separated by ``|``."""
    lines = [f"| {titles} |", "|---" * (titles.count("|") + 1) + "|"]
    return "\n".join([*lines, *(f"| {' | '.join(cells)} |" for cells in rows)])


def results_folder() -> Path:
    """Return the folder for the numbers of runs without ``--output``."""
    return cache.folder() / "results"


def value_at(record: Mapping[str, Any], path: str) -> float | None:
    """Return a number of a record by its path, such as ``roots.length_error``; None if a part is missing."""
    value = entry_at(record, path)
    return None if value is None else float(value)


def entry_at(record: Mapping[str, Any], path: str) -> Any:
    """Return an entry of a record by its path, such as ``case.scene``; None if a part is missing."""
    value: Any = record
    for name in path.split("."):
        value = None if value is None else value.get(name)
    return value


@contextmanager
def stored_json(path: Path, version: int, remedy: str) -> Iterator[dict[str, Any]]:
    """Read a JSON file with a ``schema_version``, and name the file and the remedy if its content cannot be used.

    Parameters
    ----------
    path : Path
        Existing file.
    version : int
        Version that is read.
    remedy : str
        What to do if the file has another version or is damaged, also if the block of this context finds that.

    Raises
    ------
    UserError
        If the file is damaged.
    """
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored["schema_version"] != version:
            raise ValueError(f"its schema_version is {stored['schema_version']}, this program reads {version}")
        yield stored
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{path} is damaged ({error!r}); {remedy}.") from None
