"""Curves of fresh mass, dry mass and water content against time, as in figure 4.1 of the thesis.

Masses are read from tables of weighed masses (`rhizotwin.experiment.masses`) and from tables written by ``biomass
predict``. If both tables contain a mass of the same plant and day, the weighed mass is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, log
from pathlib import Path

from rhizotwin.experiment import falls
from rhizotwin.experiment.compare import Observation, Point, means
from rhizotwin.experiment.growth_page import limit_axis, plot_curve
from rhizotwin.experiment.masses import BALANCE_G, KINDS, ORGANS, Weighed, has_masses, read_masses
from rhizotwin.experiment.measured import IN_90
from rhizotwin.scenes import assessment, subject, table_file
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.trait_table import csv_text, format_exact

_PREDICTED = {"plant", "day", "mass", "mass (g)"}
QUANTITIES = {"fresh": "wet mass (g)", "dry": "dry mass (g)", "water": "water content (%)"}
"""Axis label of each plotted quantity."""
PARTS = (*ORGANS, "plant")
"""Parts of a plant for which masses are plotted. ``plant`` is the sum of root and shoot."""


@dataclass(frozen=True, kw_only=True)
class Masses:
    """Masses of a plant on one day."""

    plant: str
    """Name of the plant."""
    day: float
    """Day of the experiment."""
    treatment: str
    """Name of the treatment."""
    grams: Mapping[str, float]
    """Masses in g, keyed by kind of mass, such as ``root_fresh``."""
    log_sigma: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of the logarithm of predicted masses, keyed by kind of mass."""

    def value(self, part: str, quantity: str) -> float | None:
        """Return a quantity of a part of the plant.

        ``quantity`` is a key of `QUANTITIES`, and the value is None if a required mass is unknown.
        """
        if quantity == "water":
            fresh, dry = self.value(part, "fresh"), self.value(part, "dry")
            return None if fresh is None or dry is None else 100.0 * (1.0 - dry / fresh)
        if part != "plant":
            return self.grams.get(f"{part}_{quantity}")
        both = [self.grams.get(f"{organ}_{quantity}") for organ in ORGANS]
        return None if any(one is None for one in both) else sum(one for one in both if one is not None)


Curves = Mapping[tuple[str, str], Sequence[Point]]
"""Type of the mean curves, keyed by part and quantity."""


def is_of_masses(path: Path) -> bool:
    """Return whether a file is a table of weighed or predicted masses."""
    if path.suffix.lower() != ".csv":
        return False
    head = _head(path)
    return head >= _PREDICTED or has_masses(head)


def read(paths: Sequence[Path], treatments: Mapping[str, str] | None = None) -> tuple[list[Masses], list[str]]:
    """Read tables of masses.

    Predicted masses that are not reliable, and masses without a plant or day, are excluded. A row without a treatment
    has the treatment of the other rows of its plant.

    Parameters
    ----------
    paths : sequence of Path
        Tables of weighed masses (g), and tables written by ``biomass predict``.
    treatments : mapping of str to str, optional
        Treatments that are known from results, keyed by plant name.

    Returns
    -------
    list of Masses, list of str
        One entry per plant and day, and sentences about masses that are excluded or extrapolated, and about plants
        whose mass falls.

    Raises
    ------
    UserError
        If a table is damaged, a mass is listed twice, or a plant has two treatments.
    """
    predicted = [path for path in paths if _head(path) >= _PREDICTED]
    rows = [row for path in predicted for row in table_file.read_table(path)]
    weighed = [one for path in paths if path not in predicted for one in read_masses(path, balance_g=BALANCE_G)]
    known = {plant: name for plant, name in (treatments or {}).items() if name}
    grams: dict[tuple[str, float], dict[str, float]] = {}
    errors: dict[tuple[str, float], dict[str, float]] = {}
    undated = 0
    for group in (_read_predicted(rows), weighed):  # weighed masses replace predicted ones
        listed: set[tuple[str, float, str]] = set()
        for one in group:
            plant, day, treatment = one.subject.plant, one.subject.day, one.subject.treatment
            if not plant or day is None:
                undated += 1
                continue
            if treatment and known.setdefault(plant, treatment) != treatment:
                raise UserError(f"{one.where}: plant {plant} has two treatments, {known[plant]!r} and {treatment!r}; correct one of them")
            for kind in one.grams:
                if (plant, day, kind) in listed:
                    raise UserError(f"{one.where}: the mass {kind} of plant {plant} on day {day:g} is listed twice; remove one of them")
                listed.add((plant, day, kind))
            grams.setdefault((plant, day), {}).update(one.grams)
            errors.setdefault((plant, day), {}).update(dict.fromkeys(one.grams, one.log_sigma))
    masses = [
        Masses(plant=plant, day=day, treatment=known.get(plant, ""), grams=own, log_sigma=errors[plant, day])
        for (plant, day), own in grams.items()
    ]
    notes = [f"{count(undated, 'row')} of masses without a plant or day cannot be used for curves; enter plant and day"] if undated else []
    return masses, [*_notes(rows), *notes, *falls.sentences(_falls(masses))]


