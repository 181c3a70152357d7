"""Tubes filled with points that stand for parts of their volume, overlaps counted once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.tubes.tubes import Index, Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""The golden angle, rad."""
_UPRIGHT = 0.8
"""A direction less upright than this (37 degrees) has a side at right angles to the z axis; others one to the x
axis."""
_LEAST_SAMPLES = 6
"""Points of a cross-section, however thin."""
_DENSE_MM = 0.15
"""Spacing of the points on all branches that tell what lies inside of them."""
_NEAR = 24
"""Such points that are looked at about a place."""
_AT_ONCE = 100_000
"""Points that are made, and places that are looked about, at once: 40 MB of distances and neighbours."""
_THICK_MM = 0.5
"""Tubes of more than this radius are few: they are looked up by themselves."""


@dataclass(frozen=True)
class Filled:
    """Points that fill tubes evenly."""

    point_mm: Array
    """(M, 3)"""
    volume_mm3: Array
    """(M,) the part of the tubes that each stands for."""
    branch: Index
    """(M,)"""
    along_mm: Array
    """(M,) how far along its branch, that of the last node in its round tip."""

    def chosen(self, which: Mask) -> Filled:
        """Return some of them (M,)."""
        return Filled(*(getattr(self, field.name)[which] for field in fields(self)))


def fill(tubes: Tubes, spacing_mm: float, *, left_out: Mask | None = None) -> Filled:
    """Fill the union of tubes, less nodes (N,) that are left out, with points some ``spacing_mm`` apart."""
    others, kept = _Dense.of(tubes), list[Filled]()
    for filled in _filled(tubes, spacing_mm, left_out):
        earlier = np.zeros(len(filled.branch), bool)
        point, other, _ = others.holding(filled.point_mm, filled.branch)
        earlier[point[other < filled.branch[point]]] = True
        kept.append(filled.chosen(~earlier))
    return _joined(kept)


def fill_each(tubes: Tubes, spacing_mm: float) -> Filled:
    """Fill every tube for itself with points some ``spacing_mm`` apart, overlaps and all."""
    return _joined(list(_filled(tubes, spacing_mm, None)))


def within(tubes: Tubes, point: Array, branch: Index) -> tuple[Index, Index, Array]:
    """Find which points (M, 3) of branches (M,) lie inside other branches.

    Returns
    -------
    point, other : (K,) int64 array
        A point and a branch it lies in.
    along_mm : (K,) float64 array
        How far along that branch.
    """
    others, found = _Dense.of(tubes), list[tuple[Index, Index, Array]]()
    for begin in range(0, max(len(point), 1), _AT_ONCE):
        inside, other, along = others.holding(point[begin : begin + _AT_ONCE], branch[begin : begin + _AT_ONCE])
        found.append((begin + inside, other, along))
    inside, other, along = (np.concatenate(part) for part in zip(*found, strict=True))
    return inside, other, along


def _joined(parts: list[Filled]) -> Filled:
    return Filled(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Filled)))


