"""Mend the tree of branches where the tracing went astray: roots that touch each other are told apart by their courses.

Where two roots touch, the easiest path to the top may change from one to the other. What is left of the first is then traced as a branch
of its own: it ends in the middle of nowhere beside the other, or begins there. Roots are smooth and few: of all ways to connect the
pieces that meet the one is taken that costs least, where a bend costs the square of its angle (and what else speaks against it, see
`_cost`), and every branch costs as much as a bend of one radian.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots import turning
from rhizotwin.recon.tubes.tubes import COURSE_NODES, Index, Tubes, above, hanging_order

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REACH_MM = 4.0
"""Pieces farther apart than this do not meet."""
_GAP_MM, _MISS_MM = 4.0, 0.5
"""A gap this long, or a jump this far to the side, speaks against a connection as much as a bend of one radian does."""
_OVERLAP_MM = 0.6
"""Pieces may overlap by a node's distance: where roots touch, their ends are uncertain."""
_FRAYED_NODES, _FRAYED = 3, 0.1
"""Ends wander where roots touch: so many nodes may be left out where pieces are joined, each at this cost."""
_BESIDE_MM, _BESIDE_NODES = 0.7, 9
"""A beginning of at most so many nodes that runs so near another branch is a second path along the same root."""
_BRANCH, _DOUBTFUL = 1.0, 2.0
"""What a branch costs, and what one that ends where no root ends costs more."""
_GAIN = 0.1
"""Changes that make the tree cheaper by less are left."""
_ROUNDS = 8
"""Joining may bring other ends together; it ends before."""


@dataclass(frozen=True)
class _Courses:
    """Where the branches come from and go to at each of their own nodes."""

    centre: Array
    """(N, 3)"""
    arriving: Array
    """(N, 3) unit vectors from the nodes before, towards the tip."""
    leaving: Array
    """(N, 3) unit vectors to the nodes behind."""
    log_before: Array
    """(N,) logarithm of the radius of the nodes before."""
    log_after: Array
    owner: Index
    """(N,) branch."""
    place: Index
    """(N,) number of the node in its branch."""


def mend(tubes: Tubes, doubtful: Mask | None = None) -> tuple[Tubes, Mask]:
    """Connect the pieces of the tree so that it is as cheap as can be; nodes stay where they are, but second paths are dropped.

    Changes that are tried: a tip goes on in a branch that begins there; two tips meet, and one of their branches is turned round; a tip
    takes over what follows of a branch that it runs into, of which what came before ends there, or goes on in a third that begins there,
    or is dropped because it runs beside the first; a branch goes on in its child, and what followed becomes the child. Whose lateral a
    root is, `hierarchy` settles at the end.

    Parameters
    ----------
    doubtful : (N,) nodes of ends whose tips are likely none: such an end is worth more if it goes on.

    Returns
    -------
    tubes : connected.
    kept : (N,) the nodes that are left.
    """
    doubt = np.zeros(len(tubes.centre_mm), bool) if doubtful is None else doubtful
    branches = turning.rightly_turned(tubes, list(tubes.branches))
    for _ in range(_ROUNDS):
        courses = _courses(tubes, branches)
        worth = _worth(courses, branches, doubt)
        changes = sorted(_meetings(courses, branches, worth) + _takeovers(courses, branches, worth) + _exchanges(courses, branches))
        touched: set[int] = set()
        owner = courses.owner.copy()
        for _, end, node, third, kind in changes:
            those = {int(courses.owner[end]), int(courses.owner[node])} | ({third} if third >= 0 else set())
            if touched & those:
                continue
            tried = _changed(courses, branches, end, node, third, kind)
            now = _owner_now(owner, branches, tried, those)
            if all(above(tried, now, k)[-1] == 0 for k in those if tried[k] is not None):
                branches, owner = tried, now
                touched |= those
        if not touched:
            break
    ordered = _parents_first(branches, len(tubes.centre_mm))
    used = np.zeros(len(tubes.centre_mm), bool)
    used[np.concatenate(ordered)] = True
    return Tubes(tubes.centre_mm, tubes.radius_mm, ordered).keep(used), used


