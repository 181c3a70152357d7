"""Length of roots that is hidden in bundles: where several roots leave the same place at small angles.

The pictures do not separate roots that are closer together than they resolve, so that a bundle is reconstructed as one
root that bears the others as laterals. Where roots spread from a point, their distances increase in proportion to the
distance from it: about as much length is hidden as has just left the bundle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots.organs import THICK_PX
from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import CentrePoints, Root

_SEPARATE_PX = math.pi
"""Gap between two roots above which they are separated, px: two pixels in a picture, which shows on average 2 / pi of
the distance of two points over a turn."""
_SAMPLES = 4
"""Number of points on a centre line per this gap."""
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
    points = rsml.sample_centre_lines(roots, separate_mm / _SAMPLES)
    first_point = np.searchsorted(points.root, np.arange(len(roots)))
    contacts = _find_contacts(points, separate_mm=separate_mm, thick_mm=thick_mm)
    place = contacts.point - first_point[contacts.root]  # along the root, in samples from its base
    begin = np.flatnonzero(np.diff(contacts.root, prepend=-1) | np.diff(contacts.other, prepend=-1))  # of each pair of roots
    pair = np.repeat(np.arange(len(begin)), np.diff(begin, append=len(place)))
    # the base, of which the first sample is half a spacing away, touches the other root
    touches = (place[begin] == 0) & (contacts.gap_mm[begin] < 0.5 * separate_mm / _SAMPLES)
    beside = touches[pair] & (place == np.arange(len(place)) - begin[pair])  # without interruption from the base
    length_mm, width_mm, longest_mm = np.zeros(len(begin)), np.zeros(len(begin)), np.zeros(len(roots))
    np.add.at(length_mm, pair[beside], points.length_mm[contacts.point[beside]])
    np.maximum.at(width_mm, pair[beside], contacts.width_mm[beside])
    np.maximum.at(longest_mm, contacts.root[begin], length_mm - (width_mm + separate_mm) / _LATERAL)
    return _MOST * float(longest_mm.sum())


@dataclass(frozen=True)
class _Contacts:
    """Points of roots that are close to another root of similar thickness, sorted by root, other root and point."""

    root: NDArray[np.int64]
    other: NDArray[np.int64]
    point: NDArray[np.int64]
    """Index of the point of the root."""
    gap_mm: NDArray[np.float64]
    """Distance between the surfaces."""
    width_mm: NDArray[np.float64]
    """Sum of both radii."""


def _find_contacts(points: CentrePoints, *, separate_mm: float, thick_mm: float) -> _Contacts:
    """Return the contacts of points with a radius below ``thick_mm``, each with the nearest point of the other root."""
    thin = np.flatnonzero(points.radius_mm < thick_mm)
    pairs = cKDTree(points.points_mm[thin]).query_pairs(separate_mm + 2.0 * thick_mm, output_type="ndarray")
    point, other = thin[np.concatenate([pairs, pairs[:, ::-1]])].T
    radii = points.radius_mm[np.stack([point, other])]
    width = radii.sum(axis=0)
    gap = np.linalg.norm(points.points_mm[point] - points.points_mm[other], axis=1) - width
    root, other = points.root[point], points.root[other]
    near = np.flatnonzero((root != other) & (gap < separate_mm) & (radii.max(axis=0) < _ALIKE * radii.min(axis=0)))
    near = near[np.lexsort((gap[near], point[near], other[near], root[near]))]
    nearest = np.diff(point[near], prepend=-1) | np.diff(other[near], prepend=-1)
    near = near[nearest != 0]
    return _Contacts(root[near], other[near], point[near], gap[near], width[near])