def _falls(masses: Sequence[Masses]) -> dict[str, list[falls.Fall]]:
    """Return the falls of the mass of plants that were weighed on several days, keyed by kind of mass with its unit."""
    found = {}
    for kind in KINDS:
        weighed = [one for one in sorted(masses, key=lambda one: one.day) if kind in one.grams]
        sizes = [
            Observation(
                plant=one.plant, treatment=one.treatment, day=one.day, value=one.grams[kind], log_sigma=one.log_sigma.get(kind, 0.0)
            )
            for one in weighed
        ]
        found[f"{kind}_g"] = falls.find_falls(sizes)
    return found


def measure(masses: Sequence[Masses]) -> Curves:
    """Compute the mean of each part and quantity on each day, with its 90 % interval."""
    curves = {}
    for part in PARTS:
        for quantity in QUANTITIES:
            seen = [
                Observation(plant=one.plant, treatment=one.treatment, day=one.day, value=value)
                for one in masses
                if (value := one.value(part, quantity)) is not None
            ]
            if seen:
                curves[part, quantity] = means(seen, most=100.0 if quantity == "water" else inf)
    return curves


def to_csv(curves: Curves) -> str:
    """Return a CSV table with one row per part, quantity, treatment and day."""
    rows: list[list[str]] = [["part", "quantity", "treatment", "day", "mean", "low", "high", "plants"]]
    for (part, quantity), points in curves.items():
        for point in points:
            numbers = [format_exact(value) for value in (point.day, point.mean, point.low, point.high)]
            rows.append([part, QUANTITIES[quantity], point.treatment, *numbers, str(point.plants)])
    return csv_text(rows)


def draw(curves: Curves) -> bytes:
    """Draw fresh mass, dry mass and water content against time, and return the figure as PNG.

    The style is that of figure 4.1 of the thesis.
    """
    colours, marks = dict(zip(PARTS, ("#8c510a", "#1b7837", "#333333"), strict=True)), "osD^v"
    shown = [quantity for quantity in QUANTITIES if any(key[1] == quantity for key in curves)]
    drawn = figure(4.2 * len(shown), 3.6)
    treatments = sorted({point.treatment for points in curves.values() for point in points})
    parts = [part for part in PARTS if any(key[0] == part for key in curves)]
    for axes, quantity in zip(drawn.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        for part in parts:
            points = curves.get((part, quantity), ())
            for number, treatment in enumerate(treatments):
                own = [point for point in points if point.treatment == treatment]
                label = f"{part}, {treatment}" if len(treatments) > 1 else part
                plot_curve(axes, own, label=label, marker=marks[number % len(marks)], color=colours[part])
        axes.set_xlabel("day")
        axes.set_ylabel(QUANTITIES[quantity])
        if quantity != "water":
            limit_axis(axes, [point for key, own in curves.items() if key[1] == quantity for point in own])
    drawn.axes[0].legend()
    return png(drawn, dpi=110)


def _head(path: Path) -> set[str]:
    return set(table_file.read_table(path)[0].cells)


def _read_predicted(rows: Sequence[table_file.Row]) -> list[Weighed]:
    found = []
    for row in rows:
        kind = row.cells.get("mass", "")
        grams = table_file.number(row, "mass (g)")
        if kind not in KINDS or grams is None or not grams > 0.0:
            raise UserError(f"{row.where}: the row is not a predicted mass; specify a table written by 'rhizotwin biomass predict'")
        low, high = (table_file.number(row, f"{end} (g)") for end in ("low", "high"))
        log_sigma = log(high / low) / (2.0 * IN_90) if low is not None and high is not None and 0.0 < low <= high else 0.0
        if not _is_unreliable(row):
            whose = subject.from_cells(row.cells, row.where)
            found.append(Weighed(where=row.where, subject=whose, grams={kind: grams}, residue_g={}, log_sigma=log_sigma))
    return found


def _is_unreliable(row: table_file.Row) -> bool:
    return row.cells.get("verdict") == "not reliable"


def _notes(rows: Sequence[table_file.Row]) -> list[str]:
    """Return sentences about predicted masses that are excluded, because they are not reliable, or extrapolated."""
    reasons = [f"the {row.cells.get('from', 'trait')} is not reliable" for row in rows if _is_unreliable(row)]
    notes = [assessment.left_out("predicted mass", reasons, total=len(rows))] if reasons else []
    if beyond := sum(row.cells.get("extrapolated") == "yes" and not _is_unreliable(row) for row in rows):
        notes.append(f"predicted mass: {beyond} of {len(rows)} values are extrapolated; weigh plants of this size for the model")
    return notes
