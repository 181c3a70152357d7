"""What cameras that were found without markers leave open.

With another scale everything is as much larger, its volume by three times the share. A view that is turned or lifted
by too much moves its outlines: what lies r from the axis by r times the angle, sideways at the azimuths where it is
near or far and not at all where it is beside, on average by r / sqrt(2). A hull is cut by whichever view is worst, so
that it becomes smaller by a view's whole error; it becomes larger only by what all views have in common.
"""

from __future__ import annotations

import math

import numpy as np

from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.uncertainty.budget import NINETY, Term


def terms(known: BareUncertainty | None, leaves: Leaves, *, views: int, mm3_per_px: float) -> tuple[Term, ...]:
    """Return the terms of cameras without markers; none where markers or a person gave the cameras.

    Parameters
    ----------
    known : BareUncertainty or None
        How well the cameras are known.
    leaves : Leaves
        The shape.
    views : int
        How many see it.
    mm3_per_px : float
        By how much the shape grows for every pixel that its outlines are moved out.
    """
    if known is None:
        return ()
    volume_mm3 = leaves.volume_mm3()
    scale = 3.0 * NINETY * known.scale * volume_mm3
    off_mm = math.hypot(known.azimuth_rad * _distance_mm(leaves) / math.sqrt(2.0), known.lift_mm)
    moved = NINETY * off_mm / known.mm_per_px * mm3_per_px
    return (
        Term.even("scale", scale, "the scale is that of the canister's diameter, which a person measured"),
        Term(
            name="cameras",
            less_mm3=moved / math.sqrt(views),
            more_mm3=moved,
            why="without markers the views' angles and heights are known only as far as the roots tell them",
        ),
    )


def _distance_mm(leaves: Leaves) -> float:
    """Return the root mean square distance of a shape from the axis."""
    middle, weight = leaves.middles_mm, leaves.filled
    return float(np.sqrt((weight * (middle[:, 0] ** 2 + middle[:, 1] ** 2)).sum() / max(float(weight.sum()), 1e-9)))
