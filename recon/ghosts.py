"""Which parts of a tree of tubes are no roots: what explains nothing, what lies inside others, and short ends that prove nothing.

All functions tell nodes (N,) that should go; `Tubes.staying` turns them into cuts from the tips.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.proof import Proof
from recon.tubes import Index, Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FLANK_PX = 1.0
"""The balls that stand for thick organs are not as precise as tubes, nor is the end at the rim of sight: this much about them is theirs."""
_EXPLAINED = 0.5
"""A branch ends where it explains less than this of what would be unexplained without it, where it covers: it is a ghost."""
_EXPLAINED_PX = 1.0
"""... or less than this squared coverage, in pixels of all views together: nothing tells of it."""
_END_NODES = 3
_NEIGHBOURS = 12
_INSIDE = 0.9
"""Share of a root's radius within which another centre line is its own."""
_SHORT_MM = 1.5
"""Branches that stand out less than this must prove that their neighbours, fitted without them, leave them unexplained."""
_LONG_MM, _TIP_NODES = 8.0, 5
"""Longer ends are roots, whatever speaks against their tips; what a tip leaves is that of its last nodes."""
_FREE_MM, _OF_FREE, _OF_LEFT, _LEAST_TIMES = 1.0, 0.25, 0.1, 0.25
"""A tip that stands free by a millimetre is as good as one that a quarter more of shows; leaving e times as much as usual, a tenth less."""
_CERTAIN = 0.2
"""Less evidence makes an end a ghost: where most false ends go, and few true ones (see docs/decisions/tubes-for-thin-roots.md)."""


def flanked(tubes: Tubes, organ: Mask) -> Mask:
    """Tell the nodes (N,) about which `FLANK_PX` more belong to them: thick organs, and the top, where the plant goes out of sight."""
    top = np.zeros(len(organ), bool)
    top[tubes.branches[0][0]] = True
    return organ | top


def unexplaining(tubes: Tubes, proved: Proof, organ: Mask) -> Mask:
    """Tell the nodes (N,) that explain no pixels of their own, averaged over neighbours along their branch."""
    gone = np.zeros(len(organ), bool)
    for k in range(len(tubes.branches)):
        own = tubes.own(k)
        explained, left = (
            np.convolve(np.pad(value[own], _END_NODES // 2, mode="edge"), np.full(_END_NODES, 1.0 / _END_NODES), "valid")
            for value in (proved.explained, proved.left)
        )
        gone[own] = (explained < _EXPLAINED * (explained + left)) | (explained < _EXPLAINED_PX)
    return gone & ~organ


def inside_another(tubes: Tubes, organ: Mask, flank_mm: float) -> Mask:
    """Tell the nodes (N,) that lie inside an earlier branch, or on an organ's flank or about the top: second paths along the same root.

    Parameters
    ----------
    flank_mm : `FLANK_PX` in mm.
    """
    centre, owner = tubes.centre_mm, tubes.owner
    reach = np.where(flanked(tubes, organ), tubes.radius_mm + flank_mm, _INSIDE * tubes.radius_mm)
    distance, near = cKDTree(centre).query(centre, k=min(_NEIGHBOURS, len(centre)))
    inside: Mask = ((owner[near] < owner[:, None]) & (distance < reach[near])).any(axis=1)
    return inside


def short_leaves(tubes: Tubes, organ: Mask) -> Mask:
    """Tell the nodes (N,) of branches that bear none and are so short that they may be an artefact of their neighbours."""
    gone = np.zeros(len(organ), bool)
    for k, length in _leaves(tubes):
        if length < _SHORT_MM + tubes.radius_mm[tubes.branches[k][0]]:
            gone[tubes.own(k)] = True
    return gone & ~organ


def doubtful_ends(tubes: Tubes, visible: Array, proved: Proof, organ: Mask) -> Mask:
    """Tell the nodes (N,) of ends, from a branch's last lateral to its tip, whose tips are likely none.

    Three things speak for a tip: that no other root hides it, that it stands free of others, and that it leaves little of what lies about
    it unexplained, compared with what tips usually leave (noise and blur count for all of them). They are weighed together, as a false tip
    may pass in one of them.

    Parameters
    ----------
    visible : (N,) share of each node, over all views, that no other hides.
    """
    gone = np.zeros(len(organ), bool)
    ends = _ends(tubes)
    if not ends:
        return gone
    owner, radius, near = tubes.owner, tubes.radius_mm, cKDTree(tubes.centre_mm)
    share, free_mm = np.zeros(len(ends)), np.full(len(ends), _FREE_MM)
    for number, (k, nodes) in enumerate(ends):
        last = nodes[-_TIP_NODES:]
        share[number] = proved.left[last].sum() / max(float((proved.explained + proved.left)[last].sum()), 1e-6)
        tip = tubes.centre_mm[nodes[-1]]
        others = np.array([n for n in near.query_ball_point(tip, _FREE_MM + float(radius.max())) if owner[n] != k], np.int64)
        if len(others):
            free_mm[number] = min(_FREE_MM, float((np.linalg.norm(tubes.centre_mm[others] - tip, axis=1) - radius[others]).min()))
    usual = max(float(np.median(share)), 1e-6)
    shown = visible[[nodes[-1] for _, nodes in ends]]
    evidence = shown + _OF_FREE * free_mm / _FREE_MM - _OF_LEFT * np.log(share / usual + _LEAST_TIMES)
    for (k, nodes), weak in zip(ends, evidence < _CERTAIN, strict=True):
        start = tubes.branches[k][np.flatnonzero(tubes.branches[k] == nodes[0])[0] - 1]
        if weak and float(np.linalg.norm(np.diff(tubes.centre_mm[[start, *nodes]], axis=0), axis=1).sum()) < _LONG_MM:
            gone[nodes] = True
    return gone & ~organ


def _ends(tubes: Tubes) -> list[tuple[int, Index]]:
    """Return the branches but the first that go on beyond their last lateral, with the nodes from there to the tip."""
    bearing = np.zeros(len(tubes.radius_mm), bool)
    bearing[[nodes[0] for nodes in tubes.branches[1:]]] = True
    found = []
    for k in range(1, len(tubes.branches)):
        own = tubes.own(k)
        last = np.flatnonzero(bearing[own])
        if not len(last) or last[-1] + 1 < len(own):
            found.append((k, own[last[-1] + 1 :] if len(last) else own))
    return found


def _leaves(tubes: Tubes) -> list[tuple[int, float]]:
    """Return the branches that bear none, with their lengths, mm."""
    bearing = {int(nodes[0]) for nodes in tubes.branches[1:]}
    return [
        (k, float(np.linalg.norm(np.diff(tubes.centre_mm[nodes], axis=0), axis=1).sum()))
        for k, nodes in enumerate(tubes.branches)
        if k > 0 and not bearing & set(nodes[1:].tolist())
    ]
