"""Error of the refraction, estimated from the displacement between rendered and photographed outlines.

A wrong refractive index, a wrong wall or a wrong scale displaces roots in a pattern that no shape reproduces in all
views. The difference eps between the measured and the rendered opacity P of a pixel is, to first order,

    eps = -grad(P) . (g theta + A D(X) c + T_k xi_k),

with the parameter theta, its effect g on the image of the root's point X, a smooth deformation D(X) c of the whole
shape, its effect A, and the error xi_k of the camera of view k. All effects are differences of lines of sight that the
twin traces. The deformation is a polynomial of degree `_DEGREE` in the coordinates, which absorbs the change of the
shape by wrong refraction. The errors of the cameras have their standard deviations in the result as a prior. Errors of
single roots are correlated, so that the covariance is that of clusters (`recon.robust`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.coverage.silhouettes import Image
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.robust import MAD, inverse, scatter
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from rhizotwin.sim.render import DEFAULT_SAMPLES
from rhizotwin.sim.world import TrueCamera
from rhizotwin.verification.pictures import Picture
from rhizotwin.verification.synthesis import Rays, Synthesis, true_camera

Array = NDArray[np.float64]

INDEX, WALL, SCALE = "refractive index of the water", "thickness of the wall", "scale (size of the marker strip)"
"""Parameters whose errors are estimated, each alone."""
_STEPS = {INDEX: 0.005, WALL: 0.5, SCALE: 0.005}
"""Differences with which the effects of the parameters are computed. Effects are linear up to several times these
steps, and the rounding of single-precision rays is a thousandth of them."""
_TURN_RAD, _SHIFT_MM = 1e-3, 0.2
"""Rotation and shift with which the effects of a camera's error are computed."""
_LEAST_EDGE = 0.05
"""Minimum gradient of the rendered opacity, per pixel, of the pixels that are compared."""
_NEAR_HIT_PX = 1.5
"""Maximum distance from a pixel of an outline to the nearest pixel whose central line of sight meets the root, px."""
_MOST_ENLARGED = 3.0
"""Maximum scale of a picture at a point, px/mm, relative to the median. It is infinite where lines of sight cross near
the wall, and a single such point would determine the estimate."""
_MOST_PIXELS = 4000
"""Maximum number of pixels of a picture that are used. More pixels of the same roots add hardly any information,
because their errors are correlated."""
_DEGREE = 3
_DEFORMED_MM = 1.0
"""Prior standard deviation of the coefficients of the deformation, mm."""
_CLUSTER_MM = 12.0
"""Edge length of the cubes whose pixels, in all views, form a cluster. Roots are straight over about this length."""
_LEAST_CLUSTERS = 8
"""Minimum number of clusters from which a standard deviation is estimated."""
_TUNING = 1.345
"""Threshold of Huber's loss in standard deviations, with an efficiency of 95 % for normal residuals (Huber 1981)."""
_ROUNDS = 15
_LATTICE_STEP = 1.0 / DEFAULT_SAMPLES["backlit"] / np.sqrt(12.0)
"""Standard deviation of the rounding of a rendered opacity, a multiple of the inverse of the number of rays."""
CHANCE = 5e-4
"""Probability with which a result with correct refraction is rejected because of noise."""
INDEX_TOLERANCE = 0.001
"""Error of the refractive index that is not an error of the result: that of ten degrees of temperature, or of a few
grams of salt per litre (profile ``bench``). It displaces a root by 0.03 mm at a depth of 40 mm."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Estimated error of one parameter, if it is the only one that is wrong."""

    parameter: str
    value: float
    sigma: float
    """Standard deviation of ``value``."""
    misfit: float
    """Weighted sum of squared residuals, relative to that without the parameter."""


@dataclass(frozen=True, kw_only=True)
class RefractionError:
    """Errors of the refraction, each estimated alone, in the order of their misfit."""

    estimates: tuple[Estimate, ...]
    """Empty if there are too few outlines."""
    clusters: int
    """Number of independent groups of pixels."""

    @property
    def index(self) -> Estimate | None:
        """Return the estimated error of the refractive index, which also measures all other errors of refraction."""
        return next((one for one in self.estimates if one.parameter == INDEX), None)

    @property
    def detectable(self) -> float:
        """Return the smallest estimated error of the index that exceeds the tolerance and the noise (`CHANCE`)."""
        index = self.index
        return math.inf if index is None else INDEX_TOLERANCE + float(student.isf(CHANCE, self.clusters - 1)) * index.sigma

    @property
    def is_wrong(self) -> bool:
        """Return whether the error exceeds `INDEX_TOLERANCE` by more than the noise (`CHANCE`)."""
        return self.index is not None and abs(self.index.value) > self.detectable


