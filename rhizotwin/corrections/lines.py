"""Centre lines of roots, and functions that cut lines, remove parts of them, or move the base of the plant.

Lines are immutable. Each correction returns a new dictionary of lines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Lines = Mapping[int, "Line"]


@dataclass(frozen=True)
class Piece:
    """Interval of arc length on a source.

    A source is a root of the uncorrected result, or a tube added by a correction.
    """

    source: int
    """Index of the source in `Solid.sources`."""
    begin_mm: float
    """Arc length at the beginning of the interval, mm."""
    end_mm: float
    """Arc length at the end of the interval, mm. It is smaller than ``begin_mm`` if the direction is reversed."""

    @property
    def length_mm(self) -> float:
        """Return the length of the interval, mm."""
        return abs(self.end_mm - self.begin_mm)

    def between(self, begin_mm: float, end_mm: float) -> Piece:
        """Return the part of the interval between two distances from its beginning. The distances are in mm."""
        sign = 1.0 if self.end_mm >= self.begin_mm else -1.0
        return Piece(self.source, self.begin_mm + sign * begin_mm, self.begin_mm + sign * end_mm)


@dataclass(frozen=True, eq=False)
class Line:
    """Root that can be corrected, with its centre line, diameters and place in the root tree."""

    points_mm: Array
    """Points (N, 3) of the centre line from base to tip in the canister frame, mm."""
    diameters_mm: Array
    """Diameter at each point (N,), mm."""
    parent: int
    """Number of the parent root. It is -1 if the root has no parent."""
    pieces: tuple[Piece, ...]
    """Parts of sources that make up this root, from base to tip."""
    tip_seen: bool = True
    """Whether the tip of the root is visible in the pictures."""
    label: str = ""
    sigma_mm: Array | None = None
    """Standard deviation of the diameter at each point (N,), mm. It is None if it is unknown."""
    plant: str = ""
    """Name of the plant. It is empty if the scan has a single plant."""

    @property
    def way_mm(self) -> Array:
        """Return the arc length (N,) from the base to each point, mm."""
        return polyline.arc_length_mm(self.points_mm)

    @property
    def length_mm(self) -> float:
        """Return the length of the centre line, mm."""
        return polyline.length_mm(self.points_mm)

    def nearest_mm(self, point_mm: Sequence[float]) -> float:
        """Return the arc length, in mm, of the point on the centre line that is nearest to ``point_mm``."""
        begin = self.points_mm[:-1]
        step = np.diff(self.points_mm, axis=0)
        square = np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
        share = np.clip(np.einsum("ij,ij->i", np.asarray(point_mm) - begin, step) / square, 0.0, 1.0)
        away = np.linalg.norm(begin + share[:, None] * step - np.asarray(point_mm), axis=1)
        best = int(away.argmin())
        return float(self.way_mm[best] + share[best] * np.sqrt(square[best]))

    def between(self, begin_mm: float, end_mm: float) -> Line:
        """Return the part of the root between two distances from its base.

        Distances are measured along the centre line, in mm.
        """
        way = self.way_mm
        inner = way[(way > begin_mm + 1e-9) & (way < end_mm - 1e-9)]
        at = np.concatenate([[begin_mm], inner, [end_mm]])
        points = polyline.interpolate(self.points_mm, way, at)
        pieces = []
        before = 0.0
        for piece in self.pieces:
            low = max(begin_mm - before, 0.0)
            high = min(end_mm - before, piece.length_mm)
            if high > low:
                pieces.append(piece.between(low, high))
            before += piece.length_mm
        sigma = None if self.sigma_mm is None else np.interp(at, way, self.sigma_mm)
        return replace(self, points_mm=points, diameters_mm=np.interp(at, way, self.diameters_mm), pieces=tuple(pieces), sigma_mm=sigma)

    def stretches(self, chosen: Mask) -> list[tuple[int, int]]:
        """Return the runs of at least two consecutive points that a mask (N,) selects.

        A run consists of the indices of its first and last point.
        """
        rows = np.flatnonzero(chosen)
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        return [(int(run[0]), int(run[-1])) for run in runs if len(run) > 1]

    def backward(self) -> Line:
        """Return the root with its points in reversed order, so that base and tip are exchanged."""
        pieces = tuple(Piece(piece.source, piece.end_mm, piece.begin_mm) for piece in reversed(self.pieces))
        sigma = None if self.sigma_mm is None else self.sigma_mm[::-1]
        return replace(self, points_mm=self.points_mm[::-1], diameters_mm=self.diameters_mm[::-1], pieces=pieces, sigma_mm=sigma)


def descendants(lines: Lines, number: int) -> list[int]:
    """Return the numbers of a root and all its descendants, the root itself first."""
    found = list[int]()
    waiting = [number]
    while waiting:
        one = waiting.pop()
        found.append(one)
        waiting += [k for k, line in lines.items() if line.parent == one]
    return found


def inherit_plant(lines: Lines, number: int) -> dict[int, Line]:
    """Assign a root and its descendants to the plant of the root's parent."""
    plant = lines[lines[number].parent].plant
    return {**lines, **{k: replace(lines[k], plant=plant) for k in descendants(lines, number)}}


