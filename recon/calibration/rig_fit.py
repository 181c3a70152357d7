"""Bundle adjustment of the rig over all pictures.

The unknowns are the camera of each ring, the table angles, and the pose of the canister on the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.pose_errors import PoseErrors
from rhizotwin.recon.calibration.view_fit import Linearised, Sightings, adjoint, linearise, twist
from rhizotwin.recon.robust import inverse, sandwich, scatter
from rhizotwin.recon.settings import CalibrationSettings
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array

CANISTER = np.array([0, 1, 3, 4])
"""Indices of the twist components that describe the pose of a canister on the table: tilt about x and y, and offset in
x and y. Height and rotation about the axis are part of the camera's pose."""
CANISTER_PRIOR = np.array([np.deg2rad(2.0), np.deg2rad(2.0), 5.0, 5.0])
"""Prior standard deviations of the canister's misalignment: tilt about x and y, rad, and offset in x and y, mm."""
FREE_PRIOR_RAD = 0.3
"""Prior standard deviation of a table angle that was not commanded, rad. The prior mean is the azimuth of the camera
relative to the strip, which is inaccurate if the canister is misaligned with the table."""
TAIL = 4.0
"""Degrees of freedom of the Student's t distribution that models the camera's movement in single views. Because of its
heavy tails, a view in which the camera moved does not affect the other views."""
STILL = np.array([np.deg2rad(1e-5), 1e-4])
"""Minimum standard deviation of the camera's movement in single views, rad and mm."""
LEAST_SCALE = 0.3
"""Lower limit of the estimated ratio of the corner residuals to their standard deviations. It prevents the corners from
being treated as exact if a few residuals are small."""
MOST_STEPS = 15
"""Maximum number of Gauss-Newton steps. The iteration either converges in a few steps or diverges."""
SPREAD_STEPS = 10
"""Number of fixed-point iterations for the standard deviation of the camera's movement, within each Gauss-Newton step.
The fixed-point iterations and the Gauss-Newton steps converge together."""
_CHI2_MEDIAN = 7.34
"""Median of the chi-squared distribution with 8 degrees of freedom, one for each coordinate of a marker's four corners
(`scipy.stats.chi2.median(8)` is 7.344)."""
ENOUGH = 1e-6
"""Step size below which the fit ends, in rad, mm and px."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Parameters of the rig.

    ``cam_from_canister = own[v] @ cam_from_rig[ring[v]] @ Rz(angle[v]) @ table_from_canister``.
    """

    ring: NDArray[np.int64]
    """(V,) index of each view's camera in ``cam_from_rig``."""
    cam_from_rig: Array
    """(R, 4, 4) poses of the static cameras, mm."""
    angle_rad: Array
    """(V,) table angle of each view, about +z, rad."""
    own: Array
    """(V, 4, 4) small movement of the camera in each view, relative to the static camera."""
    table_from_canister: Array
    """(4, 4) pose of the canister on the table, mm. It contains neither the height nor the rotation about the axis."""
    inset_px: float
    """Apparent enlargement of the markers on each side, px."""
    focal_scale: float
    """Ratio of the focal lengths to those of the calibrated lens."""
    spread: Array
    """(R, 2) standard deviations of the movements ``own``: rotation about each axis, rad, and shift along each axis,
    mm."""

    def rig_pose(self, view: int) -> Array:
        """Return ``cam_from_canister`` (4, 4) of a view, neglecting the small movement of the camera in this view."""
        turned = frames.rotation_z(float(self.angle_rad[view])) @ self.table_from_canister
        return np.asarray(self.cam_from_rig[self.ring[view]] @ turned)

    def pose(self, view: int) -> Array:
        """Return ``cam_from_canister`` (4, 4) of a view, including the small movement of the camera in this view."""
        return np.asarray(self.own[view] @ self.rig_pose(view))


@dataclass(frozen=True, kw_only=True)
class RigFit:
    """Best-fitting rig and its uncertainty."""

    rig: Rig
    """Best-fitting parameters of the rig."""
    views: tuple[Linearised, ...]
    """(V,) least-squares problem of each view, linearised at the solution."""
    rig_px: Array
    """(V,) reprojection error of each view, px, neglecting the small movement of the camera in this view."""
    errors: PoseErrors
    """Errors of the views' camera poses."""
    turn_sigma_rad: Array
    """(V,) standard deviations of the table angles, rad."""

    @property
    def focal_sigma(self) -> float:
        """Return the standard deviation of ``rig.focal_scale``."""
        return float(np.sqrt(self.errors.shared[1, 1]))

    def ring_covariance(self, ring: int) -> Array:
        """Return the covariance (6, 6) of the error of one ring's ``cam_from_rig``.

        The error is a twist (rad, mm) applied from the left.
        """
        own = slice(2 + 6 * ring, 8 + 6 * ring)
        return self.errors.shared[own, own]


