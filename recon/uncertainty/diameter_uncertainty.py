"""How far each root's diameter may be wrong, point by point: what a person wants to see of it in colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from rhizotwin.recon.device import Float
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes import tube_fit, tube_profiles
from rhizotwin.recon.tubes.tube_profiles import HostProfiles
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.recon.uncertainty.tube_uncertainty import EXPLAINED, UNTOLD
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]


def told(roots: Sequence[Root], system: RootSystem) -> tuple[Root, ...]:
    """Return roots with the standard deviations of their diameters.

    Parameters
    ----------
    roots : sequence of Root
        Whose points lie along branches of the system: each has the value of the nearest node.
    system : RootSystem
        As it was fitted.
    """
    sigma_mm, place = 2.0 * of_radii(system), cKDTree(system.tubes.centre_mm)
    found = []
    for root in roots:
        own = sigma_mm[place.query(root.points_mm)[1]]
        if root.parent >= 0:
            own[0] = own[1]  # it begins in or on its parent, whose nodes are nearer
        found.append(replace(root, diameter_sigma_mm=own))
    return tuple(found)


def of_radii(system: RootSystem) -> Array:
    """Return the standard deviation (N,) of each node's radius, mm."""
    drawn = system.drawn
    covered = dr.select(1.0 - drawn.passing > EXPLAINED, mi.Float(1.0), 0.0) * system.seen.seen
    variance = _mean(dr.square(mi.Float(drawn.difference)), covered)
    return combined(system.tubes, tube_profiles.profiles(drawn).host(), variance)


def combined(tubes: Tubes, profiles: HostProfiles, variance: float) -> Array:
    """Return the standard deviation (N,) of each radius: how far views disagree, and what none of them tells.

    With the fit's equations H dr = g, g a sum over views, the views' parts H^-1 g_v of a step scatter as the radii
    would with other views (the jackknife of `tube_uncertainty`, node by node). Where a node is hidden in most views
    their parts are small for want of anything seen; there the curvature H over the pictures' own variance says how
    little is told, and roots of one order how little it can be.

    Parameters
    ----------
    variance : float
        Of what tubes leave unexplained in a pixel that they cover.
    """
    told = (profiles.width_2 * profiles.scale**2).sum(axis=0)
    smooth = tube_fit.prior(tubes)[3::4, 3::4]
    steps: Array = splu((sparse.diags(told + tube_fit.LEAST) + smooth).tocsc()).solve((profiles.width * profiles.scale).T)
    views = np.sqrt(steps.shape[1] * np.var(steps, axis=1))
    untold = 1.0 / np.sqrt(told / max(variance, 1e-9) + 1.0 / (UNTOLD * tubes.radius_mm) ** 2)
    return np.hypot(views, untold)


def _mean(value: Float, weight: Float) -> float:
    return float(dr.sum(value * weight)[0]) / max(float(dr.sum(weight)[0]), 1.0)
