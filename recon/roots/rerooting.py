"""Trees of roots that can be rerooted and split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rhizotwin.scenes.rsml import Root

Place = tuple[int, int]
"""Index of a root, and index of a point on that root."""


@dataclass(frozen=True)
class Tree:
    """Connected roots. The first root has no parent, and parents come before children."""

    roots: tuple[Root, ...]
    is_turned: bool = False
    """Whether the tree was rerooted, so that orders and parents refer to a new base."""

    @classmethod
    def from_roots(cls, roots: Sequence[Root]) -> list[Tree]:
        """Split a list of roots into connected trees. Parents must come before children."""
        tree_of, members = [0] * len(roots), list[list[int]]()
        for index, root in enumerate(roots):
            if root.parent < 0:
                tree_of[index] = len(members)
                members.append([])
            else:
                tree_of[index] = tree_of[root.parent]
            members[tree_of[index]].append(index)
        return [cls(_renumber(roots, chosen)) for chosen in members]

    def joint(self, line: int) -> Place:
        """Return the parent of a root, and the index of the parent's point to which the root is attached."""
        root = self.roots[line]
        parent = self.roots[root.parent].points_mm
        return root.parent, int(np.argmin(np.sum((parent - root.points_mm[0]) ** 2, axis=1)))

    def way(self, line: int, at: int) -> list[Place]:
        """Return the path from the base of the tree to a point of a root, as pairs of root index and point index.

        The first point of a root and the parent's point to which it is attached are both included.
        """
        found: list[Place] = []
        while line >= 0:
            found += [(line, k) for k in range(at, -1, -1)]
            line, at = self.joint(line) if self.roots[line].parent >= 0 else (-1, 0)
        return found[::-1]

    def reroot(self, line: int, at: int) -> Tree:
        """Return the same tree with its base at a given point. Roots along the path to the old base are reversed."""
        if self.roots[line].parent < 0 and at == 0:
            return self
        chain = [(line, at)]
        while self.roots[chain[-1][0]].parent >= 0:
            chain.append(self.joint(chain[-1][0]))
        reach = dict(chain)  # for each root on the path, the last point on the path
        points = np.concatenate([self.roots[k].points_mm[: end + 1][::-1] for k, end in chain])
        diameters = np.concatenate([self.roots[k].diameters_mm[: end + 1][::-1] for k, end in chain])
        fresh = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.0])
        made = [replace(self.roots[line], points_mm=points[fresh], diameters_mm=diameters[fresh], parent=-1, order=0, tip_seen=True)]
        rest = {k: made_at for made_at, k in enumerate((k for k, end in chain if end + 1 < len(self.roots[k].points_mm)), start=1)}
        for k in rest:  # the remainder beyond the path becomes a separate root
            root, end = self.roots[k], reach[k]
            made.append(replace(root, points_mm=root.points_mm[end:], diameters_mm=root.diameters_mm[end:], parent=0, order=1))
        number = {**dict.fromkeys(reach, 0)}
        for index, root in enumerate(self.roots):
            if index in reach:
                continue
            above, joint = self.joint(index)
            parent = rest.get(above, 0) if above in reach and joint > reach[above] else number[above]
            number[index] = len(made)
            made.append(replace(root, parent=parent, order=made[parent].order + 1))
        return Tree(tuple(made), is_turned=True)

    def split(self, before: Place, behind: Place) -> tuple[Tree, Tree]:
        """Split a tree between two adjacent points on a path from its base.

        Returns
        -------
        above : Tree
            Part that contains ``before`` and keeps the base.
        below : Tree
            Part that contains ``behind``, which becomes its base.
        """
        line, at = behind
        root = self.roots[line]
        if before[0] == line and not (at < 2 and root.parent >= 0):  # in the middle of a root, both parts are lines
            at = min(max(at, 2), len(root.points_mm) - 2)
            upper = replace(root, points_mm=root.points_mm[:at], diameters_mm=root.diameters_mm[:at])
            lower = replace(root, points_mm=root.points_mm[at:], diameters_mm=root.diameters_mm[at:], parent=-1)
        else:
            upper, lower = None, replace(root, parent=-1)
        down = {line}
        for index, other in enumerate(self.roots):
            if other.parent in down and (other.parent != line or upper is None or self.joint(index)[1] >= at):
                down.add(index)
        roots = list(self.roots)
        roots[line] = lower
        below = _renumber(roots, sorted(down))
        roots[line] = lower if upper is None else upper
        above = _renumber(roots, [k for k in range(len(roots)) if k not in down or (k == line and upper is not None)])
        return Tree(above, is_turned=True), Tree(below, is_turned=True)


def _renumber(roots: Sequence[Root], chosen: Sequence[int]) -> tuple[Root, ...]:
    """Return a subset of the roots with renumbered parents. A parent outside the subset becomes -1."""
    number = {index: place for place, index in enumerate(chosen)}
    return tuple(replace(roots[index], parent=number.get(roots[index].parent, -1)) for index in chosen)