def fit_rig(
    sightings: Sequence[Sightings], start: Rig, command_rad: Array, known: NDArray[np.bool_], settings: CalibrationSettings
) -> RigFit:
    """Fit the rig to all pictures by Gauss-Newton.

    In each step, every picture is reduced to the normal equations of its camera pose, without loss of information.

    Marker corners are weighted by their covariance, and markers by the Cauchy loss. The standard deviation of the
    camera's movement between views is estimated from the pictures by expectation maximisation under Student's t
    distribution. For a static camera, it converges to zero, and all views share one pose. For a moving camera, it
    converges to the scatter of the single views.

    Parameters
    ----------
    sightings : sequence of Sightings
        Markers of each view, with their positions on the strip.
    start : Rig
        Initial rig, near the solution, in which the poses of the views are those estimated from single views.
    command_rad : (V,) float64 array
        Commanded table angles, rad.
    known : (V,) bool array
        Whether each table angle was commanded.
    settings : CalibrationSettings
        Priors of the table angles, the inset and the focus. A very small prior standard deviation of the focus keeps
        the calibrated focal length.
    """
    rig, scale = start, 1.0
    angle_sigma = np.where(known, np.deg2rad(settings.table_prior_deg), FREE_PRIOR_RAD)
    weight = np.ones(len(sightings))
    for _ in range(MOST_STEPS):
        views = _linearise_views(sightings, rig, scale)
        scale = max(scale * _residual_ratio(views), LEAST_SCALE)
        system = _System.build(rig, views, rig.angle_rad - command_rad, angle_sigma, settings)
        spread, weight = system.find_spread(rig.spread, weight)
        shared, local = system.solve(spread, weight)[:2]
        rig = _apply_step(replace(rig, spread=spread), shared, local)
        if max(np.abs(local).max(), np.abs(shared).max()) < ENOUGH:
            break
    views = _linearise_views(sightings, rig, scale)
    system = _System.build(rig, views, rig.angle_rad - command_rad, angle_sigma, settings)
    rig_px = [linearise(s, rig.rig_pose(k), focal_scale=rig.focal_scale).rms_px for k, s in enumerate(sightings)]
    return system.report(sightings, weight, np.array(rig_px))


def _linearise_views(sightings: Sequence[Sightings], rig: Rig, scale: float) -> tuple[Linearised, ...]:
    shared = {"inset_px": rig.inset_px, "focal_scale": rig.focal_scale, "scale": scale}
    return tuple(linearise(s, rig.pose(k), **shared) for k, s in enumerate(sightings))


def _residual_ratio(views: Sequence[Linearised]) -> float:
    """Return the ratio of the residuals to their standard deviations."""
    return float(np.sqrt(np.median(np.concatenate([view.chi2 for view in views])) / _CHI2_MEDIAN))


def _apply_step(rig: Rig, shared: Array, local: Array) -> Rig:
    """Update the parameters of a rig by one step of the fit.

    The step consists of the changes of the shared unknowns (2 + 6 R + 4,) and the local unknowns (V, 7), which are
    listed in `_System`.
    """
    rings = shared[2:-4].reshape(-1, 6)
    canister = np.array([shared[-4], shared[-3], 0.0, shared[-2], shared[-1], 0.0])
    return replace(
        rig,
        inset_px=rig.inset_px + float(shared[0]),
        focal_scale=rig.focal_scale + float(shared[1]),
        cam_from_rig=np.array([twist(step) @ pose for step, pose in zip(rings, rig.cam_from_rig, strict=True)]),
        table_from_canister=twist(canister) @ rig.table_from_canister,
        angle_rad=rig.angle_rad + local[:, 0],
        own=np.array([twist(step[1:]) @ pose for step, pose in zip(local, rig.own, strict=True)]),
    )


