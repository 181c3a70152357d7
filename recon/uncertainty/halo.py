"""Whether roots take light from where they are not: milky water, a lens that flares, a camera that evens tones out.

Each spreads a part of what a pixel should have over those about it. Beside roots it is then a little too dark (or too
bright, where a camera sharpens), by as much as there are roots about: by a share of the coverage, blurred.

Pixels are compared with themselves in other views of the same camera: where roots often pass, the empty backlight is
known worse, and half a percent that it lacks there would look the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette

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
"""Classes must reach this far: where roots never cover so much more of what is about, they tell nothing."""
_VIEWS = 10
"""Of a camera's turn, evenly chosen."""
_OTHERS = 3
"""Of a camera with more views than these, pixels count that are beside roots in so many others; their means then take
up a fourth of each one's own. Cameras with fewer are taken as they are."""


def spread(silhouettes: Sequence[Silhouette], stations: Sequence[tuple[int, int]]) -> float | None:
    """Return the share of the light that is spread about roots; None where too little is seen beside them.

    Parameters
    ----------
    silhouettes : sequence of Silhouette
        With the opacity of all that they see, noise and all.
    stations : sequence of tuple of int
        Of each: where its camera stood, views of which show the same backlight.

    Returns
    -------
    float or None
        Slope of the opacity beside roots over their coverage, blurred, both against the same pixel's in other views:
        medians of classes, so that thin roots that nobody found, which are in few pixels, tell nothing.
    """
    about, dark = [np.zeros(0, np.float32)], [np.zeros(0, np.float32)]
    for station in sorted(set(stations)):
        own = [one for one, at in zip(silhouettes, stations, strict=True) if at == station and one.opacity is not None]
        for one, other in _against_others(own[:: max(1, len(own) // _VIEWS)]):
            about.append(one)
            dark.append(other)
    x, y = np.concatenate(about), np.concatenate(dark)
    if not len(x) or np.ptp(x) < _ENOUGH:
        return None
    place = np.minimum(((x - x.min()) / np.ptp(x) * _BINS).astype(np.int64), _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    told = np.flatnonzero(count >= _LEAST)
    at = np.array([x[place == one].mean() for one in told])
    if len(told) < 3 or np.ptp(at) < _ENOUGH:
        return None
    medians = np.array([np.median(y[place == one]) for one in told])
    weight = np.sqrt(count[told])
    return float(np.polyfit(at, medians, 1, w=weight)[0])


def _against_others(views: Sequence[Silhouette]) -> Iterator[tuple[Image, Image]]:
    """Yield, of each view, what `_beside` returns less the same pixel's mean over all views of one camera."""
    if len(views) <= _OTHERS:
        yield from (_beside(view)[1:] for view in views)
        return
    shape = views[0].coverage.shape
    total, darkness, count = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.int32)
    for view in views:  # twice through the views: what they tell of every pixel would be large
        beside, about, dark = _beside(view)
        total[beside] += about
        darkness[beside] += dark
        count[beside] += 1
    for view in views:
        beside, about, dark = _beside(view)
        often, n = count[beside] > _OTHERS, count[beside].astype(np.float32)
        yield (about - total[beside] / n)[often], (dark - darkness[beside] / n)[often]


def _beside(silhouette: Silhouette) -> tuple[Mask, Image, Image]:
    """Return the pixels beside roots (H, W), and there how much of what is about is root (N,), and the opacity (N,)."""
    root = (silhouette.coverage > _ROOT) & silhouette.seen
    away = cv2.distanceTransform((~root).astype(np.uint8), cv2.DIST_L2, 5)
    inner = cv2.erode(silhouette.seen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    beside = inner & (away > _BESIDE_PX) & (away < 4.0 * _WIDE_PX)
    wide = cv2.GaussianBlur(np.where(silhouette.seen, silhouette.coverage, 0.0).astype(np.float32), (0, 0), _WIDE_PX)
    return np.asarray(beside), wide[beside], np.asarray(silhouette.opacity, np.float32)[beside]
