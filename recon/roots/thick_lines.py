"""The lines of laterals on thick roots: without what no view shows of them.

No view shows where a lateral begins within a storage root, and a path along the middle of what is wide is longer than
any root. The tissue of such an organ is laid down about laterals that were there before: they begin near its skin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

BURIED_MM = 1.0
"""Laterals count from their parent's axis, but from no deeper below its surface than this: secondary growth lays down
a storage root's tissue outside of the stele of the young root, of a diameter of some millimetres, on which they grew
(Esau 1977, Anatomy of Seed Plants, chapter 15)."""
SWOLLEN = 4.0
"""A root so many times as thick as a lateral on it has swollen since: bulbs and carrots of the library are 6 to 50
times as thick, the roots of the printed phantom, that never were young, 1.2 to 3.1 times."""


def emerged(roots: Sequence[Root]) -> tuple[Root, ...]:
    """Return the same roots, laterals without what lies deep within swollen ones on which they grow."""
    return tuple(_without(root, _above(roots, root)) for root in roots)


def _above(roots: Sequence[Root], root: Root) -> list[Root]:
    """Return the roots on which one grows: its parent, that one's parent and so on."""
    found: list[Root] = []
    while root.parent >= 0:
        root = roots[root.parent]
        found.append(root)
    return found


def _without(root: Root, above: Sequence[Root]) -> Root:
    """Return a root without its beginning deep within others; one that never comes out stays as it is."""
    least_mm = 2.0 * max(BURIED_MM, 0.5 * SWOLLEN * float(np.median(root.diameters_mm)))
    wide = [of.diameters_mm > least_mm for of in above]
    point = np.concatenate([np.zeros((0, 3)), *(of.points_mm[some] for of, some in zip(above, wide, strict=True))])
    diameter = np.concatenate([np.zeros(0), *(of.diameters_mm[some] for of, some in zip(above, wide, strict=True))])
    if not len(point):
        return root
    out_mm = (cdist(root.points_mm, point) - (0.5 * diameter - BURIED_MM)).min(axis=1)
    first = int(np.argmax(out_mm > 0.0))
    if first == 0:  # it begins outside, or is all inside
        return root
    share = out_mm[first - 1] / (out_mm[first - 1] - out_mm[first])
    way = polyline.way_mm(root.points_mm)
    at = np.append(way[first - 1] + share * (way[first] - way[first - 1]), way[first:])
    return replace(root, points_mm=polyline.between(root.points_mm, way, at), diameters_mm=np.interp(at, way, root.diameters_mm))
