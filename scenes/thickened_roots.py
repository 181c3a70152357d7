"""Length of laterals inside thickened parents, which does not count.

No view shows where a lateral begins inside a storage root. A lateral that is traced to the axis of a wide root would be
too long. Since the tissue of a storage root grows around existing laterals, they are assumed to begin near its surface,
in reconstructed roots as in specimens from files, so that the same length is compared.
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
"""Maximum depth of a lateral's base below the surface of a thickened parent, mm. Laterals of thinner parents begin at
the parent's axis.

Secondary growth adds tissue outside the stele of the young root, which has a diameter of some millimetres and from
which the laterals grew (Esau 1977, Anatomy of Seed Plants, chapter 15)."""
SWOLLEN = 4.0
"""Ratio of diameters above which a parent is assumed to have grown in thickness after the lateral formed.

Bulbs and carrots of the library are 6 to 50 times as thick as their laterals. The roots of the printed phantom, which
have no secondary growth, are 1.2 to 3.1 times as thick."""


_STEP_MM = 0.5
"""Spacing of the points at which depth is computed, mm. Nodes of reconstructed roots are 0.6 mm apart, those of files
have any distance."""


def trim_buried(roots: Sequence[Root]) -> tuple[Root, ...]:
    """Return the roots after removal of the parts of laterals that lie deep inside thickened parents."""
    return tuple(_trim(root, _ancestors(roots, root)) for root in roots)


def _ancestors(roots: Sequence[Root], root: Root) -> list[Root]:
    """Return the ancestors of a root, from its parent upwards."""
    found: list[Root] = []
    while root.parent >= 0:
        root = roots[root.parent]
        found.append(root)
    return found


def _sample(root: Root) -> tuple[Array, Array, Array]:
    """Return arc lengths (N,), points (N, 3) and diameters (N,) of a root, at most `_STEP_MM` apart."""
    way = polyline.arc_length_mm(root.points_mm)
    at = np.union1d(np.arange(0.0, way[-1], _STEP_MM), way)
    return at, polyline.interpolate(root.points_mm, way, at), np.interp(at, way, root.diameters_mm)


def _trim(root: Root, above: Sequence[Root]) -> Root:
    """Remove the first part of a root if this part lies deep inside the root's ancestors.

    A root that lies entirely inside its ancestors is not changed.
    """
    least_mm = 2.0 * max(BURIED_MM, 0.5 * SWOLLEN * float(np.median(root.diameters_mm)))
    above = [ancestor for ancestor in above if float(ancestor.diameters_mm.max()) > least_mm]
    if not above:
        return root
    _, points, diameters = (np.concatenate(parts) for parts in zip(*map(_sample, above), strict=True))
    point, diameter = points[diameters > least_mm], diameters[diameters > least_mm]
    at, own, _ = _sample(root)
    out_mm = (cdist(own, point) - (0.5 * diameter - BURIED_MM)).min(axis=1)
    first = int(np.argmax(out_mm > 0.0))
    if first == 0:  # the root begins outside, or lies inside entirely
        return root
    share = out_mm[first - 1] / (out_mm[first - 1] - out_mm[first])
    way, begin = polyline.arc_length_mm(root.points_mm), at[first - 1] + share * (at[first] - at[first - 1])
    at = np.append(begin, way[way > begin])
    return replace(root, points_mm=polyline.interpolate(root.points_mm, way, at), diameters_mm=np.interp(at, way, root.diameters_mm))
