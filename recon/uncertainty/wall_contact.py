"""Uncertainty due to flat objects on the wall of the canister.

Examples are tape, labels and dirt. They rotate with the canister, so that they appear in the hull like roots.
"""

from __future__ import annotations

import numpy as np

from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.uncertainty.budget import Term

_ROUND = 1.9
"""Ratio of the volume in the third shell under the wall to that in the first, for a round root that touches the wall
along a line. The width of its cross-section at a depth d is about proportional to the square root of d. The ratio is
2.4 for wide roots, and 1.9 for roots with a radius of three shells. For a ball the ratio is 5."""


def wall_contact(thick: Leaves, water: Water) -> Term:
    """Return the term of the error budget for flat parts of a shape that lie on the wall.

    A round root touches the wall along a line, so that its cross-section at a depth d under the wall grows from zero. A
    flat object on the wall has its full area there. The first and the third of three shells, each as thick as a finest
    node, contain `V1 = F + r` and `V3 = F + q r`. The flat part F is equal in both, and the round part r grows by the
    factor `q`. An area on the wall hides at most the wedge from there to the axis.

    Parameters
    ----------
    thick : Leaves
        Solids and thick roots of the shape; thin roots are round tubes.
    water : Water
        Water in the canister.
    """
    cell_mm = thick.grid.size_mm
    middle = thick.middles_mm
    reach_mm = np.hypot(middle[:, 0], middle[:, 1]) + thick.size * cell_mm / np.sqrt(2.0)
    near = thick.select(reach_mm > water.radius_mm - 3.0 * cell_mm).split()
    depth_mm = water.radius_mm - np.hypot(*near.middles_mm[:, :2].T)
    shell = np.clip(depth_mm // cell_mm, 0, 3).astype(int)
    area_mm2 = np.bincount(shell, near.occupancy, 4) * cell_mm**2
    flat_mm2 = float(np.clip((_ROUND * area_mm2[0] - area_mm2[2]) / (_ROUND - 1.0), 0.0, area_mm2[0]))
    return Term(
        name="wall_contact",
        less_mm3=min(thick.volume_mm3(), 0.5 * flat_mm2 * water.radius_mm),
        more_mm3=0.0,
        why="a part lies flat on the canister's wall, like tape, a label or dirt: clean the wall, and remove attached objects",
    )