def _filled(tubes: Tubes, spacing_mm: float, left_out: Mask | None) -> Iterator[Filled]:
    """Fill every tube for itself with points some ``spacing_mm`` apart, overlaps and all; `_AT_ONCE` of them at a time.

    Every cross-section is a sunflower (Vogel 1979, Math. Biosci. 44:179).

    Parameters
    ----------
    left_out : (N,) bool array or None
        Nodes; segments between two of them are not filled.
    """
    piece = _pieces(tubes)
    if left_out is not None:
        piece = piece.chosen(np.flatnonzero(~left_out[piece.nodes].all(axis=1)))
    length = np.linalg.norm(piece.way_mm, axis=1)
    slices = np.maximum(np.ceil(length / spacing_mm), 1).astype(np.int64)
    segment, part = _counted(slices)
    share = (part + 0.5) / slices[segment]
    # of a cap's slice the mean square of the radius, so that its volume is exact
    square = np.where(piece.is_cap[segment], 1.0 - share**2 - 1.0 / (12.0 * slices[segment] ** 2), 1.0)
    first, last = piece.radii_mm[segment].T
    radius = (first + share * (last - first)) * np.sqrt(square)
    count = np.maximum(np.ceil(np.pi * radius**2 / spacing_mm**2), _LEAST_SAMPLES).astype(np.int64)
    each_mm3 = np.pi * radius**2 * (length / slices)[segment] / count
    reached = piece.along_mm[segment] + np.where(piece.is_cap[segment], 0.0, share * length[segment])
    along, side, up = _frames(piece.way_mm)
    ends = np.cumsum(count)
    for discs in np.split(np.arange(len(count)), np.searchsorted(ends, np.arange(_AT_ONCE, count.sum(), _AT_ONCE))):
        number, place = _counted(count[discs])
        disc = discs[number]
        at, turn = radius[disc] * np.sqrt((place + 0.5) / count[disc]), _GOLDEN * (place + 0.61 * disc)  # neighbours are turned
        of = segment[disc]
        point = piece.begin_mm[of] + share[disc, None] * along[of]
        point += at[:, None] * (np.cos(turn)[:, None] * side[of] + np.sin(turn)[:, None] * up[of])
        yield Filled(point, each_mm3[disc], piece.branch[of], reached[disc])


@dataclass(frozen=True)
class _Pieces:
    """Segments of tubes, and the round tips after them."""

    nodes: Index
    """(P, 2) at both ends; of a tip twice the last one."""
    begin_mm: Array
    """(P, 3)"""
    way_mm: Array
    """(P, 3) from there to the end; a tip is as long as its radius."""
    radii_mm: Array
    """(P, 2) at both ends."""
    branch: Index
    """(P,)"""
    along_mm: Array
    """(P,) how far along its branch it begins."""
    is_cap: Mask
    """(P,)"""

    def chosen(self, which: Index) -> _Pieces:
        """Return some of them."""
        return _Pieces(*(getattr(self, field.name)[which] for field in fields(self)))


def _pieces(tubes: Tubes) -> _Pieces:
    """Cut tubes into segments and round tips."""
    nodes, radii = tubes.segments, np.stack(tubes.segment_radii, axis=1)
    branch = np.repeat(np.arange(len(tubes.branches)), [len(nodes) - 1 for nodes in tubes.branches])
    way = tubes.centre_mm[nodes[:, 1]] - tubes.centre_mm[nodes[:, 0]]
    length = np.linalg.norm(way, axis=1)
    end = np.cumsum(length)
    begin = end - length
    begin, end = (of - begin[np.searchsorted(branch, branch)] for of in (begin, end))
    last = np.flatnonzero(tubes.segment_neighbours[:, 1] == nodes[:, 1])
    tip, radius = nodes[last, 1], radii[last, 1]
    return _Pieces(
        nodes=np.concatenate([nodes, np.stack([tip, tip], axis=1)]),
        begin_mm=np.concatenate([tubes.centre_mm[nodes[:, 0]], tubes.centre_mm[tip]]),
        way_mm=np.concatenate([way, way[last] * (radius / np.maximum(length[last], 1e-12))[:, None]]),
        radii_mm=np.concatenate([radii, np.stack([radius, radius], axis=1)]),
        branch=np.concatenate([branch, branch[last]]),
        along_mm=np.concatenate([begin, end[last]]),
        is_cap=np.repeat([False, True], [len(nodes), len(last)]),
    )


def _counted(count: Index) -> tuple[Index, Index]:
    """Return, for things that come ``count`` times each, the thing and the time."""
    thing = np.repeat(np.arange(len(count)), count)
    return thing, np.arange(len(thing)) - np.repeat(np.cumsum(count) - count, count)


