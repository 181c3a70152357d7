"""Detection of tube nodes that are not roots.

These are ghosts, which explain no pixels, duplicates inside other tubes, and short ends without evidence. Each function
returns a mask of nodes (N,) to remove, which `Tubes.prune_mask` turns into cuts from the tips. The exception is
`find_uncertain_ends`, whose nodes are mostly parts of real roots with hidden ends; they are kept, but without a tip.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots.node_support import Support
from rhizotwin.recon.tubes.tubes import Index, Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FLANK_PX = 1.0
"""Margin about taproot and hypocotyl, whose spheres are less precise than tubes, and about the root's upper end where
it leaves the views."""
_EXPLAINED = 0.5
"""Minimum fraction of the coverage under a branch that the branch explains; below it, the rest of the branch is a
ghost."""
_EXPLAINED_PX = 1.0
"""Minimum squared coverage that a node explains, summed over all views, px."""
_END_NODES = 3
"""Number of nodes over which the evidence is averaged: 2 mm."""
_INSIDE = 0.9
"""Fraction of a root's radius within which another centre line duplicates it."""
_SHARED = 0.3
"""Minimum fraction of its coverage that a branch explains alone. Below it, the branch duplicates a root or is a ghost
among roots."""
_THINNER = 0.5
"""Minimum thickness of the beginning of a root relative to the rest; a thinner beginning is a detour, since roots taper
towards their tips."""
_SHORT_MM = 1.5
"""Branches that protrude less than this are kept only if the neighbours, fitted without them, leave them
unexplained."""
_LONG_MM, _TIP_NODES = 8.0, 5
"""Length above which an end always keeps its tip, and number of last nodes from which the residual at a tip is
computed."""
_FREE_MM, _OF_FREE, _OF_LEFT, _LEAST_TIMES = 1.0, 0.25, 0.1, 0.25
"""Weights of the evidence for a tip: a free distance of 1 mm counts as much as a quarter of additional visibility; a
residual larger than usual by a factor e reduces the evidence by a tenth."""
_CERTAIN = 0.15
"""Minimum evidence for a tip. At this value as many true tips are rejected as false ones accepted
(docs/decisions/tubes-for-thin-roots.md)."""


