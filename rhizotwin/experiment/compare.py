"""Growth statistics: relative growth rates, means with intervals, and comparison of treatments.

The logarithm of a trait of plant i on day t follows a linear mixed model (Laird and Ware 1982, Biometrics 38:963): one
fixed level per day, a fixed effect of the treatment on the mean day and on the daily rate, and a random level and slope
per plant. Treatments are compared between plants, however many times each plant is measured; the t statistic therefore
has (plants - treatments) degrees of freedom (Schluchter and Elashoff 1990, Journal of Statistical Computation and
Simulation 37:69).
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp, log

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from rhizotwin.scenes.errors import UserError

Array = NDArray[np.float64]

SURE = 0.05
"""Significance level for differences between treatments."""
ROUNDING = 1e-12
"""Numerical tolerance: logarithms of equal traits differ by no more than this."""
LEAST_PLANTS = 2
"""Minimum number of plants per treatment."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Value of a trait of one plant on one day."""

    plant: str
    treatment: str
    day: float
    value: float


@dataclass(frozen=True, kw_only=True)
class Point:
    """Mean of a treatment on one day."""

    treatment: str
    day: float
    mean: float
    low: float
    """Lower end of the 90 % interval of the mean, with ``high`` as the upper end; equal to the mean for one plant."""
    high: float
    plants: int


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Coefficient of the model, with its standard error and the degrees of freedom of its t statistic."""

    value: float
    error: float
    dof: int

    @property
    def interval(self) -> tuple[float, float]:
        """90 % interval."""
        reach = float(student.ppf(0.95, self.dof)) * self.error
        return self.value - reach, self.value + reach

    @property
    def p(self) -> float:
        """Two-sided p value of the coefficient.

        Without residual variation it is 0 or 1.
        """
        if self.error <= ROUNDING:
            return 1.0 if abs(self.value) <= ROUNDING else 0.0
        return float(2.0 * student.sf(abs(self.value) / self.error, self.dof))


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference between a treatment and the reference treatment."""

    treatment: str
    against: str
    size: float
    """Ratio of the trait between the treatments on the mean day."""
    size_interval: tuple[float, float]
    """90 % interval."""
    size_p: float
    rate_per_day: float
    """Difference of the relative growth rates."""
    rate_p: float
    plants: int

    @property
    def is_significant(self) -> bool:
        """Whether the sizes differ significantly; the p value of the rate is reported separately."""
        return self.size_p < SURE


def means(seen: Sequence[Observation]) -> list[Point]:
    """Compute the mean of each treatment on each day, with a 90 % interval from the variation among plants."""
    points = []
    for treatment, day in sorted({(one.treatment, one.day) for one in seen}):
        values = np.array([one.value for one in seen if (one.treatment, one.day) == (treatment, day)])
        mean, count = float(values.mean()), len(values)
        reach = float(student.ppf(0.95, count - 1) * values.std(ddof=1) / count**0.5) if count > 1 else 0.0
        points.append(Point(treatment=treatment, day=day, mean=mean, low=mean - reach, high=mean + reach, plants=count))
    return points


def relative_rates(seen: Sequence[Observation]) -> list[tuple[str, float, float, float]]:
    """Return plant, start day, end day and relative growth rate per day.

    The rate is the change of the logarithm divided by the time (Hunt 1982).
    """
    rates = []
    for plant in dict.fromkeys(one.plant for one in seen):
        own = sorted((one for one in seen if one.plant == plant), key=lambda one: one.day)
        rates += [(plant, a.day, b.day, log(b.value / a.value) / (b.day - a.day)) for a, b in pairwise(own)]
    return rates


def _plants(seen: Sequence[Observation]) -> dict[str, set[str]]:
    """Return the plants of each treatment, treatments ordered by name."""
    return {name: {one.plant for one in seen if one.treatment == name} for name in sorted({one.treatment for one in seen})}


def too_few(seen: Sequence[Observation]) -> str:
    """Return the reason why treatments cannot be compared; empty if they can, or if there is only one."""
    plants = _plants(seen)
    few = [name for name, own in plants.items() if len(own) < LEAST_PLANTS]
    if len(plants) < 2 or not few:
        return ""
    return f"treatment {few[0]!r} has {len(plants[few[0]])} plant; each treatment requires at least {LEAST_PLANTS}"


