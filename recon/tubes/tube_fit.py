"""Gauss-Newton fit of tubes to the coverage of all views, with a smoothness prior for branches.

The gradient of each node is computed separately, also where tubes hide each other. The normal equations of the nodes
are then independent, except for the smoothness along a branch. The tubes are rendered again in every iteration, so that
the iterations converge to a common solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon import passes
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.device import release
from rhizotwin.recon.tubes import root_light, smoothness, tube_profiles
from rhizotwin.recon.tubes.parameters import Parameters
from rhizotwin.recon.tubes.root_light import LEAST_LONE, LightSystem
from rhizotwin.recon.tubes.system import System
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import ResidualGradient
from rhizotwin.recon.tubes.tubes import Tubes, with_geometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_STEPS = 6
"""Maximum number of iterations. Each applies the fraction `_RELAXED` of a radius's step, so that the error of a radius
decreases to 0.4^6, less than a hundredth."""
_SETTLED, _LIGHT_SETTLED = 0.01, 0.1
"""Relative decrease of the squared residual coverage in an iteration, and change of the light parameters in standard
deviations or largest steps, whichever is smaller, below which a fit has converged. If fits end at a decrease of 2 %, a
radish of 5 days keeps three false tips of 62."""
_DAMPING, _ALONG = 0.05, 0.5
"""Terms added to each node's 3x3 normal matrix for its position, as fractions of the mean diagonal. The first is added
in all directions, the second along the branch."""
_RELAXED = 0.6
"""Fraction of the Gauss-Newton step of a radius that is applied. Tubes that cover the same pixels respond
simultaneously, so that with full steps they would oscillate between too wide and too thin."""
LEAST = 0.5
"""Minimum curvature of the sum of squares with respect to a node's position, 1/mm2. Nodes that no view shows are
therefore not moved."""
_LARGEST_STEP_MM = 0.15
"""Maximum displacement of a node per iteration, mm. It is about the radius of a thin root. At larger distances, the
profiles contain no information about the root."""
_MOST_SHARE, _MOST_MM = 0.3, 0.01
"""Limits of the change of a radius per iteration: a fraction of the radius, plus a constant in mm. Within these limits,
the profile is nearly linear in the radius."""
_THINNEST_MM = 0.02
"""Minimum radius of a tube, mm. Its width is a fifth of a pixel at 0.2 mm per pixel."""
_BULGE = 1.12
"""Maximum ratio of a radius to the median radius of the surrounding nodes, and of the median to the radius. A larger
radius would be due to another root beside the root."""


@dataclass(frozen=True)
class Fit:
    """Fitted tubes, with the residuals of the last iteration."""

    evidence: Evidence
    """Measured coverage of all views, with the fitted light parameters."""
    tubes: Tubes
    thick: Mask
    """Mask of the nodes of thick roots, shape (N,)."""
    residual: ResidualGradient
    light: Parameters | None
    """Fitted light parameters with their prior. None if these were not fitted."""
    few: bool
    """Whether too few profiles show a root that no other root hides or overlaps. In that case only the blur was fitted,
    to all profiles."""

    @cached_property
    def rendering(self) -> Rendering:
        """Rendering of the fitted tubes."""
        return Rendering.draw(self.evidence, self.tubes)

    @cached_property
    def lit(self) -> LightSystem | None:
        """Normal equations of the light parameters at the fitted tubes. None if these were not fitted."""
        if self.light is None:
            return None
        changes = root_light.changes(self.rendering, root_light.evaluated(self.light))
        return LightSystem.build(tube_profiles.profiles(self.rendering, changes, every=self.few), self.tubes, self.thick)


def fit(evidence: Evidence, tubes: Tubes, thick: Mask, *, steps: int = MOST_STEPS, light: Parameters | None = None) -> Fit:
    """Fit the positions and radii of the nodes, and the light parameters, to the pictures.

    Parameters
    ----------
    thick : (N,) bool array
        Mask of the nodes of thick roots, both of whose flanks are visible. Their radii are not smoothed and do not
        constrain the light parameters.
    steps : int
        Maximum number of iterations. The fit ends earlier if it converges.
    light : Parameters, optional
        Attenuation, blur and hairs, which are then fitted with the tubes. By default, these parameters are fixed.
    """
    few, left = False, np.inf
    for _ in range(steps):
        passes.add("gauss_newton_steps")
        drawn, change, scale = Rendering.draw(evidence, tubes), np.zeros(0), np.zeros(0)
        before, left, mixed = left, drawn.misfit, np.zeros((len(thick), 4, 0))
        profiles = tube_profiles.profiles(drawn, None if light is None else root_light.changes(drawn, light.free), every=few)
        if light is not None:
            lit = LightSystem.build(profiles, tubes, thick)
            if not few and lit.lone < LEAST_LONE:
                few, light = True, root_light.blur_only(light)
            else:
                (change, covariance), mixed = lit.solve(light), lit.by_light
                scale = np.minimum(np.sqrt(np.diag(covariance)), light.limits[2])
                light = replace(light, value=light.value + change)
                evidence = replace(evidence, light=Light.from_vector(light.value))
        residual = profiles.residual_gradient()
        tubes = _step(tubes, residual, mixed, change)
        tubes = with_geometry(tubes, tubes.centre_mm, _limit_radii(tubes, thick))
        if left > (1.0 - _SETTLED) * before and (np.abs(change) <= _LIGHT_SETTLED * scale).all():
            break
    release()  # kernels of other trees have other sizes
    return Fit(evidence, tubes, thick, residual, light, few)


def _step(tubes: Tubes, residual: ResidualGradient, mixed: Array, change: Array) -> Tubes:
    """Apply one damped Gauss-Newton step to the nodes.

    The nodes follow a simultaneous change (L,) of the light parameters, of which ``mixed`` (N, 4, L) are the
    derivatives of the nodes' gradient. L is 0 if the light parameters are fixed.
    """
    tangent, ridge = tubes.tangents, np.zeros_like(residual.hessian)
    mean = np.trace(residual.hessian[:, :3, :3], axis1=1, axis2=2)[:, None, None] / 3.0
    ridge[:, :3, :3] = _DAMPING * mean * np.eye(3) + _ALONG * mean * tangent[:, :, None] * tangent[:, None, :]
    system = System.eliminate(residual.equations(mixed), tubes, ridge + LEAST * np.eye(4))
    step = system.start * [1.0, 1.0, 1.0, _RELAXED] + system.response @ change
    way = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
    centre = tubes.centre_mm + step[:, :3] * np.minimum(1.0, _LARGEST_STEP_MM / np.maximum(way, 1e-12))
    most = _MOST_SHARE * tubes.radius_mm + _MOST_MM
    radius = np.maximum(tubes.radius_mm + np.clip(step[:, 3], -most, most), _THINNEST_MM)
    return with_geometry(tubes, centre, radius)


def _limit_radii(tubes: Tubes, thick: NDArray[np.bool_]) -> Array:
    """Return the radii (N,), limited to a range around the median radius of the surrounding nodes, mm.

    Thick roots may have swellings of any length.
    """
    typical = smoothness.median_radii(tubes)
    return np.where(thick, tubes.radius_mm, np.clip(tubes.radius_mm, typical / _BULGE, typical * _BULGE))
