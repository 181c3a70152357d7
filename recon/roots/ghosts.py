"""Detection of tube nodes that are not parts of roots.

Three kinds of nodes are detected: nodes of ghosts, which explain no pixels, nodes of duplicates, which lie inside other
tubes, and nodes of short ends without evidence. Each function returns a mask (N,) of the nodes to be removed, which
`Tubes.prune_mask` converts to cuts from the tips. The exception is `find_uncertain_ends`, whose nodes are mostly parts
of real roots with hidden ends. They are kept, but their ends are not counted as tips.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from rhizotwin.recon.roots.node_support import Support
from rhizotwin.recon.tubes.branch_graph import Index
from rhizotwin.recon.tubes.tubes import SPACING_MM, Tubes
from rhizotwin.scenes import polyline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FLANK_PX = 1.0
"""Margin added to the radius of some nodes in the search for duplicates, px. It applies to taproot and hypocotyl, whose
spheres are less precise than tubes, and to the first node of the tree, where the root leaves the field of view."""
EXPLAINED = 0.5
"""Minimum ratio of the squared coverage that a node explains to the sum of explained and residual squared coverage in
its pixels. A node with a lower ratio is part of a ghost."""
_EXPLAINED_PX = 1.0
"""Minimum squared coverage that a node must explain, integrated across the root and summed over all views, px."""
_END_NODES = 3
"""Number of neighbouring nodes over which explained and residual coverage are averaged. Three nodes represent a length
of 2 mm."""
_INVISIBLE_PX, _TAPER = 0.25, 0.25
"""Diameter below which a root covers less than the blur at the edges of others varies, px, and maximum ratio of the
radius to the largest one of the branch. A node below both is not a part of the root: a line of 0.16 px wound for 40 mm
around roots of the print after a root of 13 px had ended. In eleven other reconstructions, one node of 50,000
is below both."""
_INSIDE = 0.9
"""Fraction of a root's radius within which another centre line is a duplicate of the root."""
_WIDE_NODES = 3
"""Number of nodes, up to the one where a branch bends, of which the largest radius is used: behind a bend, a branch
becomes thinner."""
_THIN, _THINNEST, _ENCLOSED = 0.5, 0.35, 0.6
"""Maximum ratio of the radius of a branch to that of another root, and minimum fraction of its nodes inside thicker
roots, for the branch to be an artefact of an outline. In 20 reconstructions, a ghost of 22 mm has a fraction of 0.94.
Of branches below the second ratio, nodes within `_OUTLINE_PX` count: of 34, 30 had no true tip within 1 mm."""
_OUTLINE_PX = 1.7
"""Distance from an outline at which a blur of 0.85 px has decayed (two standard deviations), px."""
_SHARED = 0.3
"""Minimum fraction of its squared coverage that the beginning of a branch must explain in addition to all other tubes.
With a lower fraction, it is a duplicate of a root or a ghost among roots."""
_THINNER = 0.5
"""Minimum ratio of the radius of a weakly supported beginning of a branch to the radius of the rest of the branch. A
thinner beginning is a detour of the traced path, since roots taper towards their tips."""
_SHORT_MM = 1.5
"""Minimum length by which a branch must protrude from its parent to be kept without a test, mm. A shorter branch is
kept only if its pixels remain unexplained after its neighbours have been fitted without it."""
_LONG_MM, _TIP_NODES = 8.0, 5
"""Length above which the end of a branch is always accepted as a root tip, mm, and number of last nodes from which the
residual at a tip is computed."""
_THICKER, _LONGEST = 1.5, 2.0
"""Minimum ratio of the radius of a nodule to that of its parent, and maximum length as a multiple of its diameter."""
_FREE_MM, _OF_FREE, _OF_LEFT, _LEAST_TIMES = 1.0, 0.25, 0.1, 0.25
"""Parameters of the evidence for a tip, which is v + 0.25 d - 0.1 ln(r + 0.25). Here, v is the visible fraction of the
last node. d is its distance from the surface of other roots, limited to 1 mm. r is the residual at the tip as a
fraction of the squared coverage, relative to the median over all ends."""
_CERTAIN = 0.15
"""Minimum evidence for a tip. At this threshold, the numbers of rejected true tips and accepted false tips are equal
(docs/decisions/root-tree.md)."""


