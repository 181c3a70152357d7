"""Estimation of root sway: lateral displacement of the roots that differs from picture to picture.

After each step of the table, the roots keep swinging, and the rotating water drags them along. The displacement of a
root increases with the depth below the net pot. It has two parameters per view, and a third for rotation about the
vertical (`recon.optics.cameras.Sway`). Fitted tubes provide the lateral displacement in each view. The sway is relative
to the mean of all views, which cannot be distinguished from the shape.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.optics.cameras import STILL
from rhizotwin.recon.tubes import view_correction
from rhizotwin.recon.tubes.rig_derivatives import SWAY
from rhizotwin.recon.tubes.rig_equations import Columns, Correction
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.recon.tubes.view_correction import Viewed

Array = NDArray[np.float64]

_LOOSE = 0.02
"""Prior standard deviation of the two lateral displacements, mm per mm of depth, and of the rotation, rad per mm of
depth. It corresponds to a displacement of 2 mm at a depth of 100 mm. Roots with a larger sway cannot be
reconstructed."""
_LEAST_GAIN = 0.1
"""Minimum relative reduction of the lateral distance between roots and tubes by the sway. The sway is not estimated if
the reduction is smaller. The reduction is 0.004 for static plants of the twin, and 0.3 for a sway of 0.1 mm at the
tips."""
_LEAST_MM = 0.06
"""Minimum root mean square displacement of the roots for the sway to be corrected, and the roots to be reconstructed
again, mm. The motion check has the same threshold.

A plant with this sway loses 2 % of its volume. With 0.3 mm at the tips, which is 0.12 mm over the whole plant, it lost
8 %."""


def follow(given: Viewed, *, px_a_mm: float) -> Viewed:
    """Estimate the sway in each picture from fitted tubes, and refit the tubes, until the sway converges.

    The result is unchanged if the sway is negligible or there are too few roots. ``px_a_mm`` is the image scale, px/mm.
    """
    cameras, before = given.cameras, np.array([view.sway for view in given.cameras.views])
    index = np.arange(before.size).reshape(before.shape)
    columns = Columns.build(SWAY, index, before.ravel(), np.eye(before.size) / _LOOSE**2, before.size)

    def apply(value: Array) -> Cameras:
        sways = [(float(x), float(y), float(turn)) for x, y, turn in value.reshape(before.shape)]
        return cameras.with_views([replace(view, sway=sway) for view, sway in zip(cameras.views, sways, strict=True)], cameras.optics)

    def accept(found: list[Correction]) -> bool:
        return found[-1].after_px <= (1.0 - _LEAST_GAIN) * found[-1].before_px

    now, _ = view_correction.correct(given, columns, apply, accept)
    has_sway = any(view.sway != STILL for view in cameras.views)
    return now if has_sway or has_moved(now.evidence, cameras, now.tubes, px_a_mm) else given


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
