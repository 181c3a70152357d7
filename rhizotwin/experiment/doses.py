"""Dose response of traits to the ion concentrations of the nutrient solution.

The model is that of `compare`, with concentrations instead of a treatment. The logarithm of a trait is the sum of a
level per day and a slope times the concentration. Ions whose concentrations are correlated have a common slope, because
their effects cannot be separated. Linearity is tested with the squared concentrations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import NDArray

from rhizotwin.experiment.compare import SURE, TABLE_ROUNDING, Observation, effects, reason_not_estimable
from rhizotwin.experiment.measured import Measured
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.solution import UNIT

Array = NDArray[np.float64]

MOST_SHARED = 0.9
"""Maximum squared correlation between the concentrations of two ions whose effects are fitted separately. It is
equivalent to a variance inflation factor of 10 (Marquardt 1970, Technometrics 12:591)."""


@dataclass(frozen=True, kw_only=True)
class Response:
    """Response of a trait to the concentration of an ion."""

    ion: str
    """Name of the ion."""
    with_ions: tuple[str, ...]
    """Other ions of the group, whose concentrations are correlated with the concentration of this ion."""
    range_mmol: tuple[float, float]
    """Minimum and maximum concentration of the ion, mmol/l."""
    slope: float
    """Slope of the trait's logarithm on the mean day with respect to the concentration, l/mmol."""
    slope_interval: tuple[float, float]
    """Lower and upper end of the 90 % interval of the slope, l/mmol."""
    slope_p: float
    """p value of the slope."""
    rate: float
    """Slope of the relative growth rate with respect to the concentration, l/mmol/day. It is zero if there is a single
    day."""
    rate_p: float
    """p value of the slope ``rate``."""
    curvature_p: float | None
    """p value of the quadratic term of the concentration. It is None if an ion has only two concentrations, or if there
    are too few plants or common days."""
    levels: int
    """Number of different concentrations of the ion."""
    plants: int
    """Number of plants."""

    @property
    def change(self) -> float:
        """Ratio of the trait at the highest concentration to the trait at the lowest concentration."""
        return exp(self.slope * (self.range_mmol[1] - self.range_mmol[0]))

    def sentence(self, trait: str) -> str:
        """Return a sentence that describes the response of a trait to the ion."""
        least, most = self.range_mmol
        low, high = (100.0 * (exp(end * (most - least)) - 1.0) for end in self.slope_interval)
        beside = f" (together with {', '.join(self.with_ions)})" if self.with_ions else ""
        return (
            f"{trait}: {100.0 * (self.change - 1.0):+.0f} % from {least:.3g} to {most:.3g} {UNIT} {self.ion}{beside} on the mean day "
            f"(90 % interval {low:+.0f} to {high:+.0f} %, p = {self.slope_p:.2g}, {self.plants} plants); {self._shape}."
        )

    @property
    def _shape(self) -> str:
        if self.curvature_p is None:
            return "linearity could not be tested"
        bent = (
            "the response is not linear, so that the slope is an average"
            if self.curvature_p < SURE
            else "no deviation from linearity was found"
        )
        return f"{bent} (p = {self.curvature_p:.2g})"


def read_doses(plants: Mapping[str, Sequence[Measured]]) -> dict[str, Mapping[str, float]]:
    """Return the ion concentrations in mmol/l, keyed by plant name.

    Plants with an unknown nutrient solution are omitted.

    Raises
    ------
    UserError
        If the solution of a plant differs between days.
    """
    found: dict[str, Mapping[str, float]] = {}
    for plant, days in plants.items():
        known = [one for one in days if one.ions]
        for one in known[1:]:
            for ion in {*one.ions, *known[0].ions}:
                if not _are_equal(one.ions.get(ion, 0.0), known[0].ions.get(ion, 0.0)):
                    raise UserError(
                        f"plant {plant} has two nutrient solutions. {known[0].name} and "
                        f"{one.name} differ in {ion}; use the same solution on all days of a plant"
                    )
        if known:
            found[plant] = known[0].ions
    return found


def group_ions(doses: Mapping[str, Mapping[str, float]]) -> list[tuple[str, ...]]:
    """Group the ions whose concentrations differ between plants. Ions with correlated concentrations form one group.

    The first ion of a group has the largest range of concentration relative to its mean.
    """
    ions = list(dict.fromkeys(ion for own in doses.values() for ion in own))
    table = {ion: np.array([own.get(ion, 0.0) for own in doses.values()]) for ion in ions}
    varying = [ion for ion, values in table.items() if not _are_equal(float(values.min()), float(values.max()))]
    varying.sort(key=lambda ion: -float(np.ptp(table[ion]) / table[ion].mean()))
    groups: list[list[str]] = []
    for ion in varying:
        shared = [np.corrcoef(table[ion], table[group[0]])[0, 1] ** 2 for group in groups]
        if shared and max(shared) > MOST_SHARED:
            groups[int(np.argmax(shared))].append(ion)
        else:
            groups.append([ion])
    return [tuple(group) for group in groups]


