"""Growth statistics: relative growth rates, means with intervals, and comparison of treatments.

The logarithm of a trait of plant i on day t follows a linear mixed model (Laird and Ware 1982, Biometrics 38:963). The
fixed effects are a level per day, the effect of the treatment on the level on the mean day, and its effect on the daily
rate. The random effects are a level and a slope per plant. The plants are the statistical units, however many times
each plant is measured. The t statistic of a difference between treatments therefore has (plants - treatments) degrees
of freedom (Schluchter and Elashoff 1990, Journal of Statistical Computation and Simulation 37:69), or (observations -
fixed effects) if this is less.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp, inf, log

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from rhizotwin.scenes.errors import UserError, pip_install

Array = NDArray[np.float64]

SURE = 0.05
"""Significance level for differences between treatments."""
ROUNDING = 1e-12
"""Magnitude up to which a difference of logarithms, or its standard error, is regarded as zero."""
TABLE_ROUNDING = 1e-6
"""Relative difference up to which numbers are regarded as equal. It exceeds the rounding errors of tables, which
contain seven digits."""
LEAST_PLANTS = 2
"""Minimum number of plants per treatment for a comparison."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Value of a trait of one plant on one day."""

    plant: str
    """Name of the plant."""
    treatment: str
    """Name of the treatment."""
    day: float
    """Day of the experiment."""
    value: float
    """Value of the trait."""
    log_sigma: float = 0.0
    """Standard deviation of the logarithm of the value. It is zero if it is unknown."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """Mean of a trait over the plants of a treatment on one day."""

    treatment: str
    """Name of the treatment."""
    day: float
    """Day of the experiment."""
    mean: float
    """Mean over the plants."""
    low: float
    """Lower end of the 90 % interval of the mean, positive. It is equal to the mean if there is a single plant."""
    high: float
    """Upper end of the 90 % interval of the mean."""
    plants: int
    """Number of plants."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Estimated coefficient of the model with its uncertainty."""

    value: float
    """Estimate of the coefficient."""
    error: float
    """Standard error of the coefficient."""
    dof: int
    """Degrees of freedom of the t statistic."""

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 90 % interval of the coefficient."""
        reach = float(student.ppf(0.95, self.dof)) * self.error
        return self.value - reach, self.value + reach

    @property
    def p(self) -> float:
        """Two-sided p value of the coefficient.

        If the standard error is zero, the p value is 1 for a coefficient of zero, and 0 otherwise.
        """
        if self.error <= ROUNDING:
            return 1.0 if abs(self.value) <= ROUNDING else 0.0
        return float(2.0 * student.sf(abs(self.value) / self.error, self.dof))


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of a trait between a treatment and the reference treatment."""

    treatment: str
    """Name of the treatment."""
    against: str
    """Name of the reference treatment."""
    size: float
    """Ratio of the trait in the treatment to the trait in the reference treatment, on the mean day."""
    size_interval: tuple[float, float]
    """Lower and upper end of the 90 % interval of the ratio ``size``."""
    size_p: float
    """p value of the ratio ``size``."""
    rate_per_day: float
    """Difference between the relative growth rates in the treatment and in the reference treatment, 1/day."""
    rate_p: float
    """p value of the difference ``rate_per_day``."""
    plants: int
    """Total number of plants in both treatments."""

    @property
    def is_significant(self) -> bool:
        """Whether the ratio of the trait differs significantly from 1. The growth rate is not taken into account."""
        return self.size_p < SURE


def means(seen: Sequence[Observation], *, most: float = inf) -> list[Point]:
    """Compute the mean of a trait for each treatment and day.

    Its 90 % interval is computed from the variation among plants, on the scale of the logarithm (of the logit, if the
    values have an upper limit), so that it is inside the limits of the values. For three plants with a lognormal
    variation of 80 %, it contains the true mean in 87 % of 20,000 simulations. An interval on the scale of the values
    contains it in 83 %, and begins below zero in 43 %.

    Parameters
    ----------
    seen : sequence of Observation
        Positive values of the trait.
    most : float
        Upper limit of the values.
    """
    points = []
    for treatment, day in sorted({(one.treatment, one.day) for one in seen}):
        values = np.array([one.value for one in seen if (one.treatment, one.day) == (treatment, day)])
        mean = float(values.mean())
        count = len(values)
        error = float(student.ppf(0.95, count - 1) * values.std(ddof=1) / count**0.5) if count > 1 else 0.0
        low, high = (_moved(mean, side * error, most) for side in (-1.0, 1.0))
        points.append(Point(treatment=treatment, day=day, mean=mean, low=low, high=high, plants=count))
    return points


def _moved(value: float, error: float, most: float) -> float:
    """Return a value that is changed by an error on the scale of its logarithm, or of its logit below ``most``."""
    if abs(error) <= ROUNDING * value:
        return value
    room = 1.0 - value / most
    factor = exp(error / (value * room))  # derivative of the logarithm or logit
    return value * factor / (room + (1.0 - room) * factor)


def relative_rates(seen: Sequence[Observation]) -> list[tuple[str, float, float, float]]:
    """Return the relative growth rates between consecutive observations of each plant.

    An entry consists of the plant, the first day, the last day and the rate per day. The relative growth rate is the
    change of the trait's logarithm divided by the time (Hunt 1982).
    """
    rates = []
    for plant in dict.fromkeys(one.plant for one in seen):
        own = sorted((one for one in seen if one.plant == plant), key=lambda one: one.day)
        rates += [(plant, a.day, b.day, log(b.value / a.value) / (b.day - a.day)) for a, b in pairwise(own)]
    return rates


def _plants(seen: Sequence[Observation]) -> dict[str, set[str]]:
    """Return the names of the plants in each treatment. Treatments are sorted alphabetically."""
    return {name: {one.plant for one in seen if one.treatment == name} for name in sorted({one.treatment for one in seen})}