def _worth(courses: _Courses, branches: list[Index | None], doubtful: Mask) -> Array:
    """Return what it is worth (N,) that the branch that owns a node does not end."""
    ends = np.array([nodes is not None and bool(doubtful[nodes[-1]]) for nodes in branches])
    return np.where(ends[courses.owner], _BRANCH + _DOUBTFUL, _BRANCH)


def _courses(tubes: Tubes, branches: list[Index | None]) -> _Courses:
    """Find the courses of branches."""
    count, centre = len(tubes.centre_mm), tubes.centre_mm
    log_radius = np.log(tubes.radius_mm)
    arriving, leaving = np.zeros((count, 3)), np.zeros((count, 3))
    before, after = np.zeros(count), np.zeros(count)
    owner, place = np.full(count, -1), np.zeros(count, np.int64)
    for k, nodes in enumerate(branches):
        if nodes is None:
            continue
        number = np.arange(len(nodes))
        first, last = np.maximum(number - COURSE_NODES, 0), np.minimum(number + COURSE_NODES, len(nodes) - 1)
        own = number if k == 0 else number[1:]
        arriving[nodes[own]] = (centre[nodes] - centre[nodes[first]])[own]
        leaving[nodes[own]] = (centre[nodes[last]] - centre[nodes])[own]
        total = np.concatenate([[0.0], np.cumsum(log_radius[nodes if k == 0 else np.concatenate([nodes[1:2], nodes[1:]])])])
        before[nodes[own]] = ((total[number + 1] - total[first]) / (number + 1 - first))[own]
        after[nodes[own]] = ((total[last + 1] - total[number]) / (last + 1 - number))[own]
        owner[nodes[own]], place[nodes[own]] = k, own
    return _Courses(centre, _unit(arriving), _unit(leaving), before, after, owner, place)


def _cost(way: Array, arriving: Array, leaving: Array, log_ratio: Array) -> Array:
    """Return what connecting pieces (M,) costs, infinite where one does not follow the other.

    Parameters
    ----------
    way : (M, 3) from the end of one to the beginning of the other.
    log_ratio : (M,) of their radii: roots as thick as the other go on in each other sooner.
    """
    middle = _unit(arriving + leaving)
    along = (way * middle).sum(axis=1)
    miss = np.linalg.norm(way - along[:, None] * middle, axis=1)
    bend = np.arccos(np.clip((arriving * leaving).sum(axis=1), -1.0, 1.0))
    gap = np.maximum(along - _OVERLAP_MM, 0.0)
    cost = bend**2 + (miss / _MISS_MM) ** 2 + (gap / _GAP_MM) ** 2 + log_ratio**2
    return np.asarray(np.where(along > -_OVERLAP_MM, cost, np.inf))


class _Kind(IntEnum):
    """How the branch that owns the node of a change is treated."""

    CUT = 0
    TURNED = 1
    EXCHANGED = 2
    SPLICED = 3


_Change = tuple[float, int, int, int, _Kind]
"""Gain (negative), the node where a branch ends, that where it goes on, the branch that the interrupted one goes on in (or -1), and how."""


def _meetings(courses: _Courses, branches: list[Index | None], worth: Array) -> list[_Change]:
    """Return the tips that go on in a branch that begins near, and the tips that meet; ends may be frayed."""
    tips, tip_fray = _ends(courses, branches, last=True)
    starts, start_fray = _ends(courses, branches, last=False)
    found: list[_Change] = []
    for turned, (ends, fray) in enumerate(((starts, start_fray), (tips, tip_fray))):
        pairs = _pairs(courses.centre, tips, ends)
        a, b = tips[pairs[:, 0]], ends[pairs[:, 1]]
        cost = _FRAYED * (tip_fray[pairs[:, 0]] + fray[pairs[:, 1]]) + _cost(
            courses.centre[b] - courses.centre[a],
            courses.arriving[a],
            -courses.arriving[b] if turned else courses.leaving[b],
            courses.log_before[a] - (courses.log_before[b] if turned else courses.log_after[b]),
        )
        gain = cost - (np.maximum(worth[a], worth[b]) if turned else worth[a])
        good = (gain < -_GAIN) & (courses.owner[a] != courses.owner[b]) & (courses.owner[b] > 0)
        found += [
            (float(g), int(end), int(node), -1, _Kind.TURNED if turned else _Kind.SPLICED)
            for g, end, node in zip(gain[good], a[good], b[good], strict=True)
        ]
    return found


