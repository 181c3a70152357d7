"""One solid from tubes and thick organs: the tubes' volume painted into the finest nodes of the trimmed hull's lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.hull.carve import Leaves
from rhizotwin.recon.hull.parsimony import even
from rhizotwin.recon.roots.rooting import RootSystem
from rhizotwin.recon.tubes.tubes import Index, Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_LEAST_SAMPLES = 6
_DENSE_MM = 0.15
_NEAR = 24
_THICK_MM = 0.5
"""Tubes of more than this radius are few: they are looked up by themselves."""
_SAMPLES_A_NODE = 1.8
_FINEST_SPACING_MM = 0.05
_SLACK_PX = 0.05
"""Uncertainty of a tube's radius that the volume's bounds allow for."""


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
    """(M,) how far along its branch."""


def fill(tubes: Tubes, spacing_mm: float, *, left_out: Mask | None = None) -> Filled:
    """Fill the union of tubes with points some ``spacing_mm`` apart: where branches overlap, the later one's points are left out."""
    filled = fill_each(tubes, spacing_mm, left_out=left_out)
    earlier = np.zeros(len(filled.branch), bool)
    point, other, _ = within(tubes, filled.point_mm, filled.branch)
    earlier[point[other < filled.branch[point]]] = True
    return Filled(filled.point_mm[~earlier], filled.volume_mm3[~earlier], filled.branch[~earlier], filled.along_mm[~earlier])


def fill_each(tubes: Tubes, spacing_mm: float, *, left_out: Mask | None = None) -> Filled:
    """Fill every tube for itself with points some ``spacing_mm`` apart, overlaps and all.

    Every cross-section is a sunflower (Vogel 1979, Math. Biosci. 44:179).

    Parameters
    ----------
    left_out : (N,) nodes; segments between two of them are not filled.
    """
    a, b = tubes.segments.T
    branch = np.repeat(np.arange(len(tubes.branches)), [len(nodes) - 1 for nodes in tubes.branches])
    r_a, r_b = tubes.segment_radii
    length = np.linalg.norm(tubes.centre_mm[b] - tubes.centre_mm[a], axis=1)
    before = np.cumsum(length) - length
    before -= before[np.searchsorted(branch, branch)]
    if left_out is not None:
        stays = ~(left_out[a] & left_out[b])
        a, b, r_a, r_b, branch, length, before = (of[stays] for of in (a, b, r_a, r_b, branch, length, before))
    slices = np.maximum(np.ceil(length / spacing_mm), 1).astype(np.int64)
    segment, part = _counted(slices)
    share = (part + 0.5) / slices[segment]
    radius = r_a[segment] + share * (r_b - r_a)[segment]
    count = np.maximum(np.ceil(np.pi * radius**2 / spacing_mm**2), _LEAST_SAMPLES).astype(np.int64)
    disc, place = _counted(count)
    at, turn = radius[disc] * np.sqrt((place + 0.5) / count[disc]), _GOLDEN * (place + 0.61 * disc)
    along, side, up = _frames(tubes.centre_mm[b] - tubes.centre_mm[a])
    of = segment[disc]
    point = tubes.centre_mm[a][of] + share[disc, None] * along[of]
    point += at[:, None] * (np.cos(turn)[:, None] * side[of] + np.sin(turn)[:, None] * up[of])
    volume = (np.pi * radius**2 * (length / slices)[segment] / count)[disc]
    return Filled(point, volume, branch[of], before[of] + (share * length[segment])[disc])


def _counted(count: Index) -> tuple[Index, Index]:
    """Return, for things that come ``count`` times each, the thing and the time."""
    thing = np.repeat(np.arange(len(count)), count)
    return thing, np.arange(len(thing)) - np.repeat(np.cumsum(count) - count, count)


