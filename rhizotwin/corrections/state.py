"""Roots and voxels of a result after corrections.

States are immutable. Undo returns to an earlier state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections import deletions
from rhizotwin.corrections import lines as roots_of
from rhizotwin.corrections.deletions import Deletion
from rhizotwin.corrections.lines import Line, Lines, Piece
from rhizotwin.corrections.log import Edit
from rhizotwin.corrections.solid import Solid
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BRIDGE_MM = 0.3
"""Maximum spacing, mm, of the points on a straight tube that joins two roots."""


@dataclass(frozen=True, eq=False)
class Refitted:
    """Centre line and diameters of a root after it was fitted to the pictures."""

    points_mm: Array
    """Points (N, 3) of the centre line, mm. Their number is the same as before the fit."""
    diameters_mm: Array
    """Diameter at each point (N,), mm."""
    stays: Mask
    """Mask (N,) of the points that were excluded from the fit."""


Refit = Callable[[Lines], dict[int, Refitted]]
"""Type of a function that fits all roots to the pictures and returns the fitted roots, keyed by number."""


@dataclass(frozen=True, eq=False)
class State:
    """Roots and voxels after corrections."""

    lines: Lines
    """Remaining roots, keyed by number."""
    gone: Mask
    """Mask (N,) of the deleted voxels. N includes the voxels that corrections added."""
    next_number: int
    """Number that will be assigned to the next new root."""
    sources: int
    """Number of sources, including the tubes that corrections added."""
    base_mm: tuple[float, float, float] | None = None
    """Base of the plant in the canister frame, mm. It is None if it was not corrected."""
    deletions: tuple[Deletion, ...] = ()
    """Deletions that were not restored, oldest first."""

    @property
    def removed(self) -> dict[int, Line]:
        """Return the deleted roots as they were before the deletion, keyed by number."""
        return {k: line for deletion in self.deletions for k, line in deletion.removed.items()}

    @property
    def pieces(self) -> list[Piece]:
        """Return the parts of all sources that remain after the corrections."""
        return [piece for line in self.lines.values() for piece in line.pieces]

    @property
    def length_mm(self) -> float:
        """Return the total length of the roots, mm."""
        return sum(line.length_mm for line in self.lines.values())

    def roots(self) -> tuple[Root, ...]:
        """Convert the remaining lines to roots. Parents are sorted before their children."""
        return roots_of.as_roots(self.lines)


def start(solid: Solid, roots: tuple[Root, ...]) -> State:
    """Return the state of a result before corrections. Root k consists of source k of ``solid``."""
    lines = roots_of.as_lines(roots)
    return State(lines, np.zeros(len(solid.size), bool), len(lines), len(solid.sources))


def apply(state: State, edit: Edit, solid: Solid, *, refit: Refit | None = None) -> State:
    """Apply a correction and return the new state.

    Parameters
    ----------
    state : State
        State before the correction.
    edit : Edit
        Correction to apply.
    solid : Solid
        Voxels and sources. Tubes that the correction creates are added as sources.
    refit : Refit or None
        Function that refits the roots, required by the correction "fit".

    Raises
    ------
    UserError
        If a root is missing, or a root would become its own ancestor.
    """
    if edit.do == "delete roots":
        chosen = _check_roots(state, edit)
        numbers = [k for root in chosen for k in (roots_of.descendants(state.lines, root) if edit.laterals else [root])]
        return _record(state, replace(state, lines=roots_of.remove(state.lines, numbers)), {k: state.lines[k] for k in numbers})
    if edit.do == "restore roots":
        return _restore_roots(state, edit)
    if edit.do == "restore deletion":
        return _restore_deletion(state)
    if edit.do in ("delete voxels", "delete box"):
        return _delete_voxels(state, _rows(edit, solid), edit, solid)
    if edit.do == "restore voxels":
        gone = state.gone.copy()
        gone[_rows(edit, solid)] = False
        return replace(state, gone=gone)
    if edit.do == "fit":
        if refit is None:
            raise UserError("refitting needs the pictures; specify the dataset of the result")
        return _replace_refitted(state, refit(state.lines), solid)
    if edit.do == "base" and not state.lines:
        return replace(state, base_mm=_point(edit))
    one = _check_roots(state, edit)[0]
    line = state.lines[one]
    if edit.do == "cut":
        at = _inner_arc_length(line, edit)
        return replace(state, lines=roots_of.divide(state.lines, one, at, state.next_number), next_number=state.next_number + 1)
    if edit.do == "tip":
        return _set_tip(state, one, edit)
    if edit.do == "base":
        return replace(state, lines=roots_of.reroot(state.lines, one, _point(edit)), base_mm=_point(edit))
    other = _check_roots(state, edit)[1] if len(edit.roots) > 1 else -1
    if other < 0:
        raise UserError(f"correction '{edit.do}' needs two roots, but {len(edit.roots)} was given")
    if edit.do == "join":
        return _join(state, one, other, solid)
    if other in roots_of.descendants(state.lines, one):
        raise UserError(f"root {one} cannot become a lateral of root {other}, which is its descendant")
    return replace(state, lines=roots_of.inherit_plant({**state.lines, one: replace(line, parent=other)}, one))


def _check_roots(state: State, edit: Edit) -> list[int]:
    """Return the numbers of the roots to correct. Raise an error if a root does not exist."""
    lost = [root for root in edit.roots if root not in state.lines]
    if lost or not edit.roots:
        raise UserError(f"correction '{edit.do}': root {lost[0]} does not exist" if lost else f"correction '{edit.do}' needs a root")
    return list(edit.roots)


def _point(edit: Edit) -> tuple[float, float, float]:
    if edit.point_mm is None:
        raise UserError(f"correction '{edit.do}' needs a point")
    return edit.point_mm


def _inner_arc_length(line: Line, edit: Edit) -> float:
    """Return the arc length, in mm, of the point at which a root is corrected.

    Raise an error if the point is an end of the root.
    """
    at = line.nearest_mm(_point(edit))
    length = line.length_mm
    if not 1e-6 < at < length - 1e-6:
        raise UserError(f"correction '{edit.do}': the point is an end of root {edit.roots[0]}; choose a point between the two ends")
    return at


def _restore_roots(state: State, edit: Edit) -> State:
    """Restore deleted roots. Roots whose parents do not exist become roots without a parent."""
    removed = state.removed
    lost = [root for root in edit.roots if root not in removed]
    if lost:
        raise UserError(f"correction '{edit.do}': root {lost[0]} cannot be restored, because it was not deleted")
    lines = {**state.lines, **{k: removed[k] for k in edit.roots}}
    for k in edit.roots:
        if lines[k].parent not in lines:
            lines[k] = replace(lines[k], parent=-1)
    waiting = list[Deletion]()
    for deletion in state.deletions:
        left = {k: line for k, line in deletion.removed.items() if k not in edit.roots}
        if len(left) < len(deletion.removed):
            lines = deletions.reattach(lines, deletion)
        if left or len(deletion.rows) or not deletion.removed:
            waiting.append(replace(deletion, removed=left))
    return replace(state, lines=lines, deletions=tuple(waiting))


def _record(before: State, after: State, removed: Lines) -> State:
    """Add a deletion to the state after it, so that it can be restored."""
    made = Deletion(
        before={k: line for k, line in before.lines.items() if after.lines.get(k) is not line},
        after={k: line for k, line in after.lines.items() if before.lines.get(k) is not line},
        removed=removed,
        rows=np.flatnonzero(after.gone & ~before.gone),
    )
    return replace(after, deletions=(*after.deletions, made)) if made.before or len(made.rows) else after


def _restore_deletion(state: State) -> State:
    """Restore the last deletion that was not restored."""
    if not state.deletions:
        raise UserError("there are no deleted roots or voxels to restore")
    last = state.deletions[-1]
    gone = state.gone.copy()
    gone[last.rows] = False
    return replace(state, lines=deletions.restore(state.lines, state.removed, last), gone=gone, deletions=state.deletions[:-1])


def _rows(edit: Edit, solid: Solid) -> NDArray[np.int64]:
    """Return the row numbers of the voxels to correct."""
    if edit.box_mm is not None:
        return solid.leaves_in(*edit.box_mm)
    chosen = np.zeros(len(solid.size), bool)
    for first, count in edit.runs:
        if first + count > len(chosen):
            raise UserError(f"correction '{edit.do}': voxel {first + count - 1} does not exist; the shape has {len(chosen)} voxels")
        chosen[first : first + count] = True
    return np.flatnonzero(chosen)


def resize(state: State, solid: Solid) -> State:
    """Extend the state to all sources and voxels of a solid."""
    added = np.zeros(len(solid.size) - len(state.gone), bool)
    return replace(state, gone=np.concatenate([state.gone, added]), sources=len(solid.sources))


def _delete_voxels(state: State, rows: NDArray[np.int64], edit: Edit, solid: Solid) -> State:
    """Delete voxels and the parts of roots that lie inside them.

    If the correction has a box, the parts of roots inside the box are deleted.
    """
    gone = state.gone.copy()
    gone[rows] = True
    now = np.zeros(len(solid.size) + 1, bool)  # the last entry represents points outside all voxels
    now[rows] = True

    def inside(points_mm: Array) -> Mask:
        if edit.box_mm is not None:
            return np.asarray(((points_mm >= edit.box_mm[0]) & (points_mm <= edit.box_mm[1])).all(axis=1))
        return now[solid.find(points_mm)]

    lines, lost = roots_of.remove_inside(state.lines, inside, state.next_number)
    after = replace(state, gone=gone, lines=lines, next_number=max([state.next_number, *(k + 1 for k in lines)]))
    return _record(state, after, {k: state.lines[k] for k in lost})


def _set_tip(state: State, number: int, edit: Edit) -> State:
    """Set the tip of a root at a point. The part of the root beyond this point is deleted with its laterals."""
    line = state.lines[number]
    at = line.nearest_mm(_point(edit))
    if at >= line.length_mm - 1e-6:
        return replace(state, lines={**state.lines, number: replace(line, tip_seen=True)})
    at = _inner_arc_length(line, edit)
    divided = roots_of.divide(state.lines, number, at, state.next_number)
    beyond = {k: divided[k] for k in roots_of.descendants(divided, state.next_number)}
    kept = {k: line for k, line in divided.items() if k not in beyond}
    kept[number] = replace(kept[number], tip_seen=True)
    return _record(state, replace(state, lines=kept, next_number=state.next_number + 1), beyond)


def _join(state: State, one: int, other: int, solid: Solid) -> State:
    """Append root ``other`` with its laterals to root ``one``.

    A gap between the two roots is filled with a straight tube.
    """
    if one in roots_of.descendants(state.lines, other)[1:]:
        raise UserError(f"root {one} cannot be joined to root {other}, which is its ancestor")
    first, second = state.lines[one], state.lines[other]
    end = first.points_mm[-1]
    if one == other:
        raise UserError("a root cannot be joined to itself")
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
        lines = roots_of.inherit_plant(lines, lateral)
    return replace(resize(state, solid), lines=lines)


def _replace_refitted(state: State, found: dict[int, Refitted], solid: Solid) -> State:
    """Replace the centre lines and diameters of roots by the fitted ones.

    Parts that were excluded from the fit keep their volume.
    """
    changed = {number: root for number, root in found.items() if not root.stays.all()}
    runs = {number: _runs(root.stays) for number, root in changed.items()}
    made = [(number, a, b) for number in changed for a, b, stays in runs[number] if not stays]
    if not made:
        return state
    sources = solid.add([(changed[k].points_mm[a : b + 1], changed[k].diameters_mm[a : b + 1]) for k, a, b in made])
    source_of = dict(zip(made, sources, strict=True))
    lines = dict(state.lines)
    for number, root in changed.items():
        line = state.lines[number]
        pieces = list[Piece]()
        way = line.way_mm
        for a, b, stays in runs[number]:
            if stays:
                pieces += line.between(float(way[a]), float(way[b])).pieces
            else:
                source = source_of[number, a, b]
                pieces.append(Piece(source, 0.0, solid.length_mm(source)))
        lines[number] = replace(line, points_mm=root.points_mm, diameters_mm=root.diameters_mm, pieces=tuple(pieces), sigma_mm=None)
    return replace(resize(state, solid), lines=lines)


def _runs(stays: Mask) -> list[tuple[int, int, bool]]:
    """Divide points into runs.

    A run consists of the index of its first point, the index of its last point, and whether it was excluded from the
    fit. Adjacent runs share a point.
    """
    held = stays[:-1] & stays[1:]
    edges = [0, *(np.flatnonzero(held[1:] != held[:-1]) + 1).tolist(), len(held)]
    return [(a, b, bool(held[a])) for a, b in pairwise(edges)]
