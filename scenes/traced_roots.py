"""Preparation of manually traced roots, so that they can be used as truth.

Gaps between laterals and their parents are closed where the file states the node of the parent, or where the first
point of the lateral is missing. Stretches that several roots share are counted once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.scenes import polyline, rsml
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import RsmlFile

Array = NDArray[np.float64]

MISSING_STEPS = 2.0
"""Maximum gap between a root and its parent, in lengths of the first segment of the root, that is closed without a
stated node. If a program omits the first point of laterals, as CPlantBox 2.1.1 does, the gap is one such length."""
SHARED = 0.5
"""Maximum distance between two lines that count as tracings of the same root, as a fraction of the radius of the
thinner line. The centre lines of two different roots are at least one radius apart."""
LEAST_SHARED_MM = 2.0
"""Minimum length over which two lines must coincide to be merged, mm. It exceeds the width of any root that was traced
separately. Shorter stretches are crossings or branch points."""
MOST_LATEST = 2000
"""Maximum number of new points that are searched separately. When it is exceeded, the search tree of all points is
rebuilt. Building a tree of this size takes a millisecond."""
STEP_MM = 0.2
"""Spacing of the points at which lines are compared, mm."""


def close_gaps(file: RsmlFile) -> tuple[tuple[Root, ...], int]:
    """Connect roots that begin at a distance from their parents to nodes of the parents.

    The node is the one stated in the file. Without a usable one (`rsml_hierarchy.resolve_parent_nodes`), it is the
    nearest node, if only the first point of the root can be missing (`MISSING_STEPS`).

    Returns
    -------
    roots : tuple of Root
    closed : int
        Number of roots that were connected.
    """
    closed, roots = 0, list(file.roots)
    for index, (root, stated) in enumerate(zip(file.roots, file.parent_nodes, strict=True)):
        if root.parent < 0:
            continue
        parent = file.roots[root.parent]
        away_mm = np.linalg.norm(parent.points_mm - root.points_mm[0], axis=1)
        node, limit_mm = int(away_mm.argmin()), MISSING_STEPS * float(np.linalg.norm(root.points_mm[1] - root.points_mm[0]))
        if stated is not None:
            node, limit_mm = stated, np.inf
        reach_mm = (parent.diameters_mm[node] + root.diameters_mm[0]) / 2.0
        if reach_mm < away_mm[node] <= limit_mm:
            points_mm = np.concatenate([parent.points_mm[node : node + 1], root.points_mm])
            sigma_mm = root.diameter_sigma_mm if root.diameter_sigma_mm is None else _repeat_first(root.diameter_sigma_mm)
            diameters_mm = _repeat_first(root.diameters_mm)
            roots[index] = replace(root, points_mm=points_mm, diameters_mm=diameters_mm, diameter_sigma_mm=sigma_mm)
            closed += 1
    return tuple(roots), closed


def _repeat_first(values: Array) -> Array:
    return np.concatenate([values[:1], values])


def main_root(roots: Sequence[Root]) -> Root:
    """Return the root with the largest volume: the longest root, if all are equally thick."""
    return max(roots, key=lambda root: float(polyline.steps_mm(root.points_mm) @ (root.diameters_mm[:-1] + root.diameters_mm[1:]) ** 2))


def growth_direction(root: Root) -> Array:
    """Return the vector (3,) from the base of a root to the centre of its line, mm."""
    steps_mm = polyline.steps_mm(root.points_mm)
    middles_mm = (root.points_mm[:-1] + root.points_mm[1:]) / 2.0
    return np.asarray(steps_mm @ middles_mm / max(float(steps_mm.sum()), 1e-12) - root.points_mm[0])


@dataclass(frozen=True)
class _Line:
    """Centre line, sampled at equally spaced points."""

    points_mm: Array
    diameters_mm: Array

    @staticmethod
    def of(root: Root) -> "_Line":
        """Resample the centre line of a root at points `STEP_MM` apart."""
        along_mm = polyline.arc_length_mm(root.points_mm)
        at_mm = np.linspace(0.0, along_mm[-1], max(2, int(np.ceil(along_mm[-1] / STEP_MM)) + 1))
        points = polyline.interpolate(root.points_mm, along_mm, at_mm)
        return _Line(points, np.interp(at_mm, along_mm, root.diameters_mm))


def merge_shared_stretches(roots: Sequence[Root]) -> tuple[tuple[Root, ...], float]:
    """Remove stretches in which a root coincides with an earlier root in the list.

    Each stretch is thus counted once. The remainder of such a root becomes a lateral of the root with which it
    coincides. A completely shared root is removed, and its laterals are assigned to the root with which it coincides.

    Parameters
    ----------
    roots : sequence of Root
        Roots in an order in which parents precede their children.

    Returns
    -------
    roots : tuple of Root
        Roots without shared stretches.
    shared_mm : float
        Total length of the stretches that were removed.
    """
    kept: list[Root] = []
    owner: list[int] = []  # index in ``kept`` of the root that represents each of ``roots``
    seen = _KnownLines()
    for root in roots:
        line = _Line.of(root)
        parent = owner[root.parent] if root.parent >= 0 else -1
        runs, host = _unshared_stretches(line, seen)
        whole = runs == [(0, len(line.points_mm))]
        first = len(kept)
        for number, (start, stop) in enumerate(runs):
            above = parent if host is None or start == 0 else host
            piece = line.points_mm[start:stop], line.diameters_mm[start:stop]
            points_mm, diameters_mm = (root.points_mm, root.diameters_mm) if whole else piece
            order = kept[above].order + 1 if above >= 0 else 0
            seen_tip = root.tip_seen if number == len(runs) - 1 else True
            kept.append(replace(root, points_mm=points_mm, diameters_mm=diameters_mm, parent=above, order=order, tip_seen=seen_tip))
            seen.add(_Line(*piece), len(kept) - 1)
        owner.append(first if runs else host if host is not None else parent)
    return tuple(kept), rsml.length_mm(roots) - rsml.length_mm(kept)


class _KnownLines:
    """Centre lines processed so far, with a search for the point nearest to a given point.

    One search tree contains most of the points. A second search tree, with the latest points, is rebuilt frequently.
    """

    def __init__(self) -> None:
        self._old: tuple[cKDTree, Array, NDArray[np.int64]] | None = None
        self._lines: list[_Line] = []
        self._owners: list[NDArray[np.int64]] = []

    def add(self, line: _Line, owner: int) -> None:
        """Add a line, with the index of its root."""
        self._lines.append(line)
        self._owners.append(np.full(len(line.points_mm), owner))

    def nearest(self, points_mm: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        """Return the properties of the line point that is nearest to each of the points (N, 3).

        They are the distance (mm), the diameter (mm) and the index of the root. The distance is infinite if there are
        no lines.
        """
        found = np.full(len(points_mm), np.inf), np.zeros(len(points_mm)), np.full(len(points_mm), -1)
        trees = [] if self._old is None else [self._old]
        if self._lines:
            points = np.concatenate([line.points_mm for line in self._lines])
            diameters: Array = np.concatenate([line.diameters_mm for line in self._lines])
            owners: NDArray[np.int64] = np.concatenate(self._owners)
            if len(points) > MOST_LATEST:
                if self._old is not None:
                    points = np.concatenate([self._old[0].data, points])
                    diameters, owners = np.concatenate([self._old[1], diameters]), np.concatenate([self._old[2], owners])
                self._lines, self._owners = [], []
                latest = cKDTree(points), diameters, owners
                self._old, trees = latest, [latest]
            else:
                trees.append((cKDTree(points), diameters, owners))
        for tree, diameters, owners in trees:
            away, near = tree.query(points_mm)
            nearer = away < found[0]
            for part, values in zip(found, (away, diameters[near], owners[near]), strict=True):
                part[nearer] = values[nearer]
        return found


def _unshared_stretches(line: _Line, seen: _KnownLines) -> tuple[list[tuple[int, int]], int | None]:
    """Return the stretches of a line that do not coincide with known lines, as index ranges (start, stop).

    Also return the index of the root with which the line coincides over the greatest length, or None if there is none.
    """
    count = len(line.points_mm)
    away_mm, diameter_mm, owner = seen.nearest(line.points_mm)
    limit_mm = np.maximum(SHARED * np.minimum(line.diameters_mm, diameter_mm) / 2.0, STEP_MM / 2.0)
    with_whom = np.where(away_mm <= limit_mm, owner, -1)
    least = int(np.ceil(LEAST_SHARED_MM / STEP_MM))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], with_whom >= 0, [False]]).astype(np.int8)))
    long = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > least]
    if not long:
        return [(0, count)], None
    host = int(np.bincount(with_whom[np.concatenate([np.arange(a, b) for a, b in long])]).argmax())
    # the end points of shared stretches are kept
    bounds = [0, *(place for a, b in long for place in (a + 1, b - 1)), count]
    runs = [(a, b) for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a > least]
    return runs, host