@dataclass(frozen=True)
class _System:
    """Normal equations of the rig fit, linearised at the current parameters of the rig.

    The S shared unknowns are the inset, the focus (focal scale), 6 components of the camera pose of each ring, and 4
    components of the canister's pose. The 7 local unknowns of each view are the table angle and 6 components of the
    camera's movement. They determine the 8 parameters of a view: 6 of the pose twist, the inset of the markers' edges,
    and the factor on the focal length.
    """

    rig: Rig
    views: Sequence[Linearised]
    by_shared: Array
    """(V, 8, S) derivatives of the parameters of each view with respect to the shared unknowns."""
    by_local: Array
    """(V, 8, 7) derivatives of the parameters of each view with respect to its local unknowns."""
    shared_value: Array
    """(S,) values of the shared unknowns, minus their prior means."""
    shared_prior: Array
    """(S,) prior precision of the shared unknowns."""
    local_value: Array
    """(V, 7) values of the local unknowns, minus their prior means: table angle, rad, rotation vector of the camera's
    movement, rad, and its shift, mm."""
    angle_sigma: Array
    """(V,) prior standard deviation of the table angles, rad."""

    @classmethod
    def build(cls, rig: Rig, views: Sequence[Linearised], angle_off: Array, angle_sigma: Array, settings: CalibrationSettings) -> "_System":
        count, rings = len(views), len(rig.cam_from_rig)
        by_shared, by_local = np.zeros((count, 8, 2 + 6 * rings + 4)), np.zeros((count, 8, 7))
        by_shared[:, 6, 0] = by_shared[:, 7, 1] = 1.0
        by_local[:, :6, 1:] = np.eye(6)
        for k in range(count):
            ring = int(rig.ring[k])
            by_shared[k, :6, 2 + 6 * ring : 8 + 6 * ring] = adjoint(rig.own[k])
            cam_from_rig = rig.own[k] @ rig.cam_from_rig[ring]
            by_local[k, :6, 0] = adjoint(cam_from_rig)[:, 2]
            by_shared[k, :6, -4:] = adjoint(cam_from_rig @ frames.rotation_z(float(rig.angle_rad[k])))[:, CANISTER]
        canister, free = _to_twist(rig.table_from_canister)[CANISTER], np.zeros(6 * rings)
        known = np.array([settings.inset_prior_px, settings.focus_prior]) ** -2.0, np.full(6 * rings, 1e-9), CANISTER_PRIOR**-2.0
        return cls(
            rig=rig,
            views=views,
            by_shared=by_shared,
            by_local=by_local,
            shared_value=np.concatenate([[rig.inset_px, rig.focal_scale - 1.0], free, canister]),
            shared_prior=np.concatenate(known),
            local_value=np.column_stack([angle_off, [_to_twist(pose) for pose in rig.own]]),
            angle_sigma=angle_sigma,
        )

    def _prior(self, spread: Array, weight: Array) -> Array:
        """Return the prior precision (V, 7) of the local unknowns."""
        precision = np.repeat(spread[self.rig.ring] ** -2.0, 3, axis=1) * weight[:, None]
        return np.concatenate([self.angle_sigma[:, None] ** -2.0, precision], axis=1)

    @cached_property
    def _products(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return the products of the views' normal equations with the derivatives by local and by shared unknowns."""
        normal, gradient = np.array([view.normal for view in self.views]), np.array([view.gradient for view in self.views])
        local, shared = (np.einsum("vij,vik->vjk", by, normal) for by in (self.by_local, self.by_shared))
        by_gradient = np.einsum("vij,vi->vj", self.by_local, gradient), np.einsum("vij,vi->j", self.by_shared, gradient)
        return local @ self.by_local, local @ self.by_shared, shared @ self.by_shared, *by_gradient

    def solve(self, spread: Array, weight: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return the next step of all unknowns, with covariances.

        Return, in this order, the step of the shared unknowns (S,), the step of the local unknowns (V, 7), the
        covariance (S, S) of the shared unknowns, the covariance (V, 7, 7) of the local unknowns at fixed shared
        unknowns, and the gain (V, 7, S). The covariances are valid for independent residuals. The gain is minus the
        derivative of the local unknowns with respect to the shared unknowns.
        """
        local_normal, cross, shared_normal, local_right, shared_right = self._products
        prior = self._prior(spread, weight)
        right = local_right - prior * self.local_value
        given = inverse(local_normal + prior[:, :, None] * np.eye(7))
        gain = given @ cross
        reduced = np.sum(shared_normal - cross.transpose(0, 2, 1) @ gain, axis=0) + np.diag(self.shared_prior)
        covariance = inverse(reduced)
        shared = covariance @ (shared_right - self.shared_prior * self.shared_value - np.einsum("vij,vi->j", gain, right))
        local = np.einsum("vij,vj->vi", given, right) - gain @ shared
        return shared, local, covariance, given, gain

    def find_spread(self, spread: Array, weight: Array) -> tuple[Array, Array]:
        """Estimate the standard deviations (R, 2) of small camera movements, and the weights (V,) of views."""
        for _ in range(SPREAD_STEPS):
            _, local, shared, given, gain = self.solve(spread, weight)
            covariance = given + gain @ shared @ gain.transpose(0, 2, 1)
            movement = (self.local_value + local)[:, 1:] ** 2 + np.diagonal(covariance, axis1=1, axis2=2)[:, 1:]
            square = movement.reshape(-1, 2, 3).sum(axis=2)
            weight = (TAIL + 6.0) / (TAIL + np.sum(square / spread[self.rig.ring] ** 2, axis=1))
            found = np.array([np.sqrt(np.mean(weight[members, None] * square[members], axis=0) / 3.0) for members in self._members()])
            spread = np.maximum(found**2 / spread, STILL)
        return spread, weight

    def _members(self) -> list[NDArray[np.bool_]]:
        return [self.rig.ring == ring for ring in range(len(self.rig.cam_from_rig))]

    def report(self, sightings: Sequence[Sightings], weight: Array, rig_px: Array) -> RigFit:
        """Compute the errors of the camera poses, and return the result of the fit."""
        shared, given, gain = self.solve(self.rig.spread, weight)[2:]
        scores, curvatures, view = [], [], []
        for k, local in enumerate(self.views):
            carry, share = self.by_shared[k] - self.by_local[k] @ gain[k], 1.0 / len(local.chi2)
            held = self._prior(self.rig.spread, weight)[k]
            scores.append(local.gradients @ carry + share * held * self.local_value[k] @ gain[k])
            curvatures.append(carry.T @ local.normals @ carry + share * (gain[k].T * held) @ gain[k])
            view.append(np.full(len(local.chi2), k))
        rows, parts = np.concatenate(scores), np.concatenate(curvatures)
        known = np.diag(self.shared_prior)
        normal = parts.sum(axis=0) + known
        meat = scatter(rows, np.concatenate(view), _picture_squares(sightings, self.rig), curvatures=parts, normal=normal)
        carry = self.by_shared[:, :6] - self.by_local[:, :6] @ gain
        own = self.by_local[:, :6] @ given @ self.by_local[:, :6].transpose(0, 2, 1)
        errors = PoseErrors(shared=sandwich(normal, meat + known, shared), carry=carry, own=own)
        turn = given[:, 0, 0] + np.einsum("vs,st,vt->v", gain[:, 0], errors.shared, gain[:, 0])
        return RigFit(rig=self.rig, views=tuple(self.views), rig_px=rig_px, errors=errors, turn_sigma_rad=np.sqrt(turn))


def _to_twist(pose: Array) -> Array:
    """Return the rotation vector, rad, and the shift, mm, of a transform (4, 4) as one array (6,)."""
    return np.concatenate([frames.to_rotvec(pose), pose[:3, 3]])


def _picture_squares(sightings: Sequence[Sightings], rig: Rig) -> NDArray[np.int64]:
    """Return the index (M,) of the square in the picture that contains each marker.

    The squares have the size of a marker. In the views of a static camera, markers on the same pixels appear at the
    same angle to the curved strip. Errors caused by these pixels are therefore the same in all views. The errors of
    marker centres have a correlation of 0.1 at distances of up to 8 px, and are uncorrelated beyond (400x300 pixels,
    markers of 12 px).
    """
    side_px = float(np.median(np.concatenate([np.linalg.norm(one.px[:, 1] - one.px[:, 2], axis=1) for one in sightings])))
    square = [np.floor(one.px.mean(axis=1) / side_px) for one in sightings]
    row = np.concatenate([np.column_stack([np.full(len(at), rig.ring[k]), at]) for k, at in enumerate(square)])
    return np.asarray(np.unique(row.astype(np.int64), axis=0, return_inverse=True)[1].ravel(), np.int64)
