"""Measurement of chessboard corners by a least-squares fit of two crossing blurred edges.

A crossing is symmetric under rotation by 180 deg, so that blur and spreading ink do not displace it. The fit uses all
pixels around the crossing, whereas cornerSubPix of OpenCV uses only gradients.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from rhizotwin.scenes.frames import Array

MOST_REACH_PX: Final = 20.0
LEAST_REACH_PX: Final = 2.5
BLUR_PX: Final = (0.25, 8.0)
FIRST_BLUR_PX: Final = 0.8
MOST_STEPS: Final = 20
ENOUGH_PX: Final = 1e-3
MOST_SHIFT_PX: Final = 3.0
"""Maximum distance of the fitted crossing from its approximate position, px. The limit is smaller in small windows. A
larger distance indicates that a different crossing was found."""
LEAST_CORRELATION: Final = 0.9
LEAST_PIXELS: Final = 24


@dataclass(frozen=True, kw_only=True)
class Saddle:
    """Measured crossing of two edges."""

    at_px: Array
    """Position, px, shape (2,). Pixel centres have integer coordinates."""
    sigma_px: float
    """Standard deviation of each coordinate, estimated from the residual, px."""
    blur_px: float
    """Standard deviation of the blur, px. It includes the averaging over the area of a pixel, which has a standard
    deviation of 0.29 px."""


def fit_saddle(image: NDArray[np.uint8 | np.uint16], start_px: Array, sides_px: Array) -> Saddle | None:
    """Fit the crossing of two edges that is nearest to ``start_px``.

    The model of the pixel at p is ``k(p) + w(p) E(n1 . (p - c)) E(n2 . (p - c))`` with E(u) = erf(u / (sqrt(2) blur)),
    where n1 and n2 are the unit normals of the two edges, and k and w are linear in p. The 11 parameters are fitted
    with the Gauss-Newton method.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Grey levels.
    start_px : (2,) float64 array
        Approximate position, accurate to about two pixels.
    sides_px : (2, 2) float64 array
        Columns are vectors along the two edges. The pixels ``start_px + sides_px @ (a, b)`` with |a|, |b| < 1 must show
        only the crossing.

    Returns
    -------
    Saddle or None
        Measured crossing. None if it is at the picture's border, too small, or not recognised.
    """
    longest = float(np.linalg.norm(sides_px, axis=0).max())
    sides_px = sides_px * min(1.0, MOST_REACH_PX / longest)
    if abs(np.linalg.det(sides_px)) / longest < LEAST_REACH_PX:
        return None
    reach_px = np.abs(sides_px).sum(axis=1)
    low, high = np.ceil(start_px - reach_px).astype(int), np.floor(start_px + reach_px).astype(int) + 1
    if np.any(low < 0) or np.any(high > np.array(image.shape[::-1])):
        return None
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low[0], high[0]) - start_px[0], np.arange(low[1], high[1]) - start_px[1]))
    inside = np.abs(np.linalg.inv(sides_px) @ np.stack([x, y])).max(axis=0) < 1.0
    if np.count_nonzero(inside) < LEAST_PIXELS:
        return None
    light = image[low[1] : high[1], low[0] : high[0]].astype(np.float64).ravel()[inside]
    light = (light - light.min()) / max(float(np.ptp(light)), 1e-12)
    fitted = _gauss_newton(x[inside], y[inside], light, sides_px)
    if fitted is None:
        return None
    c, blur, sigma, correlation = fitted
    if np.linalg.norm(c) > min(MOST_SHIFT_PX, 0.5 * longest) or correlation < LEAST_CORRELATION:
        return None
    return Saddle(at_px=start_px + c, sigma_px=sigma, blur_px=blur)


def _gauss_newton(x: Array, y: Array, light: Array, sides_px: Array) -> tuple[Array, float, float, float] | None:
    """Fit the crossing with the Gauss-Newton method.

    Return the crossing (2,) relative to the start, the standard deviation of the blur, the standard deviation of the
    crossing, and the correlation between picture and model. The result is None if the fit diverges.
    """
    reach = float(np.linalg.norm(sides_px, axis=0).max())
    theta1, theta2 = np.arctan2(sides_px[1], sides_px[0]) + np.pi / 2.0  # each normal is perpendicular to its edge
    c, blur = np.zeros(2), FIRST_BLUR_PX
    linear = np.stack([np.ones_like(x), x / reach, y / reach])
    for _ in range(MOST_STEPS):
        u, v = x - c[0], y - c[1]
        n1, n2 = (np.array([np.cos(t), np.sin(t)]) for t in (theta1, theta2))
        d1, d2 = n1[0] * u + n1[1] * v, n2[0] * u + n2[1] * v
        e1, e2 = erf(d1 / (np.sqrt(2.0) * blur)), erf(d2 / (np.sqrt(2.0) * blur))
        cross = e1 * e2
        columns = np.concatenate([linear, linear * cross])
        amounts = np.linalg.lstsq(columns.T, light, rcond=None)[0]
        w = amounts[3:] @ linear
        g1, g2 = (np.exp(-0.5 * (d / blur) ** 2) * np.sqrt(2.0 / np.pi) / blur for d in (d1, d2))  # dE/dd
        by_d1, by_d2 = w * g1 * e2, w * e1 * g2
        jacobian = np.stack(
            [
                -(by_d1 * n1[0] + by_d2 * n2[0]),
                -(by_d1 * n1[1] + by_d2 * n2[1]),
                by_d1 * (n1[0] * v - n1[1] * u),
                by_d2 * (n2[0] * v - n2[1] * u),
                -(by_d1 * d1 + by_d2 * d2) / blur,
                *columns,
            ]
        )
        left = light - amounts @ columns
        normal = jacobian @ jacobian.T
        try:
            step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), jacobian @ left)
        except np.linalg.LinAlgError:
            return None
        moved = float(np.linalg.norm(step[:2]))
        if not np.isfinite(step).all():
            return None
        step = step * min(1.0, 0.3 * reach / max(moved, 1e-12), 0.3 / max(float(np.abs(step[2:4]).max()), 1e-12))
        c, theta1, theta2 = c + step[:2], theta1 + step[2], theta2 + step[3]
        blur = float(np.clip(blur + step[4], max(BLUR_PX[0], 0.5 * blur), min(BLUR_PX[1], 2.0 * blur)))
        if np.linalg.norm(c) > reach:
            return None
        if moved < ENOUGH_PX:
            break
    variance, spread = float(left @ left) / max(len(light) - 11, 1), float(np.var(light))
    covariance = np.linalg.pinv(normal) * variance
    correlation = float(np.sqrt(max(0.0, 1.0 - variance / spread))) if spread > 0.0 else 0.0
    return c, blur, float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]))), correlation
