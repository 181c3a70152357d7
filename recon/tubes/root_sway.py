"""Estimation of root sway: lateral displacement of the roots that differs from picture to picture.

After each step of the table, the roots keep swinging, and the rotating water drags them along. The displacement of a
root increases with the depth below the net pot. It has two parameters per view, and a third for rotation about the
vertical (`recon.optics.cameras.Sway`). Fitted tubes provide the lateral displacement in each view. The positions of the
nodes are eliminated, as in the calibration of the refractive index (`rig_equations`). The sway is relative to the
mean of all views, which cannot be distinguished from the shape.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.optics.cameras import STILL
from rhizotwin.recon.tubes import rig_equations, tube_fit
from rhizotwin.recon.tubes.rig_derivatives import SWAY
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_LOOSE = 0.02
"""Prior standard deviation of the two lateral displacements, mm per mm of depth, and of the rotation, rad per mm of
depth. It corresponds to a displacement of 2 mm at a depth of 100 mm. Roots with a larger sway cannot be
reconstructed."""
_LEAST_GAIN = 0.1
"""Minimum relative reduction of the lateral distance between roots and tubes by the sway. The sway is not estimated if
the reduction is smaller. The reduction is 0.004 for static plants of the twin, and 0.3 for a sway of 0.1 mm at the
tips."""
_ROUNDS, _STEPS = 3, 3
"""Maximum number of refits of the tubes, and number of iterations of each refit."""
_LEAST_MM = 0.06
"""Minimum root mean square displacement of the roots for the sway to be corrected, and the roots to be reconstructed
again, mm. The motion check has the same threshold.

A plant with this sway loses 2 % of its volume. With 0.3 mm at the tips, which is 0.12 mm over the whole plant, it lost
8 %."""


def follow(evidence: Evidence, cameras: Cameras, tubes: Tubes, thick: Mask, *, px_a_mm: float) -> tuple[Evidence, Cameras, Tubes]:
    """Estimate the sway in each picture from fitted tubes, and refit the tubes, until the sway converges.

    Parameters
    ----------
    evidence, cameras : Evidence, Cameras
        Evidence and cameras of the same views, in the same order.
    tubes : Tubes
        Tubes fitted to the evidence.
    thick : (N,) bool array
        Same as in `tube_fit.fit`.
    px_a_mm : float
        Image scale, px/mm.

    Returns
    -------
    evidence, cameras, tubes : Evidence, Cameras, Tubes
        Refined evidence, cameras and tubes with the sway of each view. They are unchanged if the sway is negligible or
        there are too few roots.
    """
    given, nearest_px = (evidence, cameras, tubes), np.inf
    columns = rig_equations.Columns.per_view(len(cameras.views), len(SWAY), _LOOSE)
    for _ in range(_ROUNDS):
        system = rig_equations.build_system(evidence, cameras, tubes, SWAY, columns)
        if system is None:
            break
        before = np.array([view.sway for view in cameras.views])
        change = system.solve(before.ravel())[0]
        still_px, left_px = system.distance_px(np.zeros_like(change)), system.distance_px(change)
        if still_px > nearest_px:
            return given
        if left_px > (1.0 - _LEAST_GAIN) * still_px:
            break
        nearest_px, sways = still_px, before + change.reshape(before.shape)
        moved = [replace(view, sway=(float(x), float(y), float(turn))) for view, (x, y, turn) in zip(cameras.views, sways, strict=True)]
        cameras = cameras.with_views(moved, cameras.optics)
        evidence = evidence.with_cameras(cameras)
        tubes = tube_fit.fit(evidence, tubes, thick, steps=_STEPS).tubes
    return (evidence, cameras, tubes) if has_moved(evidence, given[1], tubes, px_a_mm) or _has_sway(given[1]) else given


def _has_sway(cameras: Cameras) -> bool:
    """Return whether the cameras already include a sway."""
    return any(view.sway != STILL for view in cameras.views)


def has_moved(evidence: Evidence, cameras: Cameras, tubes: Tubes, px_a_mm: float) -> bool:
    """Return whether the roots must be reconstructed again, because they moved too far.

    The displacement is that of the roots in the pictures, between the current cameras and those of the reconstruction.

    Parameters
    ----------
    evidence, tubes : Evidence, Tubes
        Current views, and current roots.
    cameras : Cameras
        Cameras with which the roots were reconstructed.
    px_a_mm : float
        Image scale, px/mm.
    """
    now, then = evidence.project(tubes.centre_mm), evidence.with_cameras(cameras).project(tubes.centre_mm)
    both = now.visible & then.visible
    away_px = np.linalg.norm(now.px - then.px, axis=-1)[both]
    return bool(len(away_px)) and float(np.sqrt(np.square(away_px).mean())) > _LEAST_MM * px_a_mm
