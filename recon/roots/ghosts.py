"""Which parts of a tree of tubes are no roots.

What explains nothing, what lies inside others, and short ends that prove nothing.

All functions tell nodes (N,) that should go, which `Tubes.staying` turns into cuts from the tips; but for
`uncertain_ends`: these are mostly pieces of true roots, whose ends others hide. They stay, without a tip.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.roots.proof import Proof
from rhizotwin.recon.tubes.tubes import Index, Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FLANK_PX = 1.0
"""The spheres that stand for taproot and hypocotyl are not as precise as tubes, nor is the end at the rim of
sight: this much about them is theirs."""
_EXPLAINED = 0.5
"""A branch ends where it explains less than this of what would be unexplained without it, where it covers: it is a
ghost."""
_EXPLAINED_PX = 1.0
"""... or less than this squared coverage, in pixels of all views together: nothing tells of it."""
_END_NODES = 3
"""Nodes of an end that are weighed together: 2 mm."""
_INSIDE = 0.9
"""Share of a root's radius within which another centre line is its own."""
_SHARED = 0.3
"""A branch that explains for itself a smaller part of what it covers may be a second tube of a root, or a ghost among
roots."""
_THINNER = 0.5
"""A root whose beginning is thinner than this share of the rest begins elsewhere: roots taper towards their tips."""
_SHORT_MM = 1.5
"""Branches that stand out less than this must prove that their neighbours, fitted without them, leave them
unexplained."""
_LONG_MM, _TIP_NODES = 8.0, 5
"""The tips of longer ends are tips, whatever speaks against them; what a tip leaves is that of its last nodes."""
_FREE_MM, _OF_FREE, _OF_LEFT, _LEAST_TIMES = 1.0, 0.25, 0.1, 0.25
"""A tip that stands free by a millimetre is as good as one that a quarter more of shows; leaving e times as much as
usual, a tenth less."""
_CERTAIN = 0.15
"""With less evidence a tip is none: here as many true ones are lost as false ones stay (see
docs/decisions/tubes-for-thin-roots.md)."""


def flanked(tubes: Tubes, organ: Mask) -> Mask:
    """Tell the nodes (N,) about which `FLANK_PX` more belong to them.

    Taproot and hypocotyl, and the top, where the plant goes out of sight.
    """
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
    """Tell the nodes (N,) that lie inside an earlier branch, or on an organ's flank or about the top.

    Second paths along the same root.

    Parameters
    ----------
    flank_mm : float
        `FLANK_PX` in mm.
    """
    centre, owner = tubes.centre_mm, tubes.owner
    reach = np.where(flanked(tubes, organ), tubes.radius_mm + flank_mm, _INSIDE * tubes.radius_mm)
    # by thick roots many, their own nodes among them
    held = cKDTree(centre).query_ball_point(centre, reach, workers=-1)
    node = np.concatenate([np.asarray(nodes, np.int64) for nodes in held])
    host = np.repeat(np.arange(len(centre)), [len(nodes) for nodes in held])
    inside = np.zeros(len(centre), bool)
    inside[node[owner[host] < owner[node]]] = True
    return inside


def unproven(tubes: Tubes, proved: Proof, organ: Mask) -> Mask:
    """Tell the nodes (N,) from the beginnings of branches that together explain only a small part of what they cover.

    Second tubes of a root, ghosts among roots, and detours beside other roots to where a branch truly begins.
    """
    found = np.zeros(len(tubes.radius_mm), bool)
    for k in range(1, len(tubes.branches)):
        own = tubes.own(k)
        little = np.flatnonzero(np.cumsum(proved.explained[own]) < _SHARED * np.cumsum(proved.alone[own]))
        first, rest = np.split(own, [little.max(initial=-1) + 1])
        if not len(rest) or (len(first) and np.median(tubes.radius_mm[first]) < _THINNER * np.median(tubes.radius_mm[rest])):
            found[first] = True
    return found & ~organ


def short_leaves(tubes: Tubes, organ: Mask) -> Mask:
    """Tell the nodes (N,) of short branches that bear none: they may be an artefact of their neighbours."""
    gone = np.zeros(len(organ), bool)
    for k, line in _standing(tubes):
        if len(line) == len(tubes.branches[k]) and _length(tubes, line) < _SHORT_MM + tubes.radius_mm[line[0]]:
            gone[line[1:]] = True
    return gone & ~organ


def uncertain_ends(tubes: Tubes, visible: Array, proved: Proof, organ: Mask) -> Mask:
    """Tell the nodes (N,) of ends, from a branch's last lateral to its tip, whose tips are likely none.

    Three things speak for a tip: that no other root hides it, that it stands free of others, and that it leaves little
    of what lies about it unexplained, compared with what tips usually leave (noise and blur count for all of them).
    They are weighed together, as a false tip may pass in one of them. What stands out of its parent by less than its
    own diameter is a bulge and has no tip, whatever speaks for it.

    Parameters
    ----------
    visible : (N,) float64 array
        Share of each node, over all views, that no other hides.
    """
    gone = np.zeros(len(organ), bool)
    ends = _standing(tubes)
    if not ends:
        return gone
    owner, radius, near = tubes.owner, tubes.radius_mm, cKDTree(tubes.centre_mm)
    share, free_mm = np.zeros(len(ends)), np.full(len(ends), _FREE_MM)
    for number, (k, line) in enumerate(ends):
        last = line[1:][-_TIP_NODES:]
        share[number] = proved.left[last].sum() / max(float((proved.explained + proved.left)[last].sum()), 1e-6)
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
        if _is_bulge(tubes, k, line):  # on taproot and hypocotyl too
            gone[line[1:]] = True
    return gone


def _is_bulge(tubes: Tubes, branch: int, line: Index) -> bool:
    """Tell whether an end is a whole branch that stands out by less than its own diameter."""
    whole = len(line) == len(tubes.branches[branch])
    return whole and _length(tubes, line) - float(tubes.radius_mm[line[0]]) < 2.0 * float(tubes.radius_mm[line[1:]].mean())


def _standing(tubes: Tubes) -> list[tuple[int, Index]]:
    """Return the branches but the first that go on beyond their last lateral, with the nodes of their ends."""
    return [(k, line) for k, line in enumerate(tubes.ends) if k > 0 and len(line) > 1]


def _length(tubes: Tubes, line: Index) -> float:
    """Return the length of a line of nodes (n,), mm."""
    return polyline.length_mm(tubes.centre_mm[line])
