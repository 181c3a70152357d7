"""Table of the ladder: groups of scenes by profile, with their targets."""

import csv
import io
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from benchmarks import ladder, tree_scatter
from benchmarks.cases import PHANTOMS, THICK_FAMILIES, THIN_FAMILIES
from benchmarks.metric import Direction, Metric
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
    of: Callable[[Sequence[Record]], float]
    unit: str
    direction: Direction
    tolerance: float


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


def _scene_in(*days: int) -> Callable[[Record], bool]:
    return lambda record: record["case"]["scene"].startswith(tuple(f"radish_day{day:02d}" for day in days))


def _among(names: Sequence[str]) -> Callable[[Record], bool]:
    return lambda record: bool(record["case"]["scene"] in names)


def _named(name: str) -> Callable[[Record], bool]:
    return lambda record: bool(record["case"]["scene"] == name)


def _score_value(record: Record, *path: str) -> float:
    value: Any = record
    for name in path:
        value = None if value is None else value.get(name)
    return math.nan if value is None else float(value)


def _sizes(*path: str) -> Callable[[Sequence[Record]], list[float]]:
    return lambda records: [abs(_score_value(record, *path)) for record in records]


def _over(
    combine: Callable[[list[float]], float], values: Callable[[Sequence[Record]], list[float]]
) -> Callable[[Sequence[Record]], float]:
    """Return a quantity of many runs; a missing value makes it NaN, in contrast to `max` and `median`."""

    def quantity(records: Sequence[Record]) -> float:
        found = values(records)
        return math.nan if any(math.isnan(value) for value in found) else combine(found)

    return quantity


_VOLUME = _sizes("score", "volume_error")
_MEDIAN = _Quantity("volume_median", _over(statistics.median, _VOLUME), "1", "down", 0.003)
_WORST = _Quantity("volume_worst", _over(max, _VOLUME), "1", "down", 0.005)
_HOLDS = _Quantity("interval_holds", _over(statistics.mean, _sizes("score", "interval_holds_truth")), "1", "up", 0.0)
_LENGTH = _Quantity("length_mean", _over(statistics.mean, _sizes("score", "roots", "length_error")), "1", "down", 0.003)
_LENGTH_WORST = _Quantity("length_worst", _over(max, _sizes("score", "roots", "length_error")), "1", "down", 0.005)
_PRECISION = _Quantity("tip_precision", _over(statistics.mean, _sizes("score", "roots", "tip_precision")), "1", "up", 0.01)
_PRECISION_WORST = _Quantity("tip_precision_worst", _over(min, _sizes("score", "roots", "tip_precision")), "1", "up", 0.02)
_RECALL_WORST = _Quantity("tip_recall_worst", _over(min, _sizes("score", "roots", "tip_recall")), "1", "up", 0.02)
_RECALL = _Quantity("tip_recall", _over(statistics.mean, _sizes("score", "roots", "tip_recall")), "1", "up", 0.01)
_IDENTITY = _Quantity("identity", _over(statistics.mean, _sizes("score", "topology", "identity")), "1", "up", 0.005)
_ORDERS = _Quantity("order_length", _over(statistics.mean, _sizes("score", "topology", "order_length")), "1", "up", 0.005)
_MAIN = _Quantity("main_length", _over(statistics.mean, _sizes("score", "topology", "main_length")), "1", "up", 0.01)
_BRANCH_RECALL = _Quantity("branch_recall", _over(statistics.mean, _sizes("score", "topology", "branch_recall")), "1", "up", 0.01)
_BRANCH_PRECISION = _Quantity("branch_precision", _over(statistics.mean, _sizes("score", "topology", "branch_precision")), "1", "up", 0.01)
_WALL = _Quantity("wall_worst", _over(max, _sizes("wall_s")), "s", "down", 90.0)
_MEMORY = _Quantity("memory_worst", _over(max, _sizes("peak_memory_mib")), "MiB", "down", 600.0)

_TREE = (_IDENTITY, _ORDERS, _MAIN, _BRANCH_RECALL, _BRANCH_PRECISION)
_ROOTS = (_LENGTH, _LENGTH_WORST, _PRECISION, _PRECISION_WORST, _RECALL, _RECALL_WORST, *_TREE)
"""Every mean of length and tips is accompanied by the worst value."""
_OF_PLANTS = (_MEDIAN, _WORST, *_ROOTS, _HOLDS)

