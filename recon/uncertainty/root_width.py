"""The width of roots in pictures, before anything is made of them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Silhouette

_FAINT = 0.15
"""Smoothed coverage above this is a root: a root of a quarter pixel has it at its middle (0.25 px over sqrt(2 pi) times
a blur of 0.66 px, the smoothing's and the pixel's own)."""
_SMOOTH_PX = 0.6
"""Smoothing that joins the pixels of a thin line."""
_LENGTH = 1.122
"""Length of a line over its pixels, which touch by edges or corners: the mean over directions of 1 / max(|cos|, |sin|),
4 / pi * ln(1 + sqrt(2))."""
_WINDOW_PX = 5
"""Side of the square over which area and length are summed for the width at a place: both flanks of a root of 3 px;
wider ones are no trouble."""
_THIN = 0.25
"""A quarter of the length is thinner than the width that is returned: roots that cross or run side by side look wide.
Of a radish of five days it is 0.61, 0.75 and 0.95 px in pictures of 400, 560 and 800 pixels; a quarter of its length is
thinner than 0.232 mm, 0.6, 0.8 and 1.2 px."""


def thin_width_px(silhouettes: Sequence[Silhouette]) -> float | None:
    """Return the width of thin roots in pictures, in pixels; None where there is no line.

    The width at a place is the covered area about it over the length of the skeleton, which does not depend on the
    blur; the result is its lower quartile over the length.
    """
    widths = []
    for one in silhouettes:
        coverage = np.where(one.seen, one.coverage, 0.0).astype(np.float32)
        line = skeletonize((cv2.GaussianBlur(coverage, (0, 0), _SMOOTH_PX) > _FAINT) & one.seen)
        area, length = (cv2.boxFilter(part, -1, (_WINDOW_PX, _WINDOW_PX)) for part in (coverage, line.astype(np.float32)))
        widths.append(area[line] / (_LENGTH * length[line]))
    every = np.concatenate(widths) if widths else np.zeros(0)
    return float(np.quantile(every, _THIN)) if len(every) else None