def find_margin_nodes(tubes: Tubes, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes whose radius is increased by `FLANK_PX` in the search for duplicates.

    These are the nodes of taproot and hypocotyl, and the first node of the tree, where the root leaves the field of
    view.
    """
    top = np.zeros(len(organ), bool)
    top[tubes.branches[0][0]] = True
    return organ | top


def find_ghosts(tubes: Tubes, proved: Support, organ: Mask, px_a_mm: float) -> Mask:
    """Return the mask (N,) of nodes of ghosts, which explain too little of the coverage in their pixels.

    Explained and residual coverage are averaged over neighbouring nodes of the same branch. Nodes that are too thin to
    be visible are also ghosts, if the rest of their branch is much thicker.

    Parameters
    ----------
    px_a_mm : float
        Image scale at the centre of the water, px/mm.
    """
    gone = np.zeros(len(organ), bool)
    for k in range(len(tubes.branches)):
        own = tubes.own(k)
        explained, left = (
            np.convolve(np.pad(value[own], _END_NODES // 2, mode="edge"), np.full(_END_NODES, 1.0 / _END_NODES), "valid")
            for value in (proved.explained, proved.residual)
        )
        radius = tubes.radius_mm[own]
        thin = (2.0 * radius * px_a_mm < _INVISIBLE_PX) & (radius < _TAPER * radius.max(initial=0.0))
        if thin.sum() > 0.5 * len(thin):  # nothing leads to the rest
            thin[:] = True
        gone[own] = (explained < EXPLAINED * (explained + left)) | (explained < _EXPLAINED_PX) | thin
    return gone & ~organ


def find_overlapping(tubes: Tubes, organ: Mask, px_a_mm: float) -> Mask:
    """Return the mask (N,) of nodes inside other tubes, or in ends that fold back.

    Parameters
    ----------
    organ : (N,) bool array
        Nodes of taproot and hypocotyl.
    px_a_mm : float
        Image scale at the centre of the water, px/mm.
    """
    flank_mm, outline_mm = FLANK_PX / px_a_mm, _OUTLINE_PX / px_a_mm
    enclosed = find_enclosed(tubes, flank_mm) | find_enclosed(tubes, outline_mm, thin=_THINNEST)
    return find_duplicates(tubes, organ, flank_mm) | enclosed | find_folded(tubes)


def find_duplicates(tubes: Tubes, organ: Mask, flank_mm: float) -> Mask:
    """Return the mask (N,) of nodes that lie inside a branch with a lower index.

    Around taproot, hypocotyl and the first node of the tree, nodes within a margin are included. All these nodes are
    parts of a second path along the same root.

    Parameters
    ----------
    flank_mm : float
        Margin `FLANK_PX` converted to mm.
    """
    owner, inside = tubes.owner, np.zeros(len(organ), bool)
    reach = np.where(find_margin_nodes(tubes, organ), tubes.radius_mm + flank_mm, _INSIDE * tubes.radius_mm)
    node, host = _nodes_within(tubes, reach)
    inside[node[owner[host] < owner[node]]] = True
    return inside


def find_enclosed(tubes: Tubes, flank_mm: float, *, thin: float = _THIN) -> Mask:
    """Return the mask (N,) of branches whose centre lines lie inside much thicker roots.

    Two roots cannot occupy the same place. Such a branch compensates for an error in the outline of the thick root.

    Parameters
    ----------
    flank_mm : float
        Margin around the thick roots, mm.
    thin : float
        Maximum ratio of the radius of the branch to that of a thick root.
    """
    owner, enclosed = tubes.owner, np.zeros(len(tubes.radius_mm), bool)
    radius = np.array([np.median(tubes.radius_mm[tubes.own(k)]) for k in range(len(tubes.branches))])[owner]
    node, host = _nodes_within(tubes, tubes.radius_mm + flank_mm)
    enclosed[node[(radius[node] < thin * tubes.radius_mm[host]) & (owner[host] != owner[node]) & (owner[node] > 0)]] = True
    return np.asarray((np.bincount(owner, enclosed) >= _ENCLOSED * np.bincount(owner))[owner])


def find_folded(tubes: Tubes) -> Mask:
    """Return the mask (N,) of nodes at the ends of branches beyond a bend that no tube can have.

    No tube has a centre line with a radius of curvature below its own radius, since it would overlap itself. Where a
    branch extends beyond the tip of its root, it turns back into the root, or winds around its end. Thin roots that
    leave a bulb bend as well, but protrude from it before they are once around it.
    """
    folded = np.zeros(len(tubes.radius_mm), bool)
    for line in tubes.branches:
        points, radius = tubes.centre_mm[line], tubes.radius_mm[line]
        wide, way = maximum_filter1d(radius, _WIDE_NODES, origin=_WIDE_NODES // 2), polyline.arc_length_mm(points)
        before = points - polyline.interpolate(points, way, way - wide)
        after = polyline.interpolate(points, way, way + wide) - points
        straight = np.sum(polyline.unit_vectors(before) * polyline.unit_vectors(after), axis=1)
        resolved = (wide > SPACING_MM) & (way > radius[0] + wide) & (way < way[-1])
        for bend in np.flatnonzero(resolved & (straight < np.cos(1.0))).tolist():
            outside_mm = cdist(points[bend:], points[: bend + 1]) - radius[: bend + 1]
            around = max(wide[bend], radius[outside_mm[0].argmin()])  # within a bulb, it is that of the bulb
            outside_mm = outside_mm[1:][way[bend + 1 :] - way[bend] < 2.0 * np.pi * around]
            if outside_mm.min(axis=1).max() < _SHORT_MM:
                folded[line[bend + 1 :]] = True
                break
    return folded


def _nodes_within(tubes: Tubes, reach_mm: Array) -> tuple[Index, Index]:
    """Return the pairs (M,) of a node and a host, in which the node is within the host's reach (N,), mm.

    Each node is also paired with itself.
    """
    held = cKDTree(tubes.centre_mm).query_ball_point(tubes.centre_mm, reach_mm, workers=-1)
    node = np.concatenate([np.asarray(nodes, np.int64) for nodes in held])
    return node, np.repeat(np.arange(len(held)), [len(nodes) for nodes in held])


def find_unsupported_starts(tubes: Tubes, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes at the beginning of branches whose coverage is mostly explained by other tubes.

    Such nodes are parts of a second tube along the same root, of a ghost among roots, or of a detour along another
    root.
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
    """Return the mask (N,) of nodes of short branches without laterals.

    Such branches may compensate for errors of neighbouring branches and are therefore tested.
    """
    gone = np.zeros(len(organ), bool)
    for k, line in _free_ends(tubes):
        if len(line) == len(tubes.branches[k]) and _length(tubes, line) < _SHORT_MM + tubes.radius_mm[line[0]]:
            gone[line[1:]] = True
    return gone & ~organ


def find_uncertain_ends(tubes: Tubes, visible: Array, proved: Support, organ: Mask) -> Mask:
    """Return the mask (N,) of nodes at branch ends that are probably not root tips.

    An end comprises the nodes from a branch's last lateral to its last node. The evidence for a tip combines three
    measures, since a false tip may pass any single measure: the fraction of the last node that other roots do not hide,
    its distance from other roots, and the residual around it. The residual is compared with that of other ends, which
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
        if _protrudes(tubes, k, line) < 2.0 * radius[line[1:]].mean():  # also on taproot and hypocotyl
            gone[line[1:]] = True
    return gone


def find_nodules(tubes: Tubes) -> Mask:
    """Return the mask (N,) of nodes of nodules: short branches that are thicker than their parents.

    Roots taper from base to tip and from parent to lateral. Nodules and other swellings are parts of the plant, but not
    roots.
    """
    nodule = np.zeros(len(tubes.radius_mm), bool)
    for k, line in _free_ends(tubes):
        thick_mm = float(np.median(tubes.radius_mm[line[1:]]))
        is_thicker = thick_mm > _THICKER * float(tubes.radius_mm[line[0]])
        nodule[line[1:]] = is_thicker and _protrudes(tubes, k, line) < _LONGEST * 2.0 * thick_mm
    return nodule


def _protrudes(tubes: Tubes, branch: int, line: Index) -> float:
    """Return the length by which an end protrudes from its parent, mm; infinite if it is not the whole branch."""
    whole = len(line) == len(tubes.branches[branch])
    return _length(tubes, line) - float(tubes.radius_mm[line[0]]) if whole else np.inf


def _free_ends(tubes: Tubes) -> list[tuple[int, Index]]:
    """Return the part of each branch beyond its last lateral, as branch index and nodes.

    The first branch, and branches that end at their last lateral, are omitted.
    """
    return [(k, line) for k, line in enumerate(tubes.ends) if k > 0 and len(line) > 1]


def _length(tubes: Tubes, line: Index) -> float:
    """Return the length of a chain of nodes (n,), mm."""
    return polyline.length_mm(tubes.centre_mm[line])
