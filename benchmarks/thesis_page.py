"""Page that compares the thesis with its re-implemented method and ours, on radishes and a printed phantom."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import accuracy, assumptions, cases, commits, ladder, thesis_figures
from benchmarks.assumptions import CountedVolumes, Level
from benchmarks.cases import Case, Pictures
from benchmarks.output import markdown
from benchmarks.run import Say
from rhizotwin.experiment import mass_curves, thesis_tables
from rhizotwin.scenes.atomic import write_bytes, write_text
from rhizotwin.scenes.table_file import read_table

PHANTOM = Pictures(scene="printed_8ml", image_wh=(400, 300))
"""Pictures on which levels and assumptions are measured."""
_DAYS = (5, 10, 15, 20, 25, 30)
_METHODS = {"thesis": "re-implemented", "coverage": "ours"}

Record = Mapping[str, Any]
Run = tuple[str, int]
"""Method and number of rings of a reconstruction."""


@dataclass(frozen=True, kw_only=True)
class Plant:
    """A radish of the thesis, and the reconstructions of the twin's plant of the same mass."""

    name: str
    day: float
    grams: float
    """Fresh mass of its roots (table A.1), which the twin's plant has at 1 g/ml."""
    thesis_ml: float | None
    """Volume in table 4.1; None for two plants whose cameras could not be localised."""
    runs: Mapping[Run, Record]
    """Records of the ladder."""

    def ml(self, run: Run) -> float | None:
        """Return a reconstructed volume; None if it was not measured."""
        return float(self.runs[run]["score"]["volume_mm3"]) / 1e3 if run in self.runs else None


def plant_cases(profile: str) -> list[Case]:
    """Return the ladder's cases of the 18 radishes by both methods, in one ring and two."""
    return cases.ladder(scenes=("radish_day*",), profiles=(profile,))


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
    return list(accuracy.measure(plant_cases(profile), device=device, say=say).details.values())


def committed_records(profile: str) -> list[Record]:
    """Return the committed records of these cases."""
    names = {case.name for case in plant_cases(profile)}
    return [record for record in ladder.read(ladder.PATH) if record["case"]["name"] in names]


