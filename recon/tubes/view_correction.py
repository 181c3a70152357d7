"""Correction of the views from the roots: estimate parameters of the views, and refit the tubes, until both agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.tubes import tube_fit
from rhizotwin.recon.tubes.rig_equations import Columns, Correction, RigSystem
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_ROUNDS = 6
"""Maximum number of refits of the tubes."""


@dataclass(frozen=True)
class Viewed:
    """Fitted tubes, and the views in which they were seen."""

    evidence: Evidence
    cameras: Cameras
    """Cameras of the views in ``evidence``, in the same order."""
    tubes: Tubes
    thick: Mask
    """Mask (N,) of the nodes of thick roots, see `tube_fit.fit`."""


def correct(
    given: Viewed, columns: Columns, apply: Callable[[Array], Cameras], accept: Callable[[list[Correction]], bool]
) -> tuple[Viewed, list[Correction]]:
    """Estimate parameters of the views, and refit the tubes, as long as the estimates are accepted.

    The views are not changed if the distance between roots and tubes increases.

    Parameters
    ----------
    columns : Columns
        Parameters to estimate.
    apply : callable
        Function that returns the cameras with given values (K,) of the parameters.
    accept : callable
        Function that returns whether the last of the estimates is applied.

    Returns
    -------
    viewed : Viewed
        Corrected views, and the tubes fitted to them.
    found : list of Correction
        The estimates. The list is empty if there are too few nodes.
    """
    now, found = given, list[Correction]()
    for _ in range(_MOST_ROUNDS):
        system = RigSystem.build(Rendering.draw(now.evidence, now.tubes), now.cameras, columns)
        if system is None:
            break
        correction = system.estimate()
        found.append(correction)
        if correction.before_px > found[0].before_px:
            return given, found[:1]
        if not accept(found):
            break
        columns, cameras = columns.at(correction.value), apply(correction.value)
        evidence = now.evidence.with_cameras(cameras)
        now = Viewed(evidence, cameras, tube_fit.fit(evidence, now.tubes, now.thick).tubes, now.thick)
    return now, found