def find_margin_nodes(tubes: Tubes, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes with a margin of `FLANK_PX` about them.

    These are the nodes of taproot and hypocotyl, and the upper end of the plant, where it leaves the views.
    """
    top = np.zeros(len(organ), bool)
    top[tubes.branches[0][0]] = True
    return organ | top


def find_ghosts(tubes: Tubes, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes that explain no pixels alone, averaged over neighbours along their branch."""
    gone = np.zeros(len(organ), bool)
    for k in range(len(tubes.branches)):
        own = tubes.own(k)
        explained, left = (
            np.convolve(np.pad(value[own], _END_NODES // 2, mode="edge"), np.full(_END_NODES, 1.0 / _END_NODES), "valid")
            for value in (proved.explained, proved.residual)
        )
        gone[own] = (explained < _EXPLAINED * (explained + left)) | (explained < _EXPLAINED_PX)
    return gone & ~organ


def find_duplicates(tubes: Tubes, organ: Mask, flank_mm: float) -> Mask:
    """Return the mask (N,) of nodes inside an earlier branch, within the margin of an organ, or about the upper end.

    Such nodes belong to second paths along the same root.

    Parameters
    ----------
    flank_mm : float
        `FLANK_PX` in mm.
    """
    centre, owner = tubes.centre_mm, tubes.owner
    reach = np.where(find_margin_nodes(tubes, organ), tubes.radius_mm + flank_mm, _INSIDE * tubes.radius_mm)
    # # A node near a thick root has many neighbours, its own branch's nodes among them.
    held = cKDTree(centre).query_ball_point(centre, reach, workers=-1)
    node = np.concatenate([np.asarray(nodes, np.int64) for nodes in held])
    host = np.repeat(np.arange(len(centre)), [len(nodes) for nodes in held])
    inside = np.zeros(len(centre), bool)
    inside[node[owner[host] < owner[node]]] = True
    return inside


def find_unsupported_starts(tubes: Tubes, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes at the beginning of branches that together explain little of their own coverage.

    They belong to second tubes of a root, to ghosts among roots, and to detours along other roots to the true
    beginning.
    """
    found = np.zeros(len(tubes.radius_mm), bool)
    for k in range(1, len(tubes.branches)):
        own = tubes.own(k)
        little = np.flatnonzero(np.cumsum(proved.explained[own]) < _SHARED * np.cumsum(proved.own[own]))
        first, rest = np.split(own, [little.max(initial=-1) + 1])
        if not len(rest) or (len(first) and np.median(tubes.radius_mm[first]) < _THINNER * np.median(tubes.radius_mm[rest])):
            found[first] = True
    return found & ~organ


def find_short_leaves(tubes: Tubes, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes of short branches without children, which may be artefacts of their neighbours."""
    gone = np.zeros(len(organ), bool)
    for k, line in _free_ends(tubes):
        if len(line) == len(tubes.branches[k]) and _length(tubes, line) < _SHORT_MM + tubes.radius_mm[line[0]]:
            gone[line[1:]] = True
    return gone & ~organ


def find_uncertain_ends(tubes: Tubes, visible: Array, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes of ends, from a branch's last lateral to its tip, that probably have no tip.

    The evidence for a tip combines three measures: other roots do not hide it, it is free of other roots, and the
    residual around it is small compared with that of other tips (which accounts for noise and blur). They are combined
    since a false tip may pass any single one. An end that protrudes from its parent by less than its own diameter is a
    bulge and never has a tip.

    Parameters
    ----------
    visible : (N,) float64 array
        Fraction of each node, over all views, that no other node hides.
    """
    gone = np.zeros(len(organ), bool)
    ends = _free_ends(tubes)
    if not ends:
        return gone
    owner, radius, near = tubes.owner, tubes.radius_mm, cKDTree(tubes.centre_mm)
    share, free_mm = np.zeros(len(ends)), np.full(len(ends), _FREE_MM)
    for number, (k, line) in enumerate(ends):
        last = line[1:][-_TIP_NODES:]
        share[number] = proved.residual[last].sum() / max(float((proved.explained + proved.residual)[last].sum()), 1e-6)
        tip = tubes.centre_mm[line[-1]]
        others = np.array([n for n in near.query_ball_point(tip, _FREE_MM + float(radius.max())) if owner[n] != k], np.int64)
        if len(others):
            free_mm[number] = min(_FREE_MM, float((np.linalg.norm(tubes.centre_mm[others] - tip, axis=1) - radius[others]).min()))
    usual = max(float(np.median(share)), 1e-6)
    shown = visible[[line[-1] for _, line in ends]]
    evidence = shown + _OF_FREE * free_mm / _FREE_MM - _OF_LEFT * np.log(share / usual + _LEAST_TIMES)
    for (k, line), weak in zip(ends, evidence < _CERTAIN, strict=True):
        if weak and _length(tubes, line) < _LONG_MM:
            gone[line[1:]] = ~organ[line[1:]]
        if _is_bulge(tubes, k, line):  # also on taproot and hypocotyl
            gone[line[1:]] = True
    return gone


def _is_bulge(tubes: Tubes, branch: int, line: Index) -> bool:
    """Return whether an end is a whole branch that protrudes by less than its own diameter."""
    whole = len(line) == len(tubes.branches[branch])
    return whole and _length(tubes, line) - float(tubes.radius_mm[line[0]]) < 2.0 * float(tubes.radius_mm[line[1:]].mean())


def _free_ends(tubes: Tubes) -> list[tuple[int, Index]]:
    """Return the branches, except the first, that continue beyond their last lateral, with the nodes of their ends."""
    return [(k, line) for k, line in enumerate(tubes.ends) if k > 0 and len(line) > 1]


def _length(tubes: Tubes, line: Index) -> float:
    """Return the length of a line of nodes (n,), mm."""
    return polyline.length_mm(tubes.centre_mm[line])
