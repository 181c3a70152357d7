"""Whether hairs stand about the roots.

Hairs look like a root that is wider and fainter, and like blur. So tubes are fitted with and without them, each with
its best blur, and the difference is compared with its scatter from root to root and from view to view.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.tubes.translucent_tube import HAIRS
from rhizotwin.recon.tubes.tube_attenuation import BLUR_STEP_PX, Trials, TubeAttenuation, best_blur, with_light_kept
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_TELLING = 2.0
"""Standard deviations by which roots with and without hairs must differ to be told apart. Of plants of the twin with
such hairs two had -3.0 and -4.9, without 4.4, 5.7 and 6.8; with a tenth of the profiles 1.4."""


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
        With hairs, where they are there for certain; else evidence and tubes as they were.
    """
    if not seen.has_opacity:
        return attenuation, seen, fitted
    mu_per_mm, blur_px = attenuation.mu_per_mm, attenuation.blur_px
    trials = Trials.of(seen.by_light(), fitted, organ, blur_px)
    bald = best_blur(trials, mu_per_mm, max(0.0, blur_px - BLUR_STEP_PX))
    found = best_blur(_hairy(trials), mu_per_mm, max(0.0, blur_px - 2.0 * BLUR_STEP_PX))
    difference = found.loss - bald.loss
    by_root, by_view = np.bincount(trials.nodes.owner, weights=difference.sum(axis=0)), difference.sum(axis=1)
    sigma = float(np.sqrt(np.square(by_root).sum() + len(by_view) * by_view.var()))
    if difference.sum() > _TELLING * sigma:
        return attenuation, seen, fitted
    if difference.sum() >= -_TELLING * sigma:
        return replace(attenuation, hairs="maybe"), seen, fitted
    return replace(attenuation, hairs="there", blur_px=found.blur_px), replace(seen.by_light(), hairs=HAIRS), found.tubes


def _hairy(trials: Trials) -> Trials:
    """Return trials of the same profiles with hairs."""
    mu_per_mm = trials.start.mu_per_mm
    start = with_light_kept(trials.nodes, trials.organ, (mu_per_mm, None), (mu_per_mm, HAIRS))
    return Trials(replace(trials.light, hairs=HAIRS), trials.organ, replace(trials.start, tubes=start), trials.nodes, trials.lone)
