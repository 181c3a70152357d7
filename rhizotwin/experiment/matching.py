"""Track roots over time, and determine their day of emergence and their growth.

The centre line of a root includes its centre line on an earlier day, by which the root is recognised. The score of a
pair of a known root and a root of the current day is the length of the known centre line that lies on the current root.
Pairs are assigned so that the sum of scores is maximal (DynamicRoots, Symonova et al. 2015, matches overlapping voxels
in a similar way). Unmatched roots are new.
"""

from collections.abc import Collection, Sequence
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
"""Minimum fraction of the length of an earlier root that must lie on a root of the current day for the two to be
matched."""
RESIDUALS = 4.0
"""Maximum distance between a point and a root on which it lies, as a multiple of the median residual of the
alignment."""
LEAST_ON_MM = 0.5
"""Lower limit, mm, of the maximum distance between a point and a root on which it lies. It is the sum of the diameter
of a fine root and the tracing error, which are about one voxel each."""
LEAST_COSINE = 0.7
"""Minimum absolute cosine of the angle between two centre lines at matching points, equivalent to an angle of 45
degrees. It prevents matches between crossing roots."""


@dataclass(frozen=True, kw_only=True)
class Day:
    """Roots of a plant on one day."""

    day: float
    """Day of the experiment."""
    roots: tuple[Root, ...]
    """Roots, sorted with parents before children."""


@dataclass(frozen=True, kw_only=True)
class RootState:
    """Geometry of a root on one day in the frame of the first day, with its length and mean diameter."""

    day: float
    """Day of the experiment."""
    root: Root
    """Centre line and diameters, in the frame of the first day."""
    length_mm: float
    """Length of the centre line, mm."""
    diameter_mm: float
    """Mean diameter, mm, of the part of the root that existed at its first observation. Changes of this diameter are
    due to radial growth."""


@dataclass
class Track:
    """Root tracked over time."""

    name: str
    """Name of the root, which is the same on all days."""
    parent: str
    """Name of the parent root. It is empty if the root has no parent."""
    order: int
    """Branching order of the root. It is 0 if the root has no parent."""
    states: list[RootState] = field(default_factory=list)
    """Observations of the root in chronological order."""
    absent_day: float = 0.0
    """Day of the last scan before the root appeared. It is zero if the root was present in the first scan."""

    def limit_to(self, days: Collection[float]) -> "Track | None":
        """Return the track as if only the scans on the given days existed. It is None if they do not show the root."""
        states = [state for state in self.states if state.day in days]
        if not states:
            return None
        return replace(self, states=states, absent_day=max((day for day in days if day < states[0].day), default=0.0))

    @property
    def rates_mm_per_day(self) -> list[tuple[float, float, float]]:
        """Elongation rates between consecutive observations.

        An entry consists of the first day, the last day and the rate in mm/day.
        """
        return [(a.day, b.day, (b.length_mm - a.length_mm) / (b.day - a.day)) for a, b in pairwise(self.states)]

    @property
    def emergence_day(self) -> float:
        """Day of emergence.

        It is extrapolated to a length of zero with the first elongation rate. The day lies between the last scan
        without the root and the first scan with the root, and is the middle of both if there is no positive elongation
        rate.
        """
        first = self.states[0]
        rate = self.rates_mm_per_day[0][2] if len(self.states) > 1 else 0.0
        began = first.day - first.length_mm / rate if rate > 0.0 else (self.absent_day + first.day) / 2.0
        return float(np.clip(began, self.absent_day, first.day))


@dataclass(frozen=True, kw_only=True)
class TrackedPlant:
    """Plant whose roots were tracked over several days."""

    days: tuple[Day, ...]
    """Roots on each day, in the frame of the first day."""
    names: tuple[tuple[str, ...], ...]
    """Names of the roots on each day, in the same order as ``Day.roots``."""
    tracks: tuple[Track, ...]
    """All roots of the plant over time."""
    residual_mm: tuple[float, ...]
    """Residual of the alignment of each day after the first with the preceding days, mm."""


