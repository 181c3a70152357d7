"""Comparison of the thesis's results with its re-implemented method and ours, on radishes and a printed phantom.

These are table 4.1, and figures 3.10 (volume by level of the octree), 4.1 (growth) and 5.3 (time by level).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import accuracy, assumptions, gate
from benchmarks.assumptions import CountedVolumes, Level
from benchmarks.cases import Case, Pictures, ladder
from benchmarks.run import Say
from rhizotwin.experiment import tables
from rhizotwin.scenes.atomic import write_bytes, write_text
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.specimens import GrownSpecimen

PHANTOM = Pictures(scene="printed_8ml", image_wh=(400, 300))
"""Pictures on which levels and assumptions are measured."""
PRINT_ML, THESIS_PRINT_ML = 8.0, 7.13
"""True volume of the printed phantom, and that found in the thesis after nine levels (figure 3.10)."""
THESIS_DAY_S, THESIS_VOXEL_MM, THESIS_FACTOR = 86400.0, 0.27, 4.0
"""Time at the finest level (about a day), its voxel, and the factor of time per level (T5.3, figure 5.3)."""
BASELINE = Path(__file__).with_name("baseline_accuracy.json")
"""Committed baseline of the whole ladder."""
_DAYS = (5, 10, 15, 20, 25, 30)
_COLOURS = {"thesis": "#b2182b", "re-implemented": "#ef8a62", "ours": "#2166ac", "true": "0.3"}

Record = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Plant:
    """A radish of the thesis, and the twin's plant of the same mass."""

    name: str
    day: float
    grams: float
    """Fresh mass of its roots (table A.1), which the twin's plant has at 1 g/ml."""
    thesis_ml: float | None
    """Volume in table 4.1; None for two lost plants."""
    redone: Record | None
    """Score of the thesis's re-implemented method; None if it was not run."""
    ours: Record | None


def plant_cases(profile: str) -> list[Case]:
    """Return the ladder's cases of the 18 radishes by both methods."""
    return ladder(scenes=("radish_day*",), profiles=(profile,))


def measure(profile: str, *, device: str, say: Say, only_kept: bool) -> list[Record]:
    """Score the radishes by both methods; earlier measurements are reused.

    Parameters
    ----------
    profile : str
        Disturbances of the pictures.
    device : str
        Computing device.
    say : Say
        Receives the progress.
    only_kept : bool
        Whether to use earlier measurements only.

    Returns
    -------
    list of dict
        One record per plant and method.
    """
    if only_kept:
        found = [accuracy.load_record(case, device=device) for case in plant_cases(profile)]
        return [record for record in found if record is not None]
    return list(accuracy.measure(plant_cases(profile), device=device, say=say, projection=False).details.values())


def committed_records(profile: str) -> list[Record]:
    """Return the radishes' volumes by both methods from the ladder's committed baseline, without intervals."""
    metrics = gate.read_baseline(BASELINE).values
    found: list[Record] = []
    for case in plant_cases(profile):
        error = metrics.get(f"{case.name}/volume_error")
        specimen = case.pictures.scene_to_render().specimen
        if error is not None and isinstance(specimen, GrownSpecimen):
            score = {"volume_mm3": 1000.0 * specimen.volume_ml * (1.0 + error), "volume_interval_mm3": None}
            found.append({"case": {"scene": case.pictures.scene, "method": case.method}, "score": score})
    return found


def plants(records: Sequence[Record]) -> list[Plant]:
    """Return the thesis's 18 plants in its order, with the records of the twin's plants."""
    by = {(record["case"]["scene"], record["case"]["method"]): record["score"] for record in records}
    found = []
    masses = tables.read_table(tables.shipped("kliman_2022_masses.csv"))
    volumes = {row.cells["plant"]: row.cells["volume (ml)"] for row in tables.read_table(tables.shipped("kliman_2022_volumes.csv"))}
    for number, row in enumerate(masses):
        scene = f"radish_day{_DAYS[number // 3]:02d}{'abc'[number % 3]}"
        name = row.cells["plant"]
        found.append(
            Plant(
                name=name,
                day=float(row.cells["day"]),
                grams=float(row.cells["root_fresh_g"]),
                thesis_ml=float(volumes[name]) if volumes.get(name) else None,
                redone=by.get((scene, "thesis")),
                ours=by.get((scene, "coverage")),
            )
        )
    return found


