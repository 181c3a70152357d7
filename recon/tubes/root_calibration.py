"""Calibration from the roots: refractive index of the water, and corrections of cameras and canister.

Roots are visible in all views and at all distances from the axis. An incorrect refractive index displaces them in the
pictures in a pattern that no shape, and hardly any camera error, can reproduce. `tube_picture` and `tube_profiles`
provide the lateral displacement of the tube at each node in each view, and `rig_derivatives` its derivatives. The
positions and radii of the nodes are eliminated (Schur complement, 4x4 blocks), and

    (S / phi + prior) q = g / phi

is solved for the shared unknowns q: the refractive index, the focal length, the pose of the canister in the strip, the
camera of each station, and the table angle of each view. The covariances from the markers are used as the prior.
Residuals along a root and within a view are correlated. The variance phi of a unit of evidence is therefore computed
from the scatter of whole roots and whole views (sandwich estimator with two-way clustering: Cameron, Gelbach and Miller
2011, equation 2.11). The scatter of the pixels would be far too optimistic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from rhizotwin.recon.calibration.cameras import Cameras, RigUncertainty, RootCalibration
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.robust import inverse, scatter
from rhizotwin.recon.tubes import rig_derivatives, tube_fit, tube_profiles
from rhizotwin.recon.tubes.rig_derivatives import QUANTITIES, Quantity
from rhizotwin.recon.tubes.root_light import LEAST_VARIANCE
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import HostProfiles, ResidualGradient
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

INDEX_PRIOR = 0.003
"""Prior standard deviation of the water's refractive index.

For comparison, ten degrees change the index by 0.001, 2 g/l of salts by 0.0003, and red or blue light by 0.002."""
INDEX_LIMITS = 1.32, 1.36
"""Minimum and maximum of the estimated refractive index, which are those of hot water and of salty water."""
SURE = 3.0
"""Minimum deviation of the estimated from the given refractive index, in standard deviations, for the estimate to be
used."""
LEAST_GAIN = 0.04
"""Minimum relative reduction of the lateral distance between the centre lines in the pictures and those of the fitted
tubes. The estimated refractive index is used only if the reduction is larger.

On a radish, the correction of an index error of 0.0006 reduced the distance by 0.5 %. The reduction is proportional to
the square of the error, so that this limit corresponds to 0.0018. Wide roots that are not quite round bias the index:
for a printed phantom, the estimate is 0.0027 too high with five standard deviations, and the reduction is 0.6 to 0.8 %.
The reduction is computed from the linear system, since refitting the tubes reduces the distance by some per cent with
any index, depending on the rounding of the pictures."""
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
_ROUNDS, _STEPS = 4, 3
"""Maximum number of refits of the tubes, and number of iterations of each refit."""
_SETTLED = 0.2
"""Change of the refractive index between two refits below which the iteration has converged, in standard deviations."""


@dataclass(frozen=True)
class RigCorrection:
    """Corrections of the rig, estimated from the roots."""

    change: Array
    """Change of each unknown, shape (K,), relative to the calibration from the markers and the canister's edges."""
    sigma: Array
    """Standard deviation of each unknown, shape (K,)."""
    nodes: int
    before_px: float
    """RMS distance in the pictures, perpendicular to the root, between roots and fitted tubes before the correction,
    px. It is evaluated with each node at its best-fitting position."""
    after_px: float
    """Root mean square lateral distance in the pictures between roots and fitted tubes, px, after the correction."""


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


