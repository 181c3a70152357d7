"""Whether roots take light from where they are not: milky water, a lens that flares, a camera that evens tones out.

Each spreads a part of what a pixel should have over those about it. Beside roots it is then a little too dark (or too
bright, where a camera sharpens), by as much as there are roots about: by a share of the coverage, blurred.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.silhouettes import Silhouette

_WIDE_PX = 12.0
"""Standard deviation over which roots are blurred: far wider than a lens's blur and a root's own flanks. What is spread
over 20 px and over 5 px alike is told by it, the one a little too small and the other too large."""
_BESIDE_PX = 4.0
"""Nearer to a silhouette it is the root's own flank and its hairs (1.5 mm at 0.4 mm a pixel)."""
_ROOT = 0.5
"""Coverage of a silhouette."""
_BINS = 12
"""Classes of how many roots are about."""
_LEAST = 300
"""Pixels of a class whose median is asked; noise of 5 % a pixel then leaves 0.4 %."""
_ENOUGH = 0.05
"""Classes must reach this far: where roots never cover so much of what is about, they tell nothing."""
_VIEWS = 10
"""Of the turn, evenly chosen."""


def spread(silhouettes: Sequence[Silhouette]) -> float | None:
    """Return the share of the light that is spread about roots; None where too little is seen beside them.

    Parameters
    ----------
    silhouettes : sequence of Silhouette
        With the opacity of all that they see, noise and all.

    Returns
    -------
    float or None
        Slope of the opacity beside roots over their coverage, blurred: medians of classes, so that thin roots that
        nobody found, which are in few pixels, tell nothing.
    """
    about, dark = [], []
    for silhouette in silhouettes[:: max(1, len(silhouettes) // _VIEWS)]:
        if silhouette.opacity is not None:
            one, other = _beside(silhouette)
            about.append(one)
            dark.append(other)
    if not about:
        return None
    x, y = np.concatenate(about), np.concatenate(dark)
    if not len(x) or float(x.max()) < _ENOUGH:
        return None
    place = np.minimum((x / float(x.max()) * _BINS).astype(np.int64), _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    told = np.flatnonzero(count >= _LEAST)
    if len(told) < 3 or float(x[place == told[-1]].mean()) < _ENOUGH:
        return None
    at = np.array([x[place == one].mean() for one in told])
    medians = np.array([np.median(y[place == one]) for one in told])
    weight = np.sqrt(count[told])
    return float(np.polyfit(at, medians, 1, w=weight)[0])


def _beside(silhouette: Silhouette) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return how much of what is about is root (N,), and the opacity (N,), at pixels beside the roots."""
    root = (silhouette.coverage > _ROOT) & silhouette.seen
    away = cv2.distanceTransform((~root).astype(np.uint8), cv2.DIST_L2, 5)
    inner = cv2.erode(silhouette.seen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    beside = inner & (away > _BESIDE_PX) & (away < 4.0 * _WIDE_PX)
    wide = cv2.GaussianBlur(np.where(silhouette.seen, silhouette.coverage, 0.0).astype(np.float32), (0, 0), _WIDE_PX)
    return wide[beside], np.asarray(silhouette.opacity, np.float32)[beside]
