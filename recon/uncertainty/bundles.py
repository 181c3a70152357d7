"""Length of roots that begin in a bundle: where several roots leave the same place at small angles.

The pictures do not separate roots that are closer together than they resolve, so that a bundle is reconstructed as one
root that bears the others as laterals. Where roots spread from a point, their distances increase in proportion to the
distance from it: as much length as just leaves the bundle is hidden in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from rhizotwin.recon.roots.organs import THICK_PX
from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import Root

_SEPARATE_PX = math.pi
"""Gap between two roots above which they are separated, px: two pixels in a picture, which shows on average 2 / pi of
the distance of two points over a turn."""
_ALIKE = 2.0
"""Maximum ratio of the diameters of roots in a bundle. A lateral is usually thinner than its parent."""
_LATERAL = math.sin(math.radians(45.0))
"""Sine of the angle between a root and its parent above which it is a lateral, and does not begin in a bundle."""


def bundled_length_mm(roots: Sequence[Root], px_a_mm: float) -> float:
    """Return the length that is probably hidden in bundles, mm.

    For each thin root, it is the length from its base within which it is close to roots of similar thickness, in excess
    of that of a lateral.

    Parameters
    ----------
    roots : sequence of Root
        Reconstructed roots.
    px_a_mm : float
        Scale of the pictures, px/mm. It is 0 if they show no root, and the result as well.
    """
    if not roots or px_a_mm <= 0.0:
        return 0.0
    separate_mm = _SEPARATE_PX / px_a_mm
    points = rsml.sample_centre_lines(roots, separate_mm / 4.0)
    thin = np.flatnonzero(points.radius_mm < THICK_PX / px_a_mm)
    if not len(thin):
        return 0.0
    at, radius, root = points.points_mm[thin], points.radius_mm[thin], points.root[thin]
    pairs = cKDTree(at).query_pairs(separate_mm + 2.0 * float(radius.max()), output_type="ndarray")
    wide = radius[pairs]
    apart = np.linalg.norm(at[pairs[:, 0]] - at[pairs[:, 1]], axis=1) - wide.sum(axis=1)
    near = (root[pairs[:, 0]] != root[pairs[:, 1]]) & (apart < separate_mm) & (wide.max(axis=1) < _ALIKE * wide.min(axis=1))
    contact_mm = np.zeros(len(points.root))
    for side in (0, 1):
        np.maximum.at(contact_mm, thin[pairs[near, side]], wide[near].sum(axis=1))
    hidden_mm = 0.0
    for own in np.split(np.arange(len(contact_mm)), np.flatnonzero(np.diff(points.root)) + 1):
        free = np.flatnonzero(contact_mm[own] == 0.0)
        begin = own[: free[0]] if len(free) else own
        lateral_mm = (contact_mm[begin].max(initial=0.0) + separate_mm) / _LATERAL
        hidden_mm += max(0.0, float(points.length_mm[begin].sum()) - lateral_mm)
    return hidden_mm
