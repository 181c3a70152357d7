"""Rigid registration of the roots of one plant at two ages.

The canister frame is defined by the marker strip on the net pot. A plant that stays in its pot is therefore already
aligned up to pose errors and movements of the pot in the strip. The remaining rigid motion is estimated with the
iterative closest point algorithm (Besl and McKay 1992, trimmed as in Chetverikov et al. 2002). It moves the younger
plant's centre lines onto those of the older plant, which include them. A rotation that the centre lines do not
determine, such as that of a single root about itself, is zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rhizotwin.scenes import frames, polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

STEP_MM = 0.5
"""Spacing of the sample points on a centre line, mm. It is about one root diameter."""
KEPT = 0.7
"""Fraction of the younger plant's points that are used in the fit. These are the points nearest to the older plant,
because the other points may lie on roots that moved or were traced at one age only."""
STRIP_MM = 12.0
"""Weight of the orientation that the marker strip gives, as the length, mm, of the three axes that are aligned together
with the points. For points that are displaced by 0.15 mm over 2 mm, which are 4 sample points, it corresponds to a
standard deviation of sqrt(4 / 2) 0.15 / 12 = 1 degree."""
MOST_ROUNDS = 60
"""Maximum number of iterations of the registration."""
STILL_MM = 1e-4
"""Convergence threshold, mm. The registration ends if all coordinates change by less than this value in an
iteration."""


@dataclass(frozen=True, kw_only=True)
class Aligned:
    """Rigid registration of an older plant with the same plant at a younger age."""

    younger_from_older: Array
    """Homogeneous transform (4, 4) from the frame of the older plant to the frame of the younger plant, mm."""
    residual_mm: float
    """Median distance, mm, between the points of the younger plant and the centre lines of the older plant."""

    def of(self, root_mm: Array) -> Array:
        """Transform points (N, 3) of the older plant to the frame of the younger plant, mm."""
        moved: Array = root_mm @ self.younger_from_older[:3, :3].T + self.younger_from_older[:3, 3]
        return moved


def points_of(root: Root, step_mm: float = STEP_MM) -> tuple[Array, Array]:
    """Sample points along a root with a spacing of at most ``step_mm``.

    Return the points (N, 3) and the unit direction of the root at each point (N, 3).
    """
    way = polyline.arc_length_mm(root.points_mm)
    count = max(2, int(np.ceil(way[-1] / step_mm)) + 1)
    at = np.linspace(0.0, way[-1], count)
    points = polyline.interpolate(root.points_mm, way, at)
    along = np.gradient(points, axis=0)
    return points, along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)


def align(younger: Sequence[Root], older: Sequence[Root]) -> Aligned:
    """Register the roots of a plant at two ages.

    Both lists begin with the taproot and contain at least one root. The algorithm runs twice, from the alignment by the
    marker strip and from coinciding root bases. The registration with the smaller residual is returned.
    """
    young = np.concatenate([points_of(root)[0] for root in younger])
    old = np.concatenate([points_of(root)[0] for root in older])
    tree = cKDTree(old)
    base = np.eye(4)
    base[:3, 3] = older[0].points_mm[0] - younger[0].points_mm[0]
    tried = [_iterate_closest_points(young, old, tree, begin) for begin in (np.eye(4), base)]
    older_from_younger, residual = min(tried, key=lambda one: one[1])
    return Aligned(younger_from_older=frames.invert(older_from_younger), residual_mm=residual)


def _iterate_closest_points(young: Array, old: Array, tree: cKDTree, begin: Array) -> tuple[Array, float]:
    """Estimate the rigid motion (4, 4) that maps the points ``young`` onto the points ``old``.

    It is returned with the median distance between the moved points and the nearest points of ``old``. The iteration
    starts from the motion ``begin`` (4, 4).
    """
    motion = begin.copy()
    for _ in range(MOST_ROUNDS):
        moved = young @ motion[:3, :3].T + motion[:3, 3]
        away, near = tree.query(moved)
        kept = away <= np.quantile(away, KEPT)
        middle = moved[kept].mean(axis=0)
        goal = old[near[kept]].mean(axis=0)
        points = np.concatenate([moved[kept] - middle, STRIP_MM * motion[:3, :3].T])  # the last three are the rotated axes
        turn = Rotation.align_vectors(np.concatenate([old[near[kept]] - goal, STRIP_MM * np.eye(3)]), points)[0].as_matrix()
        step = np.eye(4)
        step[:3, :3] = turn
        step[:3, 3] = goal - turn @ middle
        motion = step @ motion
        after = young @ motion[:3, :3].T + motion[:3, 3]
        if np.abs(after - moved).max() < STILL_MM:
            break
    away = tree.query(young @ motion[:3, :3].T + motion[:3, 3])[0]
    return motion, float(np.median(away))
