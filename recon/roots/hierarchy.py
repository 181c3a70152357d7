"""Parent assignment: correction of the orders and parents of roots that were traced incorrectly at crossings.

Where roots touch, tracing connects them. Three criteria distinguish a contact from a branching point: a root continues
along the thickest line, a lateral leaves its parent in the direction of growth, and no lateral leaves in the basal zone
of its parent (Leitner et al. 2010, Plant and Soil 332:177). Points are not moved.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
_Point = tuple[Array, float]

_REACH_MM = 5.0
"""Length over which directions and diameters beyond a fork are averaged, mm."""
_THICKER = 1.25
"""Ratio of the diameter of a lateral to that of its parent beyond the fork, above which the root is assumed to continue
in the lateral. Diameters averaged over 5 mm vary by less than this ratio."""
_ROUNDS = 10
"""Maximum number of iterations. Three or four usually suffice."""
_BASAL_MM = 2.0
"""Maximum distance between the base of a lateral and the surface of its grandparent at which the lateral is reassigned
to the grandparent, mm. Such a lateral runs along its assigned parent at first, but does not originate from it."""


def arrange(roots: Sequence[Root]) -> tuple[Root, ...]:
    """Return the roots with corrected bases, orders and parents. Parents come before children.

    Centre lines are unchanged, but a straight segment is added where a root continues in a lateral that began near it.
    """
    arranged = list(roots)
    for _ in range(_ROUNDS):  # other laterals may be near the base of a root with a new course
        _move_up(arranged)
        before, arranged = arranged, _rejoin(arranged)
        if [(root.parent, len(root.points_mm)) for root in arranged] == [(root.parent, len(root.points_mm)) for root in before]:
            break
    return tuple(arranged)


def _move_up(roots: list[Root]) -> None:
    """Reassign laterals that begin in the basal zone of their parent to the parent of that parent.

    This is repeated until no such lateral is left.
    """
    moved = True
    while moved:
        moved = False
        for index, root in enumerate(roots):
            above = roots[root.parent].parent if root.parent >= 0 else -1
            if above < 0:
                continue
            away = np.linalg.norm(roots[above].points_mm - root.points_mm[0], axis=1) - roots[above].diameters_mm / 2.0
            if away.min() < _BASAL_MM:
                roots[index], moved = replace(root, parent=above), True


def _growth_cosine(parent: Root, points_mm: Array) -> float:
    """Return the cosine of the angle between the first 5 mm of a line and its parent's direction of growth."""
    at = _nearest(parent, points_mm[0])
    along = parent.points_mm[min(at + 1, len(parent.points_mm) - 1)] - parent.points_mm[max(at - 1, 0)]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_mm, axis=0), axis=1))])
    chord = points_mm[max(1, int(np.searchsorted(way, _REACH_MM, side="right")) - 1)] - points_mm[0]
    return float(along @ chord / max(float(np.linalg.norm(along) * np.linalg.norm(chord)), 1e-12))


def _nearest(root: Root, point_mm: Array) -> int:
    return int(np.argmin(np.sum((root.points_mm - point_mm) ** 2, axis=1)))


def _rejoin(roots: Sequence[Root]) -> list[Root]:
    """Divide the tree into roots again.

    At each fork, the thickest line continues, and the others begin as new roots.
    """
    leaving: dict[tuple[int, int], list[int]] = {}
    for index, root in enumerate(roots):
        if root.parent >= 0:
            leaving.setdefault((root.parent, _nearest(roots[root.parent], root.points_mm[0])), []).append(index)

    def lines_at(line: int, at: int) -> list[int]:
        """Return the lines that leave a root at a point.

        Lines that leave at the first point of such a line are included.
        """
        found = list(leaving.get((line, at), []))
        for k in found:  # the list grows during the loop
            if np.array_equal(roots[k].points_mm[0], roots[line].points_mm[at]):
                found += leaving.get((k, 0), [])
        return found

    made: list[Root] = []
    # (line, index of its next point, new parent, initial points and diameters)
    begun: list[tuple[int, int, int, list[_Point]]] = []
    begun += [(index, 0, -1, []) for index, root in enumerate(roots) if root.parent < 0][::-1]
    while begun:
        line, at, parent, path = begun.pop()
        label, number = roots[line].label, len(made)
        while at < len(roots[line].points_mm):
            here = (roots[line].points_mm[at], float(roots[line].diameters_mm[at]))
            path.append(here)
            line, at, others = _fork(roots, line, at, lines_at(line, at))
            begun += [(k, first, number, [(here[0], _own_diameter(roots[k], first))] if first else []) for k, first in others[::-1]]
        order = made[parent].order + 1 if parent >= 0 else 0
        points, diameters = np.stack([point for point, _ in path]), np.array([diameter for _, diameter in path])
        tip_seen = roots[line].tip_seen  # the tip is that of the last line
        made.append(Root(points_mm=points, diameters_mm=diameters, order=order, parent=parent, label=label, tip_seen=tip_seen))
    return made


def _fork(roots: Sequence[Root], line: int, at: int, laterals: Sequence[int]) -> tuple[int, int, list[tuple[int, int]]]:
    """Return the line in which a root continues from a point, its next point, and the lines that begin there.

    Each of the lines that begin there is returned with the index of its next point.
    """
    if not laterals:
        return line, at + 1, []
    here = roots[line].points_mm[at]
    starts = [(k, int(np.array_equal(roots[k].points_mm[0], here))) for k in laterals]
    ahead = _thickness(roots[line], at + 1)
    onward = [(k, start) for k, start in starts if _growth_cosine(roots[line], roots[k].points_mm) > 0.0]
    thickest = max(onward, key=lambda other: _thickness(roots[other[0]], 1), default=None)
    if thickest is None or ahead == 0.0 or _thickness(roots[thickest[0]], 1) < _THICKER * ahead:
        return line, at + 1, starts
    return *thickest, [(line, at + 1), *(other for other in starts if other != thickest)]


def _own_diameter(root: Root, first: int) -> float:
    """Return the diameter of a line at the point with index ``first``, mm.

    It is used as the diameter at the fork, instead of that of the parent.
    """
    return float(root.diameters_mm[min(first, len(root.diameters_mm) - 1)])


def _thickness(root: Root, first: int) -> float:
    """Return the mean diameter over the next 5 mm of a root, mm. It is 0 if the rest of the root is shorter."""
    points = root.points_mm[first:]
    if len(points) < 2:
        return 0.0
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if way[-1] < _REACH_MM:
        return 0.0
    return float(root.diameters_mm[first:][way <= _REACH_MM].mean())
