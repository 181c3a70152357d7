"""Normal equations of parameters of the views, from tubes fitted to the roots.

`tube_picture` and `tube_profiles` provide the lateral displacement of the tube at each node in each view, and
`rig_derivatives` its derivatives. The parameters are more numerous than the roots, so that the scatter of whole roots
and whole views does not determine their covariance (`system`). It determines the variance of a unit of evidence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.robust import sandwich
from rhizotwin.recon.tubes import rig_derivatives, tube_profiles
from rhizotwin.recon.tubes.parameters import Parameters
from rhizotwin.recon.tubes.rig_derivatives import Quantity
from rhizotwin.recon.tubes.system import LEAST_VARIANCE, Equations, System
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import HostProfiles

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

LEAST_NODES = 100
"""Minimum number of nodes for an estimate, which corresponds to 60 mm of root. Fewer nodes come from only one or two
roots, and their scatter is not sufficient for an estimate of the uncertainty."""
MOST_NODES = 1500
"""Maximum number of nodes used, selected at equal intervals. More nodes add no information, since the nodes of a root
are correlated."""
_LEAST_VIEWS = 8
"""Minimum number of views that must show a node for its position to be determined."""
_PASSES, _SETTLED = 20, 0.02
"""Maximum number of iterations, in each of which the change of the parameters and the variance of a unit of evidence
are updated, and relative change of the variance at which the iteration ends."""


@dataclass(frozen=True)
class Columns:
    """Parameters of the views, and how the pictures of each view depend on them."""

    parameters: Parameters
    wanted: tuple[Quantity, ...]
    """Quantities of a view on which its picture depends."""
    index: Numbers
    """Index of the parameter for each view and quantity, shape (V, Q)."""
    shared: int
    """Number of leading parameters that are shared by several views, or else of all."""

    @staticmethod
    def build(wanted: tuple[Quantity, ...], index: Numbers, value: Array, precision: Array, shared: int) -> Columns:
        """Return columns with a prior of zero mean.

        Parameters
        ----------
        wanted, index, shared : tuple of Quantity, (V, Q) int array, int
            Same as the fields.
        value, precision : (K,), (K, K) array
            Current values of the parameters, and precision matrix of their prior.
        """
        declared = dict(zip(index.ravel().tolist(), wanted * len(index), strict=True))
        many = len(value)
        parameters = Parameters(tuple(declared[k] for k in range(many)), value, np.zeros(many), precision, np.ones(many, bool))
        return Columns(parameters, wanted, index, shared)

    def at(self, value: Array) -> Columns:
        """Return the same columns at other values (K,) of the parameters."""
        return replace(self, parameters=replace(self.parameters, value=value))


@dataclass(frozen=True)
class Correction:
    """Estimated values of parameters of the views."""

    value: Array
    """Value of each parameter, shape (K,)."""
    sigma: Array
    """Standard deviation of each parameter, shape (K,)."""
    nodes: int
    before_px: float
    """RMS distance in the pictures, perpendicular to the root, between roots and fitted tubes before the correction,
    px. It is evaluated with each node at its best-fitting position."""
    after_px: float
    """The same distance after the correction, px."""


@dataclass(frozen=True)
class RigSystem:
    """Normal equations of the parameters of the views."""

    system: System
    columns: Columns
    sums: HostProfiles
    """Profiles of the M nodes that are used."""
    by: Array
    """Derivatives of each node's lateral position in each view with respect to the quantities, shape (V, M, Q)."""

    @staticmethod
    def build(drawn: Rendering, cameras: Cameras, columns: Columns) -> RigSystem | None:
        """Compute the normal equations from fitted tubes.

        The result is None if there are too few nodes.
        """
        at, profiles, points = drawn.at, tube_profiles.profiles(drawn), drawn.tubes.centre_mm
        usable = np.array(profiles.shift_2).reshape(profiles.shape) > 0.0
        nodes = np.flatnonzero(usable.sum(axis=0) >= _LEAST_VIEWS)
        if len(nodes) < LEAST_NODES:
            return None
        nodes = nodes[np.linspace(0, len(nodes) - 1, min(len(nodes), MOST_NODES)).round().astype(np.int64)]
        sums, own = profiles.host(nodes), profiles.residual_gradient()
        px = at.px[:, nodes] + drawn.evidence.window.low_px  # in coordinates of the whole picture, as used by the cameras
        moves = [
            rig_derivatives.picture_derivatives(view, cameras.optics, columns.wanted, px[v], points[nodes], sums.across[v])
            for v, view in enumerate(cameras.views)
        ]
        by = np.where((sums.shift_2 > 0.0)[..., None], np.stack(moves), 0.0)
        many = len(columns.parameters.value)
        mixed, whole, right = np.zeros((len(nodes), 4, many)), np.zeros((many, many)), np.zeros(many)
        for v, j in enumerate(columns.index):
            whole[np.ix_(j, j)] += (sums.shift_2[v, :, None] * by[v]).T @ by[v]
            right[j] += sums.shift[v] @ by[v]
            mixed[:, :3, j] += (sums.shift_2[v, :, None] * sums.across[v])[:, :, None] * by[v][:, None, :]
            mixed[:, 3, j] += (sums.shift_width[v] * sums.scale[v])[:, None] * by[v]
        # The smoothness of branches would displace curved roots, in a pattern that some index resembles.
        equations = Equations(own.hessian[nodes], own.gradient[nodes], mixed, whole, right)
        return RigSystem(System.eliminate(equations, drawn.tubes, chosen=nodes), columns, sums, by)

    def estimate(self) -> Correction:
        """Estimate the parameters."""
        parameters, shared, variance = self.columns.parameters, self.columns.shared, 1.0
        reduced, precision = self.system.reduced, parameters.precision
        for _ in range(_PASSES):
            change, least = self.system.solve(parameters, variance)
            meat, before = self.system.scatter(self._gradients(change)), variance
            found, expected = (float(np.diag(least @ part)[:shared].sum()) for part in (meat, reduced))
            variance = max(found / expected, LEAST_VARIANCE)
            if abs(variance / before - 1.0) < _SETTLED:
                break
        covariance = sandwich(reduced / before + precision, meat / before**2 + precision, least)
        return Correction(
            value=parameters.value + change,
            sigma=np.sqrt(np.diag(covariance)),
            nodes=len(self.system.start),
            before_px=self._distance_px(np.zeros_like(change)),
            after_px=self._distance_px(change),
        )

    def _remaining_residuals(self, change: Array) -> Iterator[tuple[Array, Array]]:
        """Yield the residuals of each view's lateral positions and widths (M,) after a change of the parameters."""
        sums, steps = self.sums, self.system.flank_steps(change)
        for v, (by, j) in enumerate(zip(self.by, self.columns.index, strict=True)):
            sideways, wider = np.einsum("ni,ni->n", sums.across[v], steps[:, :3]) + by @ change[j], sums.scale[v] * steps[:, 3]
            shift = sums.shift[v] - sums.shift_2[v] * sideways - sums.shift_width[v] * wider
            yield shift, sums.width[v] - sums.shift_width[v] * sideways - sums.width_2[v] * wider

    def _gradients(self, change: Array) -> Iterator[tuple[Array, Array]]:
        """Yield the gradients of the nodes (M, 4) and of the parameters (M, K) in each view after a change."""
        for v, (shift, width) in enumerate(self._remaining_residuals(change)):
            nodes = np.concatenate([self.sums.across[v] * shift[:, None], (self.sums.scale[v] * width)[:, None]], axis=1)
            right = np.zeros((len(nodes), len(change)))
            right[:, self.columns.index[v]] = self.by[v] * shift[:, None]
            yield nodes, right

    def _distance_px(self, change: Array) -> float:
        """Return the lateral distance between roots and tubes after a change (K,) of the parameters, px.

        It is the root mean square over all nodes and views.
        """
        weight, shift = self.sums.shift_2, np.stack([shift for shift, _ in self._remaining_residuals(change)])
        return float(np.sqrt(np.sum(np.square(shift) / np.maximum(weight, 1e-9), where=weight > 0.0) / weight.sum()))
