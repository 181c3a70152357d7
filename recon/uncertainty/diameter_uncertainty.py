"""Uncertainty of the diameters of roots, for each point of their centre lines.

Views of the roots can be coloured by it.
"""

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
from rhizotwin.recon.uncertainty.tube_uncertainty import EXPLAINED, NO_DATA
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]


def add_sigma(roots: Sequence[Root], system: RootSystem) -> tuple[Root, ...]:
    """Return the roots, with the standard deviation of the diameter at each of their points.

    Parameters
    ----------
    roots : sequence of Root
        Roots whose points lie along branches of the system; each point gets the value of the nearest node.
    system : RootSystem
        The fitted root system.
    """
    sigma_mm, place = 2.0 * radius_sigma(system), cKDTree(system.tubes.centre_mm)
    found = []
    for root in roots:
        own = sigma_mm[place.query(root.points_mm)[1]]
        if root.parent >= 0:
            own[0] = own[1]  # the base lies in or on the parent, whose nodes are nearer
        found.append(replace(root, diameter_sigma_mm=own))
    return tuple(found)


def radius_sigma(system: RootSystem) -> Array:
    """Return the standard deviation (N,) of each node's radius, mm."""
    drawn = system.rendering
    covered = dr.select(1.0 - drawn.passing > EXPLAINED, mi.Float(1.0), 0.0) * system.evidence.usable
    variance = _mean(dr.square(mi.Float(drawn.difference)), covered)
    return combine_sigma(system.tubes, tube_profiles.profiles(drawn).host(), variance)


def combine_sigma(tubes: Tubes, profiles: HostProfiles, variance: float) -> Array:
    """Return the standard deviation (N,) of each radius.

    It combines the scatter of the views with the uncertainty of nodes that few views show. With the fit's equations H
    dr = g, where g is a sum over views, the contributions H^-1 g_v of single views scatter as the radii would with
    other views (the jackknife of `tube_uncertainty`, node by node). If a node is hidden in most views, these
    contributions are small for lack of data. The curvature H relative to the pictures' variance then gives the standard
    deviation, limited by the scatter of radii within one order.

    Parameters
    ----------
    variance : float
        Variance of the residual per pixel that the tubes cover.
    """
    curvature = (profiles.width_2 * profiles.scale**2).sum(axis=0)
    smooth = tube_fit.prior(tubes)[3::4, 3::4]
    steps: Array = splu((sparse.diags(curvature + tube_fit.LEAST) + smooth).tocsc()).solve((profiles.width * profiles.scale).T)
    views = np.sqrt(steps.shape[1] * np.var(steps, axis=1))
    unconstrained = 1.0 / np.sqrt(curvature / max(variance, 1e-9) + 1.0 / (NO_DATA * tubes.radius_mm) ** 2)
    return np.hypot(views, unconstrained)


def _mean(value: Float, weight: Float) -> float:
    return float(dr.sum(value * weight)[0]) / max(float(dr.sum(weight)[0]), 1.0)
