"""Table of the ladder: groups of scenes by profile, with their targets."""

import csv
import io
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product
from typing import Any

from benchmarks import ladder, output, tree_scatter
from benchmarks.cases import PHANTOMS, THICK_FAMILIES, THIN_FAMILIES
from benchmarks.metric import Direction, Metric
from benchmarks.output import entry_at, value_at
from benchmarks.targets import TARGETS

Record = Mapping[str, Any]

PLANT_GROUP = "plants"
ONE_RING = "_one_ring"
"""Suffix of the groups of plants in one ring, the library's plan. Groups without it are plants in two rings."""
DAY30 = "radish_day30"


@dataclass(frozen=True)
class _Quantity:
    """One number of a group of runs."""

    name: str
    combine: Callable[[list[float]], float]
    path: str
    """Path of the combined values in a record; their signs do not count."""
    direction: Direction
    tolerance: float
    unit: str = "1"

    def of(self, records: Sequence[Record]) -> float:
        """Return the number; NaN if a value is missing, in contrast to `max` and `median`."""
        values = [value_at(record, self.path) for record in records]
        known = [abs(value) for value in values if value is not None]
        return self.combine(known) if len(known) == len(values) and not any(map(math.isnan, known)) else math.nan


@dataclass(frozen=True, kw_only=True)
class Line:
    """One number of the table."""

    key: str
    group: str
    profile: str
    quantity: str
    value: float
    """Value; NaN if it is missing in a run."""
    unit: str
    direction: Direction
    tolerance: float
    runs: int
    thesis: float | None
    """The same number for the thesis's method on the same pictures; None if it was not run or has no such number."""

    @property
    def verdict(self) -> str:
        """Whether the target is reached; empty if there is none."""
        target = TARGETS.get(self.key)
        return "" if target is None else "yes" if target.reached(self.value) else "NO"

    @property
    def goal(self) -> str:
        """Target as text."""
        return TARGETS[self.key].text if self.key in TARGETS else ""

    def metric(self) -> Metric:
        """Return the number as a metric for the gate."""
        return Metric(key=self.key, value=self.value, unit=self.unit, direction=self.direction, abs_tol=self.tolerance)


def lines(records: Iterable[Record]) -> list[Line]:
    """Return all numbers of the table for the given runs, group by group.

    Runs of the thesis's method are compared with ours.
    """
    everything = list(records)
    ours = [record for record in everything if record["case"]["method"] == "coverage"]
    theirs = {_pictures(record): record for record in everything if record["case"]["method"] == "thesis"}
    found = []
    for (group, (holds, quantities)), rings in product(_GROUPS.items(), (2, 1)):
        name = group if rings == 2 or group in PHANTOMS else f"{group}{ONE_RING}"
        for profile in ("clean", "bench", "harsh"):
            inside = [record for record in ours if record["case"]["profile"] == profile and holds(record) and _is_in(record, rings)]
            beside = [theirs[_pictures(record)] for record in inside if _pictures(record) in theirs]
            is_repeated = group in PHANTOMS and rings == 1
            found += [_line(name, profile, quantity, inside, beside) for quantity in quantities if inside and not is_repeated]
    return found


def _is_in(record: Record, rings: int) -> bool:
    """Return whether a run belongs to the groups of a number of rings; phantoms have one and belong to both."""
    return record["case"]["rings"] == rings or record["case"]["scene"] in PHANTOMS


def _line(group: str, profile: str, quantity: _Quantity, inside: Sequence[Record], beside: Sequence[Record]) -> Line:
    comparable = quantity.name.startswith("volume") and len(beside) == len(inside)
    return Line(
        key=f"ladder/{group}/{profile}/{quantity.name}",
        group=group,
        profile=profile,
        quantity=quantity.name,
        value=quantity.of(inside),
        unit=quantity.unit,
        direction=quantity.direction,
        tolerance=quantity.tolerance,
        runs=len(inside),
        thesis=quantity.of(beside) if comparable else None,
    )


def _pictures(record: Record) -> tuple[Any, ...]:
    case = record["case"]
    return case["scene"], case["profile"], case["seed"], case["rings"], case["views"], *case["image_wh"]


def _scenes(*patterns: str) -> Callable[[Record], bool]:
    return lambda record: any(fnmatchcase(record["case"]["scene"], pattern) for pattern in patterns)


