"""Parents and children of branches, given as lists of nodes."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


def owners(branches: Sequence[Index | None], count: int) -> Index:
    """Return the index (N,) of the branch that contains each of N nodes.

    N is ``count``. The index is -1 if no branch contains the node. Removed branches are None.
    """
    owner = np.full(count, -1)
    for k, nodes in enumerate(branches):
        if nodes is not None:
            owner[nodes if k == 0 else nodes[1:]] = k
    return owner


def ancestors(branches: Sequence[Index | None], owner: Index, branch: int) -> list[int]:
    """Return the indices of a branch, its parent, and all further ancestors up to the first branch.

    The first branch has the index 0. The list ends earlier if a parent is missing or the branches form a cycle.

    Parameters
    ----------
    owner : Index
        Index (N,) of the branch that contains each node, or -1 for none.
    """
    found: list[int] = []
    while branch >= 0 and branch not in found and (nodes := branches[branch]) is not None:
        found.append(branch)
        branch = int(owner[nodes[0]]) if branch > 0 else -1
    return found


def list_children(branches: Sequence[Index | None], owner: Index) -> dict[int, list[int]]:
    """Return the children of each branch that has children, keyed by the branch.

    Parameters
    ----------
    owner : Index
        Index (N,) of the branch that contains each node.
    """
    children: dict[int, list[int]] = {}
    for k, nodes in enumerate(branches):
        if nodes is not None and k > 0:
            children.setdefault(int(owner[nodes[0]]), []).append(k)
    return children


def parents_first(branches: Sequence[Index | None], count: int) -> list[int]:
    """Return the indices (K,) of all branches connected to the first branch.

    Parents come before children.

    Parameters
    ----------
    count : int
        Number of nodes.
    """
    children = list_children(branches, owners(branches, count))
    order, waiting = [], deque([0])
    while waiting:
        order.append(waiting.popleft())
        waiting.extend(children.get(order[-1], []))
    return order
