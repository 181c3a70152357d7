"""Which parts of a tree of tubes are no roots: what explains nothing, what lies inside others, and short ends that prove nothing.

All functions tell nodes (N,) that should go; `Tubes.staying` turns them into cuts from the tips.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.proof import Proof
from recon.tube_picture import Pull
from recon.tubes import Tubes

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
_TIP_SHOWN = 0.4
"""... and that it is not the others' fault: this part of their tips, over all views, is hidden by none."""
_LONG_MM, _TIP_NODES, _TIMES_USUAL = 8.0, 5, 6.0
"""A shorter branch without laterals is a ghost where its last nodes leave so many times the share that tips usually leave."""


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


def hidden_tips(tubes: Tubes, pull: Pull) -> Mask:
    """Tell the nodes (N,) of branches whose tip is hidden by others in most views."""
    tips = np.array([nodes[-1] for nodes in tubes.branches])
    hidden: Mask = (pull.visible[tips] < _TIP_SHOWN)[tubes.owner]
    return hidden


def unproved_leaves(tubes: Tubes, proved: Proof, organ: Mask) -> Mask:
    """Tell the nodes (N,) of branches that bear none, are short, and leave much of what lies about their tips unexplained.

    What is left there is compared with what usually is left about tips: noise and blur count for all of them.
    """
    gone = np.zeros(len(organ), bool)
    leaves = _leaves(tubes)
    ends = [tubes.own(k)[-_TIP_NODES:] for k, _ in leaves]
    share = np.array([proved.left[end].sum() / max(float((proved.explained + proved.left)[end].sum()), 1e-6) for end in ends])
    for (k, length), much in zip(leaves, share > _TIMES_USUAL * np.median(share) if leaves else [], strict=True):
        if much and length < _LONG_MM:
            gone[tubes.own(k)] = True
    return gone & ~organ


def _leaves(tubes: Tubes) -> list[tuple[int, float]]:
    """Return the branches that bear none, with their lengths, mm."""
    bearing = {int(nodes[0]) for nodes in tubes.branches[1:]}
    return [
        (k, float(np.linalg.norm(np.diff(tubes.centre_mm[nodes], axis=0), axis=1).sum()))
        for k, nodes in enumerate(tubes.branches)
        if k > 0 and not bearing & set(nodes[1:].tolist())
    ]
