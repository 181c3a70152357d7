"""What corrections make of a result, one after another.

A state never changes, so that undoing is taking an earlier one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections import lines as roots_of
from rhizotwin.corrections.lines import Line, Lines, Piece
from rhizotwin.corrections.log import Edit
from rhizotwin.corrections.solid import Solid
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BRIDGE_MM = 0.3
"""Points of a tube that joins two roots stand this far apart."""


@dataclass(frozen=True, eq=False)
class Refitted:
    """A root as the pictures have it."""

    points_mm: Array
    """(N, 3), as many as before."""
    diameters_mm: Array
    """(N,)"""
    stays: Mask
    """(N,) points that were not fitted."""


Refit = Callable[[Lines], dict[int, Refitted]]
"""Fits roots to the pictures again."""


@dataclass(frozen=True, eq=False)
class State:
    """Roots and voxels as corrected so far."""

    lines: Lines
    gone: Mask
    """(N,) voxels that were taken away."""
    removed: Lines
    """Roots that were taken away, as they were then."""
    next_number: int
    """Of the root that the next cut makes."""
    base_mm: tuple[float, float, float] | None = None
    """Where the plant begins, if somebody marked it."""

    @property
    def pieces(self) -> list[Piece]:
        """Return all that is there of the sources."""
        return [piece for line in self.lines.values() for piece in line.pieces]

    @property
    def length_mm(self) -> float:
        """Return the total length of the roots."""
        return sum(line.length_mm for line in self.lines.values())

    def roots(self) -> tuple[Root, ...]:
        """Return the roots in the form of files, parents before children."""
        return roots_of.as_roots(self.lines)


def start(solid: Solid, roots: tuple[Root, ...]) -> State:
    """Return a result as it was reconstructed; its roots are the solid's sources, in their order."""
    lines = {
        k: Line(
            root.points_mm,
            root.diameters_mm,
            root.parent,
            (Piece(k, 0.0, solid.length_mm(k)),),
            root.tip_seen,
            root.label,
            root.diameter_sigma_mm,
            root.plant,
        )
        for k, root in enumerate(roots)
    }
    return State(lines, np.zeros(len(solid.size), bool), {}, len(lines))


def apply(state: State, edit: Edit, solid: Solid, *, refit: Refit | None = None) -> State:
    """Return the state after a correction.

    Parameters
    ----------
    solid : Solid
        Gets sources and voxels for tubes that the correction makes.
    refit : Refit or None
        Needed for "fit" alone.

    Raises
    ------
    UserError
        Where the correction cannot be done: a root that is not there, a circle of parents.
    """
    if edit.do == "delete roots":
        chosen = _there(state, edit)
        numbers = [k for root in chosen for k in (roots_of.below(state.lines, root) if edit.laterals else [root])]
        return _without(state, numbers)
    if edit.do == "restore roots":
        return _restored(state, edit)
    if edit.do in ("delete voxels", "delete box"):
        return _cleared(state, _rows(edit, solid), edit, solid)
    if edit.do == "restore voxels":
        gone = _padded(state.gone, solid)
        gone[_rows(edit, solid)] = False
        return replace(state, gone=gone)
    if edit.do == "fit":
        if refit is None:
            raise UserError("fitting again needs the pictures: give the dataset that the result was made from")
        return _refitted(state, refit(state.lines), solid)
    if edit.do == "base" and not state.lines:
        return replace(state, base_mm=_point(edit))
    one = _there(state, edit)[0]
    line = state.lines[one]
    if edit.do == "cut":
        at = _inner(line, edit)
        return replace(state, lines=roots_of.divide(state.lines, one, at, state.next_number), next_number=state.next_number + 1)
    if edit.do == "tip":
        return _tipped(state, one, edit)
    if edit.do == "base":
        return replace(state, lines=roots_of.rooted_at(state.lines, one, _point(edit)), base_mm=_point(edit))
    other = _there(state, edit)[1] if len(edit.roots) > 1 else -1
    if other < 0:
        raise UserError(f"'{edit.do}' needs two roots; {len(edit.roots)} given")
    if edit.do == "join":
        return _joined(state, one, other, solid)
    if other in roots_of.below(state.lines, one):
        raise UserError(f"root {one} cannot hang on root {other}, which hangs on it")
    return replace(state, lines=roots_of.adopted({**state.lines, one: replace(line, parent=other)}, one))