def write(
    path: Path,
    found: Sequence[Plant],
    levels: Sequence[Level],
    counted: Sequence[CountedVolumes],
    method: Mapping[str, bytes] | None = None,
) -> list[Path]:
    """Write the page (Markdown) and its figures beside it, and return their paths.

    Parameters
    ----------
    path : Path
        Path of the page; figures get its name with a suffix.
    found : sequence of Plant
        Plants by both methods.
    levels : sequence of Level
        Volume and time by voxel.
    counted : sequence of CountedVolumes
        Errors by the thesis's assumptions.
    method : mapping of bytes, optional
        Figures of `thesis_figures.draw`.

    Returns
    -------
    list of Path
        Paths of the page and its figures.
    """
    figures: dict[str, Callable[[Any], None]] = {
        "volume_by_level": lambda axis: _volume_by_level(axis, levels),
        "time_by_level": lambda axis: _time_by_level(axis, levels),
        "growth": lambda axis: _growth(axis, found),
    }
    made = []
    for name, draw in figures.items():
        if name != "growth" and not levels:
            continue
        drawn = figure(6.4, 4.0)
        draw(drawn.subplots())
        made.append(path.with_name(f"{path.stem}_{name}.png"))
        write_bytes(made[-1], png(drawn, dpi=130))
    for name, picture in (method or {}).items():
        made.append(path.with_name(f"{path.stem}_{name}.png"))
        write_bytes(made[-1], picture)
    figures |= dict.fromkeys(method or {}, lambda _: None)
    write_text(path, page(found, levels, counted, figures={name: f"{path.stem}_{name}.png" for name in figures}))
    return [path, *made]


def page(found: Sequence[Plant], levels: Sequence[Level], counted: Sequence[CountedVolumes], *, figures: Mapping[str, str]) -> str:
    """Return the page.

    Parameters
    ----------
    found : sequence of Plant
        Plants by both methods.
    levels : sequence of Level
        Volume and time by voxel.
    counted : sequence of CountedVolumes
        Errors by the thesis's assumptions.
    figures : mapping of str
        Files of the figures: volume_by_level (3.10), time_by_level (5.3), growth (4.1); circle (3.6), rays (3.8) and
        carving (3.9) if they were drawn.

    Returns
    -------
    str
        Markdown.
    """
    parts = [
        "# Reproduction of the thesis",
        "R. Kliman, *Design of a robotic platform for plant root imaging and biomass estimation*, Georgia Institute of Technology, 2022, "
        "compared with its re-implemented method (`rhizotwin/baselines.py`) and ours. The plants are simulated: roots with masses of "
        "table A.1 at 1 g/ml, so that the true density is 1 g/ml.",
        "## Table 4.1: volumes and densities",
        _table(found),
        "## Figure 4.1: growth",
        f"![Root volume by age]({figures['growth']})",
        *_method(figures),
        "## Figure 3.10: volume of the printed phantom by level",
        f"![Volume of the printed phantom by voxel]({figures['volume_by_level']})" if levels else "Not measured.",
        "## Figure 5.3: time by level",
        f"![Time by voxel]({figures['time_by_level']})\n\n{_levels(levels)}" if levels else "Not measured.",
        "## Effect of the assumptions",
        "Volume of the printed phantom (40 pictures of 400x300) relative to the true one, minus 1, by the thesis's method with one or more "
        "assumptions changed; the first row is the thesis's own.",
        assumptions.table(counted) if counted else "Not measured.",
    ]
    return "\n\n".join(parts) + "\n"


def _method(figures: Mapping[str, str]) -> list[str]:
    """Return the available figures of the method."""
    titles = {"circle": "3.6: cameras and their circle", "rays": "3.8: rays through the canister", "carving": "3.9: progressive carving"}
    return [
        part for name, title in titles.items() if name in figures for part in (f"## Figure {title}", f"![Figure {title}]({figures[name]})")
    ]