def _ends(courses: _Courses, branches: list[Index | None], *, last: bool) -> tuple[Index, Index]:
    """Return the nodes (M,) at which branches may end (or begin), and how many nodes (M,) without laterals are left out there."""
    bearing = np.zeros(len(courses.centre), bool)
    bearing[[nodes[0] for k, nodes in enumerate(branches) if nodes is not None and k > 0]] = True
    ends: list[int] = []
    fray: list[int] = []
    for k, nodes in enumerate(branches):
        if nodes is None or (k > 0 and len(nodes) < 2):
            continue
        own = nodes[:0:-1] if last else nodes[1:]
        if not len(own):  # the first branch may be a single node
            own = nodes
        for out in range(max(1, min(_FRAYED_NODES + 1, len(own) - COURSE_NODES))):
            ends.append(int(own[out]))
            fray.append(out)
            if bearing[own[out]]:
                break
    return np.array(ends, np.int64), np.array(fray, np.int64)


def _takeovers(courses: _Courses, branches: list[Index | None], worth: Array) -> list[_Change]:
    """Return the tips that take over what follows of a branch that they run into."""
    tips, fray = _ends(courses, branches, last=True)
    inner = np.concatenate([nodes[2 + (k == 0) : -1] for k, nodes in enumerate(branches) if nodes is not None])
    previous = np.concatenate([nodes[1 + (k == 0) : -2] for k, nodes in enumerate(branches) if nodes is not None])
    if not len(inner):
        return []
    centre, owner = courses.centre, courses.owner
    bend = np.arccos(np.clip((courses.arriving[previous] * courses.leaving[inner]).sum(axis=1), -1.0, 1.0))
    held = bend**2 + (courses.log_before[previous] - courses.log_after[inner]) ** 2
    pairs = _pairs(centre, tips, inner)
    a, at = tips[pairs[:, 0]], pairs[:, 1]
    b = inner[at]
    cost = _cost(centre[b] - centre[a], courses.arriving[a], courses.leaving[b], courses.log_before[a] - courses.log_after[b]) - held[at]
    cost += _FRAYED * fray[pairs[:, 0]]
    good = (cost < worth[a] - _GAIN) & (owner[a] != owner[b])
    a, b, at, cost = a[good], b[good], at[good], cost[good]
    rest = _continuations(courses, branches, np.unique(previous[at]))
    found: list[_Change] = []
    for c, end, node, number in zip(cost, a, b, at, strict=True):
        first = int(owner[end])
        if _is_second_path(courses, branches, first, int(node)):
            found.append((float(c - worth[end]), int(end), int(node), -1, _Kind.SPLICED))
            continue
        best, third = min(
            ((more, k) for more, k in rest.get(int(previous[number]), []) if k not in (first, owner[node])), default=(0.0, -1)
        )
        if third >= 0:
            best -= worth[end] - _BRANCH
        if c + best < -_GAIN:
            found.append((float(c + best), int(end), int(node), third, _Kind.CUT))
    return found


def _is_second_path(courses: _Courses, branches: list[Index | None], first: int, node: int) -> bool:
    """Tell whether the branch that owns a node is, up to there, a second path along the root that the first branch follows."""
    second, place = int(courses.owner[node]), int(courses.place[node])
    line, beside = branches[first], branches[second]
    assert line is not None
    assert beside is not None
    if second == 0 or place > _BESIDE_NODES:
        return False
    return bool(cKDTree(courses.centre[line]).query(courses.centre[beside[1:place]])[0].max() < _BESIDE_MM)


def _exchanges(courses: _Courses, branches: list[Index | None]) -> list[_Change]:
    """Return the branches that go on in a child of theirs rather than in what follows of their own."""
    found: list[_Change] = []
    for k, line in enumerate(branches):
        if line is None or k == 0 or len(line) <= COURSE_NODES:
            continue
        parent = branches[int(courses.owner[line[0]])]
        place = int(courses.place[line[0]])
        assert parent is not None
        if place < 2 or place + COURSE_NODES >= len(parent):
            continue
        here, ways = line[[0, 0]], np.array([line[1], parent[place + 1]])
        cost = _cost(
            courses.centre[ways] - courses.centre[here],
            courses.arriving[here],
            courses.leaving[ways],
            courses.log_before[here] - courses.log_after[ways],
        )
        if cost[0] - cost[1] < -_GAIN:
            found.append((float(cost[0] - cost[1]), int(line[1]), int(parent[place]), -1, _Kind.EXCHANGED))
    return found