def _frames(along: Array) -> tuple[Array, Array, Array]:
    """Return vectors (S, 3) and two unit vectors across each."""
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    other = np.where(np.abs(unit[:, 2:]) < 0.8, np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    side = np.cross(unit, other)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return along, side, np.cross(unit, side)


def within(tubes: Tubes, point: Array, branch: Index) -> tuple[Index, Index, Array]:
    """Find which points (M, 3) of branches (M,) lie inside other branches.

    Returns
    -------
    point, other : (K,) a point and a branch it lies in.
    along_mm : (K,) how far along that branch.
    """
    centre, radius, owner, along = _dense(tubes)
    pairs: list[tuple[Index, Index]] = []
    # only points near two branches need a closer look: those whose node's neighbourhood holds another branch
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
    doubted = np.flatnonzero(mixed[tree.query(point, workers=-1)[1]]) if len(point) else np.zeros(0, np.int64)
    for part in (np.flatnonzero(thick), np.flatnonzero(~thick)):
        if not len(part) or not len(doubted):
            continue
        tree, width = cKDTree(centre[part]), radius[part]
        distance, near = tree.query(point[doubted], k=list(range(1, min(_NEAR, tree.n) + 1)), distance_upper_bound=width.max(), workers=-1)
        near = np.minimum(near, tree.n - 1)  # farther ones come as infinitely far
        row, column = np.nonzero((distance < width[near]) & (owner[part][near] != branch[doubted][:, None]))
        pairs.append((doubted[row], part[near[row, column]]))
    if not pairs:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    inside, node = (np.concatenate(found) for found in zip(*pairs, strict=True))
    return inside, owner[node], along[node]


def _dense(tubes: Tubes) -> tuple[Array, Array, Index, Array]:
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


@dataclass(frozen=True)
class United:
    """Thick organs and tubes as one solid."""

    leaves: Leaves
    """On the lattice of the trimmed hull."""
    thick_mm3: float
    """Volume of the thick organs alone."""
    thinner_mm3: float
    """What the tubes lose where all radii are smaller by `_SLACK_PX`."""
    thicker_mm3: float
    """What they gain where all are larger."""


def unite(solid: Leaves, system: RootSystem) -> United:
    """Unite the thick organs, the part of a trimmed hull within a margin of core points, with tubes.

    Where both are, a node is as full as the fuller of the two.
    """
    size_mm, tubes = solid.grid.size_mm, system.tubes
    spacing_mm = max(size_mm / _SAMPLES_A_NODE, _FINEST_SPACING_MM)
    filled = fill(tubes, spacing_mm, left_out=system.buried)
    thick = _near(solid, system.core_mm, system.margin_mm)
    slack_mm = _SLACK_PX / system.px_a_mm
    free = np.where(system.buried, 0.0, tubes.radius_mm)
    length = np.linalg.norm(np.diff(tubes.centre_mm[tubes.segments], axis=1)[:, 0], axis=1)
    radius = free[tubes.segments[:, 1]]
    thinner = float(np.pi * length @ (radius**2 - np.maximum(radius - slack_mm, 0.0) ** 2))
    thicker = float(np.pi * length @ ((radius + slack_mm) ** 2 - radius**2))
    return United(_painted(thick, filled), thick.volume_mm3(), thinner, thicker)


def _near(solid: Leaves, core_mm: Array, margin_mm: float) -> Leaves:
    """Return the leaves within a margin of core points."""
    if len(core_mm):
        size_mm = solid.grid.size_mm
        centre = np.asarray(solid.grid.origin_mm) + (solid.index + 0.5 * solid.size[:, None]) * size_mm
        kept = cKDTree(core_mm).query(centre, workers=-1)[0] < margin_mm + 0.5 * size_mm * (solid.size - 1)
    else:
        kept = np.zeros(len(solid.size), bool)
    return Leaves(solid.grid, solid.index[kept], solid.size[kept], solid.occupancy[kept])


def _painted(thick: Leaves, filled: Filled) -> Leaves:
    """Add filled tubes to leaves; leaves larger than a node are full already."""
    large = thick.size > 1
    fine = thick.index[~large].astype(np.int64)
    coarse = even(thick.index[large], thick.size[large]).astype(np.int64)
    at = np.floor((filled.point_mm - np.asarray(thick.grid.origin_mm)) / thick.grid.size_mm).astype(np.int64)
    everything = np.concatenate([at, fine, coarse])
    if not len(everything):
        return thick
    low = everything.min(axis=0)
    span = everything.max(axis=0) - low + 1
    weights = np.array([span[1] * span[2], span[2], 1])
    keys, inverse = np.unique((np.concatenate([at, fine]) - low) @ weights, return_inverse=True)
    tube = np.bincount(inverse[: len(at)], weights=filled.volume_mm3 / thick.grid.size_mm**3, minlength=len(keys)).astype(np.float64)
    organ = np.zeros(len(keys))
    organ[inverse[len(at) :]] = thick.occupancy[~large]
    occupancy = np.maximum(levelled(tube), organ)
    new = (occupancy > 0) & ~np.isin(keys, (coarse - low) @ weights)
    index = np.stack([keys // weights[0], keys // weights[1] % span[1], keys % span[2]], axis=1) + low
    return Leaves(
        thick.grid,
        np.concatenate([thick.index[large], index[new].astype(np.int32)]),
        np.concatenate([thick.size[large], np.ones(int(new.sum()), np.int32)]),
        np.concatenate([thick.occupancy[large], occupancy[new].astype(np.float32)]),
    )


def levelled(occupancy: Array) -> Array:
    """Return occupancies (N,) of at most 1 with the same sum: what sampling put too much into full nodes goes to the others."""
    factor, total = 1.0, float(occupancy.sum())
    for _ in range(5):
        factor *= total / max(float(np.minimum(factor * occupancy, 1.0).sum()), 1e-12)
    return np.minimum(factor * occupancy, 1.0)