def _frames(along: Array) -> tuple[Array, Array, Array]:
    """Return vectors (S, 3) and two unit vectors across each."""
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    other = np.where(np.abs(unit[:, 2:]) < _UPRIGHT, np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    side = np.cross(unit, other)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return along, side, np.cross(unit, side)


@dataclass(frozen=True)
class _Dense:
    """Points (P, 3) close together on all branches, that tell what lies inside of these."""

    centre_mm: Array
    radius_mm: Array
    """(P,)"""
    branch: Index
    """(P,)"""
    along_mm: Array
    """(P,) how far along it."""
    mixed: Mask
    """(P,) those about which there may be another branch: points near no others need no closer look."""

    tree: cKDTree
    parts: tuple[tuple[Index, cKDTree], ...]
    """The thick ones and the others, each with a tree: the radius of the thickest bounds the search."""

    @staticmethod
    def of(tubes: Tubes) -> _Dense:
        """Put points on tubes."""
        centre, radius, owner, along = _on_branches(tubes)
        tree, thick = cKDTree(centre), radius > _THICK_MM
        reach = 2.0 * min(float(np.quantile(radius, 0.99)) + _DENSE_MM, _THICK_MM)
        mixed = np.zeros(len(centre), bool)
        close = tree.query_pairs(reach, output_type="ndarray")
        close = close[owner[close[:, 0]] != owner[close[:, 1]]]
        mixed[close.ravel()] = True
        if thick.any():
            apart = cKDTree(centre[thick]).sparse_distance_matrix(tree, 2.0 * (float(radius.max()) + _DENSE_MM), output_type="ndarray")
            one, other = np.flatnonzero(thick)[apart["i"]], apart["j"]
            touch = (apart["v"] < radius[one] + radius[other] + 2.0 * _DENSE_MM) & (owner[one] != owner[other])
            mixed[one[touch]] = mixed[other[touch]] = True
        parts = tuple((part, cKDTree(centre[part])) for part in (np.flatnonzero(thick), np.flatnonzero(~thick)) if len(part))
        return _Dense(centre, radius, owner, along, mixed, tree, parts)

    def holding(self, point: Array, branch: Index) -> tuple[Index, Index, Array]:
        """Find which points (M, 3) of branches (M,) lie inside other branches, as `within`."""
        pairs = [np.zeros((2, 0), np.int64)]
        unproven = np.flatnonzero(self.mixed[self.tree.query(point, workers=-1)[1]]) if len(point) else np.zeros(0, np.int64)
        for part, tree in self.parts if len(unproven) else ():
            width = self.radius_mm[part]
            numbers = list(range(1, min(_NEAR, tree.n) + 1))
            distance, near = tree.query(point[unproven], k=numbers, distance_upper_bound=width.max(), workers=-1)
            near = np.minimum(near, tree.n - 1)  # farther ones come as infinitely far
            row, column = np.nonzero((distance < width[near]) & (self.branch[part][near] != branch[unproven][:, None]))
            pairs.append(np.stack([unproven[row], part[near[row, column]]]))
        inside, node = np.concatenate(pairs, axis=1)
        return inside, self.branch[node], self.along_mm[node]


def _on_branches(tubes: Tubes) -> tuple[Array, Array, Index, Array]:
    """Return points (P, 3) close together on all branches, with radius (P,), branch (P,) and how far along it (P,)."""
    centres, radii, owners, ways = list[Array](), list[Array](), list[Index](), list[Array]()
    for k, nodes in enumerate(tubes.branches):
        line, radius = tubes.centre_mm[nodes], tubes.radii(k)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / _DENSE_MM)) + 1)
        centres.append(np.stack([np.interp(at, along, line[:, axis]) for axis in range(3)], axis=1))
        radii.append(np.interp(at, along, radius))
        owners.append(np.full(len(at), k))
        ways.append(at)
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(owners), np.concatenate(ways)


def levelled(occupancy: Array) -> Array:
    """Return occupancies (N,) of at most 1 with the same sum.

    What sampling put too much into full nodes goes to the others, in proportion.
    """
    falling = np.sort(occupancy)[::-1]
    full = np.arange(len(falling))  # so many of them are full, with the factor that the others then have
    rest = np.cumsum(occupancy[np.argsort(occupancy)])[::-1]
    factor = np.maximum(rest[:1] - full, 0.0) / np.maximum(rest, 1e-12)
    enough = np.flatnonzero(factor * falling <= 1.0)
    return np.minimum((factor[enough[0]] if len(enough) else 1.0) * occupancy, 1.0)
