"""Normal equations of corrections of the rig, from tubes fitted to the roots.

`tube_picture` and `tube_profiles` provide the lateral displacement of the tube at each node in each view, and
`rig_derivatives` its derivatives. The positions and radii of the nodes are eliminated (Schur complement), and

    (S / phi + prior) q = g / phi

is solved for the shared unknowns q. Residuals along a root and within a view are correlated. The variance phi of a unit
of evidence is therefore computed from the scatter of whole roots and whole views (sandwich estimator with two-way
clustering: Cameron, Gelbach and Miller 2011, equation 2.11). The scatter of the pixels would be far too optimistic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from rhizotwin.recon.calibration.cameras import Cameras, RigUncertainty
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.robust import inverse, scatter
from rhizotwin.recon.tubes import rig_derivatives, tube_profiles
from rhizotwin.recon.tubes.rig_derivatives import QUANTITIES, Quantity
from rhizotwin.recon.tubes.root_light import LEAST_VARIANCE
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import HostProfiles, ResidualGradient
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

INDEX_PRIOR = 0.003
"""Prior standard deviation of the water's refractive index.

For comparison, ten degrees change the index by 0.001, 2 g/l of salts by 0.0003, and red or blue light by 0.002."""
LEAST_NODES = 100
"""Minimum number of nodes for an estimate, which corresponds to 60 mm of root. Fewer nodes come from only one or two
roots, and their scatter is not sufficient for an estimate of the uncertainty."""
MOST_NODES = 1500
"""Maximum number of nodes used, selected at equal intervals. More nodes add no information, since the nodes of a root
are correlated."""
LEAST_TURN_RAD = 1e-5
"""Minimum standard deviation of a table angle, rad. In pictures of 800x600 px, markers determine the angle to 7e-5
rad."""
_LEAST_VIEWS = 8
"""Minimum number of views that must show a node for its position to be determined."""
_RIDGE, _ALONG = 1e-3, 0.5
"""Terms added to each node's 3x3 normal matrix to regularise it, as fractions of its mean diagonal. The first is added
in all directions, the second along the root, where the views provide no constraint."""
_PASSES = 4
"""Number of iterations, in each of which the change of the unknowns and the variance phi of a unit of evidence are
updated."""


@dataclass(frozen=True)
class Columns:
    """Mapping from the rig parameters of each view to the unknowns of a linear system."""

    index: NDArray[np.int64]
    """Index of the unknown for each view and parameter, shape (V, Q). It is -1 if the parameter is not estimated."""
    precision: Array
    """Prior precision matrix of the unknowns, shape (K, K)."""
    shared: int
    """Number of leading unknowns that are shared by several views."""

    @staticmethod
    def per_view(views: int, quantities: int, sigma: float) -> Columns:
        """Return a mapping in which each parameter of each view is a separate unknown.

        ``sigma`` is the standard deviation of their prior.
        """
        count = views * quantities
        return Columns(np.arange(count).reshape(views, quantities), np.eye(count) / sigma**2, count)

    @staticmethod
    def for_rig(order: Sequence[int], known: RigUncertainty | None) -> Columns:
        """Return the mapping for all parameters of the rig.

        If the uncertainty of the cameras is unknown, only the refractive index is estimated.
        """
        views = len(order)
        index = np.full((views, len(QUANTITIES)), -1)
        index[:, 0] = 0
        if known is None:
            return Columns(index, np.array([[INDEX_PRIOR**-2.0]]), 1)
        index[:, 1:6] = np.arange(1, 6)
        index[:, 7:] = 6 + 6 * known.station[list(order)][:, None] + np.arange(6)
        shared = 6 + 6 * known.stations
        index[:, 6] = shared + np.arange(views)
        precision = np.zeros((shared + views, shared + views))
        precision[0, 0] = INDEX_PRIOR**-2.0
        precision[1:shared, 1:shared] = inverse(known.covariance)
        turn = np.arange(shared, shared + views)
        precision[turn, turn] = np.maximum(known.turn[list(order)], LEAST_TURN_RAD) ** -2.0
        return Columns(index, precision, shared)


def build_system(
    evidence: Evidence,
    cameras: Cameras,
    tubes: Tubes,
    wanted: tuple[Quantity, ...],
    columns: Columns,
) -> System | None:
    """Return the normal equations for parameters of the rig, computed from fitted tubes.

    The result is None if there are too few nodes.

    Parameters
    ----------
    evidence, cameras, tubes : Evidence, Cameras, Tubes
        Views, and the tubes fitted to them.
    wanted : tuple of Quantity
        Parameters to estimate.
    columns : Columns
        Mapping from the parameters of each view to the unknowns.
    """
    drawn = Rendering.draw(evidence, tubes)
    at, profiles = drawn.at, tube_profiles.profiles(drawn)
    usable = np.array(profiles.shift_2).reshape(profiles.shape) > 0.0
    chosen = np.flatnonzero(usable.sum(axis=0) >= _LEAST_VIEWS)
    if len(chosen) < LEAST_NODES:
        return None
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(len(chosen), MOST_NODES)).round().astype(np.int64)]
    sums, points = profiles.host(chosen), tubes.centre_mm[chosen]
    px = at.px[:, chosen] + evidence.window.low_px  # in coordinates of the whole picture, as used by the cameras
    moves = [
        rig_derivatives.picture_derivatives(view, cameras.optics, wanted, px[v], points, sums.across[v])
        for v, view in enumerate(cameras.views)
    ]
    by = np.where((sums.shift_2 > 0.0)[..., None], np.stack(moves), 0.0)
    return System.build(sums, profiles.residual_gradient().select(chosen), by, columns, (tubes.tangents[chosen], tubes.owner[chosen]))


@dataclass(frozen=True)
class System:
    """Normal equations of the shared unknowns, with the positions and radii of the nodes eliminated."""

    sums: HostProfiles
    by: Array
    """Derivatives of each node's lateral position in each view with respect to the rig parameters, shape (V, N, Q)."""
    columns: Columns
    root: NDArray[np.int64]
    """Index of the branch of each node, shape (N,)."""
    start: Array
    """Gauss-Newton step of each node's position and radius if the unknowns of the rig do not change, shape (N, 4)."""
    follow: Array
    """Decrease of each node's position and radius per unit change of each unknown of the rig, shape (N, 4, K), so that
    the tubes remain at the optimum."""
    reduced: Array
    """Reduced normal matrix, shape (K, K)."""
    right: Array
    """Right-hand side of the reduced normal equations, shape (K,)."""

    @staticmethod
    def build(
        sums: HostProfiles, residual: ResidualGradient, by: Array, columns: Columns, along: tuple[Array, NDArray[np.int64]]
    ) -> System:
        """Eliminate the nodes, and return the reduced normal equations.

        Parameters
        ----------
        sums, residual : HostProfiles, ResidualGradient
            Residuals of the nodes, per view and summed over the views.
        by : (V, N, Q) array
            Derivatives of the lateral shift with respect to the rig parameters of each view.
        columns : Columns
            Mapping from the parameters of each view to the unknowns.
        along : tuple of arrays
            Tangent (N, 3) and branch index (N,) of each node.
        """
        tangent, root = along
        count, unknowns = len(tangent), len(columns.precision)
        own = residual.hessian.copy()
        mean = np.trace(own[:, :3, :3], axis1=1, axis2=2)[:, None, None] / 3.0
        own[:, :3, :3] += mean * (_RIDGE * np.eye(3) + _ALONG * tangent[:, :, None] * tangent[:, None, :])
        own[:, 3, 3] += _RIDGE * own[:, 3, 3] + 1e-9
        mixed, whole, right = np.zeros((count, 4, unknowns)), np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        for v, numbers in enumerate(columns.index):
            used = numbers >= 0
            j, by_j = numbers[used], by[v][:, used[: by.shape[2]]]
            whole[np.ix_(j, j)] += (sums.shift_2[v, :, None] * by_j).T @ by_j
            right[j] += sums.shift[v] @ by_j
            mixed[:, :3, j] += (sums.shift_2[v, :, None] * sums.across[v])[:, :, None] * by_j[:, None, :]
            mixed[:, 3, j] += (sums.shift_width[v] * sums.scale[v])[:, None] * by_j
        start = np.asarray(np.linalg.solve(own, residual.gradient[..., None])[..., 0], np.float64)
        follow = np.asarray(np.linalg.solve(own, mixed), np.float64)
        reduced = _clip_eigenvalues(whole - np.einsum("nij,nik->jk", mixed, follow))
        return System(sums, by, columns, root, start, follow, reduced, right - np.einsum("nij,ni->j", mixed, start))

    def solve(self, before: Array) -> tuple[Array, Array]:
        """Return the change (K,) of the unknowns and its covariance (K, K).

        ``before`` (K,) is the change that was applied previously, to which the prior also refers.
        """
        prior, shared, phi = self.columns.precision, self.columns.shared, 1.0
        for _ in range(_PASSES):
            covariance = inverse(self.reduced + phi * prior)
            change = covariance @ (self.right - phi * prior @ before)
            meat = self._scatter(change)
            phi = float(np.diag(covariance @ meat)[:shared].sum() / np.diag(covariance @ self.reduced)[:shared].sum())
            phi = max(phi, LEAST_VARIANCE)
        covariance = inverse(self.reduced / phi + prior)
        spread = covariance @ (meat / phi**2 + prior) @ covariance
        larger = np.sqrt(np.maximum(np.diag(spread) / np.diag(covariance), 1.0))
        return covariance @ (self.right / phi - prior @ before), covariance * larger[:, None] * larger

    @cached_property
    def _slopes(self) -> list[Array]:
        """Derivatives (N, K) of the nodes' lateral positions in each view with respect to the unknowns.

        They include the motion of the nodes to their new optimum, see `follow`.
        """
        slopes = []
        for v, numbers in enumerate(self.columns.index):
            used = numbers >= 0
            slope = -np.matmul(self.sums.across[v][:, None, :], self.follow[:, :3])[:, 0]
            slope[:, numbers[used]] += self.by[v][:, used[: self.by.shape[2]]]
            slopes.append(slope)
        return slopes

    def _remaining_residuals(self, change: Array, v: int) -> tuple[Array, Array]:
        """Return the residuals of a view's lateral positions (N,) and widths (N,) after a change of the unknowns."""
        sums = self.sums
        sideways = np.einsum("ni,ni->n", sums.across[v], self.start[:, :3]) + self._slopes[v] @ change
        wider = sums.scale[v] * (self.start[:, 3] - self.follow[:, 3] @ change)
        shift = sums.shift[v] - sums.shift_2[v] * sideways - sums.shift_width[v] * wider
        return shift, sums.width[v] - sums.shift_width[v] * sideways - sums.width_2[v] * wider

    def _scatter(self, change: Array) -> Array:
        """Return the covariance (K, K) of the normal equations' right-hand side.

        It is estimated from the scatter between roots and between views, since residuals on one root or in one view are
        correlated.
        """
        root = self.root
        own = sparse.csr_matrix((np.ones(len(root)), (root, np.arange(len(root)))))  # sums the nodes of each root
        scores = []
        for v in range(len(self.by)):
            shift, width = self._remaining_residuals(change, v)
            scores.append(own @ (self._slopes[v] * shift[:, None] - self.follow[:, 3] * (self.sums.scale[v] * width)[:, None]))
        views, roots = len(scores), own.shape[0]
        return scatter(np.concatenate(scores), np.repeat(np.arange(views), roots), np.tile(np.arange(roots), views))

    def distance_px(self, change: Array) -> float:
        """Return the lateral distance between roots and tubes after a change (K,) of the unknowns, px.

        It is the root mean square over all nodes and views.
        """
        square = weight = 0.0
        for v in range(len(self.by)):
            shift, _ = self._remaining_residuals(change, v)
            weights = self.sums.shift_2[v]
            square += float(np.sum(np.square(shift) / np.maximum(weights, 1e-9), where=weights > 0.0))
            weight += float(weights.sum())
        return float(np.sqrt(square / weight))


def _clip_eigenvalues(matrix: Array) -> Array:
    """Return a symmetric matrix with its negative eigenvalues, which are due to rounding, set to zero."""
    size, axes = np.linalg.eigh(matrix)
    return np.asarray((axes * np.maximum(size, 0.0)) @ axes.T)
