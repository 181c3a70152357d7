"""Measure a marker's corners: lay its known pattern, blurred and bent round the net pot, over the picture by least squares.

Chosen over OpenCV's refinements because those look for straight sides, and a cylinder's are not (see docs/decisions).
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from scenes.frames import Array

MARGIN = 0.16
"""How much of the quiet zone takes part, in half sides."""
TARGET_PX = 90.0
"""Larger markers are averaged down to below this side."""
REACH = 1.32
STEPS = 265
"""The template covers [-REACH, REACH] squared in STEPS samples a side; a marker covers [-1, 1] squared."""
GRID: Final = np.linspace(-REACH, REACH, STEPS)
BLUR_PX = (0.3, 6.0)
LEAST_CORRELATION = 0.9
MOST_SHIFT = 0.1
"""A fit whose corners end farther than this from the start, in sides (or 2.5 px), is refused."""
CORNERS: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """Measured corners of one marker."""

    corners_px: Array
    """(4, 2) top left, top right, bottom right, bottom left."""
    covariance_px2: Array
    """(8, 8) from the residual picture."""
    blur_px: float
    """Standard deviation of the blur, the pixel's own (0.29) included."""
    correlation: float
    """Between the picture and the fitted pattern."""


def fit_marker(image: NDArray[np.uint8] | NDArray[np.uint16], white: NDArray[np.bool_], start_px: Array) -> MarkerFit | None:
    """Fit a marker's pattern to the picture.

    The model of a pixel at W(s, t) is ``k(s, t) + w(s, t) * T(s, t)`` with T the pattern (1 white, 0 black) blurred by a Gaussian in the
    picture, k and w linear in (s, t), and ``W(s, t) = H(s, t) + b (1 - s^2)``: a homography H through the corners and a bulge b, which
    is what a cylinder about a vertical axis adds to a flat marker. All 17 parameters are fitted together by Gauss-Newton.

    Parameters
    ----------
    image : (H, W) grey levels, linear in light.
    white : (n, n) True where the pattern is white, border included, row 0 at the top.
    start_px : (4, 2) corners, good to about two pixels.

    Returns
    -------
    MarkerFit or None
        None where the marker leaves the picture, is saturated, or does not look like its pattern.
    """
    side_px = float(np.mean(np.linalg.norm(np.roll(start_px, -1, axis=0) - start_px, axis=1)))
    fold = max(1, int(side_px / TARGET_PX) + (side_px > TARGET_PX))
    window = _window(image, start_px, fold)
    if window is None:
        return None
    light, centre, scale, start = window
    fitted = _gauss_newton(light, white, start)
    if fitted is None:
        return None
    h, bend, blur, covariance, correlation = fitted
    corners = _homography(h, CORNERS)
    if np.max(np.linalg.norm(corners - start, axis=1)) * scale > max(2.5, MOST_SHIFT * side_px) or correlation < LEAST_CORRELATION:
        return None
    if not np.all(np.isfinite(covariance)) or np.linalg.norm(bend) > 0.5:
        return None
    to_h = _corner_jacobian(h)
    return MarkerFit(
        corners_px=corners * scale + centre,
        covariance_px2=to_h @ covariance[:8, :8] @ to_h.T * scale**2,
        blur_px=blur * scale,
        correlation=correlation,
    )