_MEDIAN = _Quantity("volume_median", statistics.median, "score.volume_error", "down", 0.003)
_WORST = _Quantity("volume_worst", max, "score.volume_error", "down", 0.005)
_HOLDS = _Quantity("interval_holds", statistics.mean, "score.interval_holds_truth", "up", 0.0)
_LENGTH = _Quantity("length_mean", statistics.mean, "score.roots.length_error", "down", 0.003)
_LENGTH_WORST = _Quantity("length_worst", max, "score.roots.length_error", "down", 0.005)
_PRECISION = _Quantity("tip_precision", statistics.mean, "score.roots.tip_precision", "up", 0.01)
_PRECISION_WORST = _Quantity("tip_precision_worst", min, "score.roots.tip_precision", "up", 0.02)
_RECALL_WORST = _Quantity("tip_recall_worst", min, "score.roots.tip_recall", "up", 0.02)
_RECALL = _Quantity("tip_recall", statistics.mean, "score.roots.tip_recall", "up", 0.01)
_IDENTITY = _Quantity("identity", statistics.mean, "score.topology.identity", "up", 0.005)
_ORDERS = _Quantity("order_length", statistics.mean, "score.topology.order_length", "up", 0.005)
_MAIN = _Quantity("main_length", statistics.mean, "score.topology.main_length", "up", 0.01)
_BRANCH_RECALL = _Quantity("branch_recall", statistics.mean, "score.topology.branch_recall", "up", 0.01)
_BRANCH_PRECISION = _Quantity("branch_precision", statistics.mean, "score.topology.branch_precision", "up", 0.01)
_WALL = _Quantity("wall_worst", max, "wall_s", "down", 90.0, "s")
_MEMORY = _Quantity("memory_worst", max, "peak_memory_mib", "down", 600.0, "MiB")

_TREE = (_IDENTITY, _ORDERS, _MAIN, _BRANCH_RECALL, _BRANCH_PRECISION)
_ROOTS = (_LENGTH, _LENGTH_WORST, _PRECISION, _PRECISION_WORST, _RECALL, _RECALL_WORST, *_TREE)
"""Every mean of length and tips is accompanied by the worst value."""
_OF_PLANTS = (_MEDIAN, _WORST, *_ROOTS, _HOLDS)

_GROUPS: dict[str, tuple[Callable[[Record], bool], tuple[_Quantity, ...]]] = {
    "sphere_20mm": (_scenes("sphere_20mm"), (_WORST,)),
    "printed_8ml": (_scenes("printed_8ml"), (_WORST,)),
    "radish_day05-15": (_scenes("radish_day05*", "radish_day1*"), _OF_PLANTS),
    "radish_day20-30": (_scenes("radish_day2*", "radish_day30*"), _OF_PLANTS),
    "fallen_plant": (_scenes("fallen_plant"), (_WORST, *_ROOTS)),
    "thin_families": (_scenes(*THIN_FAMILIES), _OF_PLANTS),
    "thick_families": (_scenes(*THICK_FAMILIES), _OF_PLANTS),
    PLANT_GROUP: (_scenes("radish_day*", "fallen_plant"), _ROOTS),
    "all": (lambda record: bool(record["score"]), (_HOLDS,)),
    DAY30: (_scenes(f"{DAY30}*"), (_WALL, _MEMORY)),
}

_TITLES = {
    "volume_median": "volume error, median",
    "volume_worst": "volume error, worst",
    "length_mean": "length error, mean",
    "tip_precision": "tips, precision",
    "length_worst": "length error, worst",
    "tip_precision_worst": "tips, precision, worst",
    "tip_recall": "tips, recall",
    "tip_recall_worst": "tips, recall, worst",
    "identity": "identity of the roots, mean",
    "order_length": "length with the correct order, mean",
    "main_length": "main roots on found main roots, mean",
    "branch_recall": "branch points, recall",
    "branch_precision": "branch points, precision",
    "interval_holds": "runs whose interval contains the truth",
    "wall_worst": "reconstruction, longest",
    "memory_worst": "reconstruction, most memory",
}


def _text(line: Line, value: float | None) -> str:
    if value is None:
        return "-"
    if math.isnan(value):
        return "none"
    if line.quantity in ("wall_worst",):
        return f"{value:.0f} s"
    if line.unit == "MiB":
        return f"{value / 1024.0:.1f} GiB"
    return f"{value:.3f}" if line.direction == "up" else f"{100.0 * value:.1f} %"


def page(records: Sequence[Record], scattered: Mapping[str, Any]) -> str:
    """Return the page of the documentation.

    Parameters
    ----------
    records : sequence of dict
        Committed results of the ladder (`benchmarks.ladder`).
    scattered : dict
        Recorded scatter of the tree (`benchmarks.tree_scatter`).
    """
    commits = ladder.commits_of(records)
    return f"""# Results of the ladder

This page is written by `./run bench accuracy --update-baseline` from `benchmarks/ladder.json` ([accuracy](accuracy.md#the-ladder)).
The commit of a number is the last one that changed the reconstruction when it was measured: {", ".join(commits)}. The check of the
sources fails if a number is more than 60 commits of `recon` old.

Pictures have 800x600 pixels, voxels 0.27 mm. One ring is the plan of the library's scenes (40 views). Two rings are that ring, and one
from 10 mm above the rim (80 views). Intervals in brackets belong to volumes that are not reliable, bold ones miss the truth. Found and
true centre lines agree where they are closer than 0.5 mm or half of the true diameter; identity, order, main roots, branch points, ghosts
and missing length are defined in [accuracy](accuracy.md#measures-of-the-tree). Processor time and memory are those of the reconstruction.

{markdown(lines(records), records)}{tree_scatter.section(scattered)}"""


