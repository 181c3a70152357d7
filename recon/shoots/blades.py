"""Classification of a shoot's surface into leaf blades and stalks by its local flatness and width."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rhizotwin.recon import surface_sample

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEP_MM = 0.7
"""Spacing of the points that sample the surface, mm. It corresponds to two or three pixels of the usual camera, and a
third of the diameter of a stalk."""
NEAR_MM = 4.0
"""Radius of the neighbourhood in which the local shape is evaluated, mm. It is larger than a petiole (2 mm) and smaller
than a blade."""
_FLAT, _WIDE = 0.4, 0.15
"""Two thresholds for the variances a > b > c of nearby points along their principal axes. A point is on a blade if c /
b is below the first threshold and b / a exceeds the second. A blade has c near 0, a round stalk has b = c, and a clump
of stalks has three similar variances. A flat strip of width w has b / a = w^2 / (4 NEAR_MM^2), so it is classified as a
stalk below 3.1 mm. On the true surface of the twin's default shoot, thresholds of 0.3 to 0.5 and 0.1 to 0.2 all yield
its six leaves, and areas within 2 % of each other."""
_VOTE_MM = NEAR_MM / 2.0
"""Radius of the neighbourhood whose majority determines the class of a point, mm. This vote smooths the
classification."""
_APART_MM = 1.6
"""Maximum distance between neighbouring points of the same blade, mm. It is more than twice `STEP_MM`, and less than
the distance between two blades."""
_LEAST_MM2 = np.pi * NEAR_MM**2 / 2.0
"""Minimum area of a connected piece of blade for it to be counted as a leaf, mm2. The value is half of the area of the
disc in which the local shape is evaluated. Smaller pieces only contribute to the total area."""


@dataclass(frozen=True, kw_only=True)
class Blades:
    """Points on the surface of a shoot, classified as blade or stalk."""

    points_mm: Array = field(repr=False)
    """(N, 3) points, evenly distributed over the surface, mm."""
    is_blade: Mask = field(repr=False)
    """(N,) whether each point is on a blade."""
    leaf: NDArray[np.int64] = field(repr=False)
    """(N,) index of each point's blade in ``areas_mm2``, or -1 on stalks and on pieces that are too small."""
    areas_mm2: tuple[float, ...]
    """One-sided area of each connected piece, in decreasing order, mm2. A piece is one leaf, or several touching
    leaves."""
    area_mm2: float
    """Total one-sided area of all blades, mm2."""

    def near(self, points_mm: Array) -> Mask:
        """Return whether the nearest surface point of each point (P, 3) is on a blade."""
        return np.asarray(self.is_blade[cKDTree(self.points_mm).query(points_mm)[1]], np.bool_)


def find_blades(mesh: trimesh.Trimesh) -> Blades:
    """Classify the closed surface of a shoot into blades and stalks.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Surface, mm, which includes both sides of each blade.
    """
    count = max(1, int(mesh.area / STEP_MM**2))
    points = surface_sample.sample(mesh.vertices, mesh.faces, count=count, rng=np.random.default_rng(0))[0]
    each_mm2 = 0.5 * float(mesh.area) / len(points)  # area of one side
    tree = cKDTree(points)
    spread = _local_variances(points, _neighbours(tree, NEAR_MM))
    likely = (spread[:, 0] < _FLAT * spread[:, 1]) & (spread[:, 1] > _WIDE * spread[:, 2])
    voters = _neighbours(tree, _VOTE_MM)
    is_blade = voters @ likely.astype(np.float64) > 0.5 * voters.sum(axis=1)
    blades, leaf = np.flatnonzero(is_blade), np.full(len(points), -1)
    if not len(blades):
        return Blades(points_mm=points, is_blade=is_blade, leaf=leaf, areas_mm2=(), area_mm2=0.0)
    pieces = connected_components(_neighbours(cKDTree(points[blades]), _APART_MM), directed=False)[1]
    areas = each_mm2 * np.bincount(pieces)
    order = np.argsort(-areas, kind="stable")[: int((areas >= _LEAST_MM2).sum())]
    number = np.full(len(areas), -1)
    number[order] = np.arange(len(order))
    leaf[blades] = number[pieces]
    return Blades(points_mm=points, is_blade=is_blade, leaf=leaf, areas_mm2=tuple(areas[order].tolist()), area_mm2=each_mm2 * len(blades))


def _neighbours(tree: cKDTree, within_mm: float) -> csr_array:
    """Return a matrix (N, N) that is one for pairs of points within a distance, including each point with itself."""
    pairs = tree.query_pairs(within_mm, output_type="ndarray")
    rows, columns = np.concatenate([pairs, pairs[:, ::-1], np.arange(tree.n)[:, None].repeat(2, axis=1)]).T
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=(tree.n, tree.n))


def _local_variances(points: Array, near: csr_array) -> Array:
    """Return the variances (N, 3) along the principal axes of each point's neighbourhood, in increasing order, mm2."""
    centred, count = points - points.mean(axis=0), near.sum(axis=1)
    squares = (centred[:, :, None] * centred[:, None, :]).reshape(-1, 9)
    mean, moment = (near @ values / count[:, None] for values in (centred, squares))
    return np.asarray(np.linalg.eigvalsh(moment.reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]), np.float64)
