"""Roots as tubes: nodes with positions and radii on branches that form a tree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from rhizotwin.recon.tubes.branch_graph import Index, list_children
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]

SPACING_MM = 0.6
"""Distance between adjacent nodes of a branch, mm."""
TANGENT_NODES = 4
"""Number of nodes over which the tangent of a branch is computed."""
SMOOTH_MM = 0.4
"""Standard deviation of the Gaussian that smooths the steps between cells in a traced path, mm."""
_FEW = 16  # number of nearest nodes among which a preceding node is searched first
_OBLIQUE = 3.0  # maximum ratio of path length to distance between a parent's axis and a lateral, for 20 degrees
_STUB_MM = 0.7  # slightly more than the node spacing


@dataclass(frozen=True)
class Tubes:
    """Tree of tubes.

    A branch is a list of nodes from its base to its tip. Except in the first branch, the first node is a node of the
    parent, where the branch leaves the parent's centre line. There, the branch has the radius of its own second node.
    """

    centre_mm: Array
    """Positions of the nodes, shape (N, 3), canister frame, mm."""
    radius_mm: Array
    """Radii of the nodes, shape (N,), mm."""
    branches: tuple[Index, ...]
    """Node indices of each branch. Parents come before children."""

    @property
    def segments(self) -> Index:
        """Return the pairs (S, 2) of nodes that a segment joins."""
        line, first, _ = self.flattened
        follows = np.flatnonzero(first < np.arange(len(line)))
        return np.stack([line[follows - 1], line[follows]], axis=1)

    @property
    def segment_neighbours(self) -> Index:
        """Return two nodes (S, 2) for each segment: the preceding and the following one on the same branch.

        If a branch has no preceding or following node, the segment's own node is returned instead.
        """
        line, first, last = self.flattened
        place = np.flatnonzero(first < np.arange(len(line)))
        return np.stack([line[np.maximum(place - 2, first[place])], line[np.minimum(place + 1, last[place])]], axis=1)

    @property
    def segment_radii(self) -> tuple[Array, Array]:
        """Return the radii (S,) at both ends of each segment, mm.

        The first segment of a branch begins with the radius of its second node.
        """
        a, b = self.segments.T
        begin, end = self.radius_mm[a], self.radius_mm[b]
        first = np.cumsum([len(branch) - 1 for branch in self.branches[:-1]], dtype=np.int64)
        begin[first] = end[first]
        return begin, end

    def own(self, branch: int) -> Index:
        """Return the nodes (n,) of a branch without its first node, if this belongs to the parent."""
        return self.branches[branch] if branch == 0 else self.branches[branch][1:]

    @property
    def flattened(self) -> tuple[Index, Index, Index]:
        """Return the concatenated nodes of all branches, and the first and the last index of each node's branch.

        All three arrays have shape (M,). The two indices refer to the concatenated array.
        """
        count = np.array([len(branch) for branch in self.branches])
        end = np.cumsum(count)
        return np.concatenate(self.branches), np.repeat(end - count, count), np.repeat(end - 1, count)

    @property
    def owner(self) -> Index:
        """Return the index (N,) of the branch that contains each node."""
        owner = np.zeros(len(self.centre_mm), np.int64)
        for k in range(len(self.branches)):
            owner[self.own(k)] = k
        return owner

    @property
    def ends(self) -> tuple[Index, ...]:
        """Return the nodes (n,) at the end of each branch.

        They extend from the last lateral to the tip, or from the base to the tip if the branch has no laterals.
        """
        bearing = np.zeros(len(self.radius_mm), bool)
        bearing[[nodes[0] for nodes in self.branches[1:]]] = True
        last = (int(np.flatnonzero(bearing[self.own(k)]).max(initial=-1)) + (k > 0) for k in range(len(self.branches)))
        return tuple(nodes[max(first, 0) :] for nodes, first in zip(self.branches, last, strict=True))

    @property
    def neighbours(self) -> Index:
        """Return the preceding and the following node (N, 2) of each node on its branch.

        At the end of a branch, the node itself is returned instead.
        """
        (before, here), after = self.segments.T, self.segment_neighbours[:, 1]
        found = np.zeros((len(self.centre_mm), 2), np.int64)
        found[here] = np.stack([before, after], axis=1)
        found[self.branches[0][0]] = self.branches[0][:2]
        return found

    @property
    def tangents(self) -> Array:
        """Return unit vectors (N, 3) along the branches, towards their tips."""
        before, after = self.neighbours.T
        tangent = self.centre_mm[after] - self.centre_mm[before]
        return polyline.unit_vectors(tangent)

    def radii(self, branch: int) -> Array:
        """Return the radii (n,) along a branch, mm."""
        nodes = self.branches[branch]
        radius = self.radius_mm[nodes].copy()
        if branch > 0:
            radius[0] = radius[1]
        return radius

    @property
    def length_mm(self) -> float:
        """Return the total length of the centre lines, mm."""
        return math.fsum(polyline.length_mm(self.centre_mm[b]) for b in self.branches)

    def keep(self, stays: NDArray[np.bool_]) -> Tubes:
        """Return the tree with only the nodes marked in a mask (N,).

        The mask must be one that `prune_mask` returned.
        """
        number = np.cumsum(stays) - 1
        kept = [branch[stays[branch]] for k, branch in enumerate(self.branches) if stays[self.own(k)].any()]
        return Tubes(self.centre_mm[stays], self.radius_mm[stays], tuple(number[branch] for branch in kept))

    def prune_mask(self, gone: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the mask (N,) of nodes that remain after branches are cut back from their tips.

        Nodes after the last unmarked node of their branch are removed. ``gone`` (N,) marks nodes for removal. However,
        nodes up to the base of a remaining branch are kept.
        """
        stays = ~gone
        for k in range(len(self.branches) - 1, -1, -1):  # children before parents
            own = self.own(k)
            kept = np.flatnonzero(stays[own])
            last = max(kept.max(initial=-1) + 1, 2 * (k == 0))  # the first branch keeps a segment
            stays[own[:last]], stays[own[last:]] = True, False
            if last and k > 0:
                stays[self.branches[k][0]] = True
        return stays

    def cut_detours(self, gone: NDArray[np.bool_]) -> Tubes:
        """Remove long detours at the beginning of branches.

        If the first nodes of a branch are marked in ``gone`` (N,), and their path is much longer than necessary, the
        branch is attached to the nearest earlier tube instead. The nodes of the detours remain, without a branch.
        """
        owner, branches = self.owner, list(self.branches)
        bears = np.zeros(len(owner), bool)
        bears[[nodes[0] for nodes in branches[1:]]] = True
        for k, nodes in enumerate(branches[1:], 1):
            begin = 1 + int(np.argmin(np.append((gone & ~bears)[nodes[1:]], False)))
            if begin == 1 or begin == len(nodes):
                continue
            earlier = np.flatnonzero((owner < k) & ~gone)
            if not len(earlier):
                continue
            away = np.linalg.norm(self.centre_mm[earlier] - self.centre_mm[nodes[begin]], axis=1)
            parent = int(np.argmin(away - self.radius_mm[earlier]))
            if polyline.length_mm(self.centre_mm[nodes[: begin + 1]]) > _OBLIQUE * away[parent]:
                branches[k] = np.concatenate([earlier[parent : parent + 1], nodes[begin:]])
        return replace(self, branches=tuple(branches))


