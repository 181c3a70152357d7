"""Fit a straight line to points with errors in both coordinates and intrinsic scatter.

For normally distributed errors, the line is the maximum-likelihood estimate (York et al. 2004, American Journal of
Physics 72:367, eq. 13). Intrinsic scatter (variation among plants) is added to the variance of y, so that chi squared
equals the degrees of freedom (Paule and Mandel 1982, Journal of Research of the National Bureau of Standards 87:377).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import t as student

Array = NDArray[np.float64]

MOST_ROUNDS = 200
"""Maximum number of iterations for the slope."""
CONVERGED = 1e-13
"""Relative change of the slope between two iterations below which the iteration stops."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """Straight line ``y = intercept + slope * x`` with its uncertainty."""

    intercept: float
    """Value of y at x = 0."""
    slope: float
    """Change of y per unit of x."""
    covariance: tuple[tuple[float, float], tuple[float, float]]
    """Covariance matrix of intercept and slope."""
    scatter: float
    """Intrinsic standard deviation of y about the line."""
    chi2: float
    """Weighted sum of squared residuals."""
    dof: int
    """Degrees of freedom: number of groups of correlated points minus number of parameters."""

    def at(self, x: Array, *, x_sigma: Array | float = 0.0, y_sigma: Array | float = 0.0) -> tuple[Array, Array]:
        """Return the predicted y (N,) and the standard deviation (N,) of a new measurement of y.

        Parameters
        ----------
        x : (N,) float64 array
            Measured values of x, with standard deviation ``x_sigma``.
        y_sigma : float64 array or float
            Standard deviation of the measured y that is compared with the prediction.
        """
        (a, ab), (_, b) = self.covariance
        variance = a + 2.0 * ab * x + b * x**2 + self.slope**2 * np.square(x_sigma) + self.scatter**2 + np.square(y_sigma)
        return self.intercept + self.slope * x, np.sqrt(variance)

    def reach(self, share: float) -> float:
        """Return the half-width of a prediction interval as a multiple of the standard deviation.

        The coverage probability of the interval is ``share``. The half-width is a quantile of Student's t distribution
        with ``dof`` degrees of freedom.
        """
        return float(student.ppf(0.5 + share / 2.0, self.dof))


@dataclass(frozen=True)
class Points:
    """Points with errors in both coordinates."""

    x: Array
    """First coordinates (N,)."""
    y: Array
    """Second coordinates (N,)."""
    x_sigma: Array
    """Standard deviations (N,) of the errors of ``x``, may be zero."""
    y_sigma: Array
    """Standard deviations (N,) of the errors of ``y``, may be zero."""
    groups: NDArray[Any] | None = None
    """Group (N,) of each point, for example the plant that was measured on several days. Points of different groups are
    independent. None: all points are independent."""

    def __getitem__(self, chosen: NDArray[np.bool_]) -> "Points":
        """Return the points for which the mask (N,) is true."""
        return replace(self, **{name: values[chosen] for name, values in vars(self).items() if values is not None})


def fit_line(points: Points, *, slope: float | None = None, scatter: bool = True) -> Line:
    """Fit a line to points with errors in both coordinates.

    The variances of the ``n`` points of a group are multiplied by ``n``, so that the group has the weight of one point,
    as if its points were fully correlated. The uncertainty is too large if their correlation is small.

    Parameters
    ----------
    points : Points
        Points, with their errors and groups.
    slope : float or None
        Fixed slope. None: the slope is fitted.
    scatter : bool
        Whether to estimate intrinsic scatter. False: zero scatter as in York et al.

    Raises
    ------
    ValueError
        If there are too few groups to estimate an uncertainty.
    """
    parameters = 1 if slope is not None else 2
    x, y = points.x, points.y
    groups = np.arange(len(x)) if points.groups is None else points.groups
    _, group, sizes = np.unique(groups, return_inverse=True, return_counts=True)
    if len(sizes) <= parameters:
        raise ValueError(f"{len(sizes)} independent points are too few to fit {parameters} parameters with an uncertainty")
    size = sizes[group]
    dof = len(sizes) - parameters
    spread = float(np.var(y)) + float(np.var(x))
    least = 1e-12 * max(spread, 1e-12)  # keeps the weights finite for points without errors and scatter

    def line(extra: float) -> Line:
        y_var = points.y_sigma**2 + extra + (least if scatter else 0.0)
        return _fit_york(x, y, size * points.x_sigma**2, size * y_var, slope=slope, dof=dof)

    bare = line(0.0)
    if not scatter or bare.chi2 <= dof:
        return bare
    most = spread
    while line(most).chi2 > dof:
        most *= 2.0
    found = float(brentq(lambda extra: line(extra).chi2 - dof, 0.0, most, xtol=1e-12 * most))
    return replace(line(found), scatter=found**0.5)


def _fit_york(x: Array, y: Array, x_var: Array, y_var: Array, *, slope: float | None, dof: int) -> Line:
    """Fit York's line to points (N,) with given variances.

    If a slope is given, it is not fitted and has zero variance.
    """
    b = slope if slope is not None else float(np.polyfit(x, y, 1)[0])
    for _ in range(MOST_ROUNDS):
        weight = 1.0 / (y_var + b**2 * x_var)
        x_mean, y_mean = np.average(x, weights=weight), np.average(y, weights=weight)
        u, v = x - x_mean, y - y_mean
        beta = weight * (u * y_var + b * v * x_var)
        if slope is not None:
            break
        before = b
        b = float(np.sum(weight * beta * v) / np.sum(weight * beta * u))
        if abs(b - before) <= CONVERGED * abs(b):
            break
    chi2 = float(np.sum(weight * (v - b * u) ** 2))
    adjusted = x_mean + beta
    centre = float(np.average(adjusted, weights=weight))
    b_var = 0.0 if slope is not None else float(1.0 / np.sum(weight * (adjusted - centre) ** 2))
    a_var = float(1.0 / np.sum(weight)) + centre**2 * b_var
    covariance = ((a_var, -centre * b_var), (-centre * b_var, b_var))
    return Line(intercept=float(y_mean - b * x_mean), slope=b, covariance=covariance, scatter=0.0, chi2=chi2, dof=dof)
