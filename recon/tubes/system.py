"""Normal equations of the nodes and of the parameters that all nodes share.

Let x be the positions and radii of the nodes, and q the shared parameters: of the light, of the rig, or the sway. A
Gauss-Newton step solves

    (H + P) dx + B dq = g - P x        every node; P is the prior of smooth branches
    B^T dx + D dq     = h              shared parameters

The nodes are eliminated by a Schur complement, with one factorisation for all right-hand sides:

    S dq = s,    S = D - B^T (H + P)^-1 B,    s = h - B^T (H + P)^-1 (g - P x)

The nodes follow with dx = (H + P)^-1 (g - P x - B dq), along the valleys in which they compensate the parameters.

Residuals along a root and within a view are correlated. The covariance of the solution is therefore the sandwich S^-1 M
S^-T, where M is the scatter of the scores of whole roots and whole views (Cameron, Gelbach and Miller 2011, equation
2.11; `robust.scatter`). M determines the weight of the data relative to the prior. The scatter of the pixels would be
far too optimistic.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from rhizotwin.recon.robust import inverse, scatter
from rhizotwin.recon.tubes import smoothness
from rhizotwin.recon.tubes.parameters import Parameters
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

LEAST_VARIANCE = 1e-5
"""Minimum variance of the coverage. It corresponds to a standard deviation of 0.003, which is one grey level of 8
bits.

For the light parameters, it is also the variance of the error that all profiles have in common: that of the empty
backlight, and of the model of a root. The scatter between roots and views does not show it. Without it, the strength of
hairs was 3.0 +- 0.4 instead of 1, and the excess of the refractive index 0.05 +- 0.005 instead of 0."""
_RIDGE = 1e-4 * np.eye(4)
"""Ridge that is added to each node's normal matrix, 1/mm2. It keeps the matrix invertible for nodes
without a profile. A node's own curvature is about 100/mm2. A thousandth of it remains in the direction in which a
wider, fainter root looks the same."""
ROUNDING = 1e-9
"""Maximum distance between a parameter and its bound for the parameter to be considered at the bound. It allows for
rounding of log(exp(x))."""


@dataclass(frozen=True)
class Equations:
    """Normal equations of N nodes and K shared parameters, before the nodes are eliminated."""

    hessian: Array
    """Matrix of each node for x, y, z and radius, shape (N, 4, 4)."""
    gradient: Array
    """Right-hand side of each node, shape (N, 4)."""
    mixed: Array
    """Derivative of each node's gradient with respect to the shared parameters, shape (N, 4, K)."""
    whole: Array
    """Matrix of the shared parameters, shape (K, K)."""
    right: Array
    """Right-hand side of the shared parameters, shape (K,)."""


