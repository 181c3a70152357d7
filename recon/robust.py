"""Robust statistics, and covariances of fits with correlated residuals.

Residuals of a picture share its pose, its light and its pixel grid; treating them as independent is far too optimistic.
Correlated residuals form a cluster, and the covariance follows from the scatter of whole clusters: with scores s_g (the
gradient of a cluster's residuals at the solution) and the normal matrix H, the solution's covariance is H^-1 M H^-1
with M = sum s_g s_g^T (the sandwich; Cameron and Miller 2015, Journal of Human Resources 50:317). With few clusters,
each one's influence on the solution biases this. Leaving out each in turn, s_g becomes H (H - H_g)^-1 s_g, which
corrects the bias (cluster jackknife CV3; MacKinnon, Nielsen and Webb 2023, Journal of Econometrics 232:272).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

MAD = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation: the inverse of its 75 %
quantile, 0.6745."""


def inverse(normal: Array) -> Array:
    """Invert symmetric matrices (..., K, K) of unknowns with different units, after scaling to a unit diagonal."""
    size = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    outer = size[..., :, None] * size[..., None, :]
    return np.asarray(np.linalg.inv(normal / outer) / outer, np.float64)


def scatter(scores: Array, *clusters: Numbers, curvatures: Array | None = None, normal: Array | None = None) -> Array:
    """Return the covariance of a sum of scores that are correlated within clusters.

    Parameters
    ----------
    scores : (N, K) float64 array
        Gradient of each residual, or group of residuals, at the solution.
    *clusters : (N,) int64 array
        Cluster index of each score; with two ways of clustering, scores that share either are correlated (Cameron,
        Gelbach and Miller 2011, Journal of Business and Economic Statistics 29:238, equation 2.11).
    curvatures : (N, K, K) float64 array, optional
        Contribution of each score to the normal matrix. With it, clusters are left out in turn; without, the scatter is
        multiplied by G / (G - 1) for G clusters.
    normal : (K, K) float64 array, optional
        Normal matrix, including the prior; required with ``curvatures``.

    Returns
    -------
    (K, K) float64 array
        Positive semidefinite.
    """
    if len(clusters) == 2:
        both = clusters[0] * (int(clusters[1].max(initial=0)) + 1) + clusters[1]
        one, other, common = (scatter(scores, cluster, curvatures=curvatures, normal=normal) for cluster in (*clusters, both))
        return _positive(one + other - common, np.diag(np.diag(one + other)) if normal is None else normal)
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
    """Return the covariance (K, K) of a solution with a normal matrix, whose gradient has the covariance ``meat``.

    ``least`` is the covariance for independent residuals: chance must not make a variance smaller (MacKinnon, Nielsen
    and Webb 2024 use the largest of several estimates for the same reason).
    """
    bread = inverse(normal)
    found = bread @ meat @ bread
    larger = np.sqrt(np.maximum(np.diag(least) / np.maximum(np.diag(found), 1e-300), 1.0))
    return np.asarray(found * larger[:, None] * larger)


def _positive(matrix: Array, measure: Array) -> Array:
    """Return a symmetric matrix with negative eigenvalues set to zero, in units of another matrix.

    If the measure is proportional to the gradient's covariance for independent residuals, all unknowns have equal
    weight.
    """
    size = np.sqrt(np.maximum(np.diag(measure), 1e-300))
    root = size[:, None] * np.linalg.cholesky(measure / np.outer(size, size) + 1e-12 * np.eye(len(size)))
    back = np.linalg.inv(root / size[:, None])
    amount, axes = np.linalg.eigh(back @ (matrix / np.outer(size, size)) @ back.T)
    half = root @ axes * np.sqrt(np.maximum(amount, 0.0))
    return np.asarray(half @ half.T)
