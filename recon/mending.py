"""Mend the tree of branches where the tracing went astray: roots that touch each other are told apart by their directions.

Where two roots touch, the easiest path to the top may change from one to the other. What is left of the first is then traced as a branch
of its own that comes up to the same place: two tips meet head to head, or a tip ends where a branch begins that goes on in its direction.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.tubes import Index, Tubes

Array = NDArray[np.float64]

_REACH_MM = 1.2
_STRAIGHT = 0.6
"""Least cosine between directions that go on in each other."""
_NODES = 4
"""A direction is that over this many nodes."""


def mend(tubes: Tubes) -> Tubes:
    """Join branches that meet head to head, then branches that go on where another ends.

    Only the branches change; the nodes stay.
    """
    branches: list[Index | None] = list(tubes.branches)
    for head_to_head in (True, False):
        for first, second in _meetings(tubes.centre_mm, branches, head_to_head=head_to_head):
            for a, b in ((first, second), (second, first)) if head_to_head else ((first, second),):
                tried = _joined(branches, a, b, turned=head_to_head)
                if tried is not None and _whole(tried, len(tubes.centre_mm)):
                    branches = tried
                    break
    return Tubes(tubes.centre_mm, tubes.radius_mm, _parents_first(branches, len(tubes.centre_mm)))


def _meetings(centre_mm: Array, branches: list[Index | None], *, head_to_head: bool) -> list[tuple[int, int]]:
    """Return pairs of branches that may be joined, the closest first; a tip or beginning is in one pair only."""
    alive = [k for k, nodes in enumerate(branches) if nodes is not None and len(nodes) > 2]
    lines = [centre_mm[branches[k]] for k in alive]
    tip = np.array([line[-1] for line in lines])
    ahead = _unit(np.array([line[-1] - line[-min(_NODES, len(line))] for line in lines]))
    if head_to_head:
        other, onward = tip, -ahead
    else:
        other = np.array([line[1] for line in lines])
        onward = _unit(np.array([line[min(_NODES, len(line) - 1)] - line[1] for line in lines]))
    found = []
    for i, near in enumerate(cKDTree(other).query_ball_point(tip, _REACH_MM)):
        for j in near:
            if i == j or (head_to_head and j < i) or (not head_to_head and alive[j] == 0):
                continue
            way = other[j] - tip[i]
            distance = float(np.linalg.norm(way))
            beside = distance > 0.5 * _REACH_MM and float(way @ (ahead[i] + onward[j])) < _STRAIGHT * distance
            if float(ahead[i] @ onward[j]) > _STRAIGHT and not beside:
                found.append((distance, i, j))
    tips: set[int] = set()
    others: set[int] = tips if head_to_head else set()
    pairs = []
    for _, i, j in sorted(found):
        if i not in tips and j not in others:
            tips.add(i)
            others.add(j)
            pairs.append((alive[i], alive[j]))
    return pairs


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return unit


def _joined(branches: list[Index | None], a: int, b: int, *, turned: bool) -> list[Index | None] | None:
    """Append branch b, turned round or not, to branch a; None where that cannot be."""
    first, second = branches[a], branches[b]
    if first is None or second is None or b == 0:
        return None
    changed = list(branches)
    changed[a] = np.concatenate([first, second[:0:-1] if turned else second[1:]])
    changed[b] = None
    return changed


def _whole(branches: list[Index | None], count: int) -> bool:
    """Tell whether every branch still hangs, by its parents, on the first."""
    return len(_order(branches, count)) == sum(nodes is not None for nodes in branches)


def _order(branches: list[Index | None], count: int) -> list[int]:
    """Return the branches that hang on the first, parents before children."""
    owner = np.full(count, -1)
    for k, nodes in enumerate(branches):
        if nodes is not None:
            owner[nodes if k == 0 else nodes[1:]] = k
    children: dict[int, list[int]] = {}
    for k, nodes in enumerate(branches):
        if nodes is not None and k > 0:
            children.setdefault(int(owner[nodes[0]]), []).append(k)
    order, waiting = [], deque([0])
    while waiting:
        order.append(waiting.popleft())
        waiting.extend(children.get(order[-1], []))
    return order


def _parents_first(branches: list[Index | None], count: int) -> tuple[Index, ...]:
    ordered = (branches[k] for k in _order(branches, count))
    return tuple(nodes for nodes in ordered if nodes is not None)
