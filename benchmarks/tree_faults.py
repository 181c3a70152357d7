"""Deliberate faults of a root tree, which the gate must notice: ghost, swapped roots, lost tips, lost length."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root, length_mm

Floats = NDArray[np.float64]
Roots = tuple[Root, ...]

NONE = "none"
GHOST_MM, GHOST_DIAMETER_MM, GHOST_BESIDE_MM = 40.0, 0.3, 1.0
"""Length and diameter of a ghost, and its distance from the surface of the thickest root, along which it runs."""
CROSSING_MM = 2.0
"""Largest distance of two centre lines at a crossing."""
TIP_MM = 2.0
"""Length that a lateral loses with its tip: twice the distance at which tips match (`scoring.score_roots`)."""
LOST = 0.05
"""Fraction of the total length that is removed."""


def apply(fault: str, roots: Sequence[Root]) -> Roots:
    """Return roots with a deliberate fault, one of `FAULTS`; the given roots are not changed."""
    return FAULTS[fault](tuple(roots))


def add_ghost(roots: Roots) -> Roots:
    """Add a thin lateral that winds along the thickest root."""
    thickest = max(range(len(roots)), key=lambda k: float(roots[k].diameters_mm.mean()))
    host = roots[thickest]
    way = polyline.arc_length_mm(host.points_mm)
    # as far as the host reaches; a longer ghost continues in the direction of its end
    at = np.arange(0.0, GHOST_MM, 0.5)
    beyond = np.maximum(at - way[-1], 0.0)[:, None] * polyline.unit_vectors(host.points_mm[-1] - host.points_mm[0])
    axis = polyline.interpolate(host.points_mm, way, at) + beyond
    turn = at / 10.0
    away = GHOST_BESIDE_MM + 0.5 * np.interp(at, way, host.diameters_mm)
    points = axis + away[:, None] * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    kept = polyline.arc_length_mm(points) <= GHOST_MM
    ghost = Root(
        points_mm=points[kept],
        diameters_mm=np.full(int(kept.sum()), GHOST_DIAMETER_MM),
        order=host.order + 1,
        parent=thickest,
        plant=host.plant,
    )
    return (*roots, ghost)


def swap_continuations(roots: Roots) -> Roots:
    """Exchange the continuations of two laterals at the crossing that exchanges most length.

    The closest pair is used if no two laterals cross.
    """
    laterals = [k for k, root in enumerate(roots) if root.parent >= 0 and len(root.points_mm) > 3]
    crossings = [(a, b, *_closest(roots[a].points_mm, roots[b].points_mm)) for a, b in combinations(laterals, 2)]
    near = [one for one in crossings if one[4] <= CROSSING_MM] or [min(crossings, key=lambda one: one[4])]
    a, b, i, j, _ = max(near, key=lambda one: _shortest_part(roots, one))
    swapped = list(roots)
    swapped[a], swapped[b] = _joined(roots[a], i, roots[b], j), _joined(roots[b], j, roots[a], i)
    return tuple(swapped)


def _closest(points: Floats, others: Floats) -> tuple[int, int, float]:
    """Return the inner points, (N, 3) and (M, 3), at which two centre lines are closest, and their distance, mm."""
    apart = cdist(points[1:-1], others[1:-1])
    i, j = np.unravel_index(apart.argmin(), apart.shape)
    return int(i) + 1, int(j) + 1, float(apart[i, j])


def _shortest_part(roots: Roots, crossing: tuple[int, int, int, int, float]) -> float:
    """Return the length of the shortest of the four parts into which two roots divide each other, mm."""
    a, b, i, j, _ = crossing
    parts = [part for k, at in ((a, i), (b, j)) for part in (roots[k].points_mm[: at + 1], roots[k].points_mm[at:])]
    return min(polyline.length_mm(part) for part in parts)


def _joined(start: Root, i: int, end: Root, j: int) -> Root:
    points = np.concatenate([start.points_mm[: i + 1], end.points_mm[j + 1 :]])
    diameters = np.concatenate([start.diameters_mm[: i + 1], end.diameters_mm[j + 1 :]])
    return replace(start, points_mm=points, diameters_mm=diameters, tip_seen=end.tip_seen, diameter_sigma_mm=None)


def lose_tips(roots: Roots) -> Roots:
    """Cut the tip of every lateral of the main roots."""
    return tuple(_shortened(root) if root.parent >= 0 and roots[root.parent].parent < 0 else root for root in roots)


def _shortened(root: Root) -> Root:
    way = polyline.arc_length_mm(root.points_mm)
    end = max(way[-1] - TIP_MM, 0.5 * way[-1])
    at = np.append(way[way < end], end)
    diameters = np.interp(at, way, root.diameters_mm)
    return replace(root, points_mm=polyline.interpolate(root.points_mm, way, at), diameters_mm=diameters, diameter_sigma_mm=None)


def lose_length(roots: Roots) -> Roots:
    """Remove laterals without laterals, the shortest first, until `LOST` of the length is missing."""
    parents = {root.parent for root in roots}
    leaves = sorted((k for k in range(len(roots)) if k not in parents), key=lambda k: polyline.length_mm(roots[k].points_mm))
    lengths = np.cumsum([polyline.length_mm(roots[k].points_mm) for k in leaves])
    removed = set(leaves[: int(np.searchsorted(lengths, LOST * length_mm(roots))) + 1])
    number = {k: place for place, k in enumerate(k for k in range(len(roots)) if k not in removed)}
    return tuple(replace(roots[k], parent=number.get(roots[k].parent, -1)) for k in number)


FAULTS: dict[str, Callable[[Roots], Roots]] = {
    "ghost": add_ghost,
    "swap": swap_continuations,
    "tips": lose_tips,
    "length": lose_length,
}
