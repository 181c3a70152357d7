"""The ladder's figure: errors of volume and length against the plants' age, and the thesis's method on the same pictures."""

import io
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from recon.pictures import figure
from scenes.atomic import write_bytes

Record = Mapping[str, Any]

COLOURS = {"clean": "#1b7837", "bench": "#2166ac", "harsh": "#b2182b"}
SHIFT_DAYS = {"clean": -0.9, "bench": 0.0, "harsh": 0.9}
"""Profiles of one age stand side by side."""
MARGIN_DAYS = 2.5


def draw(records: Sequence[Record], path: Path) -> bool:
    """Draw the figure of all runs with radishes; returns whether there was anything to draw."""
    plants = [record for record in records if record["case"]["scene"].startswith("radish_")]
    ours = [record for record in plants if record["case"]["method"] == "coverage"]
    if not ours:
        return False
    theirs = [record for record in plants if record["case"]["method"] == "thesis"]
    drawn = figure(13.0, 4.4)
    volume, length, both = drawn.subplots(1, 3)
    for profile in COLOURS:
        _signed(volume, [record for record in ours if record["case"]["profile"] == profile], profile, _volume)
        _signed(length, [record for record in ours if record["case"]["profile"] == profile], profile, _length)
        for records_of, marker, line in ((ours, "o", "-"), (theirs, "^", ":")):
            chosen = [record for record in records_of if record["case"]["profile"] == profile]
            _magnitude(both, chosen, profile, marker, line)
    for axis, title in ((volume, "volume error (%)"), (length, "total length error (%)")):
        axis.axhline(0.0, color="0.5", linewidth=0.8)
        axis.set_ylabel(title)
        axis.legend(title="line: median", fontsize=8, title_fontsize=8)
    both.set_yscale("log")
    both.set_ylabel("volume error without its sign (%)")
    both.set_title("circles: ours; triangles: the thesis's method", fontsize=9)
    for axis in (volume, length, both):
        axis.set_xlabel("age of the radish (days)")
        ages = sorted({round(record["case"]["age_days"]) for record in ours})
        axis.set_xticks(ages)
        axis.set_xlim(ages[0] - MARGIN_DAYS, ages[-1] + MARGIN_DAYS)
        axis.grid(visible=True, alpha=0.25)
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="png", dpi=130)
    write_bytes(path, buffer.getvalue())
    return True


def _volume(record: Record) -> float | None:
    error = record["score"]["volume_error"]
    return None if error is None else 100.0 * float(error)


def _length(record: Record) -> float | None:
    roots = record["score"].get("roots")
    return None if not roots else 100.0 * float(roots["length_error"])


def _points(records: Sequence[Record], value: Callable[[Record], float | None]) -> list[tuple[float, float]]:
    """Return age and value of the runs that have one."""
    return [(float(record["case"]["age_days"]), found) for record in records if (found := value(record)) is not None]


def _medians(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    ages = sorted({age for age, _ in points})
    return ages, [statistics.median(value for age, value in points if age == wanted) for wanted in ages]


def _signed(axis: Any, records: Sequence[Record], profile: str, value: Callable[[Record], float | None]) -> None:
    points = _points(records, value)
    if points:
        shift = SHIFT_DAYS[profile]
        axis.scatter([age + shift for age, _ in points], [found for _, found in points], s=18, color=COLOURS[profile], alpha=0.75)
        ages, middle = _medians(points)
        axis.plot([age + shift for age in ages], middle, color=COLOURS[profile], linewidth=1.2, label=profile)


def _magnitude(axis: Any, records: Sequence[Record], profile: str, marker: str, line: str) -> None:
    points = [(age, abs(found)) for age, found in _points(records, _volume)]
    if points:
        shift = SHIFT_DAYS[profile]
        axis.scatter([age + shift for age, _ in points], [found for _, found in points], s=18, marker=marker, color=COLOURS[profile])
        ages, middle = _medians(points)
        axis.plot([age + shift for age in ages], middle, line, color=COLOURS[profile], linewidth=1.0)
