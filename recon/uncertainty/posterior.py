"""Distribution of the radii of fitted roots, given the pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes import root_light, tube_fit, tube_profiles
from rhizotwin.recon.tubes.root_light import INDEX
from rhizotwin.recon.tubes.system import System
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import Changes, HostProfiles
from rhizotwin.recon.uncertainty.budget import NINETY
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NO_DATA = 0.25
"""Prior standard deviation of a radius that the pictures do not constrain, as a fraction of the radius. It is the
scatter of the radii of roots of the same order."""
_EXPLAINED = 0.03
"""Minimum coverage of a pixel by the tubes for the pixel to be explained by them. Pixels within two pixels of such a
pixel are also explained."""


@dataclass(frozen=True)
class Posterior:
    """Fitted roots, and how much their radii depend on single views and on the light parameters."""

    system: RootSystem
    near: Mask
    """Mask of the pixels on the rendered roots and within two pixels of them, shape (V, H, W)."""
    profiles: HostProfiles
    """Profiles of the rendered roots."""
    by_light: Array
    """Derivative of each radius with respect to the light parameters, shape (N, L), mm. The radii change so that the
    roots absorb the same light."""
    view_steps_mm: Array
    """Contribution of each view to one further Gauss-Newton step of each radius, shape (N, V).

    With the fit's equations H dr = g, where g is a sum over views, it is H^-1 g_v. The contributions scatter as the
    radii would with other views (jackknife), also for errors common to a view, such as its pose."""
    unconstrained_mm: Array
    """Standard deviation of each radius, shape (N,), if it depended on neither its neighbours nor the scatter of views.

    If a node is hidden in most views, their contributions are small for lack of data. The curvature of the sum of
    squared residuals relative to the pictures' variance then gives the standard deviation, limited by the scatter of
    radii within one order."""

    @staticmethod
    def compute(system: RootSystem) -> Posterior:
        """Compare the fitted roots with the pictures."""
        tubes, drawn = system.tubes, system.rendering
        found = tube_profiles.profiles(drawn, _light_changes(system))
        profiles, own, by_light = found.host(), found.residual_gradient(), found.light_equations(system.thick)[0]
        of_views = np.concatenate([profiles.across * profiles.shift[..., None], (profiles.scale * profiles.width)[..., None]], axis=2)
        mixed = np.concatenate([-by_light, of_views.transpose(1, 2, 0)], axis=2)
        steps = -System.eliminate(own.equations(mixed), tubes, tube_fit.LEAST * np.eye(4)).response[:, 3]
        light = by_light.shape[2]
        near = _near_tubes(drawn)
        left = np.array(drawn.difference, np.float64).reshape(near.shape)[near]
        curvature = own.hessian[:, 3, 3] / max(float(np.square(left).sum()) / max(len(left), 1), 1e-9)
        unconstrained = 1.0 / np.sqrt(curvature + 1.0 / (_NO_DATA * tubes.radius_mm) ** 2)
        return Posterior(system, near, profiles, steps[:, :light], steps[:, light:], unconstrained)

    @property
    def radius_sigma_mm(self) -> Array:
        """Return the standard deviation (N,) of each node's radius."""
        views = self.view_steps_mm
        return np.hypot(np.sqrt(views.shape[1] * np.var(views, axis=1)), self.unconstrained_mm)

    @cached_property
    def roots(self) -> tuple[Root, ...]:
        """Branches of the system as roots, with the standard deviation of the diameter at each point.

        Each point gets the value of the nearest node. Views of the roots can be coloured by it.
        """
        sigma_mm, place = 2.0 * self.radius_sigma_mm, cKDTree(self.system.tubes.centre_mm)
        found = []
        for root in self.system.roots():
            own = sigma_mm[place.query(root.points_mm)[1]]
            if root.parent >= 0:
                own[0] = own[1]  # the base lies in or on the parent, whose nodes are nearer
            found.append(replace(root, diameter_sigma_mm=own))
        return tuple(found)


def _near_tubes(drawn: Rendering) -> Mask:
    """Return the mask (V, H, W) of usable pixels that tubes cover, and of pixels within two pixels of these."""
    coverage = drawn.coverage
    covered = (coverage > _EXPLAINED) & (np.array(drawn.evidence.usable).reshape(coverage.shape) > 0)
    return np.stack([cv2.dilate(view.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0 for view in covered])


def _light_changes(system: RootSystem) -> Changes:
    """Return the derivatives of the rendered tubes with respect to the uncertain light parameters.

    The volume is nearly linear in all but the refractive index. With the square root of the index's excess over water,
    the rim of a root becomes darker. The derivative with respect to the index is therefore the difference quotient over
    its 90 % range below the estimate.
    """
    attenuation, steps = system.attenuation, list(root_light.STEPS)
    below = min(attenuation.light.index - 1.0, NINETY * float(np.sqrt(attenuation.covariance[INDEX, INDEX])))
    if below > steps[INDEX]:
        steps[INDEX] = -below
    return root_light.changes(system.rendering, np.diag(attenuation.covariance) > 0.0, steps)
