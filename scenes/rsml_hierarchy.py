"""Parents of the roots in an RSML file.

Laterals are nested in their parents. In flat files, in which all roots are children of the plant, each root can state
the id of its parent (``parent-branch`` of RSWMS and OpenSimRoot).
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rhizotwin.scenes import rsml_xml
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.plants import NAMELESS
from rhizotwin.scenes.rsml import Array, Root

PARENT_NAMES = ("parent-branch", "parent-id", "parent-root", "parent")
"""Names of the property or attribute of a root that states the id of its parent."""
NO_PARENT = ("", "-1", "0", "none")
"""Values of this property for roots without a parent, unless a root has this id. RSWMS states the root's own id."""

FARTHEST = 2.0
"""Maximum ratio of two distances from the first point of a root: to the point of the parent stated in the file, and to
the nearest point of the parent. If the median is larger, the file numbers its points differently."""


@dataclass(kw_only=True)
class Entry:
    """Root element of a file."""

    element: ET.Element
    name: str
    """Name for messages, such as ``root 3 ("tap")``."""
    nested_in: int
    """Index of the entry in which the element is nested. It is -1 for a child of the plant."""
    plant: int
    """Number of the plant's element."""
    plant_name: str
    id: str
    label: str
    own: list[ET.Element] = field(default_factory=list)
    """Elements of the root without those of its laterals."""
    parent_node: int | None = None
    """Index of the parent's point that the root states, counted from 0 or from 1."""
    points_mm: Array = field(default_factory=lambda: np.empty((0, 3)))
    root: Root | None = None
    """The root without its parent. It is None if it has no line, because the element has fewer than two points."""

    @property
    def stated_parent(self) -> str:
        """Id of the parent that the root states, or an empty text."""
        attributes = (rsml_xml.attribute(self.element, name) for name in PARENT_NAMES)
        return rsml_xml.read_property(self.own, *PARENT_NAMES) or next((text for text in attributes if text), "")


def list_entries(document: ET.Element) -> list[Entry]:
    """Return the root elements of a document. Each element precedes the elements that are nested in it."""
    entries: list[Entry] = []
    stack: list[tuple[ET.Element, int, int, str]] = [(document, -1, 0, "")]
    plants = 0
    while stack:
        element, parent, plant, name = stack.pop()
        kind = rsml_xml.local_name(element)
        if kind == "plant":
            plants += 1
            label = rsml_xml.attribute(element, "label") or ""
            plant, name = plants, "" if label == NAMELESS else label
        elif kind == "root":
            label = rsml_xml.attribute(element, "label") or ""
            number = f"root {len(entries) + 1}"
            entries.append(
                Entry(
                    element=element,
                    name=f'{number} ("{label}")' if label else number,
                    nested_in=parent,
                    plant=plant,
                    plant_name=name,
                    id=(rsml_xml.attribute(element, "id") or "").strip(),
                    label=label,
                    own=list(rsml_xml.own_elements(element)),
                )
            )
            parent = len(entries) - 1
        stack.extend((child, parent, plant, name) for child in reversed(element))
    return entries


def find_parents(path: Path, entries: list[Entry]) -> list[int]:
    """Return the index of the parent of each entry, or -1.

    Parameters
    ----------
    path : Path
        Path of the file, used in messages.
    entries : list of Entry
        Entries with their roots.

    Raises
    ------
    UserError
        If a stated parent is unknown or ambiguous, or if roots are their own ancestors.
    """
    if any(entry.id for entry in entries):
        return _with_ids(path, entries, [entry.id for entry in entries])
    # without ids the roots are numbered in their order, from 0 or from 1: laterals begin near their parents
    found, errors = [], []
    for first in (1, 0):
        try:
            found.append(_with_ids(path, entries, [str(index + first) for index in range(len(entries))]))
        except UserError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return min(found, key=lambda parents: _total_gap_mm(entries, parents))


