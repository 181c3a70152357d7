"""Figure of the ladder: errors of volume and length by the plants' age, with the thesis's method."""

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.figures import figure, png

Record = Mapping[str, Any]

COLOURS = {"clean": "#1b7837", "bench": "#2166ac", "harsh": "#b2182b"}
APART_DAYS = 0.9
"""Horizontal distance between profiles of one age."""
MARGIN_DAYS = 2.5


def draw(records: Sequence[Record], path: Path) -> bool:
    """Draw the runs with radishes, in one ring if there are any; return whether there is anything to draw."""
    plants = [record for record in records if record["case"]["scene"].startswith("radish_day")]
    plants = [record for record in plants if record["case"]["rings"] == 1] or plants
    ours = [record for record in plants if record["case"]["method"] == "coverage"]
    if not ours:
        return False
    theirs = [record for record in plants if record["case"]["method"] == "thesis"]
    drawn = figure(13.0, 4.4)
    volume, length, both = drawn.subplots(1, 3)
    profiles = [profile for profile in COLOURS if any(record["case"]["profile"] == profile for record in ours)]
    for number, profile in enumerate(profiles):
        style = _Style(profile, APART_DAYS * (number - 0.5 * (len(profiles) - 1)))
        of_ours, of_theirs = ([record for record in those if record["case"]["profile"] == profile] for those in (ours, theirs))
        _plot(volume, _points(of_ours, _volume), style)
        _plot(length, _points(of_ours, _length), style)
        _plot(both, _sizes(of_ours), style)
        _plot(both, _sizes(of_theirs), style, "^", ":")
    for axis, title in ((volume, "volume error (%)"), (length, "total length error (%)")):
        axis.axhline(0.0, color="0.5", linewidth=0.8)
        axis.set_ylabel(title)
    drawn.legend(*volume.get_legend_handles_labels(), loc="outside upper left", ncols=len(profiles), title="line: median", alignment="left")
    both.set_yscale("log")
    both.set_ylabel("size of the volume error (%)")
    if theirs:
        both.set_title("circles: ours; triangles: the thesis's method", fontsize=9)
    for axis in (volume, length, both):
        axis.set_xlabel("age of the radish (days)")
        ages = sorted({round(record["case"]["age_days"]) for record in ours})
        axis.set_xticks(ages)
        axis.set_xlim(ages[0] - MARGIN_DAYS, ages[-1] + MARGIN_DAYS)
        axis.grid(visible=True, alpha=0.25)
    write_bytes(path, png(drawn, dpi=130))
    return True


def _volume(record: Record) -> float | None:
    error = record["score"]["volume_error"]
    return None if error is None else 100.0 * float(error)


def _length(record: Record) -> float | None:
    roots = record["score"].get("roots")
    return None if not roots else 100.0 * float(roots["length_error"])


def _points(records: Sequence[Record], value: Callable[[Record], float | None]) -> list[tuple[float, float]]:
    """Return age and value of the runs that have a value."""
    return [(float(record["case"]["age_days"]), found) for record in records if (found := value(record)) is not None]


def _sizes(records: Sequence[Record]) -> list[tuple[float, float]]:
    return [(age, abs(found)) for age, found in _points(records, _volume)]


@dataclass(frozen=True)
class _Style:
    """Style of one profile's runs."""

    profile: str
    shift_days: float


def _plot(axis: Any, points: Sequence[tuple[float, float]], style: _Style, marker: str = "o", line: str = "-") -> None:
    """Draw points, and a line through the medians of each age."""
    if not points:
        return
    colour = COLOURS[style.profile]
    axis.scatter(
        [age + style.shift_days for age, _ in points], [found for _, found in points], s=18, marker=marker, color=colour, alpha=0.75
    )
    ages = sorted({age for age, _ in points})
    middle = [statistics.median(value for age, value in points if age == wanted) for wanted in ages]
    axis.plot([age + style.shift_days for age in ages], middle, line, color=colour, linewidth=1.2, label=style.profile)
