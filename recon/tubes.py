"""Roots as tubes: nodes with positions and radii, strung on branches that form a tree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPACING_MM = 0.6
"""Distance between the nodes of a branch."""
SMOOTH_MM = 0.4
"""Standard deviation of the Gaussian that takes the steps of the cells out of a traced path."""


@dataclass(frozen=True)
class Tubes:
    """A tree of tubes.

    A branch lists its nodes from its beginning to its tip. The first node of every branch but the first belongs to its parent: there
    it leaves the parent's centre line, with its own radius that of its second node.
    """

    centre_mm: Array
    """(N, 3) nodes, canister frame."""
    radius_mm: Array
    """(N,)"""
    branches: tuple[Index, ...]
    """Node numbers; parents before children."""

    @property
    def segments(self) -> Index:
        """Return the pairs of nodes (S, 2) that a tube joins."""
        return np.concatenate([np.stack([b[:-1], b[1:]], axis=1) for b in self.branches])

    def own(self, branch: int) -> Index:
        """Return the nodes of a branch that are not its parent's."""
        return self.branches[branch] if branch == 0 else self.branches[branch][1:]

    @property
    def owner(self) -> Index:
        """Return the branch (N,) that each node belongs to."""
        owner = np.zeros(len(self.centre_mm), np.int64)
        for k in range(len(self.branches)):
            owner[self.own(k)] = k
        return owner

    @property
    def tangents(self) -> Array:
        """Return unit vectors (N, 3) along the branches, towards their tips."""
        tangent = np.zeros_like(self.centre_mm)
        for k, branch in enumerate(self.branches):
            slope = np.gradient(self.centre_mm[branch], axis=0)
            tangent[self.own(k)] = slope if k == 0 else slope[1:]
        return np.asarray(tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12))

    def radii(self, branch: int) -> Array:
        """Return the radii (n,) along a branch."""
        nodes = self.branches[branch]
        radius = self.radius_mm[nodes].copy()
        if branch > 0:
            radius[0] = radius[1]
        return radius

    @property
    def length_mm(self) -> float:
        """Return the total length of the centre lines."""
        return float(sum(np.linalg.norm(np.diff(self.centre_mm[b], axis=0), axis=1).sum() for b in self.branches))

    def keep(self, stays: NDArray[np.bool_]) -> Tubes:
        """Keep nodes (N,) as `staying` chose them."""
        number = np.cumsum(stays) - 1
        kept = [branch[stays[branch]] for k, branch in enumerate(self.branches) if stays[self.own(k)].any()]
        return Tubes(self.centre_mm[stays], self.radius_mm[stays], tuple(number[branch] for branch in kept))

    def staying(self, gone: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Tell the nodes (N,) that stay where branches are cut back from their tips.

        Cut away are the nodes ``gone`` (N,) beyond the last one that is not, or that bears a branch that stays.
        """
        stays = ~gone
        for k in range(len(self.branches) - 1, -1, -1):  # children before parents
            own = self.own(k)
            kept = np.flatnonzero(stays[own])
            last = kept[-1] + 1 if len(kept) else 2 * (k == 0)  # the first branch keeps a segment
            stays[own[:last]], stays[own[last:]] = True, False
            if last and k > 0:
                stays[self.branches[k][0]] = True
        return stays


def string(paths: Sequence[Array], radius_mm: Sequence[Array]) -> Tubes:
    """Smooth paths and string nodes evenly on them.

    Parameters
    ----------
    paths : points (n, 3) of each branch, from a point of its parent to its tip; parents before children.
    radius_mm : radii (n,) at these points.
    """
    centres, radii, count = [np.zeros((0, 3))], [np.zeros(0)], 0
    branches: list[Index] = []
    for path, radius in zip(paths, radius_mm, strict=True):
        points, thickness = _even(path, radius)
        if not branches:
            nodes = np.arange(len(points))
        else:
            parent = int(cKDTree(np.concatenate(centres)).query(path[0])[1])
            points, thickness = points[1:], thickness[1:]
            nodes = np.concatenate([[parent], count + np.arange(len(points))])
        branches.append(nodes.astype(np.int64))
        centres.append(points)
        radii.append(thickness)
        count += len(points)
    return Tubes(np.concatenate(centres), np.concatenate(radii), tuple(branches))


def _even(path: Array, radius: Array) -> tuple[Array, Array]:
    """Smooth a path, its ends held, and place nodes on it."""
    step = float(np.median(np.linalg.norm(np.diff(path, axis=0), axis=1))) if len(path) > 1 else 1.0
    pad = len(path) - 1
    mirrored = np.concatenate([2 * path[:1] - path[:0:-1], path, 2 * path[-1:] - path[-2::-1]])
    smooth = gaussian_filter1d(mirrored, SMOOTH_MM / step, axis=0)[pad : pad + len(path)]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(smooth, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(2, round(along[-1] / SPACING_MM) + 1))
    points = np.stack([np.interp(at, along, smooth[:, axis]) for axis in range(3)], axis=1)
    return points, np.interp(at, along, radius)


def moved(tubes: Tubes, centre_mm: Array, radius_mm: Array) -> Tubes:
    """Return tubes with other centres and radii."""
    return replace(tubes, centre_mm=centre_mm, radius_mm=radius_mm)