def reason_not_comparable(seen: Sequence[Observation]) -> str:
    """Return the reason why treatments cannot be compared.

    It is empty if they can be compared, or if there is only one treatment.
    """
    plants = _plants(seen)
    few = [name for name, own in plants.items() if len(own) < LEAST_PLANTS]
    if len(plants) > 1 and few:
        return f"treatment {few[0]!r} has {len(plants[few[0]])} plant, but a comparison needs at least {LEAST_PLANTS} plants per treatment"
    treatments = list(plants)
    for name in treatments[1:]:
        if why := reason_not_estimable(*_pair(seen, treatments[0], name)):
            return f"the treatments {treatments[0]!r} and {name!r} {why}"
    return ""


def _pair(seen: Sequence[Observation], against: str, treatment: str) -> tuple[list[Observation], Array]:
    """Return the observations (N,) of two treatments, and their covariate (N, 1), which is 1 for ``treatment``."""
    both = [one for one in seen if one.treatment in (against, treatment)]
    return both, np.array([[one.treatment == treatment] for one in both], np.float64)


def differences(seen: Sequence[Observation]) -> list[Difference]:
    """Compare each treatment with the reference treatment, which is the first in alphabetical order.

    Raises
    ------
    UserError
        If statsmodels is not installed, or the treatments cannot be compared (`reason_not_comparable`).
    """
    if why := reason_not_comparable(seen):
        raise UserError(why)
    against, *others = _plants(seen)
    return [_difference(*_pair(seen, against, name), against=against, treatment=name) for name in others]


def _difference(seen: Sequence[Observation], columns: Array, *, against: str, treatment: str) -> Difference:
    size, rate = effects(seen, columns)
    low, high = size[0].interval
    return Difference(
        treatment=treatment,
        against=against,
        size=exp(size[0].value),
        size_interval=(exp(low), exp(high)),
        size_p=size[0].p,
        rate_per_day=rate[0].value if rate else 0.0,
        rate_p=rate[0].p if rate else 1.0,
        plants=len({one.plant for one in seen}),
    )


def reason_not_estimable(seen: Sequence[Observation], columns: Array) -> str:
    """Return the reason why the effects of covariates cannot be estimated. It is empty if they can be estimated.

    The reason is a sentence without its subject, which is a plural: the treatments or plants that are compared.

    Parameters
    ----------
    seen : sequence of Observation
        Observations of the plants.
    columns : (N, C) array of float
        Covariates of each observation's plant.
    """
    design = _design(seen, columns)
    length = np.linalg.norm(design, axis=0)
    if np.linalg.matrix_rank(design / np.where(length > 0.0, length, 1.0), tol=TABLE_ROUNDING) < design.shape[1]:
        return "share too few days; scan all treatments on the same days"
    if _degrees_of_freedom(seen, design, columns) < 1:
        return f"have {len(seen)} scans, too few to estimate an uncertainty; scan more plants on each day"
    return ""


def effects(seen: Sequence[Observation], columns: Array) -> tuple[list[Effect], list[Effect]]:
    """Estimate the effect of each covariate on the logarithm of a trait on the mean day, and on the daily growth rate.

    Parameters
    ----------
    seen : sequence of Observation
        Observations whose effects can be estimated (`reason_not_estimable`).
    columns : (N, C) array of float
        Covariates of each observation's plant, for example 0 or 1 for the treatment, or a dose.

    Returns
    -------
    tuple of list of Effect
        Effects on the logarithm and on the rate, one per covariate. The second list is empty for a single day.

    Raises
    ------
    UserError
        If statsmodels is not installed.
    """
    design = _design(seen, columns)
    day = np.array([one.day for one in seen])
    days = len(np.unique(day))
    y = np.log([one.value for one in seen])
    plants = [one.plant for one in seen]
    value, error = _fit(y, design, plants, slopes=day - day.mean() if days > 2 else None)
    count = columns.shape[1]
    dof = _degrees_of_freedom(seen, design, columns)
    found = [Effect(value=float(v), error=float(e), dof=dof) for v, e in zip(value, error, strict=True)][days:]
    return found[:count], found[count:]


def _design(seen: Sequence[Observation], columns: Array) -> Array:
    """Return the design (N, P): a level per day, the covariates, and on several days their effects on the rate."""
    day = np.array([one.day for one in seen])
    days = np.unique(day)
    parts = [(day[:, None] == days).astype(np.float64), columns]
    if len(days) > 1:
        parts.append(columns * (day - day.mean())[:, None])
    return np.concatenate(parts, axis=1)


def _degrees_of_freedom(seen: Sequence[Observation], design: Array, columns: Array) -> int:
    """Return the smaller number of degrees of freedom: that of the plants, or that of the observations."""
    plants = len({one.plant for one in seen})
    return min(plants - 1 - columns.shape[1], len(design) - design.shape[1])


def _fit(y: Array, design: Array, plants: Sequence[str], *, slopes: Array | None) -> tuple[Array, Array]:
    """Fit a mixed model, and return its fixed effects (P,) and their standard errors (P,).

    If there is one observation per plant, ordinary least squares is used, because the random level cannot be estimated.
    Powell's method is used because the likelihood has no gradient where a variance is zero. Gradient methods stopped
    early for four of twelve sets of plants.
    """
    try:
        import statsmodels.api as models
    except ModuleNotFoundError:
        raise UserError(
            f"the comparison of treatments needs the package statsmodels; install it with: {pip_install('statsmodels')}"
        ) from None
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
    # without variation among plants, the random effect of the plant is omitted from the model
    plain = models.OLS(y, design).fit()
    return np.asarray(plain.params), np.asarray(plain.bse)
