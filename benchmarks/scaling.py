"""Growth of processor time and memory of a reconstruction with views, pixels, roots and finer voxels, one at a time.

Each point is a run of `rhizotwin reconstruct` in its own process, on pictures that are rendered once and cached. The
exponent is the slope of a straight line through the logarithms; it includes start-up and constant parts, as they are
part of a user's waiting time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import cache, commit_comparison
from benchmarks.output import markdown
from benchmarks.run import Say
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.truth import load_truth

LENGTH = "root length"
"""Axis whose values are the true root lengths of the rendered plants."""


@dataclass(frozen=True)
class Step:
    """One point of an axis."""

    pictures: tuple[str, ...]
    """Arguments of ``simulate``."""
    words: tuple[str, ...] = ()
    """Additional arguments of ``reconstruct``."""
    value: float | None = None
    """Position of the point; None for the true length of the roots, m."""


def _step(scene: str, value: float | None, *, views: int = 40, wide: int = 800, voxel_mm: float = 0.27) -> Step:
    pictures = (scene, "--views", str(views), "--image-wh", f"{wide}x{3 * wide // 4}")
    return Step(pictures, ("--voxel-mm", f"{voxel_mm:g}"), value)


UNITS = {LENGTH: ", m"}
AXES: dict[str, tuple[Step, ...]] = {
    "views": tuple(_step("radish_day15b", n, views=n) for n in (20, 40, 80, 160)),
    "megapixels": tuple(_step("radish_day15b", 0.75e-6 * n**2, wide=n) for n in (576, 1152, 2304, 2828)),
    LENGTH: tuple(_step(f"radish_day{name}", None) for name in ("05a", "10a", "15b", "30c")),
    "1/voxel_mm": tuple(_step("printed_8ml", 1.0 / mm, voxel_mm=mm) for mm in (0.4, 0.2, 0.1, 0.05)),
}
"""Axes: 20 to 160 views, 0.25 to 6 million pixels, roots of 5 to 30 days, voxels of 0.4 to 0.05 mm."""
QUICK: dict[str, tuple[Step, ...]] = {
    "views": tuple(_step("sphere_20mm", n, views=n, wide=200) for n in (12, 48)),
    "megapixels": tuple(_step("sphere_20mm", 0.75e-6 * n**2, views=12, wide=n) for n in (200, 800)),
    "1/voxel_mm": tuple(_step("sphere_20mm", 1.0 / mm, views=12, wide=200, voxel_mm=mm) for mm in (0.4, 0.1)),
}
"""Reduced axes for a quick run."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """Cost of one reconstruction."""

    value: float
    cpu_s: float
    memory_mib: float


@dataclass(frozen=True, kw_only=True)
class Growth:
    """Growth of the cost along an axis."""

    axis: str
    points: tuple[Point, ...]
    cpu: float
    """Exponent of processor time."""
    memory: float
    """Exponent of peak memory."""


def measure(axes: Sequence[str] | None, *, quick: bool, device: str, say: Say) -> list[Growth]:
    """Run every point of the given axes, or of all.

    Parameters
    ----------
    axes : sequence of str or None
        Names of axes; None for all.
    quick : bool
        Whether to use the reduced axes.
    device : str
        Computing device.
    say : Say
        Receives the cost of every point.

    Returns
    -------
    list of Growth
        Points and exponents of each axis.

    Raises
    ------
    UserError
        If an axis is unknown, or a run fails.
    """
    offered = QUICK if quick else AXES
    for axis in axes or ():
        if axis not in offered:
            raise UserError(f"--axes {axis} is not one of {', '.join(offered)}")
    found = []
    for axis in axes or offered:
        points = []
        _point(offered[axis][0], _pictures(offered[axis][0], device=device), device=device)  # compiles the kernels
        for step in offered[axis]:
            points.append(_point(step, _pictures(step, device=device), device=device))
            say(f"{axis} {points[-1].value:.4g}: {points[-1].cpu_s:.1f} s of processor time, {points[-1].memory_mib:.0f} MiB")
        found.append(growth(axis, points))
    return found


def growth(axis: str, points: Sequence[Point]) -> Growth:
    """Fit the exponents of an axis's points."""
    at = np.log([point.value for point in points])
    cpu, memory = (np.polyfit(at, np.log([getattr(point, name) for point in points]), 1)[0] for name in ("cpu_s", "memory_mib"))
    return Growth(axis=axis, points=tuple(points), cpu=float(cpu), memory=float(memory))


def table(found: Sequence[Growth]) -> str:
    """Return the exponents as a Markdown table."""
    rows = []
    for one in found:
        first, last = one.points[0], one.points[-1]
        times, memories = f"{first.cpu_s:.1f} -> {last.cpu_s:.1f}", f"{first.memory_mib:.0f} -> {last.memory_mib:.0f}"
        rows.append((one.axis, f"{first.value:.3g}", f"{last.value:.3g}", times, f"{one.cpu:.2f}", memories, f"{one.memory:.2f}"))
    return markdown("against | from | to | processor s | exponent | memory MiB | exponent", rows)


def draw(found: Sequence[Growth]) -> bytes:
    """Return a figure of processor time and memory against each axis, as PNG."""
    drawn = figure(3.2 * len(found), 5.0)
    for column, one in enumerate(found):
        value = [point.value for point in one.points]
        for row, (name, exponent, label) in enumerate((("cpu_s", one.cpu, "processor time, s"), ("memory_mib", one.memory, "memory, MiB"))):
            axes = drawn.add_subplot(2, len(found), row * len(found) + column + 1)
            cost = [getattr(point, name) for point in one.points]
            axes.loglog(value, cost, "o-", color="#2166ac")
            axes.set_title(f"exponent {exponent:.2f}", fontsize=9)
            axes.set_xlabel(f"{one.axis}{UNITS.get(one.axis, '')}")
            axes.set_ylabel(label if column == 0 else "")
            axes.set_xticks(value, [f"{x:.3g}" for x in value], rotation=45)
            axes.minorticks_off()
            axes.set_yticks([min(cost), max(cost)], [f"{min(cost):.0f}", f"{max(cost):.0f}"])
            axes.grid(True, which="both", alpha=0.3)
    return png(drawn, dpi=110)


def _pictures(step: Step, *, device: str) -> Path:
    """Return the folder of a point's pictures, rendered once."""
    folder = cache.folder() / "scaling" / "-".join(step.pictures).replace("--", "")
    if not (folder / "dataset.json").is_file():
        folder.parent.mkdir(parents=True, exist_ok=True)
        commit_comparison.run_once(commit_comparison.ROOT, ["simulate", *step.pictures, "-o", str(folder), "--device", device])
    return folder


def _point(step: Step, folder: Path, *, device: str) -> Point:
    with tempfile.TemporaryDirectory(prefix="rhizotwin-scaling-") as working:
        words = ["reconstruct", str(folder), *step.words, "-o", str(Path(working) / "result"), "--device", device]
        used = commit_comparison.run_once(commit_comparison.ROOT, words)
    value = load_truth(folder).traits["total_length_mm"] / 1000.0 if step.value is None else step.value
    return Point(value=value, cpu_s=used.cpu_s, memory_mib=used.memory_mib)
