"""Assignment of roots to plants by their bases at the grid of the net pot.

If roots of two plants touch, one tree may contain the bases of both plants and is divided. Roots taper from base to tip
and leave their parents in the direction of growth. The path between two bases is therefore cut where it is thin and its
direction reverses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots import crown, hierarchy
from rhizotwin.recon.roots.rerooting import Tree
from rhizotwin.scenes import polyline
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

_DIRECTION_MM = 5.0
"""Length over which directions and diameters are averaged along a path, mm. It is the same as in parent assignment
(`hierarchy`)."""
_SURE = 2.0
"""Ratio of the distances to the second-nearest and to the nearest plant, above which a piece without a base is assigned
with certainty. Below this ratio, it is assigned to the nearest plant and marked as uncertain."""


@dataclass(frozen=True)
class PlantedRoots:
    """Roots with the plants to which they are assigned."""

    roots: tuple[Root, ...]
    open: tuple[bool, ...]
    """Whether each root may also be part of another plant."""
    missing: tuple[str, ...]
    """Names of the plants for which no base was found."""


def assign(roots: Sequence[Root], plants: Sequence[Plant], *, grid_z_mm: float) -> PlantedRoots:
    """Assign each root to a plant.

    Parameters
    ----------
    roots : sequence of Root
        Roots as returned by `hierarchy.arrange`.
    plants : sequence of Plant
        Plants with their positions.
    grid_z_mm : float
        z coordinate of the net pot's grid, through which the roots grow, mm.
    """
    if len(plants) == 1:
        return PlantedRoots(tuple(replace(root, plant=plants[0].plant) for root in roots), (False,) * len(roots), ())
    at_mm = np.array([[*plant.at_mm, grid_z_mm] for plant in plants])
    trees = Tree.from_roots(roots)
    trees = [part for tree in trees for part in _divide(tree, at_mm)]
    owners = [_owner(tree, at_mm) for tree in trees]
    missing = tuple(plant.plant for k, plant in enumerate(plants) if k not in owners)
    owners, uncertain = _nearest(trees, owners, at_mm)
    arranged = [hierarchy.arrange(tree.roots) if tree.is_turned else tree.roots for tree in trees]
    given = [[replace(root, plant=plants[owner].plant) for root in own] for own, owner in zip(arranged, owners, strict=True)]
    return _concatenate(given, uncertain, missing)


def check_assignment(roots: Sequence[Root], plants: Sequence[Plant], *, grid_z_mm: float) -> PlantedRoots:
    """Check roots that were assigned to plants by a person, and mark uncertain assignments.

    Parameters
    ----------
    roots, plants, grid_z_mm : sequence of Root, sequence of Plant, float
        Same as in `assign`. Each root must be assigned to one of the plants.
    """
    at_mm = np.array([[*plant.at_mm, grid_z_mm] for plant in plants])
    trees = Tree.from_roots(roots)
    uncertain = _nearest(trees, [_owner(tree, at_mm) for tree in trees], at_mm)[1]
    names = {root.plant for root in roots}
    return _concatenate([tree.roots for tree in trees], uncertain, tuple(one.plant for one in plants if one.plant not in names))


def _concatenate(trees: Sequence[Sequence[Root]], uncertain: Sequence[bool], missing: tuple[str, ...]) -> PlantedRoots:
    """Concatenate the roots of several trees.

    Parents are indices within each tree in the input, and indices in the whole list in the output.
    """
    made: list[Root] = []
    for tree in trees:
        first = len(made)
        made += [replace(root, parent=root.parent + first if root.parent >= 0 else -1) for root in tree]
    return PlantedRoots(tuple(made), tuple(is_open for tree, is_open in zip(trees, uncertain, strict=True) for _ in tree), missing)


def _bases(tree: Tree, at_mm: Array) -> dict[int, tuple[int, int]]:
    """Find the bases of the plants in a tree.

    Return the root index and the point index of each base, keyed by the index of the plant. It is the point nearest to
    the plant's position, of those at most `crown.HIDDEN_MM` below the grid and horizontally within `crown.reach_mm`.
    """
    reach_mm, found = crown.reach_mm(at_mm[:, :2]), {}
    for plant, place in enumerate(at_mm):
        away = []
        for root in tree.roots:
            shift = root.points_mm - place
            allowed = (shift[:, 2] > -crown.HIDDEN_MM) & (np.linalg.norm(shift[:, :2], axis=1) < reach_mm)
            away.append(np.where(allowed, np.linalg.norm(shift, axis=1), np.inf))
        number = int(np.argmin([one.min() for one in away]))
        if away[number].min() < np.inf:
            found[plant] = (number, int(np.argmin(away[number])))
    return found


def _owner(tree: Tree, at_mm: Array) -> int:
    """Return the index of the plant whose base is in a divided tree. It is -1 if the tree contains no base."""
    return next(iter(_bases(tree, at_mm)), -1)


def _divide(tree: Tree, at_mm: Array) -> list[Tree]:
    """Divide a tree until no part contains the bases of two plants."""
    bases = list(_bases(tree, at_mm).values())
    if len(bases) < 2:
        return [tree]
    rooted = tree.reroot(*bases[0])
    other = _bases(rooted, at_mm)
    line, at = list(other.values())[1]
    way = rooted.way(line, at)
    cut = _cut(np.array([rooted.roots[k].points_mm[i] for k, i in way]), np.array([rooted.roots[k].diameters_mm[i] for k, i in way]))
    above, below = rooted.split(way[cut], way[cut + 1])
    below = below.reroot(*_nearest_point(below, rooted.roots[line].points_mm[at]))
    return [*_divide(above, at_mm), *_divide(below, at_mm)]


def _nearest_point(tree: Tree, point_mm: Array) -> tuple[int, int]:
    """Return root index and point index of the point of a tree that is nearest to a given position."""
    away = [np.linalg.norm(root.points_mm - point_mm, axis=1) for root in tree.roots]
    number = int(np.argmin([one.min() for one in away]))
    return number, int(np.argmin(away[number]))


def _cut(points_mm: Array, diameters_mm: Array) -> int:
    """Return the step at which a path (N, 3) between the bases of two plants passes from one plant to the other.

    Notes
    -----
    The step minimises ln d + cos t. The thickness d is the smaller of the median diameters over 5 mm on both sides of
    the step, and t is the angle between the chords of 5 mm before and behind it. A root thinner by a factor of e counts
    as much as a right angle.
    """
    way_mm = polyline.arc_length_mm(points_mm)
    cost = np.empty(len(points_mm) - 1)
    for step in range(len(cost)):
        before = np.flatnonzero(way_mm[: step + 1] >= way_mm[step] - _DIRECTION_MM)
        behind = step + 1 + np.flatnonzero(way_mm[step + 1 :] <= way_mm[step + 1] + _DIRECTION_MM)
        middle = 0.5 * (points_mm[step] + points_mm[step + 1])
        coming, going = middle - points_mm[before[0]], points_mm[behind[-1]] - middle
        size = float(np.linalg.norm(coming) * np.linalg.norm(going))
        cosine = float(coming @ going) / size if size > 0.0 else 1.0
        thick_mm = min(float(np.median(diameters_mm[before])), float(np.median(diameters_mm[behind])))
        cost[step] = np.log(max(thick_mm, 1e-3)) + cosine
    return int(np.argmin(cost))


def _nearest(trees: Sequence[Tree], owners: Sequence[int], at_mm: Array) -> tuple[list[int], list[bool]]:
    """Assign pieces without a base to the nearest plant. The piece that is nearest to a plant is assigned first.

    Returns
    -------
    owners : list of int
        Index of the plant to which each tree is assigned.
    unsure : list of bool
        Whether another plant is almost as near.
    """
    held = [[place[None]] for place in at_mm]  # points of each plant
    for tree, owner in zip(trees, owners, strict=True):
        if owner >= 0:
            held[owner] += [root.points_mm for root in tree.roots]
    found, uncertain = list(owners), [False] * len(trees)
    away = np.full((len(trees), len(at_mm)), np.inf)
    free = [k for k, owner in enumerate(owners) if owner < 0]
    reach = [cKDTree(np.concatenate(points)) for points in held]
    for k in free:
        away[k] = [tree.query(_ends(trees[k]))[0].min() for tree in reach]
    while free:
        k = min(free, key=lambda one: float(away[one].min()))
        free.remove(k)
        found[k] = owner = int(np.argmin(away[k]))
        others = np.delete(away[k], owner)
        uncertain[k] = bool(others.min() < _SURE * away[k, owner])
        grown = cKDTree(np.concatenate([root.points_mm for root in trees[k].roots]))
        for other in free:  # pieces detached from this one are attached to it
            away[other, owner] = min(away[other, owner], float(grown.query(_ends(trees[other]))[0].min()))
    return found, uncertain


def _ends(tree: Tree) -> Array:
    """Return the points (N, 3) at which a piece without a base may be attached.

    These are the ends of its first root.
    """
    return tree.roots[0].points_mm[[0, -1]]
