"""Width of roots in pictures, measured before the reconstruction."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Silhouette

_FAINT = 0.15
"""Minimum smoothed coverage of a root: that of a root of a quarter pixel at its centre (0.25 px over sqrt(2 pi) times a
blur of 0.66 px, from the smoothing and the pixel)."""
_SMOOTH_PX = 0.6
"""Standard deviation of the smoothing that connects the pixels of a thin line."""
_LENGTH = 1.122
"""Ratio of a line's length to its number of pixels, connected by edges or corners: the mean over directions of 1 /
max(|cos|, |sin|), 4 / pi * ln(1 + sqrt(2))."""
_WINDOW_PX = 5
"""Width of the square over which area and length are summed for the local width: both flanks of a root of 3 px; wider
roots are irrelevant."""
_THIN = 0.25
"""Quantile over the length of the width that is returned: roots that cross or run side by side appear wide. For a
radish of five days the measured width is 0.61, 0.75 and 0.95 px in pictures of 400, 560 and 800 pixels; the true
quantile of its diameter is 0.232 mm, which is 0.6, 0.8 and 1.2 px."""


def thin_width_px(silhouettes: Sequence[Silhouette]) -> float | None:
    """Return the width of thin roots in pictures, in pixels; None if there is no line.

    The local width is the covered area over the length of the skeleton, which does not depend on the blur; the result
    is the lower quartile over the length.
    """
    widths = []
    for one in silhouettes:
        coverage = np.where(one.usable, one.coverage, 0.0).astype(np.float32)
        line = skeletonize((cv2.GaussianBlur(coverage, (0, 0), _SMOOTH_PX) > _FAINT) & one.usable)
        area, length = (cv2.boxFilter(part, -1, (_WINDOW_PX, _WINDOW_PX)) for part in (coverage, line.astype(np.float32)))
        widths.append(area[line] / (_LENGTH * length[line]))
    every = np.concatenate(widths) if widths else np.zeros(0)
    return float(np.quantile(every, _THIN)) if len(every) else None
