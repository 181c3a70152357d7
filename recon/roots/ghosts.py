"""Detection of tube nodes that are not parts of roots.

These are ghosts, which explain no pixels, duplicates inside other tubes, and short ends without evidence. Each function
returns a mask (N,) of the nodes to be removed, which `Tubes.prune_mask` converts to cuts from the tips. The exception
is `find_uncertain_ends`, whose nodes are mostly parts of real roots with hidden ends. They are kept, but their ends are
not counted as tips.
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
"""Margin around taproot and hypocotyl, whose spheres are less precise than tubes, and around the root's upper end where
it leaves the field of view, px."""
_EXPLAINED = 0.5
"""Minimum fraction of the coverage in the pixels of a branch that the branch must explain. Below this fraction, the
rest of the branch is a ghost."""
_EXPLAINED_PX = 1.0
"""Minimum squared coverage that a node must explain, summed over all views, px."""
_END_NODES = 3
"""Number of nodes over which the evidence is averaged, which corresponds to 2 mm."""
_INSIDE = 0.9
"""Fraction of a root's radius within which another centre line is a duplicate of the root."""
_SHARED = 0.3
"""Minimum fraction of its coverage that a branch must explain without other branches. Below this fraction, the branch
is a duplicate of a root or a ghost among roots."""
_THINNER = 0.5
"""Minimum ratio between the radius at the beginning of a root and the radius of its remainder. A thinner beginning is a
detour, since roots taper towards their tips."""
_SHORT_MM = 1.5
"""Minimum length by which a branch must protrude from its parent, mm. A shorter branch is kept only if its neighbours,
fitted without it, leave its pixels unexplained."""
_LONG_MM, _TIP_NODES = 8.0, 5
"""Length of an end above which its tip is always accepted, mm, and number of last nodes over which the residual at a
tip is computed."""
_FREE_MM, _OF_FREE, _OF_LEFT, _LEAST_TIMES = 1.0, 0.25, 0.1, 0.25
"""Parameters of the evidence for a tip: a distance of 1 mm to other roots counts as much as an additional visibility of
a quarter, and a residual larger than usual by a factor of e reduces the evidence by a tenth. The last value is added to
the relative residual to bound its logarithm."""
_CERTAIN = 0.15
"""Minimum evidence for a tip. At this threshold, the numbers of rejected true tips and accepted false tips are equal
(docs/decisions/tubes-for-thin-roots.md)."""


def find_margin_nodes(tubes: Tubes, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes that are surrounded by the margin `FLANK_PX`.

    These are the nodes of taproot and hypocotyl, and the upper end of the plant, where it leaves the field of view.
    """
    top = np.zeros(len(organ), bool)
    top[tubes.branches[0][0]] = True
    return organ | top


def find_ghosts(tubes: Tubes, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes that explain no pixels by themselves.

    The explained coverage is averaged over neighbouring nodes of the same branch.
    """
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
    """Return the mask (N,) of nodes that lie inside an earlier branch.

    Around taproot, hypocotyl and the upper end of the plant, nodes within a margin are included. All these nodes are
    parts of a second path along the same root.

    Parameters
    ----------
    flank_mm : float
        Margin `FLANK_PX` converted to mm.
    """
    centre, owner = tubes.centre_mm, tubes.owner
    reach = np.where(find_margin_nodes(tubes, organ), tubes.radius_mm + flank_mm, _INSIDE * tubes.radius_mm)
    # A node near a thick root has many neighbours, including nodes of its own branch.
    held = cKDTree(centre).query_ball_point(centre, reach, workers=-1)
    node = np.concatenate([np.asarray(nodes, np.int64) for nodes in held])
    host = np.repeat(np.arange(len(centre)), [len(nodes) for nodes in held])
    inside = np.zeros(len(centre), bool)
    inside[node[owner[host] < owner[node]]] = True
    return inside


def find_unsupported_starts(tubes: Tubes, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes at the beginning of branches that explain too little of their own coverage.

    Such nodes are parts of second tubes along a root, of ghosts among roots, and of detours along other roots.
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
    """Return the mask (N,) of nodes of short branches without laterals, which may be artefacts of their neighbours."""
    gone = np.zeros(len(organ), bool)
    for k, line in _free_ends(tubes):
        if len(line) == len(tubes.branches[k]) and _length(tubes, line) < _SHORT_MM + tubes.radius_mm[line[0]]:
            gone[line[1:]] = True
    return gone & ~organ


def find_uncertain_ends(tubes: Tubes, visible: Array, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes at branch ends that are probably not root tips.

    An end comprises the nodes from a branch's last lateral to its last node. The evidence for a tip combines three
    measures, since a false tip may pass any single measure: the fraction of the end that other roots do not hide, its
    distance from other roots, and the residual around it. The residual is compared with that of other ends, which
    accounts for noise and blur. An end that protrudes from its parent by less than its own diameter is a bulge and
    never a tip.

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
    """Return whether an end is a whole branch that protrudes from its parent by less than its own diameter."""
    whole = len(line) == len(tubes.branches[branch])
    return whole and _length(tubes, line) - float(tubes.radius_mm[line[0]]) < 2.0 * float(tubes.radius_mm[line[1:]].mean())


def _free_ends(tubes: Tubes) -> list[tuple[int, Index]]:
    """Return index and end nodes of each branch, except the first, that continues beyond its last lateral."""
    return [(k, line) for k, line in enumerate(tubes.ends) if k > 0 and len(line) > 1]


def _length(tubes: Tubes, line: Index) -> float:
    """Return the length of a chain of nodes (n,), mm."""
    return polyline.length_mm(tubes.centre_mm[line])
