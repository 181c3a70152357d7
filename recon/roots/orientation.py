"""Orientation of branches: reversal of branches that were traced from their tips.

The criteria are the distance to the top along the roots, and the direction in which roots leave each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.tubes.branch_graph import Index, ancestors, list_children, owners
from rhizotwin.recon.tubes.tubes import TANGENT_NODES, Tubes

Array = NDArray[np.float64]

_TOUCH_MM = 1.0
"""Maximum distance between the end of a branch and the surface of another root, mm, for the branch to be a lateral of
that root."""
_ROUNDS = 8
"""Maximum number of iterations. Reversing one branch may require another to be reversed, but fewer iterations usually
suffice."""


def orient_branches(tubes: Tubes, branches: list[Index | None]) -> list[Index | None]:
    """Reverse branches that begin at their tips.

    A branch is reversed in two cases. In the first case, it ends at a root that is nearer to the top, along the roots,
    than the branch's beginning. In the second case, it leaves its parent against the parent's direction of growth, and
    ends at a root that it would leave in that root's direction of growth.

    Parameters
    ----------
    branches : list of Index or None
        Node indices (n,) of each branch, or None for removed branches. The list is modified in place and returned.
    """
    centre = tubes.centre_mm
    owner, way = owners(branches, len(centre)), np.zeros(len(centre))  # path length (N,) along the roots to the top, mm
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
    """Compute the path length to the top for the nodes of a branch and of all its descendants, in place.

    The path length of the branch's first node must be known.
    """
    children = list_children(branches, owner)
    waiting = [branch]
    while waiting:
        k = waiting.pop()
        nodes = branches[k]
        assert nodes is not None
        way[nodes[1:]] = way[nodes[0]] + np.cumsum(np.linalg.norm(np.diff(centre[nodes], axis=0), axis=1))
        waiting += children.get(k, [])


def _should_reverse(tubes: Tubes, branches: list[Index | None], owner: Index, line: Index, root: int) -> bool:
    """Return whether a branch is attached to its parent with the wrong end.

    In this case, it leaves its parent against the direction of growth, but would leave another root at its tip in the
    direction of growth. ``root`` is the node of the other root next to the tip.
    """
    centre, reach = tubes.centre_mm, min(TANGENT_NODES, len(line) - 1)
    away, back = centre[line[reach]] - centre[line[0]], centre[line[-1 - reach]] - centre[root]
    return bool(away @ _growth(tubes, branches, owner, int(line[0])) < 0.0 < back @ _growth(tubes, branches, owner, root))


def _growth(tubes: Tubes, branches: list[Index | None], owner: Index, node: int) -> Array:
    """Return the direction of growth (3,) of a branch at one of its nodes, not normalised."""
    line = branches[int(owner[node])]
    assert line is not None
    place = int(np.flatnonzero(line == node)[0])
    return np.asarray(
        tubes.centre_mm[line[min(place + TANGENT_NODES, len(line) - 1)]] - tubes.centre_mm[line[max(place - TANGENT_NODES, 0)]]
    )
