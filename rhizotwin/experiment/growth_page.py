"""Figures and HTML page of growth curves, in the style of figure 4.1 of the thesis.

A growth curve shows the mean on each day with its 90 % interval, with one line per treatment.
"""

from collections.abc import Mapping, Sequence
from math import log
from typing import TYPE_CHECKING, Any

import numpy as np

from rhizotwin.experiment.compare import SURE, Difference, Point
from rhizotwin.experiment.doses import Response, partial_residuals
from rhizotwin.experiment.drift import BY_NAME, Chart, effect_of
from rhizotwin.experiment.growth import Growth
from rhizotwin.scenes import html_page
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.solution import UNIT
from rhizotwin.scenes.trait_table import COLOUR, DEFINITIONS, SHOOT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEADINGS = {definition.name: definition.heading for definition in (*DEFINITIONS, *SHOOT, *COLOUR)}
NO_TREATMENT = "plants without a treatment"
MOST_SHOWN = 3.0
"""Largest end of the axis of a curve, relative to the largest mean. Intervals of two plants can be ten times wider."""


def draw(growth: Growth) -> bytes:
    """Draw the growth curves and return the figure as PNG."""
    drawn = figure(4.2 * len(growth.curves), 3.6)
    treatments = sorted({point.treatment for points in growth.curves.values() for point in points})
    for axes, (trait, points) in zip(drawn.subplots(1, len(growth.curves), squeeze=False)[0], growth.curves.items(), strict=True):
        for treatment in treatments:  # also without points, so that a treatment has the same colour in all axes
            own = [point for point in points if point.treatment == treatment]
            plot_curve(axes, own, label=treatment or (NO_TREATMENT if len(treatments) > 1 else "all plants"), marker="o")
        axes.set_xlabel("day")
        axes.set_ylabel(_HEADINGS[trait])
        limit_axis(axes, points)
    drawn.axes[0].legend()
    return png(drawn, dpi=110)


def limit_axis(axes: "Axes", points: Sequence[Point]) -> None:
    """Let the axis of sizes begin at 0 and end at most at `MOST_SHOWN` times the largest mean."""
    axes.set_ylim(0.0, min(axes.get_ylim()[1], MOST_SHOWN * max(point.mean for point in points)))


def plot_curve(axes: "Axes", points: Sequence[Point], *, label: str, **style: Any) -> None:
    """Plot the means of a curve against the day, with their 90 % intervals.

    Parameters
    ----------
    axes : Axes
        Axes of the figure.
    points : sequence of Point
        Means with their intervals.
    label : str
        Text of the legend, in which dollar signs do not enclose a formula.
    **style : object
        Further arguments of ``Axes.errorbar``, such as the colour.
    """
    text = label.replace("$", r"\$")
    text = f" {text}" if text.startswith("_") else text  # the legend omits texts that begin with an underscore
    mean = [point.mean for point in points]
    reach = [[point.mean - point.low for point in points], [point.high - point.mean for point in points]]
    axes.errorbar([point.day for point in points], mean, yerr=reach, capsize=3, label=text, **style)


def draw_responses(growth: Growth) -> bytes:
    """Draw the dose responses, and return the figure as PNG.

    The figure has one row per group of ions and one dot per plant.
    """
    many = max(len(one) for one in growth.responses.values())
    drawn = figure(4.2 * len(growth.responses), 3.6 * many)
    grid = drawn.subplots(many, len(growth.responses), squeeze=False)
    for column, (trait, responses) in zip(grid.T, growth.responses.items(), strict=True):
        points = partial_residuals(growth.seen[trait], growth.doses, responses)
        for axes, one, (dose, size) in zip(column, responses, points.transpose(0, 2, 1), strict=False):
            axes.plot(dose, size, "o", label="plants")
            x = np.linspace(*one.range_mmol, 50)
            away = x - dose.mean()
            axes.plot(x, np.exp(one.slope * away), label="fit")
            ends = np.exp(np.outer(one.slope_interval, away))
            axes.fill_between(x, ends.min(axis=0), ends.max(axis=0), alpha=0.2, label="90 % interval of the slope")
            axes.set_xlabel(f"{', '.join((one.ion, *one.with_ions))}: {one.ion} ({UNIT})")
            axes.set_ylabel(f"{trait} relative to the mean of the day")
    drawn.axes[0].legend()
    return png(drawn, dpi=110)