def fit_responses(seen: Sequence[Observation], doses: Mapping[str, Mapping[str, float]]) -> list[Response]:
    """Fit the responses of a trait to all groups of ions jointly.

    Parameters
    ----------
    seen : sequence of Observation
        Values of the trait. Plants without concentrations are ignored.
    doses : mapping
        Ion concentrations of each plant by name of the plant, mmol/l.

    Returns
    -------
    list of Response
        One response per group of ions. Empty if there is a reason against a fit (`reason_not_fitted`).

    Raises
    ------
    UserError
        If statsmodels is not installed.
    """
    if reason_not_fitted(seen, doses):
        return []
    known, groups, dose = _concentrations(seen, doses)
    size, rate = effects(known, dose)
    levels = [len(np.unique(np.round(column / column.max(), 6))) for column in dose.T]
    bends = _curvatures(known, dose) if min(levels) > 2 else [None] * len(groups)
    return [
        Response(
            ion=group[0],
            with_ions=group[1:],
            range_mmol=(float(dose[:, k].min()), float(dose[:, k].max())),
            slope=size[k].value,
            slope_interval=size[k].interval,
            slope_p=size[k].p,
            rate=rate[k].value if rate else 0.0,
            rate_p=rate[k].p if rate else 1.0,
            curvature_p=bends[k],
            levels=levels[k],
            plants=len({one.plant for one in known}),
        )
        for k, group in enumerate(groups)
    ]


def reason_not_fitted(seen: Sequence[Observation], doses: Mapping[str, Mapping[str, float]]) -> str:
    """Return the reason why no dose response can be fitted to a trait. It is empty if it can be fitted.

    The parameters are those of `fit_responses`.
    """
    known, groups, dose = _concentrations(seen, doses)
    if not groups:
        return "no two plants with a reliable value have different concentrations; scan plants of several nutrient solutions"
    if not _are_independent(dose):
        return "the concentrations of the ions are collinear; vary the salts independently in more plants"
    why = reason_not_estimable(known, dose)
    return f"plants with different concentrations {why}" if why else ""


def _concentrations(
    seen: Sequence[Observation], doses: Mapping[str, Mapping[str, float]]
) -> tuple[list[Observation], list[tuple[str, ...]], Array]:
    """Return the observations (N,) with concentrations, the groups of ions (C,), and the concentrations (N, C)."""
    known = [one for one in seen if one.plant in doses]
    groups = group_ions({one.plant: doses[one.plant] for one in known})
    dose = [[doses[one.plant].get(group[0], 0.0) for group in groups] for one in known]
    return known, groups, np.array(dose, np.float64).reshape(len(known), len(groups))


def partial_residuals(seen: Sequence[Observation], doses: Mapping[str, Mapping[str, float]], responses: Sequence[Response]) -> Array:
    """Compute the partial residuals of dose responses. They are plotted together with the fitted responses.

    Parameters
    ----------
    seen : sequence of Observation
        Values of the trait.
    doses : mapping
        Ion concentrations of each plant by name of the plant, mmol/l.
    responses : sequence of Response
        Fitted responses of the trait.

    Returns
    -------
    (R, P, 2) array of float
        Concentration, mmol/l, and relative size of each plant for each response. The relative size is the ratio of the
        trait to its mean on the same days, corrected for the other responses.
    """
    known = [one for one in seen if one.plant in doses]
    day_mean = {day: np.mean([np.log(one.value) for one in known if one.day == day]) for day in {one.day for one in known}}
    plants = list(dict.fromkeys(one.plant for one in known))
    size = np.array([np.mean([np.log(one.value) - day_mean[one.day] for one in known if one.plant == plant]) for plant in plants])
    dose = np.array([[doses[plant].get(one.ion, 0.0) for plant in plants] for one in responses])
    explained = np.array([one.slope for one in responses])[:, None] * (dose - dose.mean(axis=1, keepdims=True))
    return np.stack([dose, np.exp(size - explained.sum(axis=0) + explained)], axis=2)


def _curvatures(seen: Sequence[Observation], dose: Array) -> list[float | None]:
    """Return the p value of the squared concentration of each group of ions.

    The values are None if they cannot be estimated.
    """
    count = dose.shape[1]
    both = np.concatenate([dose, (dose - dose.mean(axis=0)) ** 2], axis=1)
    if reason_not_estimable(seen, both):
        return [None] * count
    return [one.p for one in effects(seen, both)[0][count:]]


def _are_independent(columns: Array) -> bool:
    """Return whether the columns (N, C) and a constant column are linearly independent."""
    scaled = (columns - columns.mean(axis=0)) / columns.std(axis=0)
    return int(np.linalg.matrix_rank(scaled, tol=TABLE_ROUNDING * len(scaled) ** 0.5)) == columns.shape[1]


def _are_equal(a: float, b: float) -> bool:
    return abs(a - b) <= TABLE_ROUNDING * max(abs(a), abs(b))