_GROUPS: dict[str, tuple[Callable[[Record], bool], tuple[_Quantity, ...]]] = {
    "sphere_20mm": (_named("sphere_20mm"), (_WORST,)),
    "printed_8ml": (_named("printed_8ml"), (_WORST,)),
    "radish_day05-15": (_scene_in(5, 10, 15), _OF_PLANTS),
    "radish_day20-30": (_scene_in(20, 25, 30), _OF_PLANTS),
    "fallen_plant": (_named("fallen_plant"), (_WORST, *_ROOTS)),
    "thin_families": (_among(THIN_FAMILIES), _OF_PLANTS),
    "thick_families": (_among(THICK_FAMILIES), _OF_PLANTS),
    PLANT_GROUP: (lambda record: _scene_in(5, 10, 15, 20, 25, 30)(record) or _named("fallen_plant")(record), _ROOTS),
    "all": (lambda record: bool(record["score"]), (_HOLDS,)),
    DAY30: (_scene_in(30), (_WALL, _MEMORY)),
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
    rows = [
        "| scenes | profile | number | runs | reached | goal | | thesis's method |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for line in found:
        head = f"| {line.group} | {line.profile} | {_TITLES[line.quantity]} | {line.runs} "
        rows.append(f"{head}| {_text(line, line.value)} | {line.goal} | {line.verdict} | {_text(line, line.thesis)} |")
    theirs = {_pictures(record): record for record in records if record["case"]["method"] == "thesis"}
    rows += [
        "",
        "| scene | profile | rings | volume | 90 % interval | length | tips: precision / recall | identity | correct order | main roots "
        "| branch points: precision / recall | ghosts / missing (mm) | processor s / MiB | thesis: volume | commit |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for record in records:
        if record["case"]["method"] == "coverage":
            rows.append(_run_row(record, theirs.get(_pictures(record))))
    return "\n".join(rows) + "\n"


def _run_row(record: Record, other: Record | None) -> str:
    case, score = record["case"], record["score"]
    true_mm3, size = score["volume_true_mm3"], "" if tuple(case["image_wh"]) == (800, 600) else f" {case['image_wh'][0]} px"
    interval = " to ".join(f"{100.0 * (limit / true_mm3 - 1.0):+.0f}" for limit in score["volume_interval_mm3"]) + " %"
    held = interval if score["interval_holds_truth"] else f"**{interval}**"
    cells = [
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
    return f"| {' | '.join(cells)} |"


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


def comma_separated(records: Sequence[Record]) -> str:
    """Return one row for each run, of both methods, as CSV with units in the header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    case_fields = ("scene", "profile", "seed", "method", "rings", "views", "age_days")
    score_fields = ("volume_true_mm3", "volume_mm3", "volume_error", "interval_holds_truth", "recall", "precision", "iou")
    root_fields = ("length_true_mm", "length_mm", "length_error", "recall", "precision", "tips_true", "tips", "tip_precision", "tip_recall")
    tree_fields = ("identity", "order_length", "main_length", "branch_recall", "branch_precision", "ghosts_mm", "doubled_mm", "missing_mm")
    taken_fields = ("wall_s", "cpu_s", "peak_memory_mib", "load")
    names = [
        *case_fields,
        *score_fields,
        "interval_low_mm3",
        "interval_high_mm3",
        *(f"roots_{name}" for name in root_fields),
        *tree_fields,
        *taken_fields,
        "commit",
    ]
    writer.writerow(names)
    for record in records:
        roots, tree = (record["score"].get(name) or {} for name in ("roots", "topology"))
        writer.writerow(
            [
                *(record["case"].get(name) for name in case_fields),
                *(record["score"].get(name) for name in score_fields),
                *record["score"]["volume_interval_mm3"],
                *(roots.get(name) for name in root_fields),
                *(tree.get(name) for name in tree_fields),
                *(record.get(name) for name in (*taken_fields, "commit")),
            ]
        )
    return text.getvalue()