def resolve_parent_nodes(entries: list[Entry], parents: list[int]) -> list[int | None]:
    """Return the index (from 0) of the point of its parent to which each root is attached, or None.

    Some programs count the points from 1 (RSWMS), most from 0 (CPlantBox, OpenAlea). The first index is the one with
    which laterals begin nearer to the stated points. If these are not near (`FARTHEST`), all indices are None.
    """
    stated: dict[int, tuple[int, Array]] = {}  # number of the point, and distances from the points of the parent, mm
    for index, parent in enumerate(parents):
        number, own_mm = entries[index].parent_node, entries[index].points_mm
        if parent >= 0 and number is not None and len(own_mm) and len(entries[parent].points_mm):
            stated[index] = number, np.linalg.norm(entries[parent].points_mm - own_mm[0], axis=1)
    nodes: list[int | None] = [None] * len(entries)
    if not stated:
        return nodes
    gaps_mm = np.array(
        [[away[number - first] if 0 <= number - first < len(away) else np.inf for first in range(2)] for number, away in stated.values()]
    )
    nearest_mm = np.array([away_mm.min() for _, away_mm in stated.values()])
    first = int(np.median(gaps_mm, axis=0).argmin())
    if np.median(gaps_mm[:, first] / np.maximum(nearest_mm, 1e-6)) <= FARTHEST:
        for (index, (number, _)), gap_mm in zip(stated.items(), gaps_mm[:, first], strict=True):
            nodes[index] = number - first if np.isfinite(gap_mm) else None
    return nodes


def parents_first(path: Path, entries: list[Entry], parents: list[int]) -> list[int]:
    """Return the indices of all entries depth first, so that parents precede their laterals.

    Parameters
    ----------
    path : Path
        File, for messages.
    entries, parents : list of Entry, list of int
        Roots, and the index of the parent of each; -1 for a root without a parent.

    Raises
    ------
    UserError
        If roots are parents of each other.
    """
    laterals: list[list[int]] = [[] for _ in entries]
    for index, parent in enumerate(parents):
        if parent >= 0:
            laterals[parent].append(index)
    order: list[int] = []
    stack = [index for index, parent in enumerate(parents) if parent < 0][::-1]
    while stack:
        index = stack.pop()
        order.append(index)
        stack.extend(reversed(laterals[index]))
    if len(order) < len(entries):
        lost = entries[min(set(range(len(entries))) - set(order))]
        raise UserError(f"{path}: by the stated parents, {lost.name} is its own ancestor; correct the parents in the file")
    return order


def _with_ids(path: Path, entries: list[Entry], ids: list[str]) -> list[int]:
    """Return the parents of entries with the given ids."""
    named: dict[tuple[int, str], list[int]] = {}
    for names in (ids, [entry.label for entry in entries]):  # labels are used only if no id fits
        known = set(named)
        for index, (entry, name) in enumerate(zip(entries, names, strict=True)):
            for key in ((entry.plant, name), (-1, name)):
                if name and key not in known:
                    named.setdefault(key, []).append(index)
    return [_parent(path, index, entries, ids[index], named) for index in range(len(entries))]


def _parent(path: Path, index: int, entries: list[Entry], own_id: str, named: dict[tuple[int, str], list[int]]) -> int:
    entry = entries[index]
    text = "" if entry.nested_in >= 0 else entry.stated_parent
    for stated in (text, _without_decimals(text)):
        if stated == own_id:
            return -1
        for found in (named.get((entry.plant, stated)), named.get((-1, stated))):
            if found and len(found) > 1:
                raise UserError(f'{path}: {entry.name} states the parent "{text}", but {len(found)} roots have this id')
            if found:
                return found[0] if found[0] != index else -1
    if _without_decimals(text).lower() in NO_PARENT:
        return entry.nested_in
    raise UserError(f'{path}: {entry.name} states the parent "{text}", but no root has this id')


def _without_decimals(text: str) -> str:
    """Return "2" for "2.0", and other texts unchanged."""
    try:
        value = float(text)
    except ValueError:
        return text
    return str(int(value)) if value.is_integer() else text


def _total_gap_mm(entries: list[Entry], parents: list[int]) -> float:
    """Return the sum of the distances from the first points of roots to the nearest points of their parents, mm."""
    pairs = [(entry.root, entries[parent].root) for entry, parent in zip(entries, parents, strict=True) if parent >= 0]
    gaps = [np.linalg.norm(above.points_mm - root.points_mm[0], axis=1).min() for root, above in pairs if root and above]
    return float(sum(gaps)) if gaps else math.inf
