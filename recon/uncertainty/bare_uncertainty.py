"""Uncertainty of the volume due to cameras that were calibrated without markers.

A relative error of the scale changes the volume by three times this error. A view with an error of azimuth or vertical
shift displaces its outlines: a point at the distance r from the axis moves by r times the angle, laterally where it is
near or far and not at all where it is beside the axis, on average by r / sqrt(2). A hull is the intersection of all
views, so that it becomes smaller by a view's whole error; it becomes larger only by the error common to all views.
"""

from __future__ import annotations

import math

import numpy as np

from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.uncertainty.budget import NINETY, Term


def camera_terms(known: BareUncertainty | None, leaves: Leaves, *, views: int, mm3_per_px: float) -> tuple[Term, ...]:
    """Return the terms of the error budget for cameras that were calibrated without markers.

    No terms are returned if the cameras were calibrated with markers or given by the user.

    Parameters
    ----------
    known : BareUncertainty or None
        Uncertainty of the cameras.
    leaves : Leaves
        The shape.
    views : int
        Number of views.
    mm3_per_px : float
        Increase of the shape per pixel that its outlines are moved out.
    """
    if known is None:
        return ()
    volume_mm3 = leaves.volume_mm3()
    scale = 3.0 * NINETY * known.scale * volume_mm3
    off_mm = math.hypot(known.azimuth_rad * _distance_mm(leaves) / math.sqrt(2.0), known.lift_mm)
    moved = NINETY * off_mm / known.mm_per_px * mm3_per_px
    return (
        Term.symmetric("scale", scale, "the scale depends on the measured diameter of the canister"),
        Term(
            name="cameras",
            less_mm3=moved / math.sqrt(views),
            more_mm3=moved,
            why="without markers, the angles and heights of the views are estimated from the roots only",
        ),
    )


def _distance_mm(leaves: Leaves) -> float:
    """Return the root mean square distance of a shape's volume from the canister's axis."""
    middle, weight = leaves.middles_mm, leaves.filled_volume
    return float(np.sqrt((weight * (middle[:, 0] ** 2 + middle[:, 1] ** 2)).sum() / max(float(weight.sum()), 1e-9)))