def differences(seen: Sequence[Observation]) -> list[Difference]:
    """Compare each treatment with the first one by name.

    Raises
    ------
    UserError
        If statsmodels is not installed, or a treatment has fewer than two plants.
    """
    if why := too_few(seen):
        raise UserError(why)
    plants = _plants(seen)
    treatments, found = list(plants), []
    for name in treatments[1:]:
        both = [one for one in seen if one.treatment in (treatments[0], name)]
        found.append(_difference(both, against=treatments[0], treatment=name, plants=len(plants[name]) + len(plants[treatments[0]])))
    return found


def _difference(seen: Sequence[Observation], *, against: str, treatment: str, plants: int) -> Difference:
    treated = np.array([one.treatment == treatment for one in seen], np.float64)
    size, rate = effects(seen, treated[:, None])
    low, high = size[0].interval
    return Difference(
        treatment=treatment,
        against=against,
        size=exp(size[0].value),
        size_interval=(exp(low), exp(high)),
        size_p=size[0].p,
        rate_per_day=rate[0].value if rate else 0.0,
        rate_p=rate[0].p if rate else 1.0,
        plants=plants,
    )


def effects(seen: Sequence[Observation], columns: Array) -> tuple[list[Effect], list[Effect]]:
    """Estimate the effect of each covariate on the logarithm of a trait on the mean day, and on its daily rate.

    Parameters
    ----------
    seen : sequence of Observation
        Observations of at least ``C + 2`` plants.
    columns : (N, C) array of float
        Covariates of the plants, such as 1 for treated plants, or a dose.

    Returns
    -------
    tuple of list of Effect
        Effects on the size and on the rate, one per covariate; the second list is empty for a single day.

    Raises
    ------
    UserError
        If statsmodels is not installed.
    """
    day = np.array([one.day for one in seen])
    days = np.unique(day)
    parts = [(day[:, None] == days).astype(np.float64), columns]
    if len(days) > 1:
        parts.append(columns * (day - day.mean())[:, None])
    y, plants = np.log([one.value for one in seen]), [one.plant for one in seen]
    value, error = _fit(y, np.concatenate(parts, axis=1), plants, slopes=day - day.mean() if len(days) > 2 else None)
    count, dof = columns.shape[1], len(set(plants)) - 1 - columns.shape[1]
    found = [Effect(value=float(v), error=float(e), dof=dof) for v, e in zip(value, error, strict=True)][len(days) :]
    return found[:count], found[count:]


def _fit(y: Array, design: Array, plants: Sequence[str], *, slopes: Array | None) -> tuple[Array, Array]:
    """Return the fixed effects and their standard errors.

    With one observation per plant, the random level cannot be estimated. Powell's method is used because the likelihood
    has no gradient where a variance is 0; gradient methods stopped early for four of twelve sets of plants.
    """
    try:
        import statsmodels.api as models
    except ModuleNotFoundError:
        raise UserError("comparing treatments requires statsmodels: pip install 'rhizotwin[experiment]'") from None
    if len(set(plants)) == len(plants):
        fitted = models.OLS(y, design).fit()
        return np.asarray(fitted.params), np.asarray(fitted.bse)
    random = None if slopes is None else np.stack([np.ones(len(y)), slopes / np.std(slopes)], axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # plants that do not differ give a variance at its lower bound, zero
        try:
            fitted = models.MixedLM(y, design, groups=np.asarray(plants), exog_re=random).fit(reml=True, method="powell")
            value, error = np.asarray(fitted.fe_params), np.asarray(fitted.bse_fe)
        except np.linalg.LinAlgError:
            value = error = np.full(design.shape[1], np.nan)
    if np.isfinite(value).all() and np.isfinite(error).all():
        return value, error
    # plants without any variation: the mixed model without a random effect of the plant
    plain = models.OLS(y, design).fit()
    return np.asarray(plain.params), np.asarray(plain.bse)