def plants(records: Sequence[Record]) -> list[Plant]:
    """Return the thesis's 18 plants in its order, with the records of the twin's plants."""
    found = []
    masses = read_table(thesis_tables.shipped("kliman_2022_masses.csv"))
    volumes = {row.cells["plant"]: row.cells["volume (ml)"] for row in read_table(thesis_tables.shipped("kliman_2022_volumes.csv"))}
    for number, row in enumerate(masses):
        scene = f"radish_day{_DAYS[number // 3]:02d}{'abc'[number % 3]}"
        name = row.cells["plant"]
        found.append(
            Plant(
                name=name,
                day=float(row.cells["day"]),
                grams=float(row.cells["root_fresh_g"]),
                thesis_ml=float(volumes[name]) if volumes.get(name) else None,
                runs={(one["case"]["method"], one["case"]["rings"]): one for one in records if one["case"]["scene"] == scene},
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
    """Write the page (Markdown) and its figures in the folder `pictures` beside it, and return their paths.

    Parameters
    ----------
    path : Path
        Path of the page; figures get its name with a suffix.
    found : sequence of Plant
        Plants by both methods.
    levels : sequence of Level
        Hulls by voxel.
    counted : sequence of CountedVolumes
        Errors by the thesis's assumptions.
    method : mapping of bytes, optional
        Figures of `thesis_figures.draw`.

    Returns
    -------
    list of Path
        Paths of the page and its figures.
    """
    drawn = {"masses": thesis_figures.masses(), "growth": thesis_figures.growth(_series(found)), **(method or {})}
    if levels:
        drawn |= {"volume_by_level": thesis_figures.volume_by_level(levels), "time_by_level": thesis_figures.time_by_level(levels)}
    files = {name: f"pictures/{path.stem}_{name}.png" for name in drawn}
    for name, picture in drawn.items():
        write_bytes(path.parent / files[name], picture)
    write_text(path, page(found, levels, counted, files))
    return [path, *(path.parent / file for file in files.values())]


def page(found: Sequence[Plant], levels: Sequence[Level], counted: Sequence[CountedVolumes], files: Mapping[str, str]) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    found, levels, counted : sequence
        See `write`.
    files : mapping of str
        Files of the figures: masses (4.1), growth (ours), volume_by_level (3.10) and time_by_level (5.3); circle (3.6),
        silhouettes (3.7), rays (3.8) and carving (3.9) if they were drawn.
    """

    def image(words: str, name: str) -> str:
        return f"![{words}]({files[name]})" if name in files else "Not drawn."

    parts = [
        "# Reproduction of the thesis",
        _INTRODUCTION.format(commit=commits.last_of_reconstruction() or "unknown"),
        "## Table 4.1: volumes and densities",
        _table(found),
        _volumes_text(found),
        _REGULARISED,
        "## Figure 4.1: masses and water content",
        image("Fresh mass, dry mass and water content by day, from table A.1", "masses"),
        _water_text(),
        "## Root volumes by age",
        image("Root volume by age", "growth"),
        "The volumes of the table above, which the thesis does not draw; circles are shifted sideways so that they do not overlap.",
        "## Figure 3.6: cameras and their circle",
        image("Cameras about the canister with the circle of best fit", "circle"),
        _CIRCLE,
        "## Figure 3.7: silhouettes",
        image("Steps of the silhouette of a plant", "silhouettes"),
        _SILHOUETTES,
        "## Figure 3.8: rays through the canister",
        image("Rays of a camera, refracted by wall and water", "rays"),
        "Level rays of one camera. The water outside the outermost rays is invisible to this camera.",
        "## Figure 3.9: progressive carving",
        image("The phantom carved with four sizes of voxels", "carving"),
        "## Figure 3.10: volume of the printed phantom by level",
        image("Volume of the printed phantom by voxel", "volume_by_level"),
        _PRINT,
        _extents(levels) if levels else "Not measured.",
        "## Figure 5.3: time by level",
        image("Time by voxel", "time_by_level"),
        _levels(levels) if levels else "Not measured.",
        _TIMES,
        "## Effect of the assumptions",
        _ASSUMPTIONS,
        assumptions.table(counted) if counted else "Not measured.",
        _CONCLUSIONS,
    ]
    return "\n\n".join(parts) + "\n"


_INTRODUCTION = """\
This page compares the results of the [thesis](index.md#the-thesis) with those of its re-implemented method
(`rhizotwin/scoring/baselines.py`) and of the method of rhizotwin ("ours"). T3.4.2 denotes section 3.4.2 of the thesis. The
plants are simulated: their roots have the masses of table A.1 at 1 g/ml, so that the true density is 1 g/ml.

`./run bench thesis --committed -o docs/thesis.md` makes this page. Table 4.1 states the commit at which it was
measured. All other numbers that are not those of the thesis were measured when the page was made, at commit
`{commit}` (the last that changed the reconstruction), unless stated otherwise."""

_REGULARISED = """\
The thesis tried the regularised visual hull as a remedy for lost thin roots; it made large boxes (figure 5.2) and at
least doubled the time, and the thesis proposes to limit it to the neighbourhood of the hull (T5.3).
`rhizotwin reconstruct --method regularised` does this. With correct silhouettes (bench, one ring of 40 pictures of 800x600,
commit `4b79c14c`, [log](log/silhouettes-from-coverage.md#regularised-visual-hull)),
the strict intersection of `radish_day15b` has an error of -27 %
and 514 parts, regularised +4.5 % and 2 parts; that of `radish_day05a` has -10 % and 59 parts, regularised +36 % and 1
part. The parts are joined, but the volume is not reliable."""

_CIRCLE = """\
Phantom (bench, 40 pictures of 400x300). The thesis shows on the left a failed localisation, with one row of markers
and 200 pictures, and on the right a proper one, with two rows and 40 pictures; both estimate each pose from its own
picture. The distances are root mean squares. On the twin, one row of markers increases them, but the localisation
does not fail. The thesis calls its localisation accurate to microns (T5.2), but attributes the error of its phantom
to poor poses (figure 3.10)."""

_SILHOUETTES = """\
Part of a picture of `radish_day15b` (bench, 800x600), with the error of the area that it covers. As the thesis
states (T3.4.2), the threshold loses thin roots and the edges lose the inside of thick ones. Both together contain all
roots, but wider. According to T3.4.2, the last filter, an opening, removes holes in thin roots and thickens them, so
it opens the background; our re-implementation opens the roots, which cannot widen them, and may have less excess than
the thesis. The thesis's figure shows the whole canister; here, as in its carving, only pixels that show water count."""

_PRINT = """\
The thesis computes 7.13 ml for its real phantom of 8 ml after nine iterations, -11 %, and attributes this to poor
poses, aggressive culling of voxels, and a clipped top. It does not state the voxel of an iteration.

Dimensions of the same hulls with the finest voxel, from their outermost voxels as in T3.5. The thesis states an
accuracy of about 4 % for its phantom:"""

_TIMES = """\
Processor time (summed over the cores) of carving alone, of the phantom (clean, 40 pictures of 400x300). The line of
the thesis contains no data: T5.3 states roughly a day, and about four times the time per iteration; its pictures have
800x600 pixels, and it names no computer for the day.

**Octree and regular grid.** According to T5.3, a fixed grid instead of the octree takes almost 16 days instead of a
day, and T3.4.4 also names memory. The table shows the same for our carving: the octree has a small fraction of the
grid's voxels, and its advantage grows with the resolution. The last column is the ratio of the times. The volumes of
octree and grid, both by the thesis's method, are equal up to a few voxels, so that the octree loses nothing. The
thesis stores its octree in a dictionary, which it states to be almost 10 times faster to access than a tree; ours
consists of arrays."""

_ASSUMPTIONS = """\
Volume error of the printed phantom (clean, 40 pictures of 400x300) by the method of the thesis with one or more
assumptions changed; the first row is the thesis's own. Poses: from each picture alone, with two rows of markers or
one, or from the whole scan jointly. Outlines: Otsu's threshold combined with Sobel edges and opened, as in the
thesis; the threshold alone (dark), opened; or coverage. Views in which a voxel is invisible carve it, as in the
thesis, or are ignored. The last three columns differ in the treatment of voxels that are partly inside: kept as in
the thesis, weighted by their fraction inside, or dropped. The pictures of the thesis have twice the resolution, with
which the excess is smaller ([accuracy](accuracy.md))."""

_CONCLUSIONS = """\
**The silhouettes determine the sign of the error.** Sobel edges are on both sides of an outline, so that combining
them with the threshold widens every root by about a pixel. Without the edges, the threshold and the opening lose
parts of thin roots, and the strict intersection keeps only voxels in all 40 silhouettes: the error is negative, as in
the thesis (-11 %). The thesis attributes its error to aggressive culling because of poor poses, and to the clipped
top. Here the error remains negative with joint poses, so that poses are not the main cause. That edges widened the
roots of its radishes, which are one or two pixels wide, is our conclusion.

**The treatment of partial voxels determines the size of the error.** The row of markers, joint poses and the rule for
blind views matter less for this phantom, which is in the middle of the canister and visible in every view. The
radishes have not been computed with other assumptions."""


def _runs(found: Sequence[Plant]) -> list[Run]:
    """Return the methods and numbers of rings that were measured for any plant, the thesis's method first."""
    measured = {run for one in found for run in one.runs}
    return [(method, rings) for method in _METHODS for rings in (1, 2) if (method, rings) in measured]


def _words(run: Run) -> str:
    return f"{_METHODS[run[0]]}, {run[1]} ring{'s' * (run[1] > 1)}"


def _table(found: Sequence[Plant]) -> str:
    """Return table 4.1 with our columns, and the commits at which they were measured."""
    runs = _runs(found)
    known = ladder.commits_of([record for one in found for record in one.runs.values()])
    head = ["plant", "day", "mass (g)", "thesis (ml)", "g/ml"]
    for run in runs:
        head += [f"{_words(run)} (ml)", *(["90 % interval (ml)"] if run[0] == "coverage" else []), "g/ml"]
    head += ["commit"] if len(known) > 1 else []
    rows = []
    for one in found:
        cells = [one.name, f"{one.day:g}", f"{one.grams:.4f}", *_both(one, one.thesis_ml, digits=3)]
        for run in runs:
            volume, density = _both(one, one.ml(run), digits=4)
            cells += [volume, *([_interval(one.runs.get(run))] if run[0] == "coverage" else []), density]
        cells += [", ".join(f"`{commit}`" for commit in ladder.commits_of(list(one.runs.values()))) or "-"] if len(known) > 1 else []
        rows.append(cells)
    return markdown(" | ".join(head), rows) + (f"\n\nMeasured at commit `{known[0]}`." if len(known) == 1 else "")


def _both(one: Plant, volume_ml: float | None, *, digits: int) -> tuple[str, str]:
    """Return a volume and its density as text."""
    return ("-", "-") if volume_ml is None else (f"{volume_ml:.{digits}f}", f"{one.grams / volume_ml:.3f}")


def _interval(record: Record | None) -> str:
    ends = None if record is None else record["score"]["volume_interval_mm3"]
    return "-" if ends is None else " to ".join(f"{end / 1e3:.4f}" for end in ends)


def _volumes_text(found: Sequence[Plant]) -> str:
    """Return the text below table 4.1."""
    times = [one.thesis_ml / one.grams for one in found if one.thesis_ml is not None]
    density = sum(1.0 / one for one in times) / len(times)
    lines = [
        "Radishes (clean, 40 pictures of 800x600 per ring); one ring is the plan of the library's scenes. The thesis has no "
        "volumes for radishes 17 and 18, because their camera poses were faulty (appendix D). Densities are masses divided by "
        f"volumes; T4.2.2 describes the reciprocal. The volumes of the thesis in ml are {min(times):.0f} to {max(times):.0f} times "
        f"the masses in g. Their mean density is {density:.3f} g/ml, as it states, which is {100.0 * density:.0f} % of that of "
        "water and not the 10 % of its text."
    ]
    for run in _runs(found):
        own = [(one, one.runs[run]["score"]) for one in found if run in one.runs]
        ratios = [score["volume_mm3"] / 1e3 / one.grams for one, score in own]
        if run[0] == "thesis":
            lines.append(f"{_words(run).capitalize()}: {min(ratios):.0f} to {max(ratios):.0f} times the true volume ({len(own)} plants).")
        else:
            ends = [(score["volume_interval_mm3"], one.grams) for one, score in own if score["volume_interval_mm3"] is not None]
            held = sum(low <= 1e3 * grams <= high for (low, high), grams in ends)
            most = 100.0 * max(abs(ratio - 1.0) for ratio in ratios)
            text = f"; {held} of {len(ends)} intervals contain the true volume" if ends else ""
            lines.append(f"{_words(run).capitalize()}: the largest error is {most:.1f} % ({len(own)} plants){text}.")
    lines.append(
        "These pictures are free of errors of the rig, so the excess is caused by the method, mainly by its silhouettes "
        "([below](#effect-of-the-assumptions)). The thesis names blobs in the silhouettes of complex roots, extraneous voxels, "
        "aggressive culling of voxels and optical distortion (T4.2.2)."
    )
    return "\n".join(lines)


def _water_text() -> str:
    """Return the text below figure 4.1: water contents in the thesis's text and in its table."""
    curves = mass_curves.measure(mass_curves.read([thesis_tables.shipped("kliman_2022_masses.csv")])[0])

    def means(part: str) -> str:
        first, *later = [point.mean for point in curves[part, "water"]]
        return f"{first:.1f} % on day 5, and {min(later):.1f} to {max(later):.1f} % from day 10 on"

    return (
        "Drawn from table A.1 as the thesis's figure: mean of three plants per day, here with its 90 % interval. Text and table "
        "of the thesis differ. Shoots contain 92 to 94 % water according to T4.2.1; in the table, the means of the days are "
        f"{means('shoot')}. "
        f"For roots, the text states 96 to 97 %, the table {means('root')}. "
        f"For whole plants they agree: roughly 92 % in the beginning and 94 to 96 % later, and in the table {means('plant')}. "
        "The percentages and densities that tables A.1 and 4.1 print follow from their masses and volumes."
    )


def _extents(levels: Sequence[Level]) -> str:
    finest = levels[-1]
    rows = []
    for number, true in enumerate(finest.true_extents_mm):
        lengths = (one.extents_mm[number] for one in (finest.thesis, finest.ours))
        rows.append(["xyz"[number], f"{true:.1f}", *(f"{mm:.1f} | {100.0 * (mm / true - 1.0):+z.1f} %" for mm in lengths)])
    return markdown("axis | true (mm) | re-implemented (mm) | error | our hull (mm) | error", rows)


def _levels(levels: Sequence[Level]) -> str:
    titles = "voxel (mm) | our hull (ml) | s | re-implemented (ml) | s | octree voxels | grid voxels | grid (ml) | grid s | grid / octree"
    rows = []
    for one in levels:
        theirs = one.thesis
        full = ("-", "-", "-")
        if theirs.grid_cpu_s is not None and theirs.grid_ml is not None:
            full = (f"{theirs.grid_ml:.2f}", f"{theirs.grid_cpu_s:.2f}", f"{theirs.grid_cpu_s / theirs.cpu_s:.1f}")
        cells = (f"{one.voxel_mm:g}", f"{one.ours.ml:.2f}", f"{one.ours.cpu_s:.2f}", f"{theirs.ml:.2f}", f"{theirs.cpu_s:.2f}")
        rows.append((*cells, f"{theirs.voxels:,}", f"{one.grid_voxels:,}", *full))
    return markdown(titles, rows)


def _series(found: Sequence[Plant]) -> dict[str, list[tuple[float, float]]]:
    """Return the series of volumes by age, without empty ones."""
    volumes: dict[str, list[tuple[float, float | None]]] = {
        "true: fresh mass at 1 g/ml": [(one.day, one.grams) for one in found],
        "thesis, table 4.1": [(one.day, one.thesis_ml) for one in found],
        **{_words(run): [(one.day, one.ml(run)) for one in found] for run in _runs(found)},
    }
    return {name: [(day, ml) for day, ml in points if ml is not None] for name, points in volumes.items()}
