"""Traits of a root system, computed from its centre lines and its solid by standard definitions.

The same code is used for truth and results. The definitions are those of GiA Roots (Galkovskyi et al. 2012, BMC Plant
Biology 12:116, table 1), extended from pictures to three dimensions as in Rangarajan et al. 2021 (Plant Phenomics
2021:6953197, table 1). Branches and their angles are defined as in DynamicRoots (Symonova et al. 2015, PLoS ONE
10:e0127657). `scenes.trait_table` contains the definitions in words.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline
from rhizotwin.scenes.rsml import Root, sample_centre_lines

Array = NDArray[np.float64]

SLICE_MM = 1.0
"""Distance between the horizontal planes in which roots are counted, mm."""
MOST_PERCENT = 84.0
"""Percentile of the root counts that is used as their maximum (GiA Roots). It is robust against a single whorl of
laterals."""
UPPER_SHARE = 1.0 / 3.0
"""Depth at which the lower part of a root system begins, as a fraction of the total depth (GiA Roots)."""
EMERGENCE_MM = 5.0
"""Length of a lateral over which its angle to the parent is measured, mm."""
ROOT_G_PER_ML = (0.5, 1.5)
"""Plausible range of the fresh mass per volume of roots, g/ml. Roots of wetland plants contain up to about one half of
gas (Justin and Armstrong 1987, New Phytologist 106:465), and nothing in a root is denser than cellulose (1.5 g/ml)."""
DEPTH_BIN_MM = 10.0
DIAMETER_BIN_MM = 0.1
"""Width of the bins of the histogram over diameter, mm. It is half a pixel at 800x600 pixels. The width of the bins
over depth is 10 mm."""


def density_note(g_per_ml: float) -> str:
    """Return words about a fresh root mass per volume outside `ROOT_G_PER_ML`, and about the units that may be wrong.

    They are empty if the value is plausible.
    """
    low, high = ROOT_G_PER_ML
    if low <= g_per_ml <= high:
        return ""
    slips = {1e-3: "g under a heading in mg, or mm3 under one in ml", 1e3: "mg under a heading in g, or ml under one in mm3"}
    cause = next((f" ({words})" for factor, words in slips.items() if low <= g_per_ml / factor <= high), "")
    return f"{g_per_ml:.2g} g/ml, outside {low:g} to {high:g} g/ml; check the units of masses and volumes{cause}"


@dataclass(frozen=True, kw_only=True)
class Traits:
    """Traits of a root system. Depth is measured downwards from the highest point of the solid.

    If centre lines are unknown, the traits that depend on them are None, and the histograms are empty.
    """

    total_length_mm: float | None
    volume_mm3: float
    surface_mm2: float
    """Surface area of the solid, mm2."""
    mean_diameter_mm: float | None
    """Mean diameter, weighted by length, mm."""
    median_diameter_mm: float | None
    """Median diameter, weighted by length, mm."""
    max_diameter_mm: float | None
    depth_mm: float
    """Vertical extent, mm."""
    width_mm: float
    """Largest horizontal distance between two points, mm."""
    convex_hull_mm3: float
    solidity: float
    """Ratio of the volume of the roots to the volume of their convex hull."""
    max_root_count: float | None
    """84th percentile of the number of roots that cross horizontal planes."""
    median_root_count: float | None
    bushiness: float | None
    """Ratio of ``max_root_count`` to ``median_root_count``."""
    lower_length_share: float | None
    """Fraction of the root length that is in the lower two thirds of the depth."""
    roots: int | None
    tips: int | None
    branch_points: int | None
    """Number of points at which laterals emerge, one for each lateral."""
    length_by_order_mm: tuple[float, ...]
    """Total length of the roots of each order, mm. The first order is that of the taproots."""
    length_by_depth_mm: tuple[float, ...]
    """Root length in each depth bin of 10 mm, mm. The first bin begins at the highest point."""
    length_by_diameter_mm: tuple[float, ...]
    """Root length in each diameter bin of 0.1 mm, mm. The first bin begins at 0."""
    angle_to_gravity_deg: float | None
    """Mean angle between the direction of growth and straight down, weighted by length, deg."""
    angle_to_parent_deg: float | None
    """Mean angle between the first 5 mm of a lateral and its parent, deg. It is None if there are no laterals."""
    specific_root_length_m_per_g: float | None = None
    """Ratio of the total length to the given mass, m/g. It is None if no mass is given."""
    tissue_density_g_per_ml: float | None = None
    """Ratio of the given mass to the volume, g/ml. It is None if no mass is given."""
    tortuosity: float | None = None
    """Ratio of the total length to the sum of the distances between base and tip of all roots."""
    branch_distance_mm: float | None = None
    """Mean distance between successive branch points of a root without a parent, mm. It is None if none has two."""
    lateral_density_per_cm: float | None = None
    """Number of laterals of roots without a parent, per length of their zones from the first to the last branch point,
    1/cm (Dubrovsky and Forde 2012, Plant Cell 24:4). Zones of laterals, most of which bear a few laterals of a few
    millimetres, are not included."""
    width_by_depth_mm: tuple[float, ...] = ()
    """Largest horizontal distance between two centre-line points in each depth bin of 10 mm, mm."""


@dataclass(frozen=True)
class _Segments:
    """Straight segments of all roots."""

    start: Array
    step: Array
    length: Array
    diameter: Array
    order: NDArray[np.int64]


def measure_traits(
    roots: Sequence[Root], vertices_mm: Array, *, volume_mm3: float, surface_mm2: float, mass_g: float | None = None
) -> Traits:
    """Compute the traits of a root system.

    Parameters
    ----------
    roots : sequence of Root
        Parents before children, points from base to tip, canister frame (z up); empty if centre lines are unknown.
    vertices_mm : (V, 3) float64 array
        Vertices of the solid's surface.
    volume_mm3, surface_mm2 : float
        Volume and surface area of the solid, in which overlaps of roots are counted once.
    mass_g : float or None
        Measured mass of the roots; None if unknown.

    Raises
    ------
    ValueError
        If there are no vertices, or the mass is not positive.
    """
    if not len(vertices_mm):
        raise ValueError("the solid has no vertices")
    hull_mm3, width_mm = _hull(vertices_mm)
    top_mm, bottom_mm = float(vertices_mm[:, 2].max()), float(vertices_mm[:, 2].min())
    pieces = _segments(roots)
    known = (total_mm := float(pieces.length.sum())) > 0.0
    most, median = _root_counts(pieces) if known else (None, None)
    angles = _emergence_deg(roots)
    by_diameter = np.floor(pieces.diameter / DIAMETER_BIN_MM + 1e-9).astype(np.int64)
    measured = Traits(
        total_length_mm=total_mm if known else None,
        volume_mm3=volume_mm3,
        surface_mm2=surface_mm2,
        mean_diameter_mm=float(pieces.diameter @ pieces.length) / total_mm if known else None,
        median_diameter_mm=_median_diameter(pieces) if known else None,
        max_diameter_mm=float(max(root.diameters_mm.max() for root in roots)) if known else None,
        depth_mm=top_mm - bottom_mm,
        width_mm=width_mm,
        convex_hull_mm3=hull_mm3,
        solidity=volume_mm3 / hull_mm3 if hull_mm3 > 0.0 else 1.0,
        max_root_count=most,
        median_root_count=median,
        bushiness=most / median if most is not None and median else None,
        lower_length_share=_below(pieces, top_mm - UPPER_SHARE * (top_mm - bottom_mm)) / total_mm if known else None,
        roots=len(roots) if known else None,
        tips=sum(root.tip_seen for root in roots) if known else None,
        branch_points=sum(root.parent >= 0 for root in roots) if known else None,
        length_by_order_mm=_bin_lengths(pieces.order, pieces.length) if known else (),
        length_by_depth_mm=_by_depth(pieces, top_mm) if known else (),
        length_by_diameter_mm=_bin_lengths(by_diameter, pieces.length) if known else (),
        angle_to_gravity_deg=_gravity_deg(pieces) if known else None,
        angle_to_parent_deg=float(np.mean(angles)) if len(angles) else None,
        tortuosity=_tortuosity(roots, total_mm) if known else None,
        width_by_depth_mm=_width_by_depth(roots, top_mm) if known else (),
        **_branching(roots),
    )
    return measured if mass_g is None else weighed(measured, mass_g)


def weighed(traits: Traits, mass_g: float) -> Traits:
    """Return traits with those that are computed from the mass of the roots.

    Raises
    ------
    ValueError
        If the mass is not positive.
    """
    if not mass_g > 0.0:
        raise ValueError(f"{mass_g=} is invalid; the mass must be positive")
    length_mm = traits.total_length_mm
    return replace(
        traits,
        specific_root_length_m_per_g=None if length_mm is None else length_mm / 1000.0 / mass_g,
        tissue_density_g_per_ml=mass_g / (traits.volume_mm3 / 1000.0),
    )


def _tortuosity(roots: Sequence[Root], total_mm: float) -> float | None:
    direct_mm = sum(float(np.linalg.norm(root.points_mm[-1] - root.points_mm[0])) for root in roots)
    return total_mm / direct_mm if direct_mm > 0.0 else None


def _branching(roots: Sequence[Root]) -> dict[str, float | None]:
    """Return ``branch_distance_mm`` and ``lateral_density_per_cm``."""
    places: dict[int, list[float]] = {}
    for root, position in zip(roots, branch_positions_mm(roots), strict=True):
        if position is not None and roots[root.parent].parent < 0:
            places.setdefault(root.parent, []).append(position)
    zones = [(max(found) - min(found), len(found)) for found in places.values() if max(found) > min(found)]
    zone_mm = sum(length for length, _ in zones)
    return {
        "branch_distance_mm": zone_mm / sum(laterals - 1 for _, laterals in zones) if zones else None,
        "lateral_density_per_cm": 10.0 * sum(laterals for _, laterals in zones) / zone_mm if zones else None,
    }


def _segments(roots: Sequence[Root]) -> _Segments:
    step = np.concatenate([np.zeros((0, 3)), *(np.diff(root.points_mm, axis=0) for root in roots)])
    diameter = [(root.diameters_mm[:-1] + root.diameters_mm[1:]) / 2.0 for root in roots]
    return _Segments(
        start=np.concatenate([np.zeros((0, 3)), *(root.points_mm[:-1] for root in roots)]),
        step=step,
        length=np.linalg.norm(step, axis=1),
        diameter=np.concatenate([np.zeros(0), *diameter]),
        order=np.concatenate([np.zeros(0, np.int64), *(np.full(len(root.points_mm) - 1, root.order) for root in roots)]),
    )


def _median_diameter(pieces: _Segments) -> float:
    thin_first = np.argsort(pieces.diameter)
    below = np.cumsum(pieces.length[thin_first])
    return float(pieces.diameter[thin_first[int(np.searchsorted(below, 0.5 * below[-1]))]])


def _gravity_deg(pieces: _Segments) -> float:
    cosine = np.clip(-pieces.step[:, 2] / np.maximum(pieces.length, 1e-12), -1.0, 1.0)
    return float(np.rad2deg(np.arccos(cosine)) @ pieces.length / pieces.length.sum())


def _bin_lengths(index: NDArray[np.int64], length: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in np.bincount(np.maximum(index, 0), weights=length))


def _below(pieces: _Segments, z_mm: float) -> float:
    """Return the length of all roots below a given height, mm. Horizontal segments at this height are included."""
    other = pieces.start[:, 2] + pieces.step[:, 2]
    low, high = np.minimum(pieces.start[:, 2], other), np.maximum(pieces.start[:, 2], other)
    return float(pieces.length @ (1.0 - np.clip((high - z_mm) / np.maximum(high - low, 1e-9), 0.0, 1.0)))


def _by_depth(pieces: _Segments, top_mm: float) -> tuple[float, ...]:
    """Return the root length per depth bin, mm."""
    lowest = float(np.minimum(pieces.start[:, 2], pieces.start[:, 2] + pieces.step[:, 2]).min())
    count = _depth_bins(top_mm - lowest)
    below = [_below(pieces, top_mm - DEPTH_BIN_MM * k) for k in range(1, count)]
    return tuple(float(value) for value in -np.diff([float(pieces.length.sum()), *below, 0.0]))


def _width_by_depth(roots: Sequence[Root], top_mm: float) -> tuple[float, ...]:
    """Return the largest horizontal distance of the centre lines per depth bin, mm. It is 0 in bins without roots."""
    long = [root for root in roots if polyline.length_mm(root.points_mm) > 0.0]
    between = sample_centre_lines(long, SLICE_MM / 2.0).points_mm
    points = np.concatenate([between, *(root.points_mm for root in long)])
    depth_mm = top_mm - points[:, 2]
    last = _depth_bins(float(depth_mm.max())) - 1
    bins = np.clip(np.floor(depth_mm / DEPTH_BIN_MM).astype(np.int64), 0, last)
    return tuple(_width(points[bins == k, :2]) if (bins == k).any() else 0.0 for k in range(last + 1))


def _depth_bins(depth_mm: float) -> int:
    return max(1, int(np.ceil(depth_mm / DEPTH_BIN_MM - 1e-9)))


def _hull(points_mm: Array) -> tuple[float, float]:
    """Return the volume of the convex hull, and the largest horizontal distance between two points.

    The volume is 0 if the points are in one plane.
    """
    from scipy.spatial import ConvexHull, QhullError  # imported here: not required for reading traits

    try:
        volume = float(ConvexHull(points_mm).volume)
    except QhullError:
        volume = 0.0
    return volume, _width(points_mm[:, :2])


def _width(level: Array) -> float:
    """Return the largest distance between two of the points (N, 2)."""
    from scipy.spatial import ConvexHull, QhullError

    corners = level
    if len(level) > 3:
        try:
            corners = level[ConvexHull(level).vertices]
        except QhullError:  # for collinear points, the ends have the greatest distance
            along = np.linalg.svd(level - level.mean(axis=0), full_matrices=False)[2][0]
            corners = level[[int(np.argmin(level @ along)), int(np.argmax(level @ along))]]
    # a flat hull has few corners
    return max(float(np.max(np.sum((corners - corner) ** 2, axis=1))) for corner in corners) ** 0.5


def _root_counts(pieces: _Segments) -> tuple[float, float]:
    """Return the maximum and the median number of roots that cross a horizontal plane.

    The maximum is the 84th percentile. Planes without roots are ignored, and both numbers are at least one.
    """
    low = np.minimum(pieces.start[:, 2], pieces.start[:, 2] + pieces.step[:, 2])
    high = np.maximum(pieces.start[:, 2], pieces.start[:, 2] + pieces.step[:, 2])
    base = float(low.min()) + SLICE_MM / 2.0
    planes = max(1, int(np.ceil((float(high.max()) - base) / SLICE_MM)))
    # A segment crosses the planes k with low < base + k * SLICE <= high.
    first = np.clip(np.floor((low - base) / SLICE_MM).astype(np.int64) + 1, 0, planes)
    last = np.clip(np.floor((high - base) / SLICE_MM).astype(np.int64) + 1, 0, planes)
    change = np.bincount(first, minlength=planes + 1) - np.bincount(last, minlength=planes + 1)
    count = np.cumsum(change)[:planes]
    met = count[count > 0]
    return (float(np.percentile(met, MOST_PERCENT)), float(np.median(met))) if len(met) else (1.0, 1.0)


def branch_positions_mm(roots: Sequence[Root]) -> list[float | None]:
    """Return the position of each root's branch point along its parent, mm; None for roots without a parent."""
    found: list[float | None] = []
    for root in roots:
        if root.parent < 0:
            found.append(None)
            continue
        points = roots[root.parent].points_mm
        found.append(float(polyline.arc_length_mm(points)[int(np.argmin(np.sum((points - root.points_mm[0]) ** 2, axis=1)))]))
    return found


