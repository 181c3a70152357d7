"""Division of a tree of centre lines into roots with orders and parents.

Where roots touch or hide each other, the traced lines are bent from one root into another. At each fork, the root
therefore continues in the line with the most similar direction and diameter beyond the junction, where the lines no
longer affect each other. Two lines that run along each other before they separate are roots of the same order. No
lateral leaves in the basal zone of its parent (Leitner et al. 2010, Plant and Soil 332:177). Points are not moved
(docs/decisions/root-tree.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.thickened_roots import SWOLLEN

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_REACH_MM = 5.0
"""Minimum length beyond a junction over which directions and diameters are compared, mm. The length is at least the
diameter of the root."""
_BASAL_MM = 2.0
"""Maximum distance between the base of a lateral and the surface of its grandparent at which the lateral is reassigned
to the grandparent, mm. Such a lateral runs along its assigned parent at first, but does not originate from it."""
_RUN_ALONG, _BEND_RAD = 0.82, 3.0
"""Two lines that separate are roots of the same order, which ran along each other, if the ratio of their diameters,
times the ratio of the parent's cross-sections before and beyond the fork, times exp(-angle / `_BEND_RAD`) is larger
than `_RUN_ALONG`. In 203 reconstructions, this corrects 10,765 of 15,885 mm with a wrong parent, and reassigns 176 of
47,774 mm with a right one (8,772 and 628 mm by limits of the angle and the ratio of diameters)."""
_UP = np.array([0.0, 0.0, 1.0])
"""Direction from which a main root comes at its base: primary roots grow downwards from the shoot."""
_AMBIGUOUS = 0.5
"""Difference of two costs (rad2) below which a root may as well continue in the other line. Of 44 forks of plants with
less, 7 were wrong, and of 497 with more, none."""
_CROWN, _RIVAL = 2.0, 0.7
"""Height of a crown, in diameters of the stem, and minimum ratio of the diameter of a line that leaves it to that of
the main root, at which either of them may be the main root. The line then has half of its cross-section. In a maize
whose crown is hidden, the ratios are 1.2 to 2.2 and the order of half of the length is wrong; in a bean, basal roots of
0.53 to 0.63 leave the right main root, and in a print a lateral of 0.55."""


@dataclass(frozen=True)
class AmbiguousFork:
    """Fork at which a root may as well continue in one of its laterals."""

    point_mm: Array
    """Position (3,), canister frame, mm."""
    length_mm: float
    """Length of the shorter of both lines, with all that grows from it, mm: its order may be wrong. In a crown, it is
    that of the largest line that may be the main root."""


@dataclass(frozen=True)
class _Step:
    """Continuation of a root at a point."""

    child: int
    limit_mm: float = 0.0
    """Diameter at which the root ends, because all lines are much thinner beyond a junction; 0 if it does not end."""
    other: int = -1
    """Child in which it may as well continue; -1 if there is none."""


@dataclass(frozen=True)
class _Way:
    """Points (N, 3) along a path from a junction, canister frame, mm, with their diameters (N,), mm."""

    points_mm: Array
    diameters_mm: Array

    def beyond(self, skip_mm: float, reach_mm: float) -> tuple[Array, float]:
        """Return the direction (3,) and the mean logarithm of the diameter of a stretch of the path.

        The stretch begins ``skip_mm`` along the path and is ``reach_mm`` long. It is shorter if the path is, and covers
        the whole path if this ends within ``skip_mm``.
        """
        way = polyline.arc_length_mm(self.points_mm)
        first = skip_mm if way[-1] > skip_mm else 0.0
        last = min(first + reach_mm, float(way[-1]))
        ends = polyline.interpolate(self.points_mm, way, np.array([first, last]))
        within = (way[1:] >= first) & (way[1:] <= last)
        diameters = self.diameters_mm[1:][within] if within.any() else np.interp([last], way, self.diameters_mm)
        return polyline.unit_vectors(ends[1:] - ends[:1])[0], float(np.log(diameters).mean())


@dataclass(frozen=True)
class _Lines:
    """Centre lines as a tree of points."""

    points_mm: Array
    """Shape (N, 3), canister frame, mm."""
    diameters_mm: Array
    """Shape (N,), mm."""
    children: list[list[int]]
    """Next points of each point."""
    onward: list[int]
    """Next point of each point on the path to a tip with the largest volume; -1 at the tips."""
    beyond_mm: Array
    """Length (N,) of all lines beyond each point, with the segment that leads to it, mm."""
    bases: list[int]
    """First points of the lines without a parent."""

    @classmethod
    def build(cls, points_mm: Array, diameters_mm: Array, above: Index, bases: list[int]) -> _Lines:
        """Connect each point with the preceding one, whose index in ``above`` (N,) is -1 if there is none."""
        children: list[list[int]] = [[] for _ in above]
        for point in np.flatnonzero(above >= 0).tolist():
            children[above[point]].append(point)
        order, volume, onward, beyond_mm = list(bases), np.zeros(len(above)), [-1] * len(above), np.zeros(len(above))
        for point in order:  # the list grows during the loop
            order += children[point]
        for point in reversed(order):
            for child in children[point]:
                step_mm = np.linalg.norm(points_mm[child] - points_mm[point])
                beyond_mm[child] += step_mm
                beyond_mm[point] += beyond_mm[child]
                more = volume[child] + step_mm * diameters_mm[child] ** 2
                if onward[point] < 0 or more > volume[point]:
                    volume[point], onward[point] = more, child
        return cls(points_mm, diameters_mm, children, onward, beyond_mm, bases)

    @classmethod
    def of_tubes(cls, tubes: Tubes) -> _Lines:
        """Return the branches of a tree of tubes."""
        above = np.full(len(tubes.radius_mm), -1)
        before, here = tubes.segments.T
        above[here] = before
        return cls.build(tubes.centre_mm, 2.0 * tubes.radius_mm, above, [int(tubes.branches[0][0])])

    @classmethod
    def join(cls, roots: Sequence[Root]) -> _Lines:
        """Connect lines to the nearest points of their parents."""
        first = np.cumsum([0, *(len(root.points_mm) for root in roots)])
        points = np.concatenate([root.points_mm for root in roots])
        above, original = np.arange(len(points)) - 1, np.arange(len(points))
        for root, begin in zip(roots, first.tolist(), strict=False):
            above[begin] = -1
            if root.parent >= 0:
                base = original[first[root.parent] + _nearest(roots[root.parent], root.points_mm[0])]
                copied = bool(np.array_equal(points[base], points[begin]))
                above[begin + copied] = base  # the copy of a point of the parent is not used
                original[begin] = base if copied else begin
        bases = [begin for root, begin in zip(roots, first.tolist(), strict=False) if root.parent < 0]
        return cls.build(points, np.concatenate([root.diameters_mm for root in roots]), above, bases)

    def ahead(self, point: int, child: int, length_mm: float) -> _Way:
        """Return the path from a point through one of its children, up to a length."""
        return self._follow([point, child], length_mm, lambda path: self.onward[path[-1]])

    def back(self, path: Sequence[int], length_mm: float) -> _Way:
        """Return the end of a path, backwards from its last point, up to a length."""
        return self._follow([path[-1]], length_mm, lambda found: path[-1 - len(found)] if len(found) < len(path) else -1)

    def _follow(self, path: list[int], length_mm: float, following: Callable[[list[int]], int]) -> _Way:
        while length_mm > 0.0 and (point := following(path)) >= 0:
            length_mm -= float(np.linalg.norm(self.points_mm[point] - self.points_mm[path[-1]]))
            path.append(point)
        return _Way(self.points_mm[path], self.diameters_mm[path])

    def divide(self, *, bulbs_end: bool) -> list[tuple[list[int], int]]:
        """Return the points of each root and the index of its parent, or -1. Parents come before children.

        The first point of a root with a parent is a point of the parent. If ``bulbs_end`` is false, a bulb continues in
        one of its roots.
        """
        found: list[tuple[list[int], int]] = []
        begun: list[tuple[list[int], int]] = [([base], -1) for base in self.bases[::-1]]
        while begun:
            path, parent = begun.pop()
            thinnest_mm = 0.0
            while self.children[path[-1]]:
                following = self.next_step(path)
                thinnest_mm = max(thinnest_mm, following.limit_mm * bulbs_end)
                ends = self.diameters_mm[following.child] < thinnest_mm
                begun += [([path[-1], child], len(found)) for child in self.children[path[-1]][::-1] if ends or child != following.child]
                if ends:
                    break
                path.append(following.child)
            found.append((path, parent))
        return found

    def find_rivals(self, path: Sequence[int]) -> dict[int, int]:
        """Return lines that may be the main root instead of a given one, because they leave its crown and are as thick.

        The keys are the first points of these lines, and the values are the points of the path that they leave.
        """
        points_mm, diameters_mm = self.points_mm[path], self.diameters_mm[path]
        way = polyline.arc_length_mm(points_mm)
        stem_mm = float(diameters_mm[way <= _REACH_MM].max())
        own = _Way(points_mm, diameters_mm).beyond(_CROWN * stem_mm, _REACH_MM)[1]
        forks = np.array(path)[way <= _CROWN * stem_mm].tolist()
        aside = {child: point for point in forks for child in self.children[point] if child not in path}
        ahead = {child: self.ahead(point, child, 0.5 * stem_mm + _REACH_MM) for child, point in aside.items()}
        return {child: aside[child] for child, way in ahead.items() if way.beyond(0.5 * stem_mm, _REACH_MM)[1] - own > np.log(_RIVAL)}

    def next_step(self, path: Sequence[int]) -> _Step:
        """Return the child of the last point in which a root with a given path continues.

        Within the junction at its base, a lateral continues in the thickest child, and a main root in one that is both
        thick and vertical.
        """
        here = path[-1]
        children = self.children[here]
        if len(children) == 1:
            return _Step(children[0])
        skip_mm = 0.5 * float(np.median(self.diameters_mm[list(path[-5:])]))
        reach_mm = max(_REACH_MM, 2.0 * skip_mm)
        back = self.back(path, skip_mm + reach_mm)
        length_mm = polyline.length_mm(back.points_mm)
        sections = [self.ahead(here, child, skip_mm + reach_mm).beyond(skip_mm, reach_mm) for child in children]
        direction, log_before = back.beyond(skip_mm, reach_mm)
        if length_mm < skip_mm:  # within the junction at its base
            log_before = max(log for _, log in sections)
            if path[0] not in self.bases:
                return _Step(children[[log for _, log in sections].index(log_before)])
            direction = _UP
        bends = [np.arccos(np.clip(-direction @ onward, -1.0, 1.0)) for onward, _ in sections]
        costs = [bend**2 + (log - log_before) ** 2 for bend, (_, log) in zip(bends, sections, strict=True)]
        best, second = np.argsort(costs, kind="stable")[:2].tolist()
        limit_mm = float(np.exp(log_before)) / SWOLLEN
        if np.exp(sections[best][1]) < limit_mm and length_mm > max(_REACH_MM, skip_mm):
            return _Step(self.onward[here], limit_mm)  # the rest of a bulb
        return _Step(children[best], other=children[second] if costs[second] - costs[best] < _AMBIGUOUS else -1)


def arrange(roots: Sequence[Root]) -> tuple[Root, ...]:
    """Return the roots with corrected bases, orders and parents. Parents come before children.

    Centre lines are unchanged, but a straight segment is added where a root continues in a lateral that began near it.
    """
    lines, made = _Lines.join(roots), list[Root]()
    line = np.repeat(np.arange(len(roots)), [len(root.points_mm) for root in roots])
    for path, parent in lines.divide(bulbs_end=True):
        diameters = lines.diameters_mm[path]
        if parent >= 0:
            diameters[0] = diameters[1]  # at the fork, not that of the parent
        begins, ends = (roots[line[point]] for point in (path[parent >= 0], path[-1]))
        points = lines.points_mm[path]
        made.append(Root(points_mm=points, diameters_mm=diameters, parent=parent, order=0, label=begins.label, tip_seen=ends.tip_seen))
    return _assign_parents(made)


def find_ambiguous_forks(roots: Sequence[Root]) -> list[AmbiguousFork]:
    """Return the forks at which arranged roots may as well continue in a lateral, that with the longest lines first."""
    lines, found = _Lines.join(roots), dict[int, AmbiguousFork]()
    above = {child: point for point, children in enumerate(lines.children) for child in children}
    first = np.cumsum([0, *(len(root.points_mm) for root in roots)])
    for root, begin, end in zip(roots, first.tolist(), first[1:].tolist(), strict=False):
        path = list(range(begin, end))
        if root.parent >= 0:  # from the point of the parent, whose copy is not used
            path = path[begin not in above :]
            path.insert(0, above[path[0]])
        for number in range(root.parent >= 0, len(path) - 1):
            point, following = path[number : number + 2]
            if len(lines.children[point]) > 1:
                step = lines.next_step(path[: number + 1])
                for other in {step.child, step.other} - {following, -1}:
                    found[other] = AmbiguousFork(lines.points_mm[point], float(lines.beyond_mm[[following, other]].min()))
        if root.parent < 0 and (rivals := lines.find_rivals(path)):
            largest = max(rivals, key=lambda rival: lines.beyond_mm[rival])
            found[largest] = AmbiguousFork(lines.points_mm[rivals[largest]], float(lines.beyond_mm[largest]))
    return sorted(found.values(), key=lambda fork: -fork.length_mm)


def divide(tubes: Tubes) -> Tubes:
    """Return the same tree with branches that continue at each fork in the line that `arrange` would choose.

    Bulbs do not end, since their tubes would then lack the rest below the last fork.
    """
    return replace(tubes, branches=tuple(np.array(path) for path, _ in _Lines.of_tubes(tubes).divide(bulbs_end=False)))


def _assign_parents(roots: Sequence[Root]) -> tuple[Root, ...]:
    """Assign roots that do not originate from their parent to the parent of that parent, and set the orders."""
    found: list[Root] = []
    for root in roots:
        parent = root.parent
        while parent >= 0 and (above := found[parent].parent) >= 0 and not _originates(root, found[parent], found[above]):
            parent = above
        found.append(replace(root, parent=parent, order=found[parent].order + 1 if parent >= 0 else 0))
    return tuple(found)


def _originates(root: Root, parent: Root, grandparent: Root) -> bool:
    """Return whether a root is a lateral of its parent.

    It is not if it begins in the parent's basal zone, or if it ran along the parent: it separates at a small angle, is
    about as thick, and the parent is thinner beyond.
    """
    away = np.linalg.norm(grandparent.points_mm - root.points_mm[0], axis=1) - grandparent.diameters_mm / 2.0
    if away.min() < _BASAL_MM:
        return False
    way, at = polyline.arc_length_mm(parent.points_mm), _nearest(parent, root.points_mm[0])
    radius_mm = 0.5 * float(parent.diameters_mm[at])
    direction, log = _Way(root.points_mm, root.diameters_mm).beyond(radius_mm, _REACH_MM)
    near = np.abs(way - way[at]) <= max(_REACH_MM, 2.0 * radius_mm)
    before, beyond = near & (way < way[at] - radius_mm), near & (way > way[at] + radius_mm)
    if not before.any() or not beyond.any():
        return True
    along = polyline.unit_vectors(np.diff(parent.points_mm[near][[0, -1]], axis=0))[0]
    thickness_mm, before_mm, beyond_mm = (float(np.median(parent.diameters_mm[part])) for part in (near, before, beyond))
    angle = float(np.arccos(np.clip(direction @ along, -1.0, 1.0)))
    return bool(np.exp(log - angle / _BEND_RAD) / thickness_mm * (before_mm / beyond_mm) ** 2 <= _RUN_ALONG)


def _nearest(root: Root, point_mm: Array) -> int:
    return int(np.argmin(np.sum((root.points_mm - point_mm) ** 2, axis=1)))
