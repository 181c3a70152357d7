"""Reconnection of branches where tracing changed from one root to another.

Where two roots touch, the shortest path to the top may switch from one root to the other. The remainder of the first
root is then traced as a separate branch that begins or ends beside the second. Roots that touch are distinguished by
their tangents. Since roots are smooth and few, the cheapest of all ways to connect the adjacent pieces is chosen. A
bend costs the square of its angle (see `_cost` for the other terms), and each branch costs as much as a bend of one
radian.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots import orientation
from rhizotwin.recon.tubes.branch_graph import Index, ancestors, parents_first
from rhizotwin.recon.tubes.tubes import SPACING_MM, TANGENT_NODES, Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REACH_MM = 4.0
"""Maximum distance between two pieces that are connected, mm."""
_GAP_MM, _MISS_MM = 4.0, 0.5
"""Gap and lateral offset between two pieces, mm, each of which costs as much as a bend of one radian."""
_OVERLAP_MM = 0.6
"""Maximum overlap of two connected pieces, mm, which equals the spacing of the nodes. The ends of pieces are uncertain
where roots touch."""
_FRAYED_NODES, _FRAYED = 3, 0.1
"""Maximum number of uncertain nodes that may be dropped at each of the two ends to be joined, and cost of each dropped
node."""
_BESIDE_MM, _BESIDE_NODES = 0.7, 9
"""Maximum distance from another branch, mm, and maximum number of nodes. The beginning of a branch is a duplicate of
the other branch if it exceeds neither of them."""
_BRANCH, _UNCERTAIN = 1.0, 2.0
"""Cost of each branch, and additional cost of each branch with an uncertain end."""
_GAIN = 0.1
"""Minimum reduction of the total cost for a change to be applied."""
_ROUNDS = 8
"""Maximum number of iterations. Joining two pieces may bring other ends together, but fewer iterations usually
suffice."""


@dataclass(frozen=True)
class _Tangents:
    """Tangents and mean radii of the branches before and after each node."""

    centre: Array
    """Positions of the nodes, shape (N, 3), mm."""
    arriving: Array
    """Unit vectors from the preceding nodes to each node, towards the tip, shape (N, 3)."""
    leaving: Array
    """Unit vectors from each node to the following nodes, shape (N, 3)."""
    log_before: Array
    """Mean logarithm of the radius over each node and the nodes before it, shape (N,)."""
    log_after: Array
    owner: Index
    """Index of the branch that contains each node, shape (N,)."""
    place: Index
    """Position of each node within its branch, shape (N,)."""


def link(tubes: Tubes, uncertain: Mask | None = None) -> tuple[Tubes, Mask]:
    """Reconnect the pieces of a tree at minimum cost.

    Nodes are not moved, but duplicate paths are removed. Forks are divided and parents are assigned later
    (`hierarchy`). The following changes are tried:

    - A tip continues in a branch that begins near it.
    - Two tips meet, and one of their branches is reversed.
    - A tip continues in the remainder of a branch that it runs into. The first part of that branch ends there,
      continues in a third branch that begins there, or is removed as a duplicate.
    - A branch whose first part is a duplicate of another branch begins at that branch instead.

    Parameters
    ----------
    uncertain : (N,) bool array or None
        Mask of nodes at branch ends that are probably not root tips. Continuing such an end saves an additional cost.

    Returns
    -------
    tubes : Tubes
        Reconnected tree.
    kept : (N,) bool array
        Mask of the nodes that remain in the tree.
    """
    marked = np.zeros(len(tubes.centre_mm), bool) if uncertain is None else uncertain
    branches = orientation.orient_branches(tubes, list(tubes.branches))
    for _ in range(_ROUNDS):
        tangents = _tangents(tubes, branches)
        worth = _worth(tangents, branches, marked)
        edits = sorted(_meetings(tangents, branches, worth) + _takeovers(tangents, branches, worth) + _moves(tangents, branches))
        touched: set[int] = set()
        owner = tangents.owner.copy()
        for edit in edits:
            those = {int(tangents.owner[edit.end]), int(tangents.owner[edit.node]), edit.third} - {-1}
            if touched & those:
                continue
            tried = _apply(edit, tangents, branches)
            now = _update_owners(owner, branches, tried, those)
            if all(ancestors(tried, now, k)[-1] == 0 for k in those if tried[k] is not None):
                branches, owner = tried, now
                touched |= those
        if not touched:
            break
    ordered = _parents_first(branches, len(tubes.centre_mm))
    used = np.zeros(len(tubes.centre_mm), bool)
    used[np.concatenate(ordered)] = True
    return Tubes(tubes.centre_mm, tubes.radius_mm, ordered).keep(used), used


def _worth(tangents: _Tangents, branches: list[Index | None], uncertain: Mask) -> Array:
    """Return the cost (N,) that is saved if the branch of each node is joined to another branch instead of ending.

    The cost is higher for a branch with an uncertain end.
    """
    ends = np.array([nodes is not None and bool(uncertain[nodes[-1]]) for nodes in branches])
    return np.where(ends[tangents.owner], _BRANCH + _UNCERTAIN, _BRANCH)


def _tangents(tubes: Tubes, branches: list[Index | None]) -> _Tangents:
    """Compute tangents and mean radii along all branches."""
    count, centre = len(tubes.centre_mm), tubes.centre_mm
    log_radius = np.log(tubes.radius_mm)
    arriving, leaving = np.zeros((count, 3)), np.zeros((count, 3))
    log_before, log_after = np.zeros(count), np.zeros(count)
    owner, place = np.full(count, -1), np.zeros(count, np.int64)
    for k, nodes in enumerate(branches):
        if nodes is None:
            continue
        number = np.arange(len(nodes))
        first, last = np.maximum(number - TANGENT_NODES, 0), np.minimum(number + TANGENT_NODES, len(nodes) - 1)
        skip = np.round(tubes.radius_mm[nodes] / SPACING_MM).astype(np.int64)  # within a junction, lines are bent
        back, on = np.minimum(skip, first), np.minimum(skip, len(nodes) - 1 - last)
        own = number if k == 0 else number[1:]
        arriving[nodes[own]] = (centre[nodes[number - back]] - centre[nodes[first - back]])[own]
        leaving[nodes[own]] = (centre[nodes[last + on]] - centre[nodes[number + on]])[own]
        total = np.concatenate([[0.0], np.cumsum(log_radius[nodes if k == 0 else np.concatenate([nodes[1:2], nodes[1:]])])])
        log_before[nodes[own]] = ((total[number + 1] - total[first]) / (number + 1 - first))[own]
        log_after[nodes[own]] = ((total[last + 1] - total[number]) / (last + 1 - number))[own]
        owner[nodes[own]], place[nodes[own]] = k, own
    return _Tangents(centre, polyline.unit_vectors(arriving), polyline.unit_vectors(leaving), log_before, log_after, owner, place)


def _cost(way: Array, arriving: Array, leaving: Array, log_before: Array, log_after: Array) -> Array:
    """Return the cost (M,) of joining each pair of pieces.

    It is infinite if the second piece is not ahead of the first.

    Parameters
    ----------
    way : (M, 3) float64 array
        Vector from the end of the first piece to the beginning of the second, mm.
    log_before, log_after : (M,) float64 array
        Mean logarithms of the radii of the pieces, mm. Pieces of equal thickness are connected first.
    """
    middle = polyline.unit_vectors(arriving + leaving)
    along = (way * middle).sum(axis=1)
    miss = np.linalg.norm(way - along[:, None] * middle, axis=1)
    bend = np.arccos(np.clip((arriving * leaving).sum(axis=1), -1.0, 1.0))
    gap = np.maximum(along - _OVERLAP_MM, 0.0)
    radius = np.exp(np.minimum(log_before, log_after))  # within a junction, lines are off by up to their radius
    cost = bend**2 + (miss / np.maximum(_MISS_MM, radius)) ** 2 + (gap / _GAP_MM) ** 2 + (log_before - log_after) ** 2
    return np.asarray(np.where(along > -_OVERLAP_MM, cost, np.inf))


def _join_cost(tangents: _Tangents, before: Index, after: Index) -> Array:
    """Return the cost (M,) of continuing in the node ``after`` from the node ``before``, in the direction of growth."""
    way = tangents.centre[after] - tangents.centre[before]
    return _cost(way, tangents.arriving[before], tangents.leaving[after], tangents.log_before[before], tangents.log_after[after])


class _Kind(IntEnum):
    """Kind of a change in which one branch continues in another branch.

    The other branch is cut in two, reversed, or appended without its beginning. The last kind is a change in which the
    other branch leaves the first one instead, again without its beginning.
    """

    CUT = 0
    TURNED = 1
    SPLICED = 2
    MOVED = 3


class _Edit(NamedTuple):
    """Edit of the tree, in which one branch continues at a node of a second branch. Edits are sorted by their score."""

    score: float
    """Change of the cost; negative."""
    end: int
    """Node at which the first branch ends."""
    node: int
    """Node of the second branch at which it continues."""
    third: int
    """Branch in which the beginning of the second branch continues; -1 if there is none."""
    kind: _Kind


def _meetings(tangents: _Tangents, branches: list[Index | None], worth: Array) -> list[_Edit]:
    """Return the edits in which a branch is extended from its tip by a nearby branch.

    The nearby branch begins near the tip, or it ends there and is reversed. Uncertain nodes at the ends may be dropped.
    """
    tips, tip_fray = _ends(tangents, branches, last=True)
    starts, start_fray = _ends(tangents, branches, last=False)
    found: list[_Edit] = []
    for turned, (ends, fray) in enumerate(((starts, start_fray), (tips, tip_fray))):
        pairs = _pairs(tangents.centre, tips, ends)
        a, b = tips[pairs[:, 0]], ends[pairs[:, 1]]
        cost = _FRAYED * (tip_fray[pairs[:, 0]] + fray[pairs[:, 1]]) + _cost(
            tangents.centre[b] - tangents.centre[a],
            tangents.arriving[a],
            -tangents.arriving[b] if turned else tangents.leaving[b],
            tangents.log_before[a],
            tangents.log_before[b] if turned else tangents.log_after[b],
        )
        gain = cost - (np.maximum(worth[a], worth[b]) if turned else worth[a])
        good = (gain < -_GAIN) & (tangents.owner[a] != tangents.owner[b]) & (tangents.owner[b] > 0)
        found += [
            _Edit(float(g), int(end), int(node), -1, _Kind.TURNED if turned else _Kind.SPLICED)
            for g, end, node in zip(gain[good], a[good], b[good], strict=True)
        ]
    return found


def _ends(tangents: _Tangents, branches: list[Index | None], *, last: bool) -> tuple[Index, Index]:
    """Return the nodes (M,) at which branches may end if uncertain nodes are dropped.

    If ``last`` is false, the nodes at which branches may begin are returned. The second array (M,) contains the number
    of nodes dropped in each case. Nodes with laterals are never dropped.
    """
    bearing = np.zeros(len(tangents.centre), bool)
    bearing[[nodes[0] for k, nodes in enumerate(branches) if nodes is not None and k > 0]] = True
    ends: list[int] = []
    fray: list[int] = []
    for k, nodes in enumerate(branches):
        if nodes is None or (k > 0 and len(nodes) < 2):
            continue
        own = nodes[:0:-1] if last else nodes[1:]
        if not len(own):  # the first branch may be a single node
            own = nodes
        for out in range(max(1, min(_FRAYED_NODES + 1, len(own) - TANGENT_NODES))):
            ends.append(int(own[out]))
            fray.append(out)
            if bearing[own[out]]:
                break
    return np.array(ends, np.int64), np.array(fray, np.int64)


def _takeovers(tangents: _Tangents, branches: list[Index | None], worth: Array) -> list[_Edit]:
    """Return the edits in which a tip meets an inner node of a branch and continues in the rest of that branch."""
    tips, fray = _ends(tangents, branches, last=True)
    inner = np.concatenate([nodes[2 + (k == 0) : -1] for k, nodes in enumerate(branches) if nodes is not None])
    previous = np.concatenate([nodes[1 + (k == 0) : -2] for k, nodes in enumerate(branches) if nodes is not None])
    if not len(inner):
        return []
    owner = tangents.owner
    pairs = _pairs(tangents.centre, tips, inner)
    a, at = tips[pairs[:, 0]], pairs[:, 1]
    b = inner[at]
    cost = _join_cost(tangents, a, b) - _bends(tangents, previous, inner)[at] + _FRAYED * fray[pairs[:, 0]]
    good = (cost < worth[a] - _GAIN) & (owner[a] != owner[b])
    a, b, at, cost = a[good], b[good], at[good], cost[good]
    rest = _continuations(tangents, branches, np.unique(previous[at]))
    found: list[_Edit] = []
    for c, end, node, number in zip(cost, a, b, at, strict=True):
        first = int(owner[end])
        if _is_second_path(tangents, branches, first, int(node)):
            found.append(_Edit(float(c - worth[end]), int(end), int(node), -1, _Kind.SPLICED))
            continue
        best, third = min(
            ((more, k) for more, k in rest.get(int(previous[number]), []) if k not in (first, owner[node])), default=(0.0, -1)
        )
        if third >= 0:
            best -= worth[end] - _BRANCH
        if c + best < -_GAIN:
            found.append(_Edit(float(c + best), int(end), int(node), third, _Kind.CUT))
    return found


def _moves(tangents: _Tangents, branches: list[Index | None]) -> list[_Edit]:
    """Return the edits in which a branch leaves another root than its parent, because its first part duplicates it."""
    begins = [
        (nodes[0], *nodes[place - 1 : place + 1])
        for k, nodes in enumerate(branches)
        if nodes is not None and k > 0
        for place in range(2, min(_BESIDE_NODES + 1, len(nodes) - 1))
    ]
    base, previous, inner = np.array(begins, np.int64).reshape(-1, 3).T
    if not len(inner):
        return []
    owner = tangents.owner
    hosts = np.flatnonzero(owner >= 0)
    pairs = _pairs(tangents.centre, hosts, inner)
    a, at = hosts[pairs[:, 0]], pairs[:, 1]
    b = inner[at]
    cost = _join_cost(tangents, a, b) - _bends(tangents, previous, inner)[at]
    good = (cost < -_GAIN) & (owner[a] != owner[b]) & (owner[a] != owner[base[at]])
    return [
        _Edit(float(change), int(end), int(node), -1, _Kind.MOVED)
        for change, end, node in zip(cost[good], a[good], b[good], strict=True)
        if _is_second_path(tangents, branches, int(owner[end]), int(node))
    ]


def _bends(tangents: _Tangents, previous: Index, inner: Index) -> Array:
    """Return the cost (M,) of the path from each node to the next of the same branch."""
    bend = np.arccos(np.clip((tangents.arriving[previous] * tangents.leaving[inner]).sum(axis=1), -1.0, 1.0))
    return np.asarray(bend**2 + (tangents.log_before[previous] - tangents.log_after[inner]) ** 2)


def _is_second_path(tangents: _Tangents, branches: list[Index | None], first: int, node: int) -> bool:
    """Return whether the beginning of a branch, up to ``node``, runs along the same root as the branch ``first``."""
    second, place = int(tangents.owner[node]), int(tangents.place[node])
    line, beside = branches[first], branches[second]
    assert line is not None
    assert beside is not None
    if second == 0 or place > _BESIDE_NODES:
        return False
    return bool(cKDTree(tangents.centre[line]).query(tangents.centre[beside[1:place]])[0].max() < _BESIDE_MM)


def _continuations(tangents: _Tangents, branches: list[Index | None], nodes: Index) -> dict[int, list[tuple[float, int]]]:
    """Return the branches in which an interrupted branch could continue, keyed by its last node.

    Each branch is returned with the change of the cost, which is negative.
    """
    starts = np.array([line[1] for k, line in enumerate(branches) if line is not None and k > 0 and len(line) > 2], np.int64)
    if not len(starts):
        return {}
    pairs = _pairs(tangents.centre, nodes, starts)
    a, b = nodes[pairs[:, 0]], starts[pairs[:, 1]]
    found: dict[int, list[tuple[float, int]]] = {}
    for c, node, branch in zip(_join_cost(tangents, a, b) - _BRANCH, a, tangents.owner[b], strict=True):
        if c < 0.0:
            found.setdefault(int(node), []).append((float(c), int(branch)))
    return found


def _pairs(centre: Array, first: Index, second: Index) -> Index:
    """Return index pairs (M, 2) of nodes from two lists that are within `_REACH_MM` of each other."""
    near = cKDTree(centre[first]).sparse_distance_matrix(cKDTree(centre[second]), _REACH_MM, output_type="ndarray")
    pairs = np.stack([near["i"], near["j"]], axis=1)[np.lexsort((near["j"], near["i"]))]
    return pairs[first[pairs[:, 0]] != second[pairs[:, 1]]]


def _apply(edit: _Edit, tangents: _Tangents, branches: list[Index | None]) -> list[Index | None]:
    """Return the branches after an edit. The second branch is interrupted at the node at which the first continues."""
    changed = list(branches)
    a, b, place = tangents.owner[edit.end], tangents.owner[edit.node], tangents.place[edit.node]
    whole, second = branches[a], branches[b]
    assert whole is not None
    assert second is not None
    if edit.kind is _Kind.MOVED:
        changed[b] = np.concatenate([[edit.end], second[place:]])
        return _reattach(tangents.centre, changed, second[1:place], whole)
    first = whole[: tangents.place[edit.end] + 1]  # uncertain end nodes are dropped
    if edit.kind is _Kind.TURNED:
        changed[a], changed[b] = np.concatenate([first, second[place:0:-1]]), None
        return changed
    changed[a] = np.concatenate([first, second[place:]])
    if edit.kind is _Kind.SPLICED:
        changed[b] = None
        return _reattach(tangents.centre, changed, second[1:place], first)
    left = second[:place]
    changed[b] = left if len(left) > 1 else None
    following = branches[edit.third] if edit.third >= 0 else None
    if following is not None:
        changed[b], changed[edit.third] = np.concatenate([left, following[1:]]), None
    return changed


def _reattach(centre: Array, branches: list[Index | None], dropped: Index, line: Index) -> list[Index | None]:
    """Attach the laterals of dropped nodes to the nearest nodes of a line."""
    nearest = dict(zip(dropped.tolist(), line[cKDTree(centre[line]).query(centre[dropped])[1]].tolist(), strict=True))
    return [
        nodes if k == 0 or nodes is None or int(nodes[0]) not in nearest else np.concatenate([[nearest[int(nodes[0])]], nodes[1:]])
        for k, nodes in enumerate(branches)
    ]


def _update_owners(owner: Index, before: list[Index | None], after: list[Index | None], changed: set[int]) -> Index:
    """Return the index (N,) of the branch that contains each node after some branches have changed.

    It is -1 for dropped nodes.
    """
    now = owner.copy()
    for branches, gone in ((before, True), (after, False)):
        for k in changed:
            nodes = branches[k]
            if nodes is not None:
                now[nodes[k > 0 :]] = -1 if gone else k
    return now


def _parents_first(branches: list[Index | None], count: int) -> tuple[Index, ...]:
    ordered = (branches[k] for k in parents_first(branches, count))
    return tuple(nodes for nodes in ordered if nodes is not None)
