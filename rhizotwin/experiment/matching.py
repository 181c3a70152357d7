"""Roots through time: which root of today is which of yesterday, when it came, and how it grows.

A root is known by where it runs: the older root holds the younger's line. Each pair of an old identity and a root of
today has a score, the length of the known line that lies on today's root; the pairs are chosen so that the sum of
scores is the largest (DynamicRoots, Symonova et al. 2015, matches overlapping voxels in the same spirit). What nobody
knew is new.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from rhizotwin.experiment.alignment import STEP_MM, Aligned, align, points_of
from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

LEAST_SHARE = 0.5
"""Of a known line that must lie on a root for it to be the same."""
RESIDUALS = 4.0
"""A point lies on a root nearer than so many median residuals of the alignment ..."""
LEAST_ON_MM = 0.5
"""... and at least this: a fine root's diameter and the trace's error, about a voxel each."""
LEAST_COSINE = 0.7
"""And runs within 45 degrees of it: roots that cross are two."""


@dataclass(frozen=True, kw_only=True)
class Day:
    """A plant's roots on one day."""

    day: float
    roots: tuple[Root, ...]
    """Parents before children."""


@dataclass(frozen=True, kw_only=True)
class Sight:
    """A root as it was on one day, in the frame of the first day."""

    day: float
    root: Root
    length_mm: float
    diameter_mm: float
    """Mean over the length that it had when it was first seen: its growth is growth in diameter."""


@dataclass
class Track:
    """A root through time."""

    name: str
    """The same on all days."""
    parent: str
    """Name of the root that it hangs on; empty for a taproot."""
    order: int
    sights: list[Sight] = field(default_factory=list)
    absent_day: float = 0.0
    """The last day on which it was not there yet; 0 where it was there on the first."""

    @property
    def rates_mm_per_day(self) -> list[tuple[float, float, float]]:
        """Return from when, to when, and by how much a day it grew longer, between sights."""
        return [(a.day, b.day, (b.length_mm - a.length_mm) / (b.day - a.day)) for a, b in pairwise(self.sights)]

    @property
    def emergence_day(self) -> float:
        """Return the day on which its length began, by its first rate.

        Between the last day without it and the first with it.
        """
        first = self.sights[0]
        rate = self.rates_mm_per_day[0][2] if len(self.sights) > 1 else 0.0
        began = first.day - first.length_mm / rate if rate > 0.0 else (self.absent_day + first.day) / 2.0
        return float(np.clip(began, self.absent_day, first.day))


@dataclass(frozen=True, kw_only=True)
class Followed:
    """A plant followed through its days."""

    days: tuple[Day, ...]
    """In the first day's frame."""
    names: tuple[tuple[str, ...], ...]
    """Of each day's roots."""
    tracks: tuple[Track, ...]
    residual_mm: tuple[float, ...]
    """Of each alignment with the day before."""


def follow(days: Sequence[Day]) -> Followed:
    """Give every root an identity through time.

    Parameters
    ----------
    days : sequence of Day
        Of one plant, the youngest first, each with at least one root.
    """
    tracks: dict[str, Track] = {}
    latest: dict[str, Root] = {}
    moved: list[Day] = []
    names: list[tuple[str, ...]] = []
    residuals: list[float] = []
    for now in days:
        here, on_mm = now, LEAST_ON_MM
        if moved:
            found = align([latest[name] for name in latest], now.roots)
            here, on_mm = _moved(now, found), max(LEAST_ON_MM, RESIDUALS * found.residual_mm)
            residuals.append(found.residual_mm)
        known = _same(list(latest.values()), here.roots, on_mm)
        own = [list(latest)[known[k]] if k in known else "" for k in range(len(here.roots))]
        for k, root in enumerate(here.roots):
            if not own[k]:
                parent = own[root.parent] if root.parent >= 0 else ""
                own[k] = _new_name(tracks, parent)
                tracks[own[k]] = Track(name=own[k], parent=parent, order=root.order, absent_day=moved[-1].day if moved else 0.0)
            track = tracks[own[k]]
            first_mm = track.sights[0].length_mm if track.sights else np.inf
            length_mm, diameter_mm = polyline.length_mm(root.points_mm), _diameter(root, first_mm)
            track.sights.append(Sight(day=now.day, root=root, length_mm=length_mm, diameter_mm=diameter_mm))
            latest[own[k]] = root
        moved.append(here)
        names.append(tuple(own))
    return Followed(days=tuple(moved), names=tuple(names), tracks=tuple(tracks.values()), residual_mm=tuple(residuals))


@dataclass(frozen=True)
class _Points:
    """All roots as points."""

    points: Array
    """(N, 3)"""
    along: Array
    """(N, 3) unit directions."""
    owner: NDArray[np.int64]
    """(N,) index of the root."""

    @classmethod
    def of(cls, roots: Sequence[Root]) -> "_Points":
        sampled = [points_of(root) for root in roots]
        owner = np.repeat(np.arange(len(roots)), [len(points) for points, _ in sampled])
        return cls(np.concatenate([points for points, _ in sampled]), np.concatenate([along for _, along in sampled]), owner)


def _moved(day: Day, aligned: Aligned) -> Day:
    return replace(day, roots=tuple(replace(root, points_mm=aligned.of(root.points_mm)) for root in day.roots))


def _same(known: Sequence[Root], today: Sequence[Root], on_mm: float) -> dict[int, int]:
    """Return which known root each of today's is, by index, for those that one is."""
    if not known:
        return {}
    mine, theirs = _Points.of(known), _Points.of(today)
    near = cKDTree(mine.points).sparse_distance_matrix(cKDTree(theirs.points), on_mm, output_type="ndarray")
    a, b, away = near["i"], near["j"], near["v"]
    along = np.abs(np.sum(mine.along[a] * theirs.along[b], axis=1)) >= LEAST_COSINE
    a, b, worth = a[along], b[along], 1.0 - 0.5 * away[along] / on_mm
    best = np.zeros(len(mine.points) * len(today))  # of each known point on each of today's roots
    np.maximum.at(best, a * len(today) + theirs.owner[b], worth)
    score = np.zeros((len(known), len(today)))
    np.add.at(score, mine.owner, best.reshape(-1, len(today)))
    length = np.array([polyline.length_mm(root.points_mm) for root in known]) + STEP_MM
    # a short line may lie on a root by chance: length counts
    score *= (length / np.bincount(mine.owner, minlength=len(known)))[:, None]
    rows, columns = linear_sum_assignment(-score)
    least = 0.5 * LEAST_SHARE * length  # a point at the farthest allowed is worth a half
    return {int(j): int(i) for i, j in zip(rows, columns, strict=True) if score[i, j] >= least[i]}


def _new_name(tracks: dict[str, Track], parent: str) -> str:
    """Return a name that tells the parent and which of its laterals a root is, in the order of appearance."""
    count = sum(track.parent == parent for track in tracks.values())
    return f"{parent}.{count + 1}" if parent else str(count + 1)


def _diameter(root: Root, first_mm: float) -> float:
    """Return the mean diameter over the first part of a root."""
    step = polyline.steps_mm(root.points_mm)
    way = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, min(first_mm, float(way[-1])), 20)
    return float(np.interp(at, way, root.diameters_mm).mean())