def remove(lines: Lines, numbers: Sequence[int]) -> dict[int, Line]:
    """Remove roots and attach their laterals to the nearest remaining ancestor."""
    gone = set(numbers)
    kept = {}
    for number, line in lines.items():
        if number in gone:
            continue
        parent = line.parent
        while parent in gone:
            parent = lines[parent].parent
        kept[number] = line if parent == line.parent else replace(line, parent=parent)
    return kept


def divide(lines: Lines, number: int, at_mm: float, new: int) -> dict[int, Line]:
    """Cut a root in two. The part beyond the cut becomes root ``new`` and keeps its laterals.

    Parameters
    ----------
    lines : Lines
        All roots by number.
    number, new : int
        Number of the root to cut, and number of the new root.
    at_mm : float
        Distance of the cut from the base along the centre line, mm.

    Returns
    -------
    dict of Line
        All roots by number, after the cut.
    """
    line = lines[number]
    changed = dict(lines)
    changed[number] = replace(line.between(0.0, at_mm), tip_seen=False)
    changed[new] = replace(line.between(at_mm, line.length_mm), parent=number)
    for k, other in lines.items():
        if other.parent == number and line.nearest_mm(other.points_mm[0]) > at_mm:
            changed[k] = replace(other, parent=new)
    return changed


def remove_inside(lines: Lines, inside: Callable[[Array], Mask], new: int) -> tuple[dict[int, Line], list[int]]:
    """Remove the parts of roots that lie inside a region.

    Parameters
    ----------
    inside : callable
        Function that returns a mask (N,) of the points (N, 3), mm, inside the region.
    new : int
        Number of the first new root. A root with remaining parts on both sides of the region is divided.

    Returns
    -------
    lines : dict of Line
        Remaining roots by number.
    gone : list of int
        Numbers of roots that lay completely inside the region.
    """
    changed = dict(lines)
    gone = list[int]()
    if not lines:
        return changed, gone
    ends = np.cumsum([len(line.points_mm) for line in lines.values()])[:-1]
    of_all = inside(
        np.concatenate([line.points_mm for line in lines.values()])
    )  # one call for all roots, because each call may sort all voxels
    for (number, line), within in zip(lines.items(), np.split(of_all, ends), strict=True):
        if not within.any():
            continue
        way = line.way_mm
        stretches = line.stretches(~within)
        if not stretches:
            gone.append(number)
            continue
        for place, (first, last) in enumerate(stretches):
            part = line.between(float(way[first]), float(way[last]))
            part = replace(part, tip_seen=line.tip_seen and last == len(way) - 1)
            if place == 0:
                changed[number] = part
            else:
                changed[new] = replace(part, parent=number)
                new += 1
    return remove(changed, gone), gone


def reroot(lines: Lines, number: int, point_mm: Sequence[float]) -> dict[int, Line]:
    """Make one end of a root the base of the plant.

    The end that is nearer to ``point_mm`` is chosen. The root then has no parent, and its former ancestors become its
    laterals.
    """
    changed = dict(lines)
    line = lines[number]
    if line.nearest_mm(point_mm) > line.length_mm / 2.0:
        line = line.backward()
    above = line.parent
    child = number
    changed[number] = replace(line, parent=-1)
    while above >= 0:
        parent = lines[above]
        at = changed[child].points_mm
        turned = parent.backward() if _distance_mm(parent.points_mm[-1], at) < _distance_mm(parent.points_mm[0], at) else parent
        changed[above] = replace(turned, parent=child)
        child = above
        above = parent.parent
    return changed


def _distance_mm(point_mm: Array, line_mm: Array) -> float:
    return float(np.linalg.norm(line_mm - point_mm, axis=1).min())


def as_lines(roots: Sequence[Root]) -> dict[int, Line]:
    """Convert roots to lines, keyed by number. Line k consists of a single piece, which is the whole of root k."""
    return {
        k: Line(
            root.points_mm,
            root.diameters_mm,
            root.parent,
            (Piece(k, 0.0, polyline.length_mm(root.points_mm)),),
            root.tip_seen,
            root.label,
            root.diameter_sigma_mm,
            root.plant,
        )
        for k, root in enumerate(roots)
    }


def as_roots(lines: Lines) -> tuple[Root, ...]:
    """Convert lines to roots. Parents are sorted before their children."""
    placed = dict[int, int]()
    roots = list[Root]()
    waiting = sorted((number for number, line in lines.items() if line.parent not in lines), reverse=True)
    while waiting:
        number = waiting.pop()
        line = lines[number]
        parent = placed.get(line.parent, -1)
        placed[number] = len(roots)
        order = roots[parent].order + 1 if parent >= 0 else 0
        roots.append(
            Root(
                points_mm=line.points_mm,
                diameters_mm=line.diameters_mm,
                order=order,
                parent=parent,
                label=line.label,
                tip_seen=line.tip_seen,
                diameter_sigma_mm=line.sigma_mm,
                plant=line.plant,
            )
        )
        waiting += sorted((k for k, other in lines.items() if other.parent == number), reverse=True)
    return tuple(roots)
