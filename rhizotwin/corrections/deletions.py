"""Restore deleted roots and parts of roots. Roots that were edited after the deletion are not changed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line, Lines


@dataclass(frozen=True, eq=False)
class Deletion:
    """Roots and voxels that a correction deleted or changed."""

    before: Lines
    """Deleted and changed roots before the deletion, keyed by number."""
    after: Lines
    """Changed and new roots after the deletion, keyed by number."""
    removed: Lines
    """Deleted roots that were not restored, keyed by number. They include a part that was cut off and deleted."""
    rows: NDArray[np.int64]
    """Rows of the deleted voxels."""

    @property
    def cut(self) -> dict[int, list[int]]:
        """Return the numbers of the parts of each root that was shortened or divided, the root itself first."""
        cut = [k for k, line in self.after.items() if k in self.before and self.before[k].points_mm is not line.points_mm]
        return {k: [k, *(new for new, line in self.after.items() if new not in self.before and line.parent == k)] for k in cut}


def find_edited(lines: Lines, deletion: Deletion) -> list[int]:
    """Return the numbers of the cut roots that cannot be restored, because one of their parts was edited since."""
    return [number for number, parts in deletion.cut.items() if not all(_is_unedited(lines, deletion, k, number) for k in parts)]


def restore(lines: Lines, removed: Lines, deletion: Deletion) -> dict[int, Line]:
    """Return the roots after a deletion was restored.

    Parameters
    ----------
    lines, removed : Lines
        Existing roots, and all deleted roots of this and earlier deletions that were not restored.
    deletion : Deletion
        Deletion to restore.
    """
    edited = find_edited(lines, deletion)
    found, merged = dict(lines), dict[int, int]()  # merged: root of each part that is joined with its root again
    for number, parts in deletion.cut.items():
        if number not in edited:
            found[number] = replace(deletion.before[number], parent=lines[number].parent, plant=lines[number].plant)
            merged |= dict.fromkeys(parts[1:], number)
    found = {k: replace(line, parent=merged.get(line.parent, line.parent)) for k, line in found.items() if k not in merged}
    # a deleted tip is already part of its root, unless the root was edited and stays divided
    back = {k: line for k, line in deletion.removed.items() if k in deletion.before or line.parent in edited}
    found |= back
    for k, line in back.items():
        parent = line.parent
        while parent >= 0 and parent not in found:  # until the nearest ancestor that exists
            parent = removed[parent].parent if parent in removed else -1
        found[k] = replace(line, parent=parent)
    return reattach(found, deletion)


def reattach(lines: Lines, deletion: Deletion) -> dict[int, Line]:
    """Attach laterals to their parents before a deletion, if these exist again."""
    found = dict(lines)
    for k, then in deletion.after.items():
        if k in lines and k in deletion.before and lines[k].parent == then.parent and deletion.before[k].parent in lines:
            found[k] = replace(lines[k], parent=deletion.before[k].parent)
    return found


def _is_unedited(lines: Lines, deletion: Deletion, number: int, root: int) -> bool:
    """Return whether a part of a root is as the deletion left it. The root itself may have another parent."""
    line = lines.get(number)
    then = deletion.after[number]
    return line is not None and line.points_mm is then.points_mm and (number == root or line.parent == then.parent)