def place_nodes(paths: Sequence[Array], radius_mm: Sequence[Array]) -> Tubes:
    """Smooth paths, and place evenly spaced nodes on them.

    Parameters
    ----------
    paths : sequence of float64 array
        Points (n, 3) of each branch, from a point of its parent to its tip. Parents come before children.
    radius_mm : sequence of float64 array
        Radii (n,) at these points, mm.
    """
    strung = [_resample(path, radius) for path, radius in zip(paths, radius_mm, strict=True)]
    strung[1:] = [(points[1:], thickness[1:]) for points, thickness in strung[1:]]  # the first node belongs to the parent
    centre, radius = (np.concatenate(part) for part in zip(*strung, strict=True))
    first = np.concatenate([[0], np.cumsum([len(points) for points, _ in strung])])
    parents = _nearest_before(centre, np.array([path[0] for path in paths]), first[:-1])
    nodes = np.split(np.arange(len(centre)), first[1:-1])
    return Tubes(centre, radius, (nodes[0], *(np.concatenate([[parent], own]) for parent, own in zip(parents[1:], nodes[1:], strict=True))))


def _nearest_before(centre: Array, points: Array, count: Index) -> Index:
    """Return the index (M,) of the centre that is nearest to each point (M, 3).

    For point k, only the first ``count[k]`` centres are considered. The index is 0 if ``count[k]`` is 0.
    """
    near = cKDTree(centre).query(points, k=min(_FEW, len(centre)))[1].reshape(len(points), -1)
    allowed = near < count[:, None]
    found = np.where(allowed.any(axis=1), near[np.arange(len(near)), allowed.argmax(axis=1)], 0)
    for k in np.flatnonzero(~allowed.any(axis=1) & (count > 0)):  # all of the nearest nodes come later
        found[k] = np.linalg.norm(centre[: count[k]] - points[k], axis=1).argmin()
    return np.asarray(found, np.int64)


