"""Output folder of `rhizotwin timelapse tips`: tables and figure of the motion of root tips."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rhizotwin.experiment import motion
from rhizotwin.experiment.measured import IN_90
from rhizotwin.experiment.motion import Motion, TipTrack
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.folders import new_folder
from rhizotwin.stored import result_files

MOST_NAMED = 10
"""Number of tracks up to which they have colours and a legend, one for each colour of matplotlib."""


def find_sources(sources: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the result folders and the datasets among sources, which are such folders, or contain them.

    Raises
    ------
    UserError
        If a source is neither.
    """
    results, scans = list[Path](), list[Path]()
    for source in sources:
        found = [source] if (source / "dataset.json").is_file() else sorted(path.parent for path in source.glob("[!.]*/dataset.json"))
        if found:
            scans += found
        elif source.is_dir():
            results += result_files.results_in([source])
        else:
            raise UserError(f"{source} is neither a result, nor a dataset, nor a folder of them")
    return results, scans


def write(
    results: Sequence[Path], scans: Sequence[Path], output: Path, *, say: Callable[[str], object] = lambda _: None
) -> tuple[str, ...]:
    """Measure the motion of root tips, write the output folder atomically, and return the findings as sentences.

    Parameters
    ----------
    results, scans : sequence of Path
        Results of full scans, and datasets, see `motion.measure`.
    output : Path
        New or empty folder for ``tips.csv``, ``tracks.csv`` and ``tips.png``.
    say : callable
        Function that is called with a line of text for each scan.

    Raises
    ------
    UserError
        If there is nothing to measure, or the folder cannot be written.
    """
    with new_folder(output) as building:
        moved = motion.measure(results, scans, say=say)
        atomic.write_text(building / "tips.csv", motion.tips_csv(moved))
        atomic.write_text(building / "tracks.csv", motion.tracks_csv(moved))
        atomic.write_bytes(building / "tips.png", draw(moved))
    return (*(_sentence(track) for track in moved.tracks), *moved.notes)


def _sentence(track: TipTrack) -> str:
    rate = 24.0 * track.length.mean_rate
    half = 24.0 * IN_90 * track.length.mean_rate_sigma
    said = f"{track.plant}, root {track.root}: {rate:.2f} mm/day (90 % interval {rate - half:.2f} to {rate + half:.2f})"
    if (nutation := track.nutation) is None:
        return f"{said}; no circumnutation"
    long_mm, short_mm = nutation.radii_mm
    return f"{said}; circumnutation with a period of {nutation.period_h:.2f} h on an ellipse of {long_mm:.2f} by {short_mm:.2f} mm"


def draw(moved: Motion) -> bytes:
    """Draw the tracks from above, the angle to gravity and the elongation over time, and return the figure as PNG."""
    drawn = figure(12.6, 4.2)
    above, angles, rates = drawn.subplots(1, 3)
    few = len(moved.tracks) <= MOST_NAMED
    for number, track in enumerate(moved.tracks):
        style = {"color": f"C{number}" if few else "C0", "label": f"{track.plant}, root {track.root}".replace("$", r"\$")}
        x, y = (axis.value - axis.value[0] for axis in track.position[:2])
        above.plot(x, y, linewidth=1.0, **style)
        above.plot(*(track.points_mm - [axis.value[0] for axis in track.position])[:, :2].T, ".", markersize=2, color=style["color"])
        for axes, value, sigma in (
            (angles, track.angle.value, np.hypot(track.angle.value_sigma, motion.SIGMA_DEG)),
            (rates, 24.0 * track.length.rate, 24.0 * track.length.rate_sigma),
        ):
            axes.plot(track.hours, value, linewidth=1.0, **style)
            if few:
                axes.fill_between(
                    track.hours, value - IN_90 * sigma, value + IN_90 * sigma, alpha=0.15, color=style["color"], linewidth=0.0
                )
    above.set_aspect("equal", "datalim")
    above.set_xlabel("x from the first scan (mm)")
    above.set_ylabel("y from the first scan (mm)")
    above.set_title("tips from above")
    for axes, name in ((angles, "angle to gravity (deg)"), (rates, "elongation (mm/day)")):
        axes.set_xlabel("time (h)")
        axes.set_ylabel(name)
    if few:
        above.legend(fontsize="small")
    return png(drawn, dpi=110)