def _continuations(courses: _Courses, branches: list[Index | None], nodes: Index) -> dict[int, list[tuple[float, int]]]:
    """Return, for some nodes, the branches that begin near in which a root that ends there would go on, with the (negative) cost."""
    starts = np.array([line[1] for k, line in enumerate(branches) if line is not None and k > 0 and len(line) > 2], np.int64)
    if not len(starts):
        return {}
    pairs = _pairs(courses.centre, nodes, starts)
    a, b = nodes[pairs[:, 0]], starts[pairs[:, 1]]
    cost = _cost(
        courses.centre[b] - courses.centre[a], courses.arriving[a], courses.leaving[b], courses.log_before[a] - courses.log_after[b]
    )
    found: dict[int, list[tuple[float, int]]] = {}
    for c, node, branch in zip(cost - _BRANCH, a, courses.owner[b], strict=True):
        if c < 0.0:
            found.setdefault(int(node), []).append((float(c), int(branch)))
    return found


def _pairs(centre: Array, first: Index, second: Index) -> Index:
    """Return pairs (M, 2) of numbers of nodes of two lists that are near each other."""
    near = cKDTree(centre[first]).sparse_distance_matrix(cKDTree(centre[second]), _REACH_MM, output_type="ndarray")
    pairs = np.stack([near["i"], near["j"]], axis=1)[np.lexsort((near["j"], near["i"]))]
    return pairs[first[pairs[:, 0]] != second[pairs[:, 1]]]


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return unit


def _changed(courses: _Courses, branches: list[Index | None], end: int, node: int, third: int, kind: _Kind) -> list[Index | None]:
    """Return branches of which one goes on from a node of its own in another's node, and what is left of that one in a third, if any."""
    changed = list(branches)
    a, b, place = int(courses.owner[end]), int(courses.owner[node]), int(courses.place[node])
    whole, second = branches[a], branches[b]
    assert whole is not None
    assert second is not None
    if kind is _Kind.EXCHANGED:
        changed[b], changed[a] = np.concatenate([second[: place + 1], whole[1:]]), second[place:]
        return changed
    first = whole[: courses.place[end] + 1]  # what is frayed is left out
    if kind is _Kind.TURNED:
        changed[a], changed[b] = np.concatenate([first, second[place:0:-1]]), None
        return changed
    changed[a] = np.concatenate([first, second[place:]])
    if kind is _Kind.SPLICED:
        changed[b] = None
        return _rehung(courses.centre, changed, second[1:place], first)
    left = second[:place]
    changed[b] = left if len(left) > 1 else None
    following = branches[third] if third >= 0 else None
    if following is not None:
        changed[b], changed[third] = np.concatenate([left, following[1:]]), None
    return changed


def _rehung(centre: Array, branches: list[Index | None], dropped: Index, line: Index) -> list[Index | None]:
    """Hang the children of dropped nodes on the nearest nodes of a line."""
    nearest = dict(zip(dropped.tolist(), line[cKDTree(centre[line]).query(centre[dropped])[1]].tolist(), strict=True))
    return [
        nodes if k == 0 or nodes is None or int(nodes[0]) not in nearest else np.concatenate([[nearest[int(nodes[0])]], nodes[1:]])
        for k, nodes in enumerate(branches)
    ]


def _owner_now(owner: Index, before: list[Index | None], after: list[Index | None], changed: set[int]) -> Index:
    """Return the branch (N,) that owns each node after some branches changed, -1 where a node was dropped."""
    now = owner.copy()
    for branches, gone in ((before, True), (after, False)):
        for k in changed:
            nodes = branches[k]
            if nodes is not None:
                now[nodes[k > 0 :]] = -1 if gone else k
    return now


def _parents_first(branches: list[Index | None], count: int) -> tuple[Index, ...]:
    ordered = (branches[k] for k in hanging_order(branches, count))
    return tuple(nodes for nodes in ordered if nodes is not None)
