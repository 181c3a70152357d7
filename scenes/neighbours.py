"""Spatial relation of root systems that share a canister: contact, proximity and common space.

Two roots are in contact if their surfaces meet. The zone of a root extends to `ZONE_MM` from its surface. This is about
the width of the zone in which roots take up immobile nutrients and exchange exudates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError, cKDTree

from rhizotwin.scenes.assessment import Verdict
from rhizotwin.scenes.rsml import Root, sample_centre_lines
from rhizotwin.scenes.traits import DEPTH_BIN_MM

Array = NDArray[np.float64]

ZONE_MM = 2.0
_STEP_MM = 0.25
"""Distance between the points at which centre lines are compared, mm. It is half the diameter of a fine root."""
_OTHERS = 16
"""Number of nearest points on the other plant to which a point is compared. The nearest centre line is not always that
of the root with the nearest surface."""


@dataclass(frozen=True, kw_only=True)
class Neighbours:
    """Comparison of two plants in one canister. In each pair of values, the first is that of the first plant."""

    plants: tuple[str, str]
    nearest_mm: float
    """Minimum distance between the root surfaces of the two plants, mm. It is 0 if they touch."""
    contact_mm: tuple[float, float]
    """Length of the roots of each plant that are in contact with the other plant, mm."""
    zone_mm: tuple[float, float]
    """Length of the roots of each plant whose distance from the other plant is at most `ZONE_MM`, mm."""
    zone_share: tuple[float, float]
    """Ratio of `zone_mm` to the root length of each plant."""
    zone_share_by_depth: tuple[tuple[float, ...], tuple[float, ...]]
    """Value `zone_share` in each depth bin of 10 mm. The first bin begins at the top of the higher plant. The value is
    0 in bins without roots."""
    hulls_overlap_mm3: float
    """Volume of the intersection of the two convex hulls, mm3."""
    hulls_overlap_share: tuple[float, float]
    """Ratio of `hulls_overlap_mm3` to the volume of the convex hull of each plant."""

    def lines(self, verdict: Verdict) -> list[str]:
        """Format the comparison as lines of text.

        Parameters
        ----------
        verdict : Verdict
            Verdict on the length of the roots, on which all values depend. The first line states it unless it is
            "reliable".
        """
        (a, b), percent = self.plants, [f"{100.0 * share:.1f} %" for share in self.zone_share]
        nearest = "their roots touch" if self.nearest_mm == 0.0 else f"the minimum distance of their roots is {self.nearest_mm:.2f} mm"
        shares = [f"{100.0 * share:.0f} %" for share in self.hulls_overlap_share]
        return [
            f"{a} and {b}{'' if verdict == 'reliable' else f' ({verdict})'}: {nearest}",
            f"  length in contact: {self.contact_mm[0]:.1f} mm of {a}, {self.contact_mm[1]:.1f} mm of {b}",
            f"  length within {ZONE_MM:g} mm of the other plant: {percent[0]} of {a}, {percent[1]} of {b}",
            f"  intersection of the convex hulls: {self.hulls_overlap_mm3 / 1000.0:.3g} ml, {shares[0]} of the hull of {a}, {shares[1]} "
            f"of the hull of {b}",
        ]


HEAD = (
    "plant",
    "other",
    "nearest_mm",
    "contact_mm",
    "zone_mm",
    "zone_share",
    "hulls_overlap_mm3",
    "hulls_overlap_share",
    "depth_from_mm",
    "depth_zone_share",
)
"""Column names of the table returned by `rows`."""


def rows(found: Sequence[Neighbours]) -> list[list[str]]:
    """Return table rows for each ordered pair of plants.

    The first row is for all depths, and the others are for one depth bin each.
    """
    made = []
    for one in found:
        for k in (0, 1):
            pair = [one.plants[k], one.plants[1 - k]]
            numbers = (
                one.nearest_mm,
                one.contact_mm[k],
                one.zone_mm[k],
                one.zone_share[k],
                one.hulls_overlap_mm3,
                one.hulls_overlap_share[k],
            )
            made.append([*pair, *(f"{number:.6g}" for number in numbers), "", ""])
            blank = [""] * len(numbers)
            made += [[*pair, *blank, f"{DEPTH_BIN_MM * bin_:g}", f"{share:.6g}"] for bin_, share in enumerate(one.zone_share_by_depth[k])]
    return made


def find_neighbours(roots: Sequence[Root]) -> tuple[Neighbours, ...]:
    """Compare every pair of plants in a canister.

    Parameters
    ----------
    roots : sequence of Root
        Roots of all plants, with the names of their plants. Roots without a plant's name are ignored.

    Returns
    -------
    tuple of Neighbours
        Comparison of each pair, in the order of the plants; empty if there are fewer than two plants.
    """
    names = list(dict.fromkeys(root.plant for root in roots if root.plant))
    plants = {name: _Plant.of([root for root in roots if root.plant == name]) for name in names}
    return tuple(_pair(a, plants[a], b, plants[b]) for a, b in combinations(names, 2))


@dataclass(frozen=True)
class _Plant:
    points_mm: Array
    """Points along the centre lines, mm, shape (P, 3)."""
    radius_mm: Array
    length_mm: Array
    """Length of the piece of centre line that each point represents, mm, shape (P,)."""
    tree: cKDTree

    @staticmethod
    def of(roots: Sequence[Root]) -> _Plant:
        along = sample_centre_lines(roots, _STEP_MM)
        return _Plant(along.points_mm, along.radius_mm, along.length_mm, cKDTree(along.points_mm))

    def away_mm(self, other: _Plant) -> Array:
        """Return the distance from this plant's surface to that of the other plant at each of its P points, mm.

        It is 0 where the plants touch.
        """
        count = min(_OTHERS, len(other.points_mm))
        away, nearest = other.tree.query(self.points_mm, k=count)
        away, nearest = away.reshape(-1, count), nearest.reshape(-1, count)
        return np.maximum((away - other.radius_mm[nearest]).min(axis=1) - self.radius_mm, 0.0)


def _pair(name_a: str, a: _Plant, name_b: str, b: _Plant) -> Neighbours:
    away = a.away_mm(b), b.away_mm(a)
    top_mm = float(max(a.points_mm[:, 2].max(), b.points_mm[:, 2].max()))
    lengths = a.length_mm, b.length_mm
    contact, zone = ([float(length[d <= most].sum()) for length, d in zip(lengths, away, strict=True)] for most in (0.0, ZONE_MM))
    total = [float(length.sum()) for length in lengths]
    by_depth = [_by_depth(one, d, top_mm) for one, d in zip((a, b), away, strict=True)]
    common_mm3, share_a, share_b = _common_hull(a.points_mm, b.points_mm)
    return Neighbours(
        plants=(name_a, name_b),
        nearest_mm=float(min(away[0].min(), away[1].min())),
        contact_mm=(contact[0], contact[1]),
        zone_mm=(zone[0], zone[1]),
        zone_share=(zone[0] / total[0], zone[1] / total[1]),
        zone_share_by_depth=(by_depth[0], by_depth[1]),
        hulls_overlap_mm3=common_mm3,
        hulls_overlap_share=(share_a, share_b),
    )


def _by_depth(plant: _Plant, away_mm: Array, top_mm: float) -> tuple[float, ...]:
    index = np.floor((top_mm - plant.points_mm[:, 2]) / DEPTH_BIN_MM).astype(np.int64)
    total = np.bincount(index, weights=plant.length_mm)
    near = np.bincount(index, weights=np.where(away_mm <= ZONE_MM, plant.length_mm, 0.0), minlength=len(total))
    return tuple(float(share) for share in np.divide(near, total, out=np.zeros_like(total), where=total > 0.0))


def _common_hull(a: Array, b: Array) -> tuple[float, float, float]:
    """Return the volume of the intersection of two convex hulls, mm3, and its ratio to the volume of each hull.

    All values are 0 if a hull is flat or the hulls are disjoint.
    """
    try:
        hulls = ConvexHull(a), ConvexHull(b)
    except (QhullError, ValueError):
        return 0.0, 0.0, 0.0
    planes = np.concatenate([hull.equations for hull in hulls])
    # centre of the largest ball inside both hulls, which is the point with the greatest distance from all planes
    found = linprog(
        [0.0, 0.0, 0.0, -1.0], A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]), b_ub=-planes[:, 3], bounds=(None, None)
    )
    if not found.success or found.x[3] <= 1e-9:
        return 0.0, 0.0, 0.0
    volume = float(ConvexHull(HalfspaceIntersection(planes, found.x[:3]).intersections).volume)
    return volume, volume / float(hulls[0].volume), volume / float(hulls[1].volume)
