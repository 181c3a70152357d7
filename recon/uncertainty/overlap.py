"""Overlap of thick roots, which shows that they are not round.

Two roots cannot be in the same place. If fitted tubes overlap outside the junctions of parents and laterals, several
tubes represent a single body that is not round, such as a disc or a flat carrot. The gaps between these tubes are
probably parts of the body, even if no silhouette requires them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes.filling import fill
from rhizotwin.recon.uncertainty.budget import Term

Array = NDArray[np.float64]

_POINTS = 20_000
"""Approximate number of points that fill the thick roots. There are about ten across a thick root of the print."""


def overlap_term(system: RootSystem, hull: Leaves, shape: Leaves) -> Term:
    """Return the term of the error budget for the gaps between overlapping thick roots.

    A gap is within one diameter of a place that two roots share, in the hull, but not in the shape. In wider gaps, a
    further root would have been traced.

    Parameters
    ----------
    system : RootSystem
        Fitted roots.
    hull, shape : Leaves
        Hull beside the tubes, and the part of it that belongs to the shape.
    """
    place_mm, diameter_mm = find_overlaps(system)
    tree = cKDTree(place_mm)

    def near_mm3(leaves: Leaves) -> float:
        away, nearest = tree.query(leaves.middles_mm, distance_upper_bound=float(diameter_mm.max()), workers=-1)
        return leaves.select(away < np.append(diameter_mm, 0.0)[nearest]).volume_mm3()

    gaps_mm3 = max(0.0, near_mm3(hull) - near_mm3(shape)) if len(place_mm) else 0.0
    why = "thick roots overlap, so that they are parts of a body that is not round, which may extend between them"
    return Term(name="overlapping roots", less_mm3=0.0, more_mm3=gaps_mm3, why=why)


def find_overlaps(system: RootSystem) -> tuple[Array, Array]:
    """Find places that several thick roots share. Junctions, where a lateral is inside its parent, do not count.

    Returns
    -------
    place_mm : (M, 3) float64 array
        Points inside two or more roots, uniformly distributed, mm.
    diameter_mm : (M,) float64 array
        Diameter of one of the roots at each point, mm.
    """
    tubes, thick = system.tubes, system.thick & ~system.solid
    a, b = tubes.segments[thick[tubes.segments].all(axis=1)].T
    length = np.linalg.norm(tubes.centre_mm[b] - tubes.centre_mm[a], axis=1)
    volume_mm3 = float(np.pi * length @ tubes.radius_mm[b] ** 2)
    if volume_mm3 == 0.0:
        return np.zeros((0, 3)), np.zeros(0)
    parent = tubes.owner[[nodes[0] for nodes in tubes.branches]]
    filled = fill(tubes, float(np.cbrt(volume_mm3 / _POINTS)), excluded=~thick)
    shared, is_junction = np.zeros((2, len(filled.branch)), bool)
    for k in np.unique(tubes.owner[thick]):
        nodes = tubes.own(k)[thick[tubes.own(k)]]
        radius = tubes.radius_mm[nodes]
        away, nearest = cKDTree(tubes.centre_mm[nodes]).query(filled.point_mm, distance_upper_bound=float(radius.max()), workers=-1)
        inside = (away < np.append(radius, 0.0)[nearest]) & (filled.branch != k)
        joined = (filled.branch == parent[k]) | (parent[filled.branch] == k)
        is_junction |= inside & joined
        shared |= inside & ~joined
    place_mm, node = filled.point_mm[shared & ~is_junction], np.flatnonzero(thick)
    return place_mm, 2.0 * tubes.radius_mm[node[cKDTree(tubes.centre_mm[node]).query(place_mm)[1]]]
