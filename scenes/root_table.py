"""Table of single roots, with geometry, parent and place on the parent of each.

The definitions are those of RSML (Lobet et al. 2015, Plant Physiology 167:617) and SmartRoot (Lobet et al. 2011, Plant
Physiology 157:29). The same code is used for truth and results.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline
from rhizotwin.scenes.assessment import NO_INTERVAL, Verdict
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.trait_table import csv_text, format_exact
from rhizotwin.scenes.traits import branch_positions_mm, emergence_deg

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RootRow:
    """One root. Positions along a root are measured from its base; unknown values are None."""

    root: int
    """Number of the root, as in its id in RSML files: 1, 2, ..."""
    parent: int | None
    """Number of the parent; None for roots without one."""
    plant: str
    order: int
    """0 for a taproot."""
    length_mm: float
    tortuosity: float | None
    """Ratio of the length to the distance from base to tip."""
    diameter_base_mm: float
    diameter_mean_mm: float
    """Mean over the length."""
    diameter_tip_mm: float
    volume_mm3: float
    """Volume of the tube along the root, which includes the part inside the parent."""
    insertion_angle_deg: float | None
    """Angle between the first 5 mm and the parent at the branch point."""
    position_mm: float | None
    """Position of the branch point on the parent."""
    next_branch_mm: float | None
    """Distance on the parent to the next branch point towards its tip."""
    laterals: int
    lateral_density_per_cm: float | None
    """Laterals per length of the branched zone, from the first branch point to the last; None for fewer than two
    branch points."""
    base_depth_mm: float
    """Depth of the base below the rim of the canister."""
    tip_depth_mm: float
    tip_seen: bool
    """Whether the tip is visible in the pictures."""


def root_rows(roots: Sequence[Root]) -> list[RootRow]:
    """Return a row for each root. Parents are indices into the roots."""
    positions = branch_positions_mm(roots)
    on_parent: dict[int, list[int]] = {}
    for index, root in enumerate(roots):
        if root.parent >= 0:
            on_parent.setdefault(root.parent, []).append(index)
    return [_row(roots, index, positions, on_parent) for index in range(len(roots))]


def to_csv(roots: Sequence[Root], *, verdict: Verdict = NO_INTERVAL.verdict) -> str:
    """Return the rows as a CSV table; cells of unknown values are empty, and yes and no stand for a seen tip.

    The last column is the verdict on the total length of the scan.
    """
    rows = [[*(_cell(value) for value in asdict(row).values()), verdict] for row in root_rows(roots)]
    return csv_text([[*(one.name for one in fields(RootRow)), "verdict"], *rows])


def _row(roots: Sequence[Root], index: int, positions: Sequence[float | None], on_parent: dict[int, list[int]]) -> RootRow:
    root, position, borne = roots[index], positions[index], on_parent.get(index, [])
    steps, radius = polyline.steps_mm(root.points_mm), root.diameters_mm / 2.0
    length, chord = float(steps.sum()), float(np.linalg.norm(root.points_mm[-1] - root.points_mm[0]))
    places = sorted({where for lateral in borne if (where := positions[lateral]) is not None})
    onward = [
        where - position
        for sibling in on_parent.get(root.parent, [])
        if position is not None and (where := positions[sibling]) is not None and where > position
    ]
    zone_mm = places[-1] - places[0] if places else 0.0
    middle = (root.diameters_mm[:-1] + root.diameters_mm[1:]) / 2.0
    return RootRow(
        root=index + 1,
        parent=root.parent + 1 if root.parent >= 0 else None,
        plant=root.plant,
        order=root.order,
        length_mm=length,
        tortuosity=length / chord if chord > 0.0 else None,
        diameter_base_mm=float(root.diameters_mm[0]),
        diameter_mean_mm=float(steps @ middle) / length if length > 0.0 else float(root.diameters_mm.mean()),
        diameter_tip_mm=float(root.diameters_mm[-1]),
        volume_mm3=float(np.pi / 3.0 * steps @ (radius[:-1] ** 2 + radius[:-1] * radius[1:] + radius[1:] ** 2)),
        insertion_angle_deg=emergence_deg(root.points_mm, roots[root.parent].points_mm) if root.parent >= 0 else None,
        position_mm=position,
        next_branch_mm=min(onward, default=None),
        laterals=len(borne),
        lateral_density_per_cm=10.0 * len(borne) / zone_mm if zone_mm > 0.0 else None,
        base_depth_mm=float(-root.points_mm[0, 2]),
        tip_depth_mm=float(-root.points_mm[-1, 2]),
        tip_seen=root.tip_seen,
    )


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return format_exact(value) if isinstance(value, float | int | None) else str(value)