def track_roots(days: Sequence[Day]) -> TrackedPlant:
    """Match the roots of a plant between days and return their tracks.

    Parameters
    ----------
    days : sequence of Day
        Roots of a plant in ascending order of days, with at least one root per day.
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
            here = _align_day(now, found)
            on_mm = max(LEAST_ON_MM, RESIDUALS * found.residual_mm)
            residuals.append(found.residual_mm)
        known = _match_roots(list(latest.values()), here.roots, on_mm)
        own = [list(latest)[known[k]] if k in known else "" for k in range(len(here.roots))]
        for k, root in enumerate(here.roots):
            if not own[k]:
                parent = own[root.parent] if root.parent >= 0 else ""
                own[k] = _new_name(tracks, parent)
                tracks[own[k]] = Track(name=own[k], parent=parent, order=root.order, absent_day=moved[-1].day if moved else 0.0)
            track = tracks[own[k]]
            first_mm = track.states[0].length_mm if track.states else np.inf
            length_mm = polyline.length_mm(root.points_mm)
            diameter_mm = _basal_diameter_mm(root, first_mm)
            track.states.append(RootState(day=now.day, root=root, length_mm=length_mm, diameter_mm=diameter_mm))
            latest[own[k]] = root
        moved.append(here)
        names.append(tuple(own))
    return TrackedPlant(days=tuple(moved), names=tuple(names), tracks=tuple(tracks.values()), residual_mm=tuple(residuals))


@dataclass(frozen=True)
class _Points:
    """Sample points on the centre lines of all roots found on one day."""

    points: Array
    """Sample points (N, 3), mm."""
    along: Array
    """Unit vector (N, 3) along the centre line at each point."""
    owner: NDArray[np.int64]
    """Index (N,) of the root on which each point lies."""

    @classmethod
    def of(cls, roots: Sequence[Root]) -> "_Points":
        sampled = [points_of(root) for root in roots]
        owner = np.repeat(np.arange(len(roots)), [len(points) for points, _ in sampled])
        return cls(np.concatenate([points for points, _ in sampled]), np.concatenate([along for _, along in sampled]), owner)


def _align_day(day: Day, aligned: Aligned) -> Day:
    return replace(day, roots=tuple(replace(root, points_mm=aligned.of(root.points_mm)) for root in day.roots))


def _match_roots(known: Sequence[Root], today: Sequence[Root], on_mm: float) -> dict[int, int]:
    """Match the roots of two days.

    Return the index of the earlier root, keyed by the index of the root of the current day.
    """
    if not known:
        return {}
    mine, theirs = _Points.of(known), _Points.of(today)
    near = cKDTree(mine.points).sparse_distance_matrix(cKDTree(theirs.points), on_mm, output_type="ndarray")
    a, b, away = near["i"], near["j"], near["v"]
    along = np.abs(np.sum(mine.along[a] * theirs.along[b], axis=1)) >= LEAST_COSINE
    a = a[along]
    b = b[along]
    worth = 1.0 - 0.5 * away[along] / on_mm
    best = np.zeros(len(mine.points) * len(today))  # maximum score of each known point on each current root
    np.maximum.at(best, a * len(today) + theirs.owner[b], worth)
    score = np.zeros((len(known), len(today)))
    np.add.at(score, mine.owner, best.reshape(-1, len(today)))
    length = np.array([polyline.length_mm(root.points_mm) for root in known]) + STEP_MM
    # scores are weighted by length, because short centre lines may lie on a root by chance
    score *= (length / np.bincount(mine.owner, minlength=len(known)))[:, None]
    rows, columns = linear_sum_assignment(-score)
    least = 0.5 * LEAST_SHARE * length  # the score of a point at the maximum distance is one half
    return {int(j): int(i) for i, j in zip(rows, columns, strict=True) if score[i, j] >= least[i]}


def _new_name(tracks: dict[str, Track], parent: str) -> str:
    """Return the name of a new root.

    It consists of the parent's name and the number of the lateral in order of appearance.
    """
    count = sum(track.parent == parent for track in tracks.values())
    return f"{parent}.{count + 1}" if parent else str(count + 1)


def _basal_diameter_mm(root: Root, first_mm: float) -> float:
    """Return the mean diameter of a root, mm, over the distance ``first_mm`` from its base."""
    step = polyline.steps_mm(root.points_mm)
    way = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, min(first_mm, float(way[-1])), 20)
    return float(np.interp(at, way, root.diameters_mm).mean())