@dataclass(frozen=True)
class _Rows:
    """Linear equations of the outline pixels of one view."""

    difference: Array
    """(N,) measured minus rendered opacity."""
    points_mm: Array
    """(N, 3) points of the roots."""
    by_point: Array
    """(N, 3) derivatives by the position of the point, 1/mm."""
    by_parameter: Array
    """(N, P) derivatives by the parameters of `_STEPS`."""
    by_camera: Array
    """(N, 6) derivatives by the rotation, rad, and the shift, mm, of the camera, from the left."""
    precision: Array
    """(6,) inverse prior variances of the camera's error."""


class Equations:
    """Equations of all views of a result.

    Parameters
    ----------
    result, scene : Result, Scene
        Result and scene of its dataset.
    synthesis : Synthesis
        Twin of the result.
    """

    def __init__(self, result: Result, scene: Scene, synthesis: Synthesis) -> None:
        self.synthesis, self.scene = synthesis, scene
        self.changed = {
            INDEX: Synthesis(result, scene, n_water_error=_STEPS[INDEX]),
            WALL: Synthesis(result, scene, wall_error_mm=_STEPS[WALL]),
        }
        self.rows: list[_Rows] = []

    def add(self, picture: Picture, rendered: Image) -> None:
        """Add the outlines of a picture, given its rendered opacity (H, W)."""
        camera = true_camera(picture.camera, self.scene)
        down, right = np.gradient(rendered.astype(np.float64))
        gradient = np.stack([right, down], axis=-1)
        surface = self.synthesis.surface(camera, rendered)
        outline = (np.linalg.norm(gradient, axis=-1) > _LEAST_EDGE) & picture.usable & (surface.distance_px <= _NEAR_HIT_PX)
        px = np.argwhere(outline)[:, ::-1]
        if not len(px):
            return
        px = px[:: -(-len(px) // _MOST_PIXELS)]
        hit_px, points_mm = surface.at(px)
        rays = self.synthesis.rays(camera, hit_px)
        sideways = [self.synthesis.rays(camera, hit_px + step) for step in (*np.eye(2), *-np.eye(2))]
        moves = [one.offset_mm(points_mm) for one in sideways]
        to_px = np.linalg.pinv(np.stack([0.5 * (moves[k] - moves[k + 2]) for k in range(2)], axis=-1))  # (N, 2, 3)
        slope = gradient[px[:, 1], px[:, 0]]
        size = np.linalg.norm(to_px, axis=(1, 2))
        known = np.logical_and.reduce([one.known for one in sideways]) & (size < _MOST_ENLARGED * np.median(size))

        def effect(other: Rays, step: float) -> Array:
            """Return the change (N,) of the opacity per unit, if other lines of sight belong to the pixels."""
            return np.asarray(np.einsum("ni,nij,nj->n", slope, to_px, other.offset_mm(points_mm)) / step)

        along = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None, :]
        parameters = [effect(changed.rays(camera, hit_px), _STEPS[name]) for name, changed in self.changed.items()]
        pose = camera.cam_from_canister
        parameters.append(effect(self.synthesis.rays(_moved(camera, np.r_[0, 0, 0, _STEPS[SCALE] * pose[:3, 3]]), hit_px), _STEPS[SCALE]))
        twists = np.diag([_TURN_RAD] * 3 + [_SHIFT_MM] * 3)
        cameras = [effect(self.synthesis.rays(_moved(camera, twist), hit_px), float(twist.sum())) for twist in twists]
        self.rows.append(
            _Rows(
                difference=(picture.opacity - rendered)[px[:, 1], px[:, 0]].astype(np.float64)[known],
                points_mm=points_mm[known],
                by_point=-np.einsum("ni,nij,njk->nk", slope, to_px, along)[known],
                by_parameter=np.stack(parameters, axis=1)[known],
                by_camera=np.stack(cameras, axis=1)[known],
                precision=_precision(picture.camera),
            )
        )

    def solve(self) -> RefractionError:
        """Estimate the error of each parameter."""
        points_mm = np.concatenate([rows.points_mm for rows in self.rows]) if self.rows else np.zeros((0, 3))
        cell = np.unique(np.floor(points_mm / _CLUSTER_MM).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
        clusters = int(cell.max(initial=-1)) + 1
        if clusters < _LEAST_CLUSTERS:
            return RefractionError(estimates=(), clusters=clusters)
        nuisance, precision = self._nuisance(points_mm)
        difference = np.concatenate([rows.difference for rows in self.rows])
        weight, sigma = _fit_weights(nuisance, precision, difference)
        data = _Data(difference=difference, weight=weight, sigma=sigma, cell=cell)
        found = []
        for k, name in enumerate(_STEPS):
            column = np.concatenate([rows.by_parameter[:, k] for rows in self.rows])
            found.append(_fit_one(name, column, nuisance, precision, data))
        return RefractionError(estimates=tuple(sorted(found, key=lambda one: one.misfit)), clusters=clusters)

    def _nuisance(self, points_mm: Array) -> tuple[Array, Array]:
        """Return the columns (N, K) of the deformation and of the cameras, and their prior inverse variances (K,)."""
        centre = points_mm.mean(axis=0)
        place = (points_mm - centre) / np.abs(points_mm - centre).max()
        powers = [power for power in product(range(_DEGREE + 1), repeat=3) if sum(power) <= _DEGREE]
        basis = np.stack([np.prod(place**power, axis=1) for power in powers], axis=1)
        by_point = np.concatenate([rows.by_point for rows in self.rows])
        deformed = (basis[:, :, None] * by_point[:, None, :]).reshape(len(basis), -1)
        views = np.zeros((len(basis), 6 * len(self.rows)))
        first = 0
        for v, rows in enumerate(self.rows):
            views[first : first + len(rows.difference), 6 * v : 6 * v + 6] = rows.by_camera
            first += len(rows.difference)
        prior = [np.full(deformed.shape[1], _DEFORMED_MM**-2.0), *(rows.precision for rows in self.rows)]
        return np.hstack([deformed, views]), np.concatenate(prior)


def _moved(camera: TrueCamera, twist: Array) -> TrueCamera:
    """Return a camera after a rotation, rad, and a shift, mm, of the scene in the camera's frame."""
    return replace(camera, cam_from_rig=frames.from_rotvec(twist[:3], twist[3:]) @ camera.cam_from_rig)


def _precision(camera: Camera) -> Array:
    """Return the inverse variances (6,) of the rotation, rad, and the shift, mm, of a camera.

    Given cameras have no standard deviation. They are regarded as exact to a tenth of the steps of the derivatives.
    """
    turn_rad = np.deg2rad(camera.rotation_sigma_deg or 0.0) / np.sqrt(3.0) or 0.1 * _TURN_RAD
    shift_mm = (camera.position_sigma_mm or 0.0) / np.sqrt(3.0) or 0.1 * _SHIFT_MM
    return np.repeat([turn_rad**-2.0, shift_mm**-2.0], 3)


@dataclass(frozen=True, kw_only=True)
class _Data:
    """Differences of opacity at the outlines, and their weights."""

    difference: Array
    """Observed minus rendered opacity (N,)."""
    weight: Array
    """Huber's weights (N,)."""
    sigma: float
    """Standard deviation of the differences."""
    cell: NDArray[np.int64]
    """Number (N,) of the cell of correlated pixels."""


def _fit_weights(columns: Array, precision: Array, difference: Array) -> tuple[Array, float]:
    """Return Huber's weights (N,) of the residuals without any parameter, and their standard deviation."""
    weight = np.ones(len(difference))
    residual = difference
    sigma = 1.0
    for _ in range(_ROUNDS):
        sigma = float(np.hypot(MAD * np.median(np.abs(residual)), _LATTICE_STEP))
        normal = columns.T @ (weight[:, None] * columns) / sigma**2 + np.diag(precision)
        residual = difference - columns @ np.linalg.solve(normal, columns.T @ (weight * difference) / sigma**2)
        weight = 1.0 / np.maximum(1.0, np.abs(residual) / (_TUNING * sigma))
    return weight, sigma


def _fit_one(name: str, column: Array, nuisance: Array, precision: Array, data: _Data) -> Estimate:
    """Estimate one parameter together with the nuisance parameters."""
    difference, weight, sigma = data.difference, data.weight, data.sigma
    columns = np.column_stack([column, nuisance])
    normal = columns.T @ (weight[:, None] * columns) / sigma**2 + np.diag(np.append(0.0, precision))
    covariance = inverse(normal)
    found = covariance @ (columns.T @ (weight * difference)) / sigma**2
    residual = difference - columns @ found
    scores = columns * (weight * residual / sigma**2)[:, None]
    spread = covariance[0] @ scatter(scores, data.cell) @ covariance[0]
    return Estimate(
        parameter=name,
        value=float(found[0]),
        sigma=float(np.sqrt(max(spread, covariance[0, 0]))),
        misfit=float(np.sum(weight * residual**2) / np.sum(weight * difference**2)),
    )


def worst_first(estimates: Sequence[Estimate]) -> str:
    """Return the errors of the parameters as text, with the most probable one first."""
    units = {INDEX: ("", 1.0), WALL: (" mm", 1.0), SCALE: (" %", 100.0)}
    parts = []
    for one in estimates:
        unit, factor = units[one.parameter]
        parts.append(f"{one.parameter} {factor * one.value:+.2g}{unit} (+- {factor * one.sigma:.1g}{unit})")
    return ", or ".join(parts)
