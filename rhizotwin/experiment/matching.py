"""Tracking of roots over time: identity across days, day of emergence, and growth.

A root is recognised by its course, because the older root includes the younger root's centre line. The score of a known
root and a root of the current day is the length of the known centre line that lies on the current root. Pairs are
assigned so that the sum of scores is maximal (DynamicRoots, Symonova et al. 2015, matches overlapping voxels in a
similar way). Roots without a match are new.
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
"""Minimum fraction of a known centre line that must lie on a root for a match."""
RESIDUALS = 4.0
"""A point lies on a root within this multiple of the median residual of the alignment ..."""
LEAST_ON_MM = 0.5
"""... and at least within this distance: diameter of a fine root plus tracing error, about one voxel each."""
LEAST_COSINE = 0.7
"""Maximum angle of 45 degrees between directions, so that crossing roots are distinguished."""


@dataclass(frozen=True, kw_only=True)
class Day:
    """Roots of a plant on one day."""

    day: float
    roots: tuple[Root, ...]
    """Roots, parents before children."""


@dataclass(frozen=True, kw_only=True)
class RootState:
    """State of a root on one day, in the frame of the first day."""

    day: float
    root: Root
    length_mm: float
    diameter_mm: float
    """Mean diameter over the length at the first observation, so that its change is radial growth."""


@dataclass
class Track:
    """A root tracked over time."""

    name: str
    """Name of the root, the same on all days."""
    parent: str
    """Name of the parent root; empty for a taproot."""
    order: int
    states: list[RootState] = field(default_factory=list)
    absent_day: float = 0.0
    """Last day before the root appeared; 0 if it was present on the first day."""

    @property
    def rates_mm_per_day(self) -> list[tuple[float, float, float]]:
        """Return start day, end day and elongation per day between observations."""
        return [(a.day, b.day, (b.length_mm - a.length_mm) / (b.day - a.day)) for a, b in pairwise(self.states)]

    @property
    def emergence_day(self) -> float:
        """Day of emergence, extrapolated to length zero with the first elongation rate.

        It is limited to the interval between the last day without the root and the first day with it.
        """
        first = self.states[0]
        rate = self.rates_mm_per_day[0][2] if len(self.states) > 1 else 0.0
        began = first.day - first.length_mm / rate if rate > 0.0 else (self.absent_day + first.day) / 2.0
        return float(np.clip(began, self.absent_day, first.day))


@dataclass(frozen=True, kw_only=True)
class TrackedPlant:
    """A plant whose roots were tracked over several days."""

    days: tuple[Day, ...]
    """Days, in the frame of the first one."""
    names: tuple[tuple[str, ...], ...]
    """Names of the roots of each day."""
    tracks: tuple[Track, ...]
    residual_mm: tuple[float, ...]
    """Residual of each alignment with the preceding day."""


def track_roots(days: Sequence[Day]) -> TrackedPlant:
    """Assign an identity over time to each root.

    Parameters
    ----------
    days : sequence of Day
        Days of one plant in ascending order, each with at least one root.
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
            first_mm = track.states[0].length_mm if track.states else np.inf
            length_mm, diameter_mm = polyline.length_mm(root.points_mm), _diameter(root, first_mm)
            track.states.append(RootState(day=now.day, root=root, length_mm=length_mm, diameter_mm=diameter_mm))
            latest[own[k]] = root
        moved.append(here)
        names.append(tuple(own))
    return TrackedPlant(days=tuple(moved), names=tuple(names), tracks=tuple(tracks.values()), residual_mm=tuple(residuals))


@dataclass(frozen=True)
class _Points:
    """All roots as sample points."""

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
    """Map each matched root of the current day to its index among the known roots."""
    if not known:
        return {}
    mine, theirs = _Points.of(known), _Points.of(today)
    near = cKDTree(mine.points).sparse_distance_matrix(cKDTree(theirs.points), on_mm, output_type="ndarray")
    a, b, away = near["i"], near["j"], near["v"]
    along = np.abs(np.sum(mine.along[a] * theirs.along[b], axis=1)) >= LEAST_COSINE
    a, b, worth = a[along], b[along], 1.0 - 0.5 * away[along] / on_mm
    best = np.zeros(len(mine.points) * len(today))  # best score of each known point on each current root
    np.maximum.at(best, a * len(today) + theirs.owner[b], worth)
    score = np.zeros((len(known), len(today)))
    np.add.at(score, mine.owner, best.reshape(-1, len(today)))
    length = np.array([polyline.length_mm(root.points_mm) for root in known]) + STEP_MM
    # short centre lines may lie on a root by chance, so that scores are weighted by length
    score *= (length / np.bincount(mine.owner, minlength=len(known)))[:, None]
    rows, columns = linear_sum_assignment(-score)
    least = 0.5 * LEAST_SHARE * length  # a point at the maximum distance scores one half
    return {int(j): int(i) for i, j in zip(rows, columns, strict=True) if score[i, j] >= least[i]}


def _new_name(tracks: dict[str, Track], parent: str) -> str:
    """Return a name composed of the parent's name and the number of the lateral in order of appearance."""
    count = sum(track.parent == parent for track in tracks.values())
    return f"{parent}.{count + 1}" if parent else str(count + 1)


def _diameter(root: Root, first_mm: float) -> float:
    """Return the mean diameter over the basal part of a root."""
    step = polyline.steps_mm(root.points_mm)
    way = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, min(first_mm, float(way[-1])), 20)
    return float(np.interp(at, way, root.diameters_mm).mean())