def attach(tree: Tubes, paths: Sequence[Array], radius_mm: Sequence[Array], parents: Sequence[int]) -> Tubes:
    """Attach paths to a tree, and place nodes on them.

    A path that begins at the tip of a branch extends that branch.

    Parameters
    ----------
    tree : Tubes
        Tree to which the paths are attached.
    paths : sequence of float64 array
        Points (n, 3) of each new branch, from its parent to its tip.
    radius_mm : sequence of float64 array
        Radii (n,) at these points, mm.
    parents : sequence of int
        Node of the tree at which each path begins, or -1 for the nearest node of the preceding new branches.
    """
    if not paths:
        return tree
    strung, count = [_resample(path, radius) for path, radius in zip(paths, radius_mm, strict=True)], len(tree.radius_mm)
    centre, radius = (np.concatenate([line[1:] for line in part]) for part in zip(*strung, strict=True))
    first, loose = np.cumsum([0, *(len(points) - 1 for points, _ in strung)]), np.array(parents) < 0
    nearest = _nearest_before(centre, np.array([path[0] for path in paths]), np.where(loose, first[:-1], 0))
    begin = np.where(loose, count + nearest, parents)
    branches, tips = list(tree.branches), {int(nodes[-1]): k for k, nodes in enumerate(tree.branches)}
    for k, parent in enumerate(begin.tolist()):
        new_nodes = count + np.arange(first[k], first[k + 1])
        ended = tips.pop(parent, None)
        if ended is None:
            branches.append(np.concatenate([np.array([parent], np.int64), new_nodes]))
        else:
            branches[ended] = np.concatenate([branches[ended], new_nodes])
    return Tubes(np.concatenate([tree.centre_mm, centre]), np.concatenate([tree.radius_mm, radius]), tuple(branches))


def _resample(path: Array, radius: Array) -> tuple[Array, Array]:
    """Smooth a path while its ends remain fixed, and place evenly spaced nodes on it."""
    step = float(np.median(np.linalg.norm(np.diff(path, axis=0), axis=1))) if len(path) > 1 else 1.0
    pad = len(path) - 1
    mirrored = np.concatenate([2 * path[:1] - path[:0:-1], path, 2 * path[-1:] - path[-2::-1]])
    smooth = gaussian_filter1d(mirrored, SMOOTH_MM / step, axis=0)[pad : pad + len(path)]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(smooth, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(2, round(along[-1] / SPACING_MM) + 1))
    points = np.stack([np.interp(at, along, smooth[:, axis]) for axis in range(3)], axis=1)
    return points, np.interp(at, along, radius)


