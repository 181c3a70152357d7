"""Connection of several plants, or roots that leave the net pot far apart, into a single tree by an artificial branch.

Tracing and fitting require a single tree. The artificial branch, the crown, is its first branch and lies behind the net
pot. It runs from above the first plant or root to above the last, and each of them is attached to it as a branch.
`mark_hidden` excludes the artificial nodes from the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.model import Scene

if TYPE_CHECKING:
    from rhizotwin.recon.roots.root_tree import RootSystem

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Top = tuple[float, float, float]

HIDDEN_MM = 8.0
"""Height below the net pot's grid in which the visible top of a plant is searched, mm.

From a camera at the height of the roots, the dark net pot hides the topmost 2.4 mm of thin roots, and a few diameters
more of a thick base (docs/accuracy.md)."""
_BEYOND_MM = 3.0
"""Length by which the crown extends beyond the outermost plants, mm. Because of this extension, these plants are
attached along the crown like all others, and not at its ends."""
_LEFT = 0.5
"""Minimum ratio of a node's radius to the median radius of its branch for the node to be part of a real root. Fitting
reduces the radius of artificial nodes below this limit, since they cover pixels that show no root."""
_FEW = 3
"""Minimum number of views that must show a node for it to be part of a real root. Two views barely determine the
position of a point."""


def tops(scene: Scene) -> tuple[Top, ...]:
    """Return the points at which the plants are attached to the crown.

    They lie halfway between the grid and the top of the opaque net pot. A single plant is in the middle.
    """
    z_mm = 0.5 * (scene.net_pot.grid_z_mm + scene.net_pot.top_mm)
    return tuple((*plant.at_mm, z_mm) for plant in scene.plants) if len(scene.plants) > 1 else ((0.0, 0.0, z_mm),)


def reach_mm(at_mm: Array) -> float:
    """Return the maximum horizontal distance of a plant's base from the given position of the plant, mm.

    It is half the smallest distance between the positions (P, 2) of two plants.
    """
    apart = np.linalg.norm(at_mm[:, None] - at_mm[None], axis=2)
    return 0.5 * float(apart[~np.eye(len(at_mm), dtype=bool)].min())


def find_top_cells(centre_mm: Array, dense: NDArray[np.bool_], tops_mm: Sequence[Top]) -> dict[int, Index]:
    """Return the indices of the cells in which the top of each plant is searched, keyed by the index of the plant.

    All of these cells contain roots.

    Parameters
    ----------
    centre_mm : (N, 3) float64 array
        Centres of the cells, mm.
    dense : (N,) bool array
        Mask of the cells that contain roots.
    tops_mm : sequence of tuple of float
        Attachment points of the plants. The top of a single plant may be anywhere, so that none is returned.
    """
    if len(tops_mm) < 2:
        return {}
    at_mm = np.array(tops_mm)[:, :2]
    near = reach_mm(at_mm)
    highest = float(centre_mm[dense, 2].max())
    high = dense & (centre_mm[:, 2] > highest - HIDDEN_MM)
    chosen = (np.flatnonzero(high & (np.linalg.norm(centre_mm[:, :2] - place, axis=1) < near)) for place in at_mm)
    return {plant: cells for plant, cells in enumerate(chosen) if len(cells)}


def attach_paths(paths: Sequence[tuple[int, Array, Array]], under: Mapping[int, Top], step_mm: float) -> list[tuple[Array, Array]]:
    """Attach the traced paths of several plants, or of roots that leave the net pot far apart, to a crown.

    Parameters
    ----------
    paths : sequence of tuple
        First cell, points (n, 3) and shadows (n,) of each path. Parents come before children.
    under : mapping
        Attachment point of each plant or root, keyed by the cell from which it was traced.
    step_mm : float
        Spacing of the points along a path, mm.

    Returns
    -------
    list of tuple
        Points and shadows of each path, starting with the crown.
    """
    points = np.array(list(under.values()))
    along = points[:, :2] - points[:, :2].mean(axis=0)
    axis = np.linalg.svd(along)[2][0]
    order = np.argsort(along @ axis)
    ends = np.array([*axis, 0.0]) * _BEYOND_MM
    crown = _line([points[order[0]] - ends, *points[order], points[order[-1]] + ends], step_mm)
    found = [(crown, np.full(len(crown), float(np.mean([shadow.mean() for _, _, shadow in paths]))))]
    left = dict(under)
    for first, line, shadow in paths:
        if first in left:  # the first path of a plant is extended to the crown
            rise = _line([np.array(left.pop(first)), line[0]], step_mm)[:-1]
            line, shadow = np.concatenate([rise, line]), np.concatenate([np.full(len(rise), shadow[0]), shadow])
        found.append((line, shadow))
    return found


def _line(corners: Sequence[Array], step_mm: float) -> Array:
    """Return evenly spaced points (N, 3) along the straight segments between corners."""
    parts = [np.asarray(corners[0])[None]]
    for a, b in pairwise(corners):
        count = max(1, round(float(np.linalg.norm(b - a)) / step_mm))
        parts.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(parts)


def mark_hidden(system: RootSystem, top_mm: float) -> RootSystem:
    """Mark nodes without evidence in the pictures as solid, so that they are not part of any root and add no volume.

    These are the nodes of the crown if there is one, or else the hidden nodes at the base of the plant.

    Parameters
    ----------
    top_mm : float
        z coordinate of the upper limit of the visible water, below the net pot, mm.
    """
    at, height_mm, radius_mm = system.evidence.project(system.tubes.centre_mm), system.tubes.centre_mm[:, 2], system.tubes.radius_mm
    shown = np.zeros(len(height_mm), np.int64)
    for view, silhouette in enumerate(system.evidence.silhouettes):
        column, row = np.round(np.where(at.visible[view][:, None], at.px[view], 0.0)).astype(np.int64).T
        shown += at.visible[view] & silhouette.usable[row, column]
    hidden = shown < _FEW
    if not system.has_crown:
        base, *others = system.tubes.branches
        forks = np.isin(base, [nodes[0] for nodes in others])  # a root keeps the laterals of its hidden base
        held = np.zeros(len(height_mm), bool)
        held[base[: int(np.argmin(hidden[base] & ~forks))]] = True
        return replace(system, solid=system.solid | held)
    high = height_mm > top_mm - HIDDEN_MM
    held = (height_mm > top_mm) | (high & hidden)
    for nodes in system.tubes.branches:
        if held[nodes[0]] and not held[nodes].all():  # below the net pot, the fit shrinks nodes that are not part of a root
            own = nodes[int(np.argmin(held[nodes])) :]
            thick = radius_mm[own] > _LEFT * float(np.median(radius_mm[own]))
            above = own[: int(np.argmax(thick))]
            held[above[high[above]]] = True
    return replace(system, solid=system.solid | held)
