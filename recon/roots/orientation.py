"""Orientation of branches: reverse those that were traced from their tips.

The criteria are the distance to the top along the roots, and the direction in which roots leave each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.tubes.tubes import TANGENT_NODES, Index, Tubes, ancestors, list_children, owners

Array = NDArray[np.float64]

_TOUCH_MM = 1.0
"""Maximum distance of a tip from the surface of another root for the tip to be that root's lateral's base."""
_ROUNDS = 8
"""Maximum number of rounds; reversing one branch may reverse another. Usually fewer are needed."""


def orient_branches(tubes: Tubes, branches: list[Index | None]) -> list[Index | None]:
    """Reverse branches that begin at their tips.

    These are branches that end at a root nearer to the top, along the roots, than their beginning, and branches that
    leave their parent against its direction of growth and end at a root that they would leave in its direction of
    growth.

    Parameters
    ----------
    branches : list of Index or None
        Node indices (n,) of each, None for removed ones; modified in place, and returned.
    """
    centre = tubes.centre_mm
    owner, way = owners(branches, len(centre)), np.zeros(len(centre))  # the way (N,) along the roots to the top, mm
    _find_ways(centre, branches, owner, way, 0)
    for _ in range(_ROUNDS):
        turned = False
        tips = np.array([nodes[-1] for nodes in branches if nodes is not None])
        near = cKDTree(centre).query_ball_point(centre[tips], _TOUCH_MM + float(tubes.radius_mm.max()))
        for tip, those in zip(tips, near, strict=True):
            k, around = int(owner[tip]), np.array(those, np.int64)
            if k <= 0:
                continue
            others = around[(owner[around] != k) & (owner[around] >= 0)]
            if not len(others):
                continue
            gap = np.linalg.norm(centre[others] - centre[tip], axis=1) - tubes.radius_mm[others]
            best = int(np.argmin(gap))
            parent, line = int(others[best]), branches[k]
            assert line is not None
            nearer = way[parent] + max(gap[best], 0.0) + _TOUCH_MM <= way[line[0]]
            if gap[best] > _TOUCH_MM or not (nearer or _should_reverse(tubes, branches, owner, line, parent)):
                continue
            if k not in ancestors(branches, owner, int(owner[parent])):
                branches[k] = np.concatenate([[parent], line[:0:-1]])
                _find_ways(centre, branches, owner, way, k)
                turned = True
        if not turned:
            break
    return branches


def _find_ways(centre: Array, branches: list[Index | None], owner: Index, way: Array, branch: int) -> None:
    """Set the path length to the top for the nodes of a branch, from its first node's, and of all its descendants."""
    children = list_children(branches, owner)
    waiting = [branch]
    while waiting:
        k = waiting.pop()
        nodes = branches[k]
        assert nodes is not None
        way[nodes[1:]] = way[nodes[0]] + np.cumsum(np.linalg.norm(np.diff(centre[nodes], axis=0), axis=1))
        waiting += children.get(k, [])


def _should_reverse(tubes: Tubes, branches: list[Index | None], owner: Index, line: Index, root: int) -> bool:
    """Return whether a branch leaves its parent against its growth, but would leave another root along it.

    The other root would be left at a node near the branch's tip.
    """
    centre, reach = tubes.centre_mm, min(TANGENT_NODES, len(line) - 1)
    away, back = centre[line[reach]] - centre[line[0]], centre[line[-1 - reach]] - centre[root]
    return bool(away @ _growth(tubes, branches, owner, int(line[0])) < 0.0 < back @ _growth(tubes, branches, owner, root))


def _growth(tubes: Tubes, branches: list[Index | None], owner: Index, node: int) -> Array:
    """Return the direction, not normalised, in which the branch that owns a node grows there."""
    line = branches[int(owner[node])]
    assert line is not None
    place = int(np.flatnonzero(line == node)[0])
    return np.asarray(
        tubes.centre_mm[line[min(place + TANGENT_NODES, len(line) - 1)]] - tubes.centre_mm[line[max(place - TANGENT_NODES, 0)]]
    )
