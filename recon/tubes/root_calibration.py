"""Calibration from the roots: estimate the refractive index of the water, and correct cameras and canister.

Roots are visible in all views and at all distances from the axis. A wrong refractive index displaces them in the
pictures in a pattern that no shape, and hardly any camera error, can reproduce. `tube_picture` and `tube_profiles` give
the lateral displacement of the tube at each node and view, and `rig_derivatives` its derivatives. The nodes' own
positions and radii are eliminated (Schur complement, 4x4 blocks), and

    (S / phi + prior) q = g / phi

is solved for the shared unknowns q: the refractive index, and with it the focal length, the pose of the canister in the
strip, the camera of each station and the table angle of each view. The covariances from the markers serve as the prior.
Residuals along a root and within a view are correlated; phi, the variance of a unit of evidence, is therefore computed
from the scatter of whole roots and whole views (sandwich estimator with two-way clustering: Cameron, Gelbach and Miller
2011, equation 2.11) and not from the pixels, which would be far too optimistic.
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
"""Prior standard deviation of the water's refractive index: ten degrees change it by 0.001, 2 g/l of salts by 0.0003,
red or blue light by 0.002."""
INDEX_LIMITS = 1.32, 1.36
"""Range of the refractive index, from hot to salty water."""
SURE = 3.0
"""Minimum deviation from the given index, in standard deviations, for the estimate to be used. At least `LEAST_NODES`
nodes are required."""
LEAST_GAIN = 0.04
"""Minimum relative reduction of the lateral distance of the roots for the estimate to be used.