def _emergence_deg(roots: Sequence[Root]) -> Array:
    """Return the angles between laterals and their parents (L,), deg. Laterals of zero length are omitted."""
    angles = [emergence_deg(root.points_mm, roots[root.parent].points_mm) for root in roots if root.parent >= 0]
    return np.array([angle for angle in angles if angle is not None])


def emergence_deg(lateral_mm: Array, parent_mm: Array) -> float | None:
    """Return the angle between a lateral and its parent at the point of emergence, deg.

    The direction of the lateral is that of its first 5 mm.

    Parameters
    ----------
    lateral_mm, parent_mm : (N, 3), (M, 3) float64 array
        Points of the lateral and of its parent, from base to tip.

    Returns
    -------
    float or None
        Angle; None if one of the roots has no length at this point.
    """
    nearest = int(np.argmin(np.sum((parent_mm - lateral_mm[0]) ** 2, axis=1)))
    along = parent_mm[min(nearest + 1, len(parent_mm) - 1)] - parent_mm[max(nearest - 1, 0)]
    way = polyline.arc_length_mm(lateral_mm)
    lateral = polyline.interpolate(lateral_mm, way, np.array([min(EMERGENCE_MM, float(way[-1]))]))[0] - lateral_mm[0]
    size = float(np.linalg.norm(along) * np.linalg.norm(lateral))
    return float(np.rad2deg(np.arccos(np.clip(along @ lateral / size, -1.0, 1.0)))) if size > 0.0 else None
