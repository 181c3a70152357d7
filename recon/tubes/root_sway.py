"""How the roots sway from picture to picture.

After a step of the table roots swing on, and the water turns on and takes them along. What hangs from the net pot goes
the farther aside the deeper it is: by two numbers a view, and a third for the turn about the vertical
(`recon.optics.cameras.Sway`). Fitted tubes say in each view how far off they lie sideways; their own places are
eliminated, and what is left is the sway, as `root_calibration` finds the index. It is measured from the mean of all
views, which no picture tells from the shape.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.optics.cameras import STILL
from rhizotwin.recon.tubes import root_calibration, tube_fit
from rhizotwin.recon.tubes.sight_change import SWAY
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_LOOSE = 0.02
"""Standard deviation of a sway before anything is known, mm per mm of depth, and rad per mm: 2 mm at 100 mm. More
leaves no root to be found."""
_LEAST_GAIN = 0.1
"""Share of the roots' distance from their places that it must take off. Plants of the twin that stand still gain 0.004;
a sway of 0.1 mm at the tips is 0.3."""
_ROUNDS, _STEPS = 3, 3
"""Times that the tubes are fitted anew, and steps of each fit."""
_LEAST_MM = 0.06
"""Root mean square distance from which roots are followed, and found anew where they are, as the check of motion has
it: a plant that sways by it loses two hundredths of its volume (0.3 mm at the tips, of which the whole plant has 0.12,
lost 8 %)."""


def follow(seen: Evidence, cameras: Cameras, tubes: Tubes, thick: Mask, *, px_a_mm: float) -> tuple[Evidence, Cameras, Tubes]:
    """Ask fitted tubes how far aside they are in each picture, and fit them anew, until nothing changes.

    Parameters
    ----------
    seen, cameras : Evidence, Cameras
        With the same views, in the same order.
    tubes : Tubes
        Fitted to them.
    thick : (N,) bool array
        As in `tube_fit.fit`.
    px_a_mm : float
        Pixels a millimetre.

    Returns
    -------
    seen, cameras, tubes : Evidence, Cameras, Tubes
        With each view's sway; the same where roots stand still or nearly so, or are too few to tell.
    """
    given, nearest_px = (seen, cameras, tubes), np.inf
    columns = root_calibration.Columns.own(len(cameras.views), len(SWAY), _LOOSE)
    for _ in range(_ROUNDS):
        system = root_calibration.system(seen, cameras, tubes, SWAY, columns)
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
        cameras = cameras.moved(moved, cameras.optics)
        seen = seen.with_cameras(cameras)
        tubes = tube_fit.fit(seen, tubes, thick, steps=_STEPS).tubes
    return (seen, cameras, tubes) if is_far(seen, given[1], tubes, px_a_mm) or _sways(given[1]) else given


def _sways(cameras: Cameras) -> bool:
    """Tell whether a sway is known already."""
    return any(view.sway != STILL for view in cameras.views)


def is_far(seen: Evidence, cameras: Cameras, tubes: Tubes, px_a_mm: float) -> bool:
    """Tell whether roots are so far from where they seemed to be with other cameras that they must be found anew.

    Parameters
    ----------
    seen, tubes : Evidence, Tubes
        The views, and the roots as they are.
    cameras : Cameras
        With which they were found.
    px_a_mm : float
        Pixels a millimetre.
    """
    now, then = seen.project(tubes.centre_mm), seen.with_cameras(cameras).project(tubes.centre_mm)
    both = now.seen & then.seen
    away_px = np.linalg.norm(now.px - then.px, axis=-1)[both]
    return bool(len(away_px)) and float(np.sqrt(np.square(away_px).mean())) > _LEAST_MM * px_a_mm