On a radish, an error of 0.0006 gained 0.5 %; the gain grows with the square, so this limit corresponds to 0.0018. Wide
roots that are not quite round bias the index: for a printed phantom, the estimate is 0.0027 too high with five standard
deviations, and gains 0.6 to 0.8 %. The gain is that of the linear system: refitting the tubes reduces the distance by
some per cent with any index, depending on the rounding of the pictures.
"""
LEAST_NODES = 100
"""Minimum number of nodes (60 mm of root): fewer come from one or two roots, whose scatter does not give an
uncertainty."""
MOST_NODES = 1500
"""Maximum number of nodes, evenly selected; more add no information, as nodes of one root are correlated."""
LEAST_TURN_RAD = 1e-5
"""Minimum standard deviation of a table angle: markers determine it to 7e-5 at 800x600."""
_LEAST_VIEWS = 8
"""Minimum number of views for the position of a node to be determined."""
_RIDGE, _ALONG = 1e-3, 0.5
"""Fractions of a node's own curvature added in all directions, and along its root, where the views give no
constraint."""
_PASSES = 4
"""Number of iterations of the variance of a unit of evidence and the change."""
_ROUNDS, _STEPS = 4, 3
"""Number of refits of the tubes, and steps of each."""
_SETTLED = 0.2
"""Maximum change of the index in the last iteration, in standard deviations."""


@dataclass(frozen=True)
class RigCorrection:
    """Corrections of the rig estimated from the roots."""

    change: Array
    """(K,) values of all unknowns, relative to the estimate from markers and edges."""
    sigma: Array
    """(K,) standard deviations."""
    nodes: int
    before_px: float
    """Root mean square lateral distance between roots and tubes in the pictures, with each node at its best
    position."""
    after_px: float
    """The same with the corrected rig."""


@dataclass(frozen=True)
class Columns:
    """Mapping from the quantities of each view to the unknowns."""

    index: NDArray[np.int64]
    """(V, Q) index of the unknown, -1 where there is none."""
    precision: Array
    """(K, K) prior precision."""
    shared: int
    """Number of leading unknowns that several views share."""

    @staticmethod
    def per_view(views: int, quantities: int, sigma: float) -> Columns:
        """Return the columns of quantities that are independent for each view, with a wide prior."""
        count = views * quantities
        return Columns(np.arange(count).reshape(views, quantities), np.eye(count) / sigma**2, count)

    @staticmethod
    def for_rig(order: Sequence[int], known: RigUncertainty | None) -> Columns:
        """Return the columns of the rig; of the index only if the uncertainty of the cameras is unknown."""
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

    If the estimate is significant, update index and cameras and refit the tubes until convergence; if this does not
    reduce the residuals, the initial values are kept.

    Parameters
    ----------
    evidence : Evidence
        Evidence of the views of ``cameras``, in their order.
    thick : (N,) bool array
        As in `tube_fit.fit`.

    Returns
    -------
    evidence : Evidence
        Evidence with the resulting cameras and optics.
    tubes : Tubes
        Tubes fitted to it.
    cameras : Cameras
        Resulting cameras. Their ``roots`` holds the estimate; None if there are too few nodes.
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
    """Estimate corrections of the rig from fitted tubes; return None if there are too few nodes.

    Parameters
    ----------
    taken : (K,) float64 array or None
        Changes that the cameras already include, relative to the estimate from markers and edges.
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
    """Return the normal equations of the rig quantities from fitted tubes; None if there are too few nodes.

    Parameters
    ----------
    evidence, cameras, tubes : Evidence, Cameras, Tubes
        Views, and the tubes fitted to them.
    wanted : tuple of Quantity
        Quantities to estimate.
    columns : Columns
        Index of the unknown of each quantity in each view.
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
    """Return whether the index estimated from the roots is significant and within limits."""
    estimated = optics.n_water + float(found.change[0])
    sure = abs(float(found.change[0])) > SURE * float(found.sigma[0])
    return sure and found.after_px < (1.0 - LEAST_GAIN) * found.before_px and INDEX_LIMITS[0] < estimated < INDEX_LIMITS[1]


def apply_change(cameras: Cameras, change: Array) -> Cameras:
    """Return the cameras with a change (K,) of their unknowns applied."""
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
    """Normal equations of the shared unknowns, with the nodes' own positions and radii eliminated."""

    sums: HostProfiles
    by: Array
    """(V, N, Q) derivatives of the lateral shift by the quantities of the view."""
    columns: Columns
    root: NDArray[np.int64]
    """(N,) the branch of each node."""
    start: Array
    """(N, 4) step of the nodes with the shared unknowns unchanged."""
    follow: Array
    """(N, 4, K) response of the nodes to the shared unknowns (with opposite sign)."""
    reduced: Array
    """(K, K)"""
    right: Array
    """(K,)"""

    @staticmethod
    def build(
        sums: HostProfiles, residual: ResidualGradient, by: Array, columns: Columns, along: tuple[Array, NDArray[np.int64]]
    ) -> System:
        """Eliminate the nodes.

        Parameters
        ----------
        sums, residual : HostProfiles, ResidualGradient
            Residuals of the nodes, per view and summed.
        by : (V, N, Q) array
            Derivatives of the lateral shift by the quantities of the view.
        columns : Columns
            Index of the unknown of each quantity.
        along : tuple of arrays
            Tangents (N, 3) and branches (N,) of the nodes.
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
        reduced = _positive(whole - np.einsum("nij,nik->jk", mixed, follow))
        return System(sums, by, columns, root, start, follow, reduced, right - np.einsum("nij,ni->j", mixed, start))

    def solve(self, before: Array) -> tuple[Array, Array]:
        """Return the change (K,) and its covariance; ``before`` (K,) was applied already."""
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
        """Derivative (N, K) of each view's shift by the shared unknowns, including the response of the nodes."""
        slopes = []
        for v, numbers in enumerate(self.columns.index):
            used = numbers >= 0
            slope = -np.matmul(self.sums.across[v][:, None, :], self.follow[:, :3])[:, 0]
            slope[:, numbers[used]] += self.by[v][:, used[: self.by.shape[2]]]
            slopes.append(slope)
        return slopes

    def _left(self, change: Array, v: int) -> tuple[Array, Array]:
        """Return the remaining residuals of a view: shift (N,) and width (N,)."""
        sums = self.sums
        sideways = np.einsum("ni,ni->n", sums.across[v], self.start[:, :3]) + self._slopes[v] @ change
        wider = sums.scale[v] * (self.start[:, 3] - self.follow[:, 3] @ change)
        shift = sums.shift[v] - sums.shift_2[v] * sideways - sums.shift_width[v] * wider
        return shift, sums.width[v] - sums.shift_width[v] * sideways - sums.width_2[v] * wider

    def _scatter(self, change: Array) -> Array:
        """Return the covariance (K, K) of the right-hand side, from the scatter of whole roots and whole views."""
        root = self.root
        own = sparse.csr_matrix((np.ones(len(root)), (root, np.arange(len(root)))))  # sums nodes by root
        scores = []
        for v in range(len(self.by)):
            shift, width = self._left(change, v)
            scores.append(own @ (self._slopes[v] * shift[:, None] - self.follow[:, 3] * (self.sums.scale[v] * width)[:, None]))
        views, roots = len(scores), own.shape[0]
        return scatter(np.concatenate(scores), np.repeat(np.arange(views), roots), np.tile(np.arange(roots), views))

    def distance_px(self, change: Array) -> float:
        """Return the root mean square lateral distance that remains after a change (K,)."""
        square = weight = 0.0
        for v in range(len(self.by)):
            shift, _ = self._left(change, v)
            weights = self.sums.shift_2[v]
            square += float(np.sum(np.square(shift) / np.maximum(weights, 1e-9), where=weights > 0.0))
            weight += float(weights.sum())
        return float(np.sqrt(square / weight))


def _positive(matrix: Array) -> Array:
    """Return a symmetric matrix with negative eigenvalues due to rounding set to zero."""
    size, axes = np.linalg.eigh(matrix)
    return np.asarray((axes * np.maximum(size, 0.0)) @ axes.T)