def page(growth: Growth | None, masses: bytes | None = None, solution: bytes | None = None, notes: Sequence[str] = ()) -> str:
    """Return the HTML page with growth curves, comparisons, tracked roots and excluded values.

    Parameters
    ----------
    growth : Growth or None
        Measured growth. None if the page only shows masses or the nutrient solution.
    masses : bytes, optional
        Figure of masses as PNG, see `mass_curves.draw`.
    solution : bytes, optional
        Figure of the nutrient solution as PNG, see `uptake.draw`.
    notes : sequence of str
        Sentences about masses and about the uptake of nutrients.
    """
    parts = []
    if growth is not None:
        parts.append(f"<h1>Growth of {len(growth.plants)} plants</h1>")
        if growth.curves:
            parts.append(
                _figure("growth curves", draw(growth), "Mean of the plants on each day with its 90 % interval; wide intervals are cut.")
            )
        else:
            parts.append("<p>No trait is reliable enough for a curve.</p>")
        if growth.responses:
            caption = (
                "Size of each plant relative to the mean of its days against the concentration of the ion, corrected for the other ions."
            )
            parts.append("<h2>Dose response</h2>" + _figure("dose responses", draw_responses(growth), caption))
        parts.append(html_page.items(sentences(growth)))
    if masses is not None:
        caption = "Fresh mass, dry mass and water content: mean of the plants on each day with its 90 % interval; wide intervals are cut."
        parts.append("<h1>Masses</h1>" + _figure("mass curves", masses, caption))
    if solution is not None:
        caption = "Readings of each plant's solution, and net uptake per root length between readings, with their 90 % intervals."
        parts.append("<h1>Nutrient solution</h1>" + _figure("nutrient solution", solution, caption))
    if notes:
        parts.append(html_page.items(notes))
    return html_page.document("Growth", *parts)


def _figure(name: str, picture: bytes, caption: str) -> str:
    return html_page.figure(html_page.image("png", picture, name), caption)


def drift_cautions(charts: Mapping[str, Chart], trait: str, size: float) -> list[str]:
    """Return a caution for each quantity of the rig whose drift could explain a difference between treatments.

    Parameters
    ----------
    charts : mapping of Chart
        Control charts of the rig during the experiment, by name of the quantity.
    trait : str
        Name of the trait.
    size : float
        Ratio of the trait between the treatments.
    """
    found = []
    for name, chart in charts.items():
        factor = effect_of(chart, BY_NAME[name], trait)
        if factor > 1.0 and abs(log(factor)) >= abs(log(size)):
            change = 100.0 * chart.change / chart.centre
            found.append(
                f"{trait}: caution: the {BY_NAME[name].heading.partition(',')[0].partition(' (')[0]} changed by {change:.2g} % during the "
                f"experiment, which could change the {trait} by {100.0 * (factor - 1.0):.2g} %, as much as the treatments differ; "
                "compare plants that were scanned at the same time (see 'rhizotwin catalogue report')."
            )
    return found


def sentences(growth: Growth) -> list[str]:
    """Return the findings on growth, treatments and dose responses as sentences."""
    found = _comparison(growth, growth.compared, growth.responses)
    without = _comparison(growth, growth.compared_without, growth.responses_without)
    found += [f"without {', '.join(growth.suspects)}: {sentence}" for sentence in without]
    for plant, tracked in growth.tracked.items():
        often = sum(len(track.states) > 1 for track in tracked.tracks)
        found.append(f"plant {plant}: {len(tracked.tracks)} roots on {len(tracked.days)} days, {often} of them found on more than one day.")
    return found + list(growth.notes)


def _comparison(growth: Growth, differences: Mapping[str, Sequence[Difference]], responses: Mapping[str, Sequence[Response]]) -> list[str]:
    found = []
    for trait, compared in differences.items():
        for one in compared:
            low, high = (100.0 * (end - 1.0) for end in one.size_interval)
            apart = "differs" if one.is_significant else "does not differ significantly"
            against = repr(one.against) if one.against else NO_TREATMENT
            found.append(
                f"{trait}: {one.treatment!r} {apart} from {against}: {100.0 * (one.size - 1.0):+.0f} % on the mean day "
                f"(90 % interval {low:+.0f} to {high:+.0f} %, p = {one.size_p:.2g}); difference of the relative growth rate "
                f"{one.rate_per_day:+.3f} per day (p = {one.rate_p:.2g}); significance level {SURE:g}."
            )
            found += drift_cautions(growth.drift, trait, one.size) if one.is_significant else []
    return found + [one.sentence(trait) for trait, own in responses.items() for one in own]
