"""Robust statistics, and covariances of fits with correlated residuals.

The residuals of one picture share its pose, its illumination and its pixel grid. Treating them as independent
underestimates the uncertainty severely. Correlated residuals are therefore grouped into clusters, and the covariance is
computed from the scatter between clusters. With scores s_g (the gradient of the residuals of cluster g at the solution)
and the normal matrix H, the covariance of the solution is H^-1 M H^-1 with M = sum s_g s_g^T. This is the sandwich
estimator (Cameron and Miller 2015, Journal of Human Resources 50:317).

With few clusters, this estimate is biased because every cluster influences the solution. The cluster jackknife CV3
corrects the bias: each cluster is omitted in turn, which replaces s_g by H (H - H_g)^-1 s_g (MacKinnon, Nielsen and
Webb 2023, Journal of Econometrics 232:272).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

MAD = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation. The ratio is the inverse
of the 75 % quantile of the standard normal distribution, 0.6745."""


def inverse(normal: Array) -> Array:
    """Invert symmetric matrices (..., K, K), each scaled to a unit diagonal to allow for different units."""
    size = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    outer = size[..., :, None] * size[..., None, :]
    return np.asarray(np.linalg.inv(normal / outer) / outer, np.float64)


def scatter(scores: Array, *clusters: Numbers, curvatures: Array | None = None, normal: Array | None = None) -> Array:
    """Estimate the covariance of a sum of scores that are correlated within clusters.

    Parameters
    ----------
    scores : (N, K) float64 array
        Gradient of each residual, or of each group of residuals, at the solution.
    *clusters : (N,) int64 array
        Cluster index of each score. If two arrays are given, scores are treated as correlated when they share a cluster
        in either array (Cameron, Gelbach and Miller 2011, Journal of Business and Economic Statistics 29:238, equation
        2.11).
    curvatures : (N, K, K) float64 array, optional
        Contribution of each score to the normal matrix, for the cluster jackknife. By default, the scatter is
        multiplied by G / (G - 1) for G clusters instead.
    normal : (K, K) float64 array, optional
        Normal matrix, including the prior; required with ``curvatures``.

    Returns
    -------
    (K, K) float64 array
        Covariance of the sum, positive semidefinite.
    """
    if len(clusters) == 2:
        both = clusters[0] * (int(clusters[1].max(initial=0)) + 1) + clusters[1]
        one, other, common = (scatter(scores, cluster, curvatures=curvatures, normal=normal) for cluster in (*clusters, both))
        return _clip_eigenvalues(one + other - common, np.diag(np.diag(one + other)) if normal is None else normal)
    (cluster,) = clusters
    _, number = np.unique(cluster, return_inverse=True)
    count = int(number.max(initial=-1)) + 1
    sums = np.zeros((count, scores.shape[1]))
    np.add.at(sums, number, scores)
    if curvatures is None or normal is None:
        return np.asarray(sums.T @ sums * (count / max(count - 1, 1)))
    own = np.zeros((count, *normal.shape))
    np.add.at(own, number, curvatures)
    sums = (normal @ inverse(normal - own) @ sums[:, :, None])[:, :, 0]
    return np.asarray(sums.T @ sums * ((count - 1) / max(count, 1)))


def sandwich(normal: Array, meat: Array, least: Array) -> Array:
    """Return the covariance (K, K) of a least-squares solution whose residuals are correlated.

    It is computed from the normal matrix ``normal`` and from ``meat``, the covariance of the gradient. ``least`` is the
    covariance of the solution for independent residuals. The variances are at least those in ``least``, because random
    scatter must not reduce them. MacKinnon, Nielsen and Webb (2024) use the largest of several estimates for the same
    reason.
    """
    bread = inverse(normal)
    found = bread @ meat @ bread
    larger = np.sqrt(np.maximum(np.diag(least) / np.maximum(np.diag(found), 1e-300), 1.0))
    return np.asarray(found * larger[:, None] * larger)


def _clip_eigenvalues(matrix: Array, measure: Array) -> Array:
    """Set the negative eigenvalues of a symmetric matrix to zero, in the metric of ``measure``.

    If ``measure`` is proportional to the gradient covariance for independent residuals, all unknowns have equal weight.
    """
    size = np.sqrt(np.maximum(np.diag(measure), 1e-300))
    root = size[:, None] * np.linalg.cholesky(measure / np.outer(size, size) + 1e-12 * np.eye(len(size)))
    back = np.linalg.inv(root / size[:, None])
    amount, axes = np.linalg.eigh(back @ (matrix / np.outer(size, size)) @ back.T)
    half = root @ axes * np.sqrt(np.maximum(amount, 0.0))
    return np.asarray(half @ half.T)
