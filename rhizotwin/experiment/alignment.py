"""Rigid registration of the roots of one plant at two ages.

The canister frame is defined by the marker strip on the net pot. A plant that stays in its pot is therefore already
aligned up to pose errors and movements of the pot in the strip. The remaining rigid motion is estimated by iterated
closest points (Besl and McKay 1992, trimmed as in Chetverikov et al. 2002) from the younger plant's centre lines to
those of the older plant, which include them.
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
"""Distance between the sample points of a centre line, about one root diameter."""
KEPT = 0.7
"""Fraction of the younger plant's points used in the fit. The others were traced at one age only, or moved."""
MOST_ROUNDS = 60
STILL_MM = 1e-4
"""The iteration ends when no point moves farther than this."""


@dataclass(frozen=True, kw_only=True)
class Aligned:
    """Registration of an older plant to the frame of the younger one."""

    younger_from_older: Array
    """(4, 4)"""
    residual_mm: float
    """Median distance of the younger plant's points from the older plant's centre lines."""

    def of(self, root_mm: Array) -> Array:
        """Transform points (N, 3) of the older plant to the frame of the younger one."""
        moved: Array = root_mm @ self.younger_from_older[:3, :3].T + self.younger_from_older[:3, 3]
        return moved


def points_of(root: Root, step_mm: float = STEP_MM) -> tuple[Array, Array]:
    """Sample points (N, 3) about ``step_mm`` apart along a root, with the unit direction (N, 3) at each."""
    way = polyline.arc_length_mm(root.points_mm)
    count = max(2, int(np.ceil(way[-1] / step_mm)) + 1)
    at = np.linspace(0.0, way[-1], count)
    points = polyline.interpolate(root.points_mm, way, at)
    along = np.gradient(points, axis=0)
    return points, along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)


def align(younger: Sequence[Root], older: Sequence[Root]) -> Aligned:
    """Register the younger plant to the older one.

    The iteration starts from the marker strip's alignment and from coinciding root bases; the better result is
    returned.

    Both lists begin with the taproot and contain at least one root.
    """
    young = np.concatenate([points_of(root)[0] for root in younger])
    old = np.concatenate([points_of(root)[0] for root in older])
    tree = cKDTree(old)
    base = np.eye(4)
    base[:3, 3] = older[0].points_mm[0] - younger[0].points_mm[0]
    tried = [_closest(young, old, tree, begin) for begin in (np.eye(4), base)]
    older_from_younger, residual = min(tried, key=lambda one: one[1])
    return Aligned(younger_from_older=frames.invert(older_from_younger), residual_mm=residual)


def _closest(young: Array, old: Array, tree: cKDTree, begin: Array) -> tuple[Array, float]:
    """Estimate the motion (4, 4) from points to other points, and the median distance of the points used.

    The iteration starts from the given motion.
    """
    motion = begin.copy()
    for _ in range(MOST_ROUNDS):
        moved = young @ motion[:3, :3].T + motion[:3, 3]
        away, near = tree.query(moved)
        kept = away <= np.quantile(away, KEPT)
        middle, goal = moved[kept].mean(axis=0), old[near[kept]].mean(axis=0)
        turn = Rotation.align_vectors(old[near[kept]] - goal, moved[kept] - middle)[0].as_matrix()
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = turn, goal - turn @ middle
        motion = step @ motion
        after = young @ motion[:3, :3].T + motion[:3, 3]
        if np.abs(after - moved).max() < STILL_MM:
            break
    away = tree.query(young @ motion[:3, :3].T + motion[:3, 3])[0]
    return motion, float(np.median(away))
