"""Whether hairs stand about the roots.

Hairs look like a root that is wider and fainter, and like blur. So tubes are fitted with and without them, each with
its best blur, and the difference is compared with its scatter from root to root and from view to view. What has hairs
is young and lets light through: about opaque roots they are never more than possible (an opaque bean without hairs
seemed to have them by 2.5 standard deviations), and about translucent ones they are taken to be there unless the
pictures exclude them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.tubes.attenuation_trials import Trials, with_light_kept
from rhizotwin.recon.tubes.translucent_tube import HAIRS
from rhizotwin.recon.tubes.tube_attenuation import BLUR_STEP_PX, TELLING, TubeAttenuation, best_blur
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_EXCLUDED = 3.0
"""Standard deviations by which roots without hairs must explain the pictures better before hairs are excluded: glassy
roots with hairs had up to 2.1 (a bean), roots without any 4.2 to 6.8."""


def find(seen: Evidence, fitted: Tubes, organ: Mask, attenuation: TubeAttenuation) -> tuple[TubeAttenuation, Evidence, Tubes]:
    """Tell whether hairs stand about the roots.

    Parameters
    ----------
    seen, fitted, organ : Evidence, Tubes, (N,) bool array
        As in `tube_attenuation.refine`.
    attenuation : TubeAttenuation
        Of the roots themselves, which stays.

    Returns
    -------
    TubeAttenuation, Evidence, Tubes
        With hairs, where roots are translucent and nothing excludes them; else evidence and tubes as they were.
    """
    if not seen.has_opacity:
        return attenuation, seen, fitted
    mu_per_mm, blur_px = attenuation.mu_per_mm, attenuation.blur_px
    trials = Trials.of(seen.by_light(), fitted, organ, blur_px)
    bald = best_blur(trials, mu_per_mm, max(0.0, blur_px - BLUR_STEP_PX))
    found = best_blur(_hairy(trials), mu_per_mm, max(0.0, blur_px - 2.0 * BLUR_STEP_PX))
    against = trials.significance(bald, found)
    if against < -_EXCLUDED:
        return attenuation, seen, fitted
    if mu_per_mm is None:
        return replace(attenuation, hairs="maybe"), seen, fitted
    told: Literal["maybe", "there"] = "there" if against > TELLING else "maybe"
    return replace(attenuation, hairs=told, blur_px=found.blur_px), replace(seen.by_light(), hairs=HAIRS), found.tubes


def _hairy(trials: Trials) -> Trials:
    """Return trials of the same profiles with hairs."""
    mu_per_mm = trials.start.mu_per_mm
    start = with_light_kept(trials.nodes, trials.organ, (mu_per_mm, None), (mu_per_mm, HAIRS))
    return Trials(replace(trials.light, hairs=HAIRS), trials.organ, replace(trials.start, tubes=start), trials.nodes, trials.lone)