def _there(state: State, edit: Edit) -> list[int]:
    """Return the roots of an edit, which must be there."""
    lost = [root for root in edit.roots if root not in state.lines]
    if lost or not edit.roots:
        raise UserError(f"'{edit.do}': there is no root {lost[0]} now" if lost else f"'{edit.do}' names no root")
    return list(edit.roots)


def _point(edit: Edit) -> tuple[float, float, float]:
    if edit.point_mm is None:
        raise UserError(f"'{edit.do}' needs a point")
    return edit.point_mm


def _inner(line: Line, edit: Edit) -> float:
    """Return how far along a root an edit's point lies, which must not be its end."""
    at, length = line.nearest_mm(_point(edit)), line.length_mm
    if not 1e-6 < at < length - 1e-6:
        raise UserError(f"'{edit.do}': the point is an end of root {edit.roots[0]}; choose one between its ends")
    return at


def _without(state: State, numbers: list[int]) -> State:
    removed = {**state.removed, **{k: state.lines[k] for k in numbers if k in state.lines}}
    return replace(state, lines=roots_of.without(state.lines, numbers), removed=removed)


def _restored(state: State, edit: Edit) -> State:
    """Bring roots back, under their parents where these are there."""
    lost = [root for root in edit.roots if root not in state.removed]
    if lost:
        raise UserError(f"'{edit.do}': root {lost[0]} was not taken away")
    lines = {**state.lines, **{k: state.removed[k] for k in edit.roots}}
    for k in edit.roots:
        if lines[k].parent not in lines:
            lines[k] = replace(lines[k], parent=-1)
    return replace(state, lines=lines, removed={k: line for k, line in state.removed.items() if k not in edit.roots})


def _rows(edit: Edit, solid: Solid) -> NDArray[np.int64]:
    """Return the voxels of an edit."""
    if edit.box_mm is not None:
        return solid.leaves_in(*edit.box_mm)
    rows = np.concatenate([np.zeros(0, np.int64), *(np.arange(first, first + count) for first, count in edit.runs)])
    if len(rows) and rows.max() >= len(solid.size):
        raise UserError(f"'{edit.do}': there is no voxel {rows.max()}; the shape has {len(solid.size)}")
    return rows


def _padded(gone: Mask, solid: Solid) -> Mask:
    return np.concatenate([gone, np.zeros(len(solid.size) - len(gone), bool)])


def _cleared(state: State, rows: NDArray[np.int64], edit: Edit, solid: Solid) -> State:
    """Take voxels away, and what of the roots lies in them or in the edit's box."""
    gone = _padded(state.gone, solid)
    gone[rows] = True
    now = np.zeros(len(solid.size) + 1, bool)  # the last one stands for where no voxel is
    now[rows] = True

    def inside(points_mm: Array) -> Mask:
        if edit.box_mm is not None:
            return np.asarray(((points_mm >= edit.box_mm[0]) & (points_mm <= edit.box_mm[1])).all(axis=1))
        return now[solid.find(points_mm)]

    lines, lost = roots_of.outside(state.lines, inside, state.next_number)
    removed = {**state.removed, **{k: state.lines[k] for k in lost}}
    return replace(state, gone=gone, lines=lines, removed=removed, next_number=max([state.next_number, *(k + 1 for k in lines)]))


