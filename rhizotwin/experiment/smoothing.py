"""Smoothing of a series of measurements, with its rate of change and intervals of both.

The series is a parabola plus a twice integrated Wiener process plus independent noise. The posterior mean is a quintic
smoothing spline (Wahba 1978, Journal of the Royal Statistical Society B 40:364). The likelihood of the ratio of both
variances (restricted maximum likelihood) is computed on a grid. Means and variances are averages over the grid, with
the likelihood as weight, so that the intervals include the uncertainty of the ratio.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]

LEAST = 6
"""Minimum number of measurements. A parabola has three parameters; the noise is estimated from the others."""
RATIOS = (0.0, *np.geomspace(1e-2, 1e12, 31))
"""Variance of the Wiener process relative to that of the noise, for a series of duration 1. With the largest ratio, the
spline follows eight measurements per period of an oscillation of 50 times the noise."""


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """Smoothed series of measurements."""

    value: Array
    """Smoothed values (N,)."""
    value_sigma: Array
    """Standard deviations (N,) of the smoothed values."""
    rate: Array
    """Rates of change (N,), per unit of time."""
    rate_sigma: Array
    """Standard deviations (N,) of the rates."""
    mean_rate: float
    """Mean rate over the series."""
    mean_rate_sigma: float
    """Standard deviation of the mean rate."""


def smooth(times: Array, values: Array) -> Smoothed:
    """Smooth a series of measurements.

    Parameters
    ----------
    times : (N,) array
        Ascending times of at least `LEAST` measurements.
    values : (N,) array
        Measured values.

    Returns
    -------
    Smoothed
        Values and rates at the times of the measurements. Standard deviations are multiplied by a factor, so that
        normal intervals have the width of those of Student's t distribution with N - 3 degrees of freedom.
    """
    count = len(times)
    span = float(times[-1] - times[0])
    t = (times - times[0]) / span
    basis = np.stack([np.ones(count), t, t**2], axis=1)
    early = np.minimum(t[:, None], t)
    apart = np.abs(t[:, None] - t)
    shape = early**3 * (early**2 / 5.0 + apart * early / 2.0 + apart**2 / 3.0) / 4.0
    after = early**3 * (early / 4.0 + apart / 3.0) / 2.0  # derivative where the first time is the later one
    slope = np.where(t[:, None] > t, after, early**2 * (early**2 / 4.0 + 2.0 * apart * early / 3.0 + apart**2 / 2.0) / 2.0)
    rows = np.concatenate([shape, slope, shape[-1:] - shape[:1]])  # covariances of values, rates and mean rate with the series
    own = np.concatenate([np.diag(shape), t**3 / 3.0, shape[-1:, -1]])
    bases = np.concatenate([basis, np.stack([0.0 * t, 1.0 + 0.0 * t, 2.0 * t], axis=1), [[0.0, 1.0, 1.0]]])
    means, variances, likelihoods = [], [], []
    for ratio in RATIOS:
        factor = cho_factor(np.eye(count) + ratio * shape, lower=True)
        solved = cho_solve(factor, basis)
        normal = basis.T @ solved
        line = np.linalg.solve(normal, solved.T @ values)
        rest = cho_solve(factor, values - basis @ line)
        noise = float((values - basis @ line) @ rest) / (count - 3)
        means.append(bases @ line + ratio * rows @ rest)
        lead = bases - ratio * rows @ solved
        known = np.einsum("ij,ji->i", rows, cho_solve(factor, rows.T))
        variances.append(noise * (ratio * own - ratio**2 * known + np.einsum("ij,jk,ik->i", lead, np.linalg.inv(normal), lead)))
        log_det = 2.0 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(normal)[1]
        likelihoods.append(-0.5 * ((count - 3) * np.log(max(noise, 1e-300)) + log_det))
    weight = np.exp(np.array(likelihoods) - max(likelihoods))
    weight /= weight.sum()
    mean = weight @ np.array(means)
    spread = weight @ (np.maximum(variances, 0.0) + (np.array(means) - mean) ** 2)
    sigma = np.sqrt(spread * (count - 3) / (count - 5))
    return Smoothed(
        value=mean[:count],
        value_sigma=sigma[:count],
        rate=mean[count:-1] / span,
        rate_sigma=sigma[count:-1] / span,
        mean_rate=float(mean[-1]) / span,
        mean_rate_sigma=float(sigma[-1]) / span,
    )
