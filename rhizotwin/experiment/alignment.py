"""One plant at two ages in one frame: the strip on its pot brings them near, its roots bring them together.

The canister's frame is the strip's, so that a plant that stays in its pot is where it was, but for the error of the
poses and what the pot was turned or moved in the strip. The rest is a rigid motion: the younger plant's centre lines
are laid on the older's, which hold them (iterated closest points, Besl and McKay 1992, trimmed as Chetverikov et al.
2002).
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
"""Between the points that a centre line is seen as: a root's diameter."""
KEPT = 0.7
"""Share of the younger plant's points that are laid on the older's: the others were traced at one age only, or
moved."""
MOST_ROUNDS = 60
STILL_MM = 1e-4
"""A round that moves no point farther is the last."""


@dataclass(frozen=True, kw_only=True)
class Aligned:
    """How an older plant is brought to the younger's frame."""

    younger_from_older: Array
    """(4, 4)"""
    residual_mm: float
    """Median distance of the younger's points from the older's lines."""

    def of(self, root_mm: Array) -> Array:
        """Return points (N, 3) of the older plant in the younger's frame."""
        moved: Array = root_mm @ self.younger_from_older[:3, :3].T + self.younger_from_older[:3, 3]
        return moved


def points_of(root: Root, step_mm: float = STEP_MM) -> tuple[Array, Array]:
    """Return points (N, 3) about ``step_mm`` apart along a root, and the unit direction (N, 3) at each."""
    way = polyline.arc_length_mm(root.points_mm)
    count = max(2, int(np.ceil(way[-1] / step_mm)) + 1)
    at = np.linspace(0.0, way[-1], count)
    points = polyline.interpolate(root.points_mm, way, at)
    along = np.gradient(points, axis=0)
    return points, along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)


def align(younger: Sequence[Root], older: Sequence[Root]) -> Aligned:
    """Lay the younger plant on the older one, from where the strip has them and from root base on root base.

    The better one counts.

    Both lists begin with the taproot and hold at least one root.
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
    """Return the motion (4, 4) that lays points on others, and the median distance of those that are kept.

    It begins with a first guess.
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