def calibrate(evidence: Evidence, cameras: Cameras, tubes: Tubes, thick: Mask) -> tuple[Evidence, Tubes, Cameras]:
    """Estimate the refractive index from fitted tubes.

    If the estimate is significant, index and cameras are updated and the tubes are refitted until convergence. The
    initial values are kept if this does not reduce the residuals.

    Parameters
    ----------
    evidence : Evidence
        Measured coverage of the views of ``cameras``, in the same order.
    thick : (N,) bool array
        Same as in `tube_fit.fit`.

    Returns
    -------
    evidence : Evidence
        Measured coverage with the resulting cameras and optics.
    tubes : Tubes
        Tubes fitted to the coverage with these cameras.
    cameras : Cameras
        Resulting cameras. Their attribute ``roots`` is the estimate, or None if there are too few nodes.
    """
    first = estimate(evidence, cameras, tubes)
    if first is None:
        return evidence, tubes, cameras
    given, found, now = (evidence, tubes), first, cameras
    if sure := is_significant(first, cameras.optics):
        for _ in range(_ROUNDS):
            now = apply_change(cameras, found.change)
            evidence = evidence.with_cameras(now)
            tubes = tube_fit.fit(evidence, tubes, thick, steps=_STEPS).tubes
            last = found
            found = estimate(evidence, now, tubes, taken=last.change) or last
            if abs(found.change[0] - last.change[0]) < _SETTLED * found.sigma[0]:
                break
        if found.after_px > first.before_px:
            sure, (evidence, tubes), found, now = False, given, first, cameras
    calibration = RootCalibration(
        n_water=now.optics.n_water if sure else cameras.optics.n_water + float(found.change[0]),
        n_water_sigma=float(found.sigma[0]),
        n_water_given=cameras.optics.n_water,
        focal_scale=now.lens.focal_px[0] / cameras.lens.focal_px[0],
        believed=sure,
        nodes=first.nodes,
        before_px=first.before_px,
        after_px=found.after_px,
    )
    return evidence, tubes, replace(now, roots=calibration)


def estimate(evidence: Evidence, cameras: Cameras, tubes: Tubes, *, taken: Array | None = None) -> RigCorrection | None:
    """Estimate corrections of the rig from fitted tubes.

    The result is None if there are too few nodes.

    Parameters
    ----------
    taken : (K,) float64 array or None
        Changes that were already applied to the cameras, relative to the estimate from markers and edges.
    """
    known = cameras.uncertainty
    columns, wanted = Columns.for_rig(cameras.order, known), QUANTITIES if known is not None else QUANTITIES[:1]
    found = build_system(evidence, cameras, tubes, wanted, columns)
    if found is None:
        return None
    before = np.zeros(len(columns.precision)) if taken is None else taken
    more, covariance = found.solve(before)
    return RigCorrection(
        change=before + more,
        sigma=np.sqrt(np.diag(covariance)),
        nodes=len(found.start),
        before_px=found.distance_px(np.zeros_like(more)),
        after_px=found.distance_px(more),
    )


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


def is_significant(found: RigCorrection, optics: Optics) -> bool:
    """Return whether the refractive index estimated from the roots is significant and within its limits."""
    estimated = optics.n_water + float(found.change[0])
    sure = abs(float(found.change[0])) > SURE * float(found.sigma[0])
    return sure and found.after_px < (1.0 - LEAST_GAIN) * found.before_px and INDEX_LIMITS[0] < estimated < INDEX_LIMITS[1]


def apply_change(cameras: Cameras, change: Array) -> Cameras:
    """Return the cameras after the unknowns have changed by ``change`` (K,)."""
    optics = replace(cameras.optics, n_water=cameras.optics.n_water + float(change[0]))
    known = cameras.uncertainty
    if known is None:
        return replace(cameras, optics=optics)
    stations = known.stations
    camera, turn = change[6 : 6 + 6 * stations].reshape(-1, 6), change[6 + 6 * stations :]
    moved = []
    for v, (frame, view) in enumerate(zip(cameras.order, cameras.views, strict=True)):
        canister = np.array([change[2], change[3], turn[v], change[4], change[5], 0.0])
        view = rig_derivatives.move_camera(rig_derivatives.move_canister(view, canister), camera[known.station[frame]])
        moved.append(replace(view, camera=view.camera.focused(1.0 + float(change[1]))))
    return cameras.with_views(moved, optics)


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
