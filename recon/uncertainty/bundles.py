"""Length of roots that is hidden in bundles: where several roots leave the same place at small angles.

The pictures do not separate roots that are closer together than they resolve, so that a bundle is reconstructed as one
root that bears the others as laterals. Where roots spread from a point, their distances increase in proportion to the
distance from it: about as much length is hidden as has just left the bundle.
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


_MOST = 2.0
"""Maximum ratio of the hidden length to the length that has just left a bundle. Where 20 to 80 roots spread from one
point, it was 0.6 to 2.1 (docs/decisions/volume-interval.md)."""


def bundled_length_mm(roots: Sequence[Root], px_a_mm: float) -> float:
    """Return the length that may be hidden in bundles, mm.

    It is proportional to the length from the base of each thin root within which it is close to a root of similar
    thickness that it touches at its base, in excess of that of a lateral.

    Parameters
    ----------
    roots : sequence of Root
        Reconstructed roots.
    px_a_mm : float
        Scale of the pictures, px/mm. It is 0 if they show no root, and the result as well.
    """
    if not roots or px_a_mm <= 0.0:
        return 0.0
    separate_mm, thick_mm = _SEPARATE_PX / px_a_mm, THICK_PX / px_a_mm
    points = rsml.sample_centre_lines(roots, separate_mm / 4.0)
    root, thin = points.root, np.flatnonzero(points.radius_mm < thick_mm)
    if not len(thin):
        return 0.0
    begin = np.searchsorted(root, np.arange(len(roots)))  # first point of each root
    pairs = thin[cKDTree(points.points_mm[thin]).query_pairs(separate_mm + 2.0 * thick_mm, output_type="ndarray")]
    pairs = np.concatenate([pairs, pairs[:, ::-1]])  # a point of a root, and one of another
    wide = points.radius_mm[pairs]
    gap = np.linalg.norm(points.points_mm[pairs[:, 0]] - points.points_mm[pairs[:, 1]], axis=1) - wide.sum(axis=1)
    near = (root[pairs[:, 0]] != root[pairs[:, 1]]) & (gap < separate_mm) & (wide.max(axis=1) < _ALIKE * wide.min(axis=1))
    table = np.stack([root[pairs[near, 0]], root[pairs[near, 1]], pairs[near, 0] - begin[root[pairs[near, 0]]]], axis=1)
    order = np.lexsort((gap[near], *table.T[::-1]))
    table, gap, wide = table[order], gap[near][order], wide[near].sum(axis=1)[order]
    first = np.diff(table, axis=0, prepend=-1).any(axis=1)  # the nearest point of the other root
    table, gap, wide = table[first], gap[first], wide[first]
    run = np.flatnonzero(np.diff(table[:, :2], axis=0, prepend=-1).any(axis=1))  # begin of each pair of roots
    count = np.diff([*run, len(table)])
    beside = table[:, 2] == np.arange(len(table)) - np.repeat(run, count)  # without interruption from the base
    beside &= np.repeat((table[run, 2] == 0) & (gap[run] < separate_mm / 8.0), count)  # which is sampled in its middle
    along_mm, contact_mm, of = np.zeros(len(run)), np.zeros(len(run)), np.repeat(np.arange(len(run)), count)
    np.add.at(along_mm, of[beside], points.length_mm[begin[table[beside, 0]] + table[beside, 2]])
    np.maximum.at(contact_mm, of[beside], wide[beside])
    longest_mm = np.zeros(len(roots))
    np.maximum.at(longest_mm, table[run, 0], along_mm - (contact_mm + separate_mm) / _LATERAL)
    return _MOST * float(longest_mm.sum())
