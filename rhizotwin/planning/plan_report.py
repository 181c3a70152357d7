"""Output of a comparison of capture plans as a table, CSV text and figure."""

import csv
import io
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rhizotwin.planning.plans import Row
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.figures import figure, png

NOTE = (
    "volume, length: median error, and largest error over the seeds; interval: width of the 90 % interval relative to the true volume; "
    "covers: fraction of runs whose interval contains the true volume"
)


def table(rows: Sequence[Row]) -> str:
    """Format the scores of capture plans as a text table."""
    wide = max(len("heights (mm)"), *(len(_heights(row)) for row in rows)) + 2
    head = (
        f"{'heights (mm)':<{wide}}{'views':>6}{'picture':>11}{'volume':>9}{'worst':>8}{'interval':>10}{'covers':>7}"
        f"{'length':>9}{'worst':>8}{'recall':>8}{'prec.':>7}{'capture':>10}{'compute':>9}"
    )
    lines = [head, "-" * len(head)]
    for row in rows:
        v = row.variant
        size = f"{v.image_wh[0]}x{v.image_wh[1]}"
        length = "-" if row.length_error is None else f"{100 * row.length_error:+.1f}%"
        worst = "-" if row.length_error_worst is None else f"{100 * row.length_error_worst:.1f}%"
        lines.append(
            f"{_heights(row):<{wide}}{v.views:>6}{size:>11}{100 * row.volume_error:>+8.1f}%{100 * row.volume_error_worst:>7.1f}%"
            f"{100 * row.interval_width:>9.0f}%{100 * row.interval_holds:>6.0f}%{length:>9}{worst:>8}"
            f"{row.recall:>8.3f}{row.precision:>7.3f}{row.capture_min:>6.1f} min{row.compute_s:>7.0f} s"
        )
    return "\n".join(
        [*lines, NOTE, f"recall: found fraction of {_counted(rows)}; prec. (precision): correct fraction of the reconstruction"]
    )


def _heights(row: Row) -> str:
    return ", ".join(height.name for height in row.variant.heights)


def _counted(rows: Sequence[Row]) -> str:
    kinds = {"the voxels" if row.length_error is None else "the roots' length" for row in rows}
    return " or ".join(sorted(kinds))


def csv_text(rows: Sequence[Row]) -> str:
    """Format the scores of capture plans as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name in asdict(rows[0]) if name not in ("variant", "volume_errors", "length_errors")]
    writer.writerow(["heights_mm", "views_per_ring", "image_wh", *names])
    for row in rows:
        v = row.variant
        heights = " ".join(height.name for height in v.heights)
        writer.writerow([heights, v.views, f"{v.image_wh[0]}x{v.image_wh[1]}", *(getattr(row, name) for name in names)])
    return text.getvalue()


def draw(rows: Sequence[Row], path: Path, *, title: str) -> None:
    """Plot errors, recall and precision of capture plans against their number of pictures, and write the figure.

    Plans with the same camera heights and picture size are connected by a line.
    """
    has_roots = any(row.length_error is not None for row in rows)
    drawn = figure(13.5 if has_roots else 9.5, 4.6)
    axes = list(drawn.subplots(1, 3 if has_roots else 2))
    kinds = list(dict.fromkeys((row.variant.heights, row.variant.image_wh) for row in rows))
    for heights, image_wh in kinds:
        line = sorted(
            (row for row in rows if (row.variant.heights, row.variant.image_wh) == (heights, image_wh)), key=lambda row: row.pictures
        )
        label = f"{_heights(line[0])} mm, {image_wh[0]}x{image_wh[1]}"
        _errors(axes[0], line, lambda row: row.volume_errors, label)
        if has_roots:
            _errors(axes[1], line, lambda row: row.length_errors, label)
        pictures = [row.pictures for row in line]
        axes[-1].plot(pictures, [row.recall for row in line], marker="o", label=label)
        axes[-1].plot(pictures, [row.precision for row in line], marker="s", linestyle="--", color=axes[-1].lines[-1].get_color())
    for axis, name in zip(axes, ("volume", "length") if has_roots else ("volume",), strict=False):
        axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.set_ylabel(f"{name} error (%): median, dots are seeds")
    axes[-1].set_ylabel(f"{_counted(rows)}:\nrecall (line), precision (dashed)")
    for axis in axes:
        axis.set_xlabel("pictures per scan, all rings")
        axis.locator_params(axis="x", integer=True)
        axis.grid(visible=True, alpha=0.25)
    axes[0].legend(fontsize=8, title="camera heights, picture size", title_fontsize=8)
    drawn.suptitle(title, fontsize=10)
    write_bytes(path, png(drawn, dpi=130))


def _errors(axis: Any, line: Sequence[Row], of: Callable[[Row], tuple[float, ...]], label: str) -> None:
    """Plot the median error over the seeds as a line, and the error of each seed as a dot."""
    with_some = [row for row in line if of(row)]
    (drawn,) = axis.plot([r.pictures for r in with_some], [100.0 * statistics.median(of(r)) for r in with_some], linewidth=1.2, label=label)
    dots = [(row.pictures, 100.0 * error) for row in with_some for error in of(row)]
    axis.scatter([x for x, _ in dots], [y for _, y in dots], s=22, color=drawn.get_color())