def _tipped(state: State, number: int, edit: Edit) -> State:
    """End a root at a point; laterals beyond it go with what is cut away."""
    line = state.lines[number]
    at = line.nearest_mm(_point(edit))
    if at >= line.length_mm - 1e-6:
        return replace(state, lines={**state.lines, number: replace(line, tip_seen=True)})
    at = _inner(line, edit)
    lines = roots_of.divide(state.lines, number, at, state.next_number)
    cut = _without(replace(state, lines=lines, next_number=state.next_number + 1), roots_of.below(lines, state.next_number))
    return replace(cut, lines={**cut.lines, number: replace(cut.lines[number], tip_seen=True)})


def _joined(state: State, one: int, other: int, solid: Solid) -> State:
    """Let a root go on in another, with a straight tube between them; the other's laterals are its own then."""
    if one in roots_of.below(state.lines, other)[1:]:
        raise UserError(f"root {one} cannot go on in root {other}, on which it hangs")
    first, second = state.lines[one], state.lines[other]
    end = first.points_mm[-1]
    if one == other:
        raise UserError("a root cannot go on in itself")
    if np.linalg.norm(second.points_mm[-1] - end) < np.linalg.norm(second.points_mm[0] - end):
        second = second.backward()
    between: tuple[Piece, ...] = ()
    gap_mm = float(np.linalg.norm(second.points_mm[0] - end))
    if gap_mm > 1e-6:
        count = 2 + int(gap_mm / _BRIDGE_MM)
        bridge = np.linspace(end, second.points_mm[0], count)
        diameters = np.linspace(first.diameters_mm[-1], second.diameters_mm[0], count)
        source = solid.add([(bridge, diameters)])[0]
        between = (Piece(source, 0.0, solid.length_mm(source)),)
    beyond = slice(0 if between else 1, None)
    whole = replace(
        first,
        points_mm=np.concatenate([first.points_mm, second.points_mm[beyond]]),
        diameters_mm=np.concatenate([first.diameters_mm, second.diameters_mm[beyond]]),
        sigma_mm=None if first.sigma_mm is None or second.sigma_mm is None else np.concatenate([first.sigma_mm, second.sigma_mm[beyond]]),
        pieces=(*first.pieces, *between, *second.pieces),
        tip_seen=second.tip_seen,
    )
    lines = {k: replace(line, parent=one) if line.parent == other else line for k, line in state.lines.items() if k != other} | {one: whole}
    for lateral in [k for k, line in lines.items() if line.parent == one]:
        lines = roots_of.adopted(lines, lateral)
    return replace(state, lines=lines)


def _refitted(state: State, found: dict[int, Refitted], solid: Solid) -> State:
    """Put fitted roots in the place of the old ones; what was not fitted keeps its volume."""
    changed = {number: root for number, root in found.items() if not root.stays.all()}
    runs = {number: _runs(root.stays) for number, root in changed.items()}
    made = [(number, a, b) for number in changed for a, b, stays in runs[number] if not stays]
    if not made:
        return state
    sources = solid.add([(changed[k].points_mm[a : b + 1], changed[k].diameters_mm[a : b + 1]) for k, a, b in made])
    source_of = dict(zip(made, sources, strict=True))
    lines = dict(state.lines)
    for number, root in changed.items():
        line, pieces = state.lines[number], list[Piece]()
        way = line.way_mm
        for a, b, stays in runs[number]:
            if stays:
                pieces += line.between(float(way[a]), float(way[b])).pieces
            else:
                source = source_of[number, a, b]
                pieces.append(Piece(source, 0.0, solid.length_mm(source)))
        lines[number] = replace(line, points_mm=root.points_mm, diameters_mm=root.diameters_mm, pieces=tuple(pieces), sigma_mm=None)
    return replace(state, lines=lines)


def _runs(stays: Mask) -> list[tuple[int, int, bool]]:
    """Return stretches of points (first, last, whether all between two points that stay); neighbours share a point."""
    held = stays[:-1] & stays[1:]
    edges = [0, *(np.flatnonzero(held[1:] != held[:-1]) + 1).tolist(), len(held)]
    return [(a, b, bool(held[a])) for a, b in pairwise(edges)]
