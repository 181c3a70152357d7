"""Growth in numbers: relative growth rates, means with intervals, and whether treatments differ.

The logarithm of a trait of plant i on day t is followed by a linear mixed model (Laird and Ware 1982, Biometrics
38:963): a curve common to all (a level for every day), what the treatment adds on the mean day and a day, and for each
plant a level and a slope of its own. A treatment is a difference between plants, however often each is looked at, so
that its t statistic has the plants less the treatments as its degrees of freedom (Schluchter and Elashoff 1990, Journal
of Statistical Computation and Simulation 37:69).
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
"""Probability of a difference that is none, by which treatments are told apart."""
ROUNDING = 1e-12
"""Logarithms of equal traits are no more apart."""
LEAST_PLANTS = 2
"""Of each treatment."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A trait of a plant on a day."""

    plant: str
    treatment: str
    day: float
    value: float


@dataclass(frozen=True, kw_only=True)
class Point:
    """A treatment's mean on a day."""

    treatment: str
    day: float
    mean: float
    low: float
    """Ends of the 90 % interval of the mean; the mean itself for one plant."""
    high: float
    plants: int


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A coefficient of the model, with its standard error and the degrees of freedom of its t statistic."""

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
        """Probability of a value at least as large where the true one is 0.

        Values without any error are 0 or they are not.
        """
        if self.error <= ROUNDING:
            return 1.0 if abs(self.value) <= ROUNDING else 0.0
        return float(2.0 * student.sf(abs(self.value) / self.error, self.dof))


@dataclass(frozen=True, kw_only=True)
class Difference:
    """What a treatment does, against the first one."""

    treatment: str
    against: str
    size: float
    """Factor by which a plant is larger on the mean day."""
    size_interval: tuple[float, float]
    """90 % interval."""
    size_p: float
    rate_per_day: float
    """By how much its relative growth rate is larger."""
    rate_p: float
    plants: int

    @property
    def told_apart(self) -> bool:
        """Whether sizes differ: the one question that the verdict answers; the rate's p stands beside it as another."""
        return self.size_p < SURE


def means(seen: Sequence[Seen]) -> list[Point]:
    """Return the mean of each treatment on each day, with the interval that the scatter of the plants gives."""
    points = []
    for treatment, day in sorted({(one.treatment, one.day) for one in seen}):
        values = np.array([one.value for one in seen if (one.treatment, one.day) == (treatment, day)])
        mean, count = float(values.mean()), len(values)
        reach = float(student.ppf(0.95, count - 1) * values.std(ddof=1) / count**0.5) if count > 1 else 0.0
        points.append(Point(treatment=treatment, day=day, mean=mean, low=mean - reach, high=mean + reach, plants=count))
    return points


def relative_rates(seen: Sequence[Seen]) -> list[tuple[str, float, float, float]]:
    """Return plant, from day, to day and relative growth rate a day.

    The change of the logarithm over the time (Hunt 1982).
    """
    rates = []
    for plant in dict.fromkeys(one.plant for one in seen):
        own = sorted((one for one in seen if one.plant == plant), key=lambda one: one.day)
        rates += [(plant, a.day, b.day, log(b.value / a.value) / (b.day - a.day)) for a, b in pairwise(own)]
    return rates


def _plants(seen: Sequence[Seen]) -> dict[str, set[str]]:
    """Return the plants of each treatment, treatments by name."""
    return {name: {one.plant for one in seen if one.treatment == name} for name in sorted({one.treatment for one in seen})}


def too_few(seen: Sequence[Seen]) -> str:
    """Say which treatment has too few plants to be compared; empty where none has, or there is one treatment."""
    plants = _plants(seen)
    few = [name for name, own in plants.items() if len(own) < LEAST_PLANTS]
    if len(plants) < 2 or not few:
        return ""
    return f"treatment {few[0]!r} has {len(plants[few[0]])} plant; each treatment needs {LEAST_PLANTS} or more"


def differences(seen: Sequence[Seen]) -> list[Difference]:
    """Compare every treatment with the first by name.

    Raises
    ------
    UserError
        When statsmodels is not installed, or a treatment has fewer than two plants.
    """
    if why := too_few(seen):
        raise UserError(why)
    plants = _plants(seen)
    treatments, found = list(plants), []
    for name in treatments[1:]:
        both = [one for one in seen if one.treatment in (treatments[0], name)]
        found.append(_difference(both, against=treatments[0], treatment=name, plants=len(plants[name]) + len(plants[treatments[0]])))
    return found


def _difference(seen: Sequence[Seen], *, against: str, treatment: str, plants: int) -> Difference:
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


def effects(seen: Sequence[Seen], columns: Array) -> tuple[list[Effect], list[Effect]]:
    """Return by what each column moves the logarithm of a trait on the mean day, and by what a day.

    Parameters
    ----------
    seen : sequence of Seen
        At least ``C + 2`` plants.
    columns : (N, C) array of float
        What differs between plants, such as 1 for the treated ones, or a dose.

    Returns
    -------
    tuple of list of Effect
        Of each column; the second list is empty where there is one day.

    Raises
    ------
    UserError
        When statsmodels is not installed.
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

    Plants that were seen once each have no level of their own to be told. Powell's search needs no gradient, which the
    likelihood lacks where a variance is 0: of twelve sets of plants, gradients stopped short in four.
    """
    try:
        import statsmodels.api as models
    except ModuleNotFoundError:
        raise UserError("to compare treatments, statsmodels is needed: pip install 'rhizotwin[experiment]'") from None
    if len(set(plants)) == len(plants):
        fitted = models.OLS(y, design).fit()
        return np.asarray(fitted.params), np.asarray(fitted.bse)
    random = None if slopes is None else np.stack([np.ones(len(y)), slopes / np.std(slopes)], axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a variance at its bound, zero, is what plants that do not differ have
        try:
            fitted = models.MixedLM(y, design, groups=np.asarray(plants), exog_re=random).fit(reml=True, method="powell")
            value, error = np.asarray(fitted.fe_params), np.asarray(fitted.bse_fe)
        except np.linalg.LinAlgError:
            value = error = np.full(design.shape[1], np.nan)
    if np.isfinite(value).all() and np.isfinite(error).all():
        return value, error
    # plants that do not differ at all: the mixed model without a variance of plants
    plain = models.OLS(y, design).fit()
    return np.asarray(plain.params), np.asarray(plain.bse)