def markdown(found: Sequence[Line], records: Sequence[Record]) -> str:
    """Return the table of groups, and one row for each run, as Markdown."""
    groups = [
        (
            line.group,
            line.profile,
            _TITLES[line.quantity],
            f"{line.runs}",
            _text(line, line.value),
            line.goal,
            line.verdict,
            _text(line, line.thesis),
        )
        for line in found
    ]
    theirs = {_pictures(record): record for record in records if record["case"]["method"] == "thesis"}
    runs = [_run_row(record, theirs.get(_pictures(record))) for record in records if record["case"]["method"] == "coverage"]
    titles = (
        "scene | profile | rings | volume | 90 % interval | length | tips: precision / recall | identity | correct order | main roots "
        "| branch points: precision / recall | ghosts / missing (mm) | processor s / MiB | thesis: volume | commit"
    )
    head = "scenes | profile | number | runs | reached | goal | | thesis's method"
    return f"{output.markdown(head, groups)}\n\n{output.markdown(titles, runs)}\n"


def _run_row(record: Record, other: Record | None) -> list[str]:
    case, score = record["case"], record["score"]
    true_mm3, size = score["volume_true_mm3"], "" if tuple(case["image_wh"]) == (800, 600) else f" {case['image_wh'][0]} px"
    interval = " to ".join(f"{100.0 * (limit / true_mm3 - 1.0):+.0f}" for limit in score["volume_interval_mm3"]) + " %"
    held = interval if score["interval_holds_truth"] else f"**{interval}**"
    return [
        f"`{case['scene']}`{size}" + (f" seed {case['seed']}" if case["seed"] else ""),
        case["profile"],
        str(case["rings"]),
        _signed(score["volume_error"]),
        held if score["volume_trusted"] else f"({held})",
        *_tree_cells(score),
        f"{record['cpu_s']:.0f} / {record['peak_memory_mib']:.0f}",
        "-" if other is None else _signed(other["score"]["volume_error"], digits=0),
        record["commit"],
    ]


def _tree_cells(score: Mapping[str, Any]) -> list[str]:
    roots, tree = score.get("roots"), score.get("topology")
    if not roots or not tree:
        return ["-"] * 7
    return [
        _signed(roots["length_error"]),
        f"{roots['tip_precision']:.2f} / {roots['tip_recall']:.2f}",
        f"{tree['identity']:.3f}",
        f"{100.0 * tree['order_length']:.1f} %",
        f"{100.0 * tree['main_length']:.1f} %",
        f"{tree['branch_precision']:.2f} / {tree['branch_recall']:.2f}",
        f"{tree['ghosts_mm']:.0f} / {tree['missing_mm']:.0f}",
    ]


def _signed(fraction: float | None, *, digits: int = 1) -> str:
    return "-" if fraction is None else f"{100.0 * fraction:+.{digits}f} %"


_COLUMNS = {
    "case": ("scene", "profile", "seed", "method", "rings", "views", "age_days"),
    "score": ("volume_true_mm3", "volume_mm3", "volume_error", "interval_holds_truth", "recall", "precision", "iou"),
    "score.roots": (
        "length_true_mm",
        "length_mm",
        "length_error",
        "recall",
        "precision",
        "tips_true",
        "tips",
        "tip_precision",
        "tip_recall",
    ),
    "score.topology": (
        *("identity", "order_length", "main_length", "branch_recall", "branch_precision"),
        *("ghosts_mm", "doubled_mm", "missing_mm"),
    ),
}
"""Columns of the table of runs, by the part of a record."""
_COSTS = ("wall_s", "cpu_s", "peak_memory_mib", "load", "commit")


def comma_separated(records: Sequence[Record]) -> str:
    """Return one row for each run, of both methods, as CSV with units in the header."""
    columns = {("roots_" * (part == "score.roots") + name): f"{part}.{name}" for part, names in _COLUMNS.items() for name in names}
    rows = [[*columns, "interval_low_mm3", "interval_high_mm3", *_COSTS]]
    for record in records:
        cells = [entry_at(record, path) for path in (*columns.values(), "score.volume_interval_mm3", *_COSTS)]
        rows.append([cell for entry in cells for cell in (entry if isinstance(entry, list) else [entry])])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