def _table(found: Sequence[Plant]) -> str:
    head = ("plant", "day", "mass (g)", "thesis (ml)", "g/ml", "re-implemented (ml)", "g/ml", "ours (ml)", "90 % interval (ml)", "g/ml")
    rows = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for one in found:
        ends = None if one.ours is None else one.ours["volume_interval_mm3"]
        interval = "-" if ends is None else " to ".join(f"{end / 1e3:.4f}" for end in ends)
        redone, ours = _ml(one.redone), _ml(one.ours)
        cells = (one.name, f"{one.day:g}", f"{one.grams:.4f}", *_both(one, one.thesis_ml), *_both(one, redone), *_both(one, ours)[:1])
        rows.append("| " + " | ".join((*cells, interval, _both(one, ours)[1])) + " |")
    return "\n".join(rows)


def _ml(score: Record | None) -> float | None:
    return None if score is None else float(score["volume_mm3"]) / 1e3


def _both(one: Plant, volume_ml: float | None) -> tuple[str, str]:
    """Return a volume and its density as text."""
    return ("-", "-") if volume_ml is None else (f"{volume_ml:.4f}", f"{one.grams / volume_ml:.3f}")


def _levels(levels: Sequence[Level]) -> str:
    rows = ["| voxel (mm) | re-implemented (ml) | s | our hull (ml) | s |", "|---|---|---|---|---|"]
    rows += [f"| {one.voxel_mm:g} | {one.thesis_ml:.2f} | {one.thesis_s:.2f} | {one.ours_ml:.2f} | {one.ours_s:.2f} |" for one in levels]
    return "\n".join(rows)


def _volume_by_level(axis: Any, levels: Sequence[Level]) -> None:
    voxels = [one.voxel_mm for one in levels]
    axis.plot(voxels, [one.thesis_ml for one in levels], "o-", color=_COLOURS["re-implemented"], label="its method, re-implemented")
    axis.plot(voxels, [one.ours_ml for one in levels], "o-", color=_COLOURS["ours"], label="our hull, before trimming")
    axis.axhline(PRINT_ML, color=_COLOURS["true"], linewidth=0.8, label="true")
    axis.plot([THESIS_VOXEL_MM], [THESIS_PRINT_ML], "s", color=_COLOURS["thesis"], label="thesis, its real phantom")
    _by_voxel(axis, "volume (ml)")


def _time_by_level(axis: Any, levels: Sequence[Level]) -> None:
    voxels = [one.voxel_mm for one in levels]
    depth = [round(voxel / THESIS_VOXEL_MM).bit_length() - 1 for voxel in voxels]
    axis.plot(
        voxels, [THESIS_DAY_S / THESIS_FACTOR**one for one in depth], "s--", color=_COLOURS["thesis"], label="thesis (GPU), as stated"
    )
    axis.plot(voxels, [one.thesis_s for one in levels], "o-", color=_COLOURS["re-implemented"], label="its method, our carving")
    axis.plot(voxels, [one.ours_s for one in levels], "o-", color=_COLOURS["ours"], label="ours")
    _by_voxel(axis, "time of the carving (s)")


def _by_voxel(axis: Any, title: str) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.invert_xaxis()
    axis.set_xlabel("edge of the finest voxel (mm)")
    axis.set_ylabel(title)
    axis.grid(visible=True, which="both", alpha=0.25)
    axis.legend(fontsize=8)


def _growth(axis: Any, found: Sequence[Plant]) -> None:
    series: dict[str, list[tuple[float, float | None]]] = {
        "true": [(one.day, one.grams) for one in found],
        "thesis": [(one.day, one.thesis_ml) for one in found],
        "re-implemented": [(one.day, _ml(one.redone)) for one in found],
        "ours": [(one.day, _ml(one.ours)) for one in found],
    }
    words = {"true": "true: fresh mass at 1 g/ml", "thesis": "thesis, table 4.1"}
    for number, (name, points) in enumerate(series.items()):
        known = [(day, value) for day, value in points if value is not None]
        if known:
            days, values = zip(*known, strict=True)
            axis.plot([day + 0.5 * (number - 1.5) for day in days], values, "o", ms=4, color=_COLOURS[name], label=words.get(name, name))
    axis.set_yscale("log")
    axis.set_xlabel("age (days)")
    axis.set_ylabel("root volume (ml)")
    axis.grid(visible=True, alpha=0.25)
    axis.legend(fontsize=8)
