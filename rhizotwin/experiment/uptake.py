"""Net uptake of ions from the nutrient solution, per root length and time.

The net uptake between two readings is the decrease of the amount (concentration times volume) in the canister. The mean
uptake rate per root length is the uptake divided by the time and the mean root length. If the root length grows
exponentially from L1 to L2, its mean is (L2 - L1) / ln(L2 / L1) (Williams 1948, Australian Journal of Scientific
Research B 1:333). Between scans, the root length is assumed to grow exponentially.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, log

import numpy as np
from numpy.typing import NDArray
from scipy.special import exprel

from rhizotwin.experiment.compare import Observation
from rhizotwin.experiment.growth_page import NO_TREATMENT
from rhizotwin.experiment.measured import IN_90
from rhizotwin.experiment.readings import STORED_UNITS, Reading, unit_of
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.trait_table import csv_text, format_exact

Array = NDArray[np.float64]

COLUMNS = 4
"""Number of panels per row of the figure."""
HEAD = (
    *("plant", "treatment", "ion", "from_day", "to_day", "depletion_umol", "depletion_low", "depletion_high"),
    *("mean_length_m", "uptake_umol_per_m_day", "uptake_low", "uptake_high"),
)
"""Columns of the table of uptake."""


@dataclass(frozen=True, kw_only=True)
class Uptake:
    """Net uptake of an ion by a plant between two readings."""

    plant: str
    """Name of the plant."""
    treatment: str
    """Name of the treatment."""
    ion: str
    """Name of the ion."""
    days: tuple[float, float]
    """Days of both readings."""
    depletion_umol: float
    """Decrease of the amount of the ion in the solution, umol. It is negative if the amount increased."""
    depletion_sd_umol: float | None
    """Standard deviation of the decrease, umol. It is None if it is unknown."""
    length_m: float | None = None
    """Mean root length, m. It is None if it is unknown."""
    length_log_sd: float | None = None
    """Standard deviation of the logarithm of the mean root length. It is None if it is unknown."""

    @property
    def depletion_interval(self) -> tuple[float, float] | None:
        """Lower and upper end of the 90 % interval of the decrease, umol. None if its error is unknown."""
        return None if self.depletion_sd_umol is None else _interval(self.depletion_umol, self.depletion_sd_umol)

    @property
    def rate(self) -> float | None:
        """Mean uptake rate, umol per metre of root and day. It is None if the root length is unknown."""
        return None if self.length_m is None else self.depletion_umol / (self.length_m * (self.days[1] - self.days[0]))

    @property
    def rate_interval(self) -> tuple[float, float] | None:
        """Lower and upper end of the 90 % interval of the rate. None if an error is unknown.

        The errors of amounts and of the root length are propagated to first order.
        """
        if self.rate is None or self.length_m is None or self.length_log_sd is None or self.depletion_sd_umol is None:
            return None
        of_amount = self.depletion_sd_umol / (self.length_m * (self.days[1] - self.days[0]))
        return _interval(self.rate, hypot(of_amount, self.rate * self.length_log_sd))


def measure(readings: Sequence[Reading], lengths: Sequence[Observation]) -> list[Uptake]:
    """Compute the uptake of each ion between consecutive readings of a plant.

    An interval in which the solution was renewed has no uptake. The uptake rate requires root lengths on or before the
    first day and on or after the last day of the interval.

    Parameters
    ----------
    readings : sequence of Reading
        Readings of all plants, sorted by plant and day.
    lengths : sequence of Observation
        Total root lengths in mm, sorted by day.
    """
    found = []
    for plant in dict.fromkeys(one.subject.plant for one in readings):
        own = [one for one in readings if one.subject.plant == plant]
        roots = [one for one in lengths if one.plant == plant]
        for ion in dict.fromkeys(name for one in own for name in one.values if name not in STORED_UNITS):
            found += [_with_length(_depletion(before, after, ion), roots) for before, after in _intervals(own, ion)]
    return found


def mean_length(begin: float, end: float, days: Array, lengths: Array) -> float:
    """Return the mean length between two days of roots that grow exponentially between observations.

    Parameters
    ----------
    begin, end : float
        First and last day, between the first and the last observation.
    days, lengths : (N,) arrays
        Days and lengths of the observations, sorted by day.
    """
    inside = days[(days > begin) & (days < end)]
    knots = np.concatenate([[begin], inside, [end]])
    logs = np.interp(knots, days, np.log(lengths))
    steps = np.diff(knots)
    means = np.exp(logs[:-1]) * exprel(np.diff(logs))  # logarithmic mean (L2 - L1) / ln(L2 / L1)
    return float(np.sum(steps * means) / np.sum(steps))


def notes(readings: Sequence[Reading], found: Sequence[Uptake]) -> list[str]:
    """Return sentences on the uptake rates, and on readings from which no rate or interval could be computed."""
    sentences = []
    for ion in dict.fromkeys(one.ion for one in found):
        rates = [(one.rate, one.plant) for one in found if one.ion == ion and one.rate is not None]
        if rates:
            low, high = min(rates)[0], max(rates)[0]
            sentences.append(
                f"uptake of {ion}: {low:.3g} to {high:.3g} umol per metre of root and day ({count(len(rates), 'interval')} of "
                f"{count(len({plant for _, plant in rates}), 'plant')})"
            )
    without_volume = [one for one in readings if "volume" not in one.values and any(name not in STORED_UNITS for name in one.values)]
    if without_volume:
        sentences.append(f"the uptake of {count(len(without_volume), 'reading')} is unknown, because the volume of the solution is missing")
    if lost := [one for one in found if one.length_m is None]:
        plants = ", ".join(dict.fromkeys(one.plant for one in lost))
        sentences.append(
            f"the uptake per root length is unknown in {count(len(lost), 'interval')} ({plants}), because no reliable root length is known "
            "before and after; scan the plants on the days of the readings"
        )
    if [one for one in found if one.depletion_sd_umol is None]:
        sentences.append("uptake without an interval: enter standard deviations in columns such as K_sd_mmol_per_l and volume_sd_ml")
    return sentences


def to_csv(found: Sequence[Uptake]) -> str:
    """Return a CSV table with one row per plant, ion and interval between readings."""
    rows: list[Sequence[str]] = [list(HEAD)]
    for one in found:
        numbers = [
            *(*one.days, one.depletion_umol, *(one.depletion_interval or (None, None))),
            *(one.length_m, one.rate, *(one.rate_interval or (None, None))),
        ]
        rows.append([one.plant, one.treatment, one.ion, *map(format_exact, numbers)])
    return csv_text(rows)


def draw(readings: Sequence[Reading], found: Sequence[Uptake]) -> bytes:
    """Draw the measured solution and the uptake rates against the day, and return the figure as PNG."""
    panels = [*_reading_panels(readings), *_uptake_panels(found)]
    plants = {one.subject.plant: one.subject.treatment for one in readings}
    colours = {treatment: f"C{number % 10}" for number, treatment in enumerate(sorted(set(plants.values())))}
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    drawn = figure(3.6 * columns, 3.0 * rows)
    grid = list(drawn.subplots(rows, columns, squeeze=False).flat)
    for axes, (label, lines) in zip(grid, panels, strict=False):
        axes.set_xlabel("day")
        axes.set_ylabel(label)
        for plant, points in lines.items():
            days, values, low, high = np.array(points).T
            axes.errorbar(days, values, yerr=[values - low, high - values], fmt="o-", capsize=3, color=colours[plants[plant]])
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    if len(colours) > 1:
        for treatment, colour in colours.items():
            grid[0].plot([], [], "o-", color=colour, label=treatment.replace("$", r"\$") or NO_TREATMENT)
        grid[0].legend(fontsize=8)
    return png(drawn, dpi=110)


_Lines = dict[str, list[tuple[float, float, float, float]]]
"""Type of the day, value and ends of the 90 % interval of each point, keyed by plant."""


def _reading_panels(readings: Sequence[Reading]) -> list[tuple[str, _Lines]]:
    panels: dict[str, _Lines] = {}
    for one in readings:
        for quantity, value in one.values.items():
            label = f"{quantity} ({unit_of(quantity)})" if unit_of(quantity) else quantity
            low, high = _interval(value, one.sds.get(quantity, 0.0))
            panels.setdefault(label, {}).setdefault(one.subject.plant, []).append((one.subject.day or 0.0, value, low, high))
    return list(panels.items())


def _uptake_panels(found: Sequence[Uptake]) -> list[tuple[str, _Lines]]:
    panels: dict[str, _Lines] = {}
    for one in found:
        if one.rate is not None:
            low, high = one.rate_interval or (one.rate, one.rate)
            lines = panels.setdefault(f"uptake of {one.ion} (µmol / (m d))", {})
            lines.setdefault(one.plant, []).append((sum(one.days) / 2.0, one.rate, low, high))
    return list(panels.items())


def _interval(value: float, sd: float) -> tuple[float, float]:
    return value - IN_90 * sd, value + IN_90 * sd


def _intervals(own: Sequence[Reading], ion: str) -> list[tuple[Reading, Reading]]:
    """Return the pairs of consecutive readings of an ion, between which the solution was not renewed."""
    parts: list[list[Reading]] = [[]]
    for one in own:
        if one.renewed:
            parts.append([])
        if ion in one.values and "volume" in one.values:
            parts[-1].append(one)
    return [pair for part in parts for pair in pairwise(part)]


def _depletion(before: Reading, after: Reading, ion: str) -> Uptake:
    amounts = [one.values[ion] * one.values["volume"] for one in (before, after)]
    errors = []
    for one in (before, after):
        if ion in one.sds and "volume" in one.sds:
            errors += [one.sds[ion] * one.values["volume"], one.values[ion] * one.sds["volume"]]
    return Uptake(
        plant=before.subject.plant,
        treatment=before.subject.treatment,
        ion=ion,
        days=(before.subject.day or 0.0, after.subject.day or 0.0),
        depletion_umol=1000.0 * (amounts[0] - amounts[1]),
        depletion_sd_umol=1000.0 * hypot(*errors) if len(errors) == 4 else None,
    )


def _with_length(one: Uptake, seen: Sequence[Observation]) -> Uptake:
    """Add the mean root length. Its relative error is that of the lengths, which are assumed to have a common error."""
    days = np.array([point.day for point in seen])
    begin, end = one.days
    if not len(days) or begin < days[0] or end > days[-1]:
        return one
    first = int(np.searchsorted(days, begin, side="right")) - 1
    last = int(np.searchsorted(days, end, side="left"))
    used = seen[first : last + 1]
    lengths = np.array([point.value / 1000.0 for point in used])
    sigmas = np.array([point.log_sigma for point in used])
    mean = mean_length(begin, end, days[first : last + 1], lengths)
    spread = log(mean_length(begin, end, days[first : last + 1], lengths * np.exp(sigmas)) / mean) if sigmas.all() else None
    return replace(one, length_m=mean, length_log_sd=spread)