@dataclass(frozen=True)
class System:
    """Normal equations of the shared parameters, with the nodes eliminated."""

    owner: NDArray[np.int64]
    """Branch of each node, shape (N,)."""
    flanks: sparse.csr_matrix
    """Motion of the flanks with the nodes (`smoothness.flank_motion`)."""
    start: Array
    """Step of each node's position and radius if the parameters do not change, shape (N, 4)."""
    response: Array
    """Derivative of each node's position and radius with respect to the parameters, shape (N, 4, K), if the rendered
    tubes change as little as possible."""
    reduced: Array
    """Reduced normal matrix S, shape (K, K)."""
    right: Array
    """Right-hand side s of the reduced normal equations, shape (K,)."""

    @staticmethod
    def eliminate(equations: Equations, tubes: Tubes, ridge: Array = _RIDGE, *, chosen: NDArray[np.int64] | None = None) -> System:
        """Eliminate the nodes.

        Parameters
        ----------
        ridge : (4, 4) or (N, 4, 4) array
            Matrix that is added to the normal matrix of each node.
        chosen : (N,) int array, optional
            Nodes of the equations, each of which is independent of all others. By default, these are all nodes, on
            smooth branches.
        """
        count, owner = len(equations.gradient), tubes.owner if chosen is None else tubes.owner[chosen]
        flanks, smooth = sparse.identity(4 * count, format="csr"), sparse.csr_matrix((4 * count, 4 * count))
        state = np.zeros(4 * count)
        if chosen is None:
            flanks, smooth = smoothness.flank_motion(tubes), smoothness.prior(tubes)
            state = np.concatenate([tubes.centre_mm, tubes.radius_mm[:, None]], axis=1).ravel()
        nodes = equations.hessian + ridge
        blocks = sparse.bsr_matrix((nodes, np.arange(count), np.arange(count + 1)), shape=(4 * count, 4 * count))
        wanted = flanks.T @ equations.gradient.ravel() - smooth @ state
        mixed = flanks.T @ equations.mixed.reshape(4 * count, -1)
        factors = splu((flanks.T @ blocks @ flanks + smooth).tocsc(), permc_spec="MMD_AT_PLUS_A")
        start, *follow = factors.solve(np.column_stack([wanted, mixed])).T
        back = np.array(follow).reshape(-1, 4 * count).T
        reduced = equations.whole - mixed.T @ back
        return System(
            owner=owner,
            flanks=flanks,
            start=start.reshape(count, 4),
            response=-back.reshape(equations.mixed.shape),
            reduced=0.5 * (reduced + reduced.T),
            right=equations.right - mixed.T @ start,
        )

    @cached_property
    def flank_response(self) -> Array:
        """Derivative of the flanks beside each node with respect to the parameters, shape (N, 4, K)."""
        return np.asarray(self.flanks @ self.response.reshape(self.start.size, -1)).reshape(self.response.shape)

    def flank_steps(self, change: Array) -> Array:
        """Return the steps of the flanks beside each node (N, 4) if the parameters change by ``change`` (K,)."""
        return np.asarray((self.flanks @ (self.start + self.response @ change).ravel()).reshape(-1, 4))

    def scatter(self, gradients: Iterable[tuple[Array, Array]]) -> Array:
        """Return the covariance (K, K) of the right-hand side, from the scatter between roots and between views.

        ``gradients`` are the contributions of the profiles in each view to the gradients of the nodes, shape (N, 4),
        and of the parameters, shape (N, K).
        """
        own = sparse.csr_matrix((np.ones(len(self.owner)), (self.owner, np.arange(len(self.owner)))))  # sums the nodes of each root
        scores = [own @ (right + np.einsum("nij,ni->nj", self.flank_response, gradient)) for gradient, right in gradients]
        views, roots = len(scores), own.shape[0]
        return scatter(np.concatenate(scores), np.repeat(np.arange(views), roots), np.tile(np.arange(roots), views))

    def solve(self, parameters: Parameters, meat: Array | float) -> tuple[Array, Array]:
        """Return the step (K,) of the parameters and its covariance (K, K).

        Both are 0 for parameters that are not free, that no profile shows, or at a bound that they would leave. The
        step is shortened to the largest step.

        Parameters
        ----------
        meat : (K, K) array or float
            Covariance of the right-hand side, or its ratio to `reduced`.
        """
        low, high, largest = parameters.limits
        many, free = len(parameters.value), parameters.free & (np.diag(self.reduced) > 0.0)
        value = np.where(free, parameters.value, parameters.mean)  # that of opaque roots is infinite
        while True:
            change, covariance, f = np.zeros(many), np.zeros((many, many)), np.flatnonzero(free)
            if not len(f):
                return change, covariance
            at = np.ix_(f, f)
            normal, known = self.reduced[at], parameters.precision[at]
            # times the normal matrix, this is the inverse of the sandwich
            information = np.eye(len(f)) / meat if isinstance(meat, float) else normal @ inverse(meat[at])
            covariance[at] = found = inverse(information @ normal + known)
            change[f] = found @ (information @ self.right[f] + known @ (parameters.mean - value)[f])
            change /= max(1.0, float((np.abs(change) / largest).max()))
            held = free & (((value <= low + ROUNDING) & (change < 0.0)) | ((value >= high - ROUNDING) & (change > 0.0)))
            if not held.any():
                return np.where(free, np.clip(value + change, low, high) - value, 0.0), covariance
            free &= ~held
