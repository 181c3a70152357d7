"""Width of roots in pictures, measured before the roots are reconstructed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from skimage.morphology import skeletonize

from rhizotwin.recon.coverage.silhouettes import Silhouette

_FAINT = 0.15
"""Minimum coverage of a root after smoothing. A root 0.25 px wide has this coverage at its centre: 0.25 px divided by
the product of sqrt(2 pi) and 0.66 px, which is the standard deviation of the smoothing together with the pixel."""
_SMOOTH_PX = 0.6
"""Standard deviation of the Gaussian that smooths the coverage, px. It connects the pixels of a thin line."""
_LENGTH = 1.122
"""Ratio of a line's length to its number of pixels, averaged over all directions. The pixels of the line are connected
by edges or corners, so that the ratio is the mean of 1 / max(|cos|, |sin|), which is 4 / pi * ln(1 + sqrt(2))."""
_WINDOW_PX = 5
"""Edge length of the square over which covered area and line length are summed, px. It contains both flanks of a root 3
px wide. The width of wider roots is not needed."""
_THIN = 0.25
"""Quantile of the local widths, weighted by length, that is returned as the width of thin roots. It is low because
roots that cross or run side by side appear wide. For a radish of five days, the measured width is 0.61, 0.75 and 0.95
px in pictures 400, 560 and 800 pixels wide. The true quantile of its diameter is 0.232 mm, which is 0.6, 0.8 and 1.2
px."""


def thin_width_px(silhouettes: Sequence[Silhouette]) -> float | None:
    """Return the width of thin roots in pictures, px.

    The result is None if the pictures show no roots. The local width is the covered area divided by the length of the
    skeleton, which does not depend on the blur. The result is the lower quartile of the local width over the length of
    all roots.
    """
    widths = []
    for one in silhouettes:
        coverage = np.where(one.usable, one.coverage, 0.0).astype(np.float32)
        line = skeletonize((cv2.GaussianBlur(coverage, (0, 0), _SMOOTH_PX) > _FAINT) & one.usable)
        area, length = (cv2.boxFilter(part, -1, (_WINDOW_PX, _WINDOW_PX)) for part in (coverage, line.astype(np.float32)))
        widths.append(area[line] / (_LENGTH * length[line]))
    every = np.concatenate(widths) if widths else np.zeros(0)
    return float(np.quantile(every, _THIN)) if len(every) else None
