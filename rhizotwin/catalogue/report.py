"""HTML report of a catalogue: plants, missed scans, and control charts of rig parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from rhizotwin.catalogue import export, schema
from rhizotwin.catalogue.store import SCAN_OF_RESULT, Catalogue
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.experiment.drift import RIG_NUMBERS, SIGMAS, Chart, chart_of
from rhizotwin.experiment.phantom import LEAST_MM, measure_wires
from rhizotwin.scenes import atomic, html_page
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.html_page import escape, table
from rhizotwin.scenes.trait_table import csv_text, format_exact

PAGE, TABLE = "catalogue.html", "drift.csv"


@dataclass(frozen=True, kw_only=True)
class DriftPoint:
    """Value of a rig parameter in one scan."""

    result: str
    """Path of the result, as stored in the catalogue."""
    day: float
    """Time in days since the first scan. If any scan has no date, it is the age of the plant for all scans."""
    value: float


def rig_history(catalogue: Catalogue) -> dict[str, list[DriftPoint]]:
    """Return the time series of all rig parameters, keyed by parameter name.

    Each scan contributes only the most recently added uncorrected result, because repeated values would narrow the
    control limits.

    Raises
    ------
    UserError
        If a date is invalid.
    """
    rows = catalogue.rows(
        "SELECT n.name, x.path, n.value FROM rig_numbers n JOIN results x ON x.id = n.result WHERE x.corrected = 0 AND NOT EXISTS"
        f" (SELECT 1 FROM results y WHERE {SCAN_OF_RESULT.format('y')} = {SCAN_OF_RESULT.format('x')} AND y.corrected = 0 AND y.id > x.id)"
        " ORDER BY x.date, x.day, x.path"
    )
    days = _days(catalogue)
    found: dict[str, list[DriftPoint]] = {}
    for row in rows:
        if row["path"] in days:
            found.setdefault(row["name"], []).append(DriftPoint(result=row["path"], day=days[row["path"]], value=row["value"]))
    return found


def _days(catalogue: Catalogue) -> dict[str, float]:
    """Return the time of each result, in days since the first scan, keyed by stored path.

    If a scan has no date, it is the age of the plant for all results. Results without an age are then omitted.
    """
    rows = catalogue.rows(
        "SELECT x.path, coalesce(nullif(x.date, ''), s.date, '') AS date, x.day FROM results x LEFT JOIN scans s ON s.id = x.scan"
    )
    try:
        dates = {row["path"]: date.fromisoformat(row["date"]) for row in rows if row["date"]}
    except ValueError as error:
        raise schema.damaged(catalogue.path, error) from None
    if len(dates) == len(rows):
        return {path: float((day - min(dates.values())).days) for path, day in dates.items()}
    return {row["path"]: row["day"] for row in rows if row["day"] is not None}


def wire_history(catalogue: Catalogue, phantom: str, wires_mm: Sequence[float]) -> dict[str, list[DriftPoint]]:
    """Return one time series for each wire of a phantom.

    Its values are the ratio of the measured to the true cross-section of the wire.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    phantom : str
        Name of the phantom in the list of plants.
    wires_mm : sequence of float
        True diameters of the wires.

    Raises
    ------
    UserError
        If the catalogue has no such plant, or the folder or the time of a result is missing.
    """
    catalogue.plant(phantom)
    days = _days(catalogue)
    found: dict[str, list[DriftPoint]] = {}
    for result in (one for one in catalogue.chosen_results() if phantom in one.plants):
        stored = catalogue.stored_path(result.path)
        if stored not in days:
            advice = f"give every scan a date, or the scans of {phantom} a day, and add their results again"
            raise UserError(f"{result.path}: the time of the scan is unknown; {advice}")
        for wire in measure_wires(result.path, wires_mm):
            if wire.length_mm >= LEAST_MM:
                point = DriftPoint(result=stored, day=days[stored], value=1.0 + wire.error)
                found.setdefault(f"cross-section of the {wire.diameter_mm:g} mm wire, measured / true", []).append(point)
    return found


def charts(history: Mapping[str, Sequence[DriftPoint]]) -> dict[str, Chart]:
    """Return the control charts of all time series, with the keys of ``history``."""
    return {name: chart_of([one.day for one in points], [one.value for one in points]) for name, points in history.items()}


def sentences(drawn: Mapping[str, Chart]) -> list[str]:
    """Return the messages about control charts.

    There is one message for each chart with points outside the control limits, and one for each trend.
    """
    found = []
    for heading, chart in _ordered(drawn):
        if chart.limits is not None and chart.outside:
            days = ", ".join(f"{chart.times[i]:g}" for i in chart.outside)
            low, high = chart.limits
            found.append(f"{heading}: outside the control limits ({low:.4g} to {high:.4g}) on day {days}")
        if chart.has_trend:
            found.append(f"{heading}: changes by {chart.slope_per_day:+.3g} per day (p = {chart.slope_p:.2g})")
    return found


def write(catalogue: Catalogue, output: Path, *, phantom: str | None = None, wires_mm: Sequence[float] = ()) -> list[str]:
    """Write the HTML report and the table of rig parameters to a new folder.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    output : Path
        New folder.
    phantom : str or None
        Name of a phantom whose wires are included in the control charts.
    wires_mm : sequence of float
        True diameters of the phantom's wires.

    Returns
    -------
    list of str
        Messages about points outside the control limits and about trends.

    Raises
    ------
    UserError
        If the folder is not empty or cannot be written, or the phantom is unknown.
    """
    history = rig_history(catalogue)
    if phantom is not None:
        history |= wire_history(catalogue, phantom, wires_mm)
    drawn = charts(history)
    found = sentences(drawn)
    with new_folder(output) as building:
        atomic.write_text(building / PAGE, page(catalogue, drawn, found))
        atomic.write_text(building / TABLE, _csv(history, drawn))
    return found or [
        "all rig parameters are within their control limits and without a trend" if drawn else "no result has rig parameters yet"
    ]


def page(catalogue: Catalogue, drawn: Mapping[str, Chart], found: Sequence[str]) -> str:
    """Return the HTML report of a catalogue.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    drawn : mapping of Chart
        Control charts from `charts`.
    found : sequence of str
        Messages from `sentences`.
    """
    title = catalogue.path.stem
    parts = [f"<h1>{escape(title)}</h1>", f"<p>{_counts(catalogue)}</p>", "<h2>Plants</h2>", _plants(catalogue)]
    if missed := list_visits(catalogue, state="missed"):
        rows = [(one.plant, one.due_utc, one.note) for one in missed]
        parts += ["<h2>Missed scans</h2>", table(rows, head=("plant", "due (UTC)", "reason"))]
    parts.append("<h2>The rig over time</h2>")
    if drawn:
        caption = (
            "Each point is a scan. The solid line is the mean, and the dashed lines are control limits at "
            f"{SIGMAS:g} standard deviations, estimated from the mean moving range (individuals control chart). Points outside the limits "
            "are red."
        )
        picture = html_page.image("png", draw(drawn), "control charts")
        parts += [html_page.figure(picture, caption), f"<div class=out>{html_page.items(found)}</div>"]
    else:
        parts.append("<p>No result has rig parameters yet.</p>")
    return html_page.document(title, *parts)


def draw(drawn: Mapping[str, Chart]) -> bytes:
    """Draw the control charts, and return the picture as PNG."""
    shown = _ordered(drawn)
    columns = min(2, len(shown))
    rows = -(-len(shown) // columns)
    made = figure(6.0 * columns, 2.6 * rows)
    for axes, (heading, chart) in zip(made.subplots(rows, columns, squeeze=False).flat, shown, strict=False):
        axes.plot(chart.times, chart.values, "o-", color="#1f5fa8", markersize=4, linewidth=0.8)
        axes.axhline(chart.centre, color="#444444", linewidth=0.8)
        for limit in chart.limits or ():
            axes.axhline(limit, color="#444444", linewidth=0.8, linestyle="--")
        axes.plot([chart.times[i] for i in chart.outside], [chart.values[i] for i in chart.outside], "o", color="#b00020", markersize=6)
        axes.set_title(heading, fontsize=9)
        axes.set_xlabel("day", fontsize=8)
        axes.tick_params(labelsize=8)
    for axes in made.axes[len(shown) :]:
        axes.set_axis_off()
    return png(made, dpi=110)


def _ordered(drawn: Mapping[str, Chart]) -> list[tuple[str, Chart]]:
    """Return the control charts with their headings, rig parameters first and wires last."""
    headings = {number.name: number.heading for number in RIG_NUMBERS}
    names = [*(name for name in headings if name in drawn), *(name for name in drawn if name not in headings)]
    return [(headings.get(name, name), drawn[name]) for name in names]


def _counts(catalogue: Catalogue) -> str:
    counts = {name: len(export.table(catalogue, name).rows) for name in ("plants", "scans", "results", "masses", "readings")}
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _plants(catalogue: Catalogue) -> str:
    scans, results = catalogue.scans(), catalogue.results()
    rows = [
        (
            *(one.name, one.species, one.treatment, one.sown),
            str(sum(one.name in scan.plants for scan in scans)),
            str(sum(one.name in result.plants for result in results)),
        )
        for one in catalogue.plants()
    ]
    return table(rows, head=("plant", "species", "treatment", "sown", "scans", "results"))


def _csv(history: Mapping[str, Sequence[DriftPoint]], drawn: Mapping[str, Chart]) -> str:
    rows: list[Sequence[str]] = [["number", "result", "day", "value", "low", "high", "beyond"]]
    for name, points in history.items():
        low, high = drawn[name].limits or (None, None)
        for one in points:
            beyond = "" if low is None or high is None else "no" if low <= one.value <= high else "yes"
            rows.append([name, one.result, f"{one.day:g}", format_exact(one.value), format_exact(low), format_exact(high), beyond])
    return csv_text(rows)