def merge_stubs(tubes: Tubes) -> Tubes:
    """Join each branch with a lateral that begins near its end, since no root ends where a lateral leaves it.

    If several laterals begin at the last such place, the one with the smallest bend is chosen. The remainder of the
    branch beyond its laterals is removed. Branches with a remainder longer than the node spacing are not changed.
    """
    centre, owner = tubes.centre_mm, tubes.owner
    branches, used = list[Index | None](tubes.branches), np.ones(len(centre), bool)
    children = list_children(branches, owner)
    for k in sorted(children, reverse=True):  # children before parents
        line = tubes.branches[k]
        starts = np.array([int(np.flatnonzero(line == tubes.branches[j][0])[0]) for j in children[k]])
        last = int(starts.max())
        if last == 0 or np.linalg.norm(np.diff(centre[line[last:]], axis=0), axis=1).sum() > _STUB_MM:
            continue
        tangent = centre[line[last]] - centre[line[max(last - TANGENT_NODES, 0)]]
        onward: list[tuple[float, int]] = []
        for j in np.array(children[k])[starts == last].tolist():
            nodes = tubes.branches[j]
            way = centre[nodes[min(TANGENT_NODES, len(nodes) - 1)]] - centre[nodes[0]]
            onward.append((float(tangent @ way) / max(float(np.linalg.norm(way)), 1e-9), j))
        following = branches[max(onward)[1]]
        assert following is not None
        used[line[last + 1 :]] = False
        branches[k], branches[max(onward)[1]] = np.concatenate([line[: last + 1], following[1:]]), None
    return Tubes(centre, tubes.radius_mm, tuple(nodes for nodes in branches if nodes is not None)).keep(used)


def fill_gaps(tubes: Tubes) -> Tubes:
    """Insert nodes into segments that are much longer than the node spacing."""
    centres, radii, branches, count = [tubes.centre_mm], [tubes.radius_mm], list(tubes.branches), len(tubes.radius_mm)
    for k, nodes in enumerate(branches):
        way = np.diff(tubes.centre_mm[nodes], axis=0)
        parts = np.maximum(np.round(np.linalg.norm(way, axis=1) / SPACING_MM), 1).astype(np.int64)
        if k > 0:
            parts[0] = 1  # the part between the parent's centre line and its flank is not visible
        line, radius = [nodes[:1]], tubes.radii(k)
        for i in range(len(parts)):
            share = np.arange(1, parts[i]) / parts[i]
            centres.append(tubes.centre_mm[nodes[i]] + share[:, None] * way[i])
            radii.append(radius[i] + share * (radius[i + 1] - radius[i]))
            line += [count + np.arange(len(share)), nodes[i + 1 : i + 2]]
            count += len(share)
        branches[k] = np.concatenate(line).astype(np.int64)
    return Tubes(np.concatenate(centres), np.concatenate(radii), tuple(branches))


def trim_inside_parents(tubes: Tubes) -> Tubes:
    """Remove the part of each lateral that lies inside its parent.

    The lateral then begins at the point of the parent's axis to which its tangent points. Inside a thick root, pictures
    do not constrain the path to the axis, which may therefore run along the root.
    """
    centre, radius = tubes.centre_mm, tubes.radius_mm
    branches, used, instead = list(tubes.branches), np.ones(len(radius), bool), np.arange(len(radius))
    owner = tubes.owner
    for k in range(1, len(branches)):
        host, own = branches[int(owner[branches[k][0]])], branches[k][1:]
        away, nearest = cKDTree(centre[host]).query(centre[own])
        inner = int(np.argmin(np.append(away < radius[host][nearest], False)))
        if inner < 2 or inner == len(own):
            continue
        first = own[inner]
        tangent = centre[own[min(inner + TANGENT_NODES, len(own) - 1)]] - centre[first]
        reach = centre[host] - centre[first]
        back = np.minimum(reach @ tangent / max(float(tangent @ tangent), 1e-12), 0.0)
        beside = np.linalg.norm(reach - back[:, None] * tangent, axis=1)
        beside[np.linalg.norm(reach, axis=1) > _OBLIQUE * radius[host] + SPACING_MM] = np.inf
        begin = int(host[int(beside.argmin()) if np.isfinite(beside).any() else int(nearest[inner])])
        used[own[:inner]], instead[own[:inner]] = False, begin
        branches[k] = np.concatenate([[begin], own[inner:]])
    branches[1:] = [np.concatenate([instead[nodes[:1]], nodes[1:]]) for nodes in branches[1:]]
    return Tubes(centre, radius, tuple(branches)).keep(used)


def with_geometry(tubes: Tubes, centre_mm: Array, radius_mm: Array) -> Tubes:
    """Return tubes with new centres (N, 3) and radii (N,), mm."""
    return replace(tubes, centre_mm=centre_mm, radius_mm=radius_mm)
