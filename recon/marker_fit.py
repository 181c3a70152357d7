"""Measure a marker's corners: lay its known pattern, blurred and bent round the net pot, over the picture by least squares.

OpenCV's refinements look for straight sides (a cylinder's are not) and are off by up to a pixel; blur pulls some of them inwards.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from scenes.frames import Array

MARGIN: Final = 0.16
"""How much of the quiet zone takes part, in half sides."""
TARGET_PX: Final = 90.0
"""Larger markers are averaged down to at most this side."""
GRID: Final = np.linspace(-1.32, 1.32, 265)
"""Where the pattern is tabulated along s and t; a marker covers [-1, 1]."""
START_BLUR: Final = 1.2
BLUR_PX: Final = (0.25, 6.0)
MOST_STEPS: Final = 15
MOST_MOVE: Final = 0.15
"""A step moves no corner by more than this, in half sides."""
ENOUGH_PX: Final = 0.003
LEAST_CORRELATION: Final = 0.9
MOST_SHIFT: Final = 0.1
"""A fit whose corners end farther than this from the start, in sides (and 2.5 px), is refused."""
CORNERS: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """Measured corners of one marker."""

    corners_px: Array
    """(4, 2) top left, top right, bottom right, bottom left."""
    covariance_px2: Array
    """(8, 8), from the residual picture."""
    blur_px: float
    """Standard deviation of the blur, the pixel's own (0.29) included."""
    correlation: float
    """Between the picture and the fitted pattern."""


def fit_marker(image: NDArray[np.uint8] | NDArray[np.uint16], white: NDArray[np.bool_], start_px: Array) -> MarkerFit | None:
    """Fit a marker's pattern to the picture.

    The model of the pixel at W(s, t) is ``k(s, t) + w(s, t) T(s, t)`` with T the pattern (1 white, 0 black) blurred by a Gaussian in the
    picture, k and w linear in (s, t). In homogeneous coordinates ``W(s, t) = H (s, t, 1) + b (1 - s^2)``: a homography H through the corners
    and a bulge b (3,), which is what a cylinder about an axis along t adds to a flat marker. All 18 parameters (8 of H, b, the blur, 3 of k,
    3 of w) are fitted together by Gauss-Newton.

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
    window = _window(image, start_px, side_px)
    fitted = None if window is None else _gauss_newton(window, white)
    if window is None or fitted is None:
        return None
    h, bend, blur, covariance, correlation = fitted
    corners = _project(_matrix(h), CORNERS)
    shift_px = float(np.max(np.linalg.norm(corners - window.start, axis=1))) * window.scale_px
    if shift_px > max(2.5, MOST_SHIFT * side_px) or correlation < LEAST_CORRELATION or np.linalg.norm(bend) > 0.5:
        return None
    corners_from_h = _by_homography(h, CORNERS).reshape(8, 8)
    return MarkerFit(
        corners_px=corners * window.scale_px + window.centre_px,
        covariance_px2=corners_from_h @ covariance[:8, :8] @ corners_from_h.T * window.scale_px**2,
        blur_px=blur * window.scale_px,
        correlation=correlation,
    )


@dataclass(frozen=True)
class _Window:
    """Pixels round a marker; positions are (px - centre_px) / scale_px."""

    light: Array
    """(P,) fraction of full scale."""
    xy: Array
    """(P, 2)."""
    start: Array
    """(4, 2) first corners."""
    centre_px: Array
    scale_px: float
    pixel: float
    """Width of one (averaged) pixel in units of scale_px."""


def _window(image: NDArray[np.uint8] | NDArray[np.uint16], start_px: Array, side_px: float) -> _Window | None:
    """Cut out a marker with its margin, averaged down to below `TARGET_PX`; None where it leaves the picture."""
    fold = int(np.ceil(side_px / TARGET_PX))
    centre_px = start_px.mean(axis=0)
    reach_px = (1.0 + MARGIN) * np.abs(start_px - centre_px).max(axis=0) + 2.0
    low = np.floor(centre_px - reach_px).astype(int)
    count = np.ceil(2.0 * reach_px / fold).astype(int) + 1
    low = np.maximum(low, 0)
    count = np.minimum(count, (np.array(image.shape[::-1]) - low) // fold)
    outer = centre_px + (start_px - centre_px) * (1.0 + 0.5 * MARGIN)
    if np.any(outer < low - 0.5) or np.any(outer > low + count * fold - 0.5):
        return None
    crop = image[low[1] : low[1] + count[1] * fold, low[0] : low[0] + count[0] * fold].astype(np.float64)
    full = float(np.iinfo(image.dtype).max)
    light = crop.reshape(count[1], fold, count[0], fold).mean(axis=(1, 3)) / full
    u, v = (low[k] + fold * np.arange(count[k]) + (fold - 1) / 2.0 for k in (0, 1))
    scale_px = side_px / 2.0
    xy = (np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2) - centre_px) / scale_px
    unsaturated = light.ravel() < 0.985
    return _Window(
        light.ravel()[unsaturated], xy[unsaturated], (start_px - centre_px) / scale_px, centre_px, scale_px, fold / scale_px
    )


def _gauss_newton(window: _Window, white: NDArray[np.bool_]) -> tuple[Array, Array, float, Array, float] | None:
    """Return h (8,), b (2,), blur, covariance of (h, b, blur, ...) and the correlation, or None where the fit runs away."""
    h, bend, blur = _homography_through(window.start), np.zeros(3), START_BLUR * window.pixel
    st = _invert(h, bend, window.xy, _project(np.linalg.inv(_matrix(h)), window.xy))
    inside = np.all(np.abs(st) < 1.0 + MARGIN, axis=1)
    for iteration in range(MOST_STEPS):
        if iteration in (1, 3):
            st = _invert(h, bend, window.xy, _project(np.linalg.inv(_matrix(h)), window.xy))
            inside = np.all(np.abs(st) < 1.0 + MARGIN, axis=1)
            if np.count_nonzero(inside) < 60:
                return None
        xy, light = window.xy[inside], window.light[inside]
        st = _invert(h, bend, xy, st[inside] if len(st) == len(inside) else st)
        model = _Linearised.at(h, bend, blur, st, white)
        shades = np.stack([np.ones(len(st)), st[:, 0], st[:, 1]], axis=1)
        photometric = np.concatenate([shades, shades * model.pattern[:, None]], axis=1)
        amounts = np.linalg.lstsq(photometric, light, rcond=None)[0]
        contrast = shades @ amounts[3:]
        design = np.concatenate([contrast[:, None] * model.slopes, photometric], axis=1)
        residual = light - photometric @ amounts
        normal = design.T @ design
        try:
            step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), design.T @ residual)[:12]
        except np.linalg.LinAlgError:
            return None
        moved = np.abs(_project(_matrix(h + step[:8]), CORNERS) - _project(_matrix(h), CORNERS)).max()
        step = step * min(1.0, MOST_MOVE / max(moved, 1e-12))
        h, bend = h + step[:8], bend + step[8:11]
        blur = float(np.clip(blur + step[11], BLUR_PX[0] * window.pixel, BLUR_PX[1] * window.pixel))
        if not np.isfinite(moved) or np.abs(h).max() > 10.0 or contrast.mean() <= 0.0:
            return None
        if iteration > 3 and moved * window.scale_px < ENOUGH_PX:
            break
    variance = float(residual @ residual) / max(len(residual) - 18, 1)
    spread = float(np.var(light))
    correlation = float(np.sqrt(max(0.0, 1.0 - variance / spread))) if spread > 0.0 else 0.0
    return h, bend, blur, np.linalg.pinv(normal) * variance, correlation


@dataclass(frozen=True)
class _Linearised:
    """The pattern at pixels, and its change with (h, b, blur)."""

    pattern: Array
    """(P,)."""
    slopes: Array
    """(P, 12)."""

    @classmethod
    def at(cls, h: Array, bend: Array, blur: float, st: Array, white: NDArray[np.bool_]) -> "_Linearised":
        """Evaluate at pixels whose pattern coordinates are ``st`` (P, 2)."""
        along_s, along_t = _jacobian(h, bend, st)
        middle = _jacobian(h, bend, np.zeros((1, 2)))
        sigma = blur / np.linalg.norm(middle[0]), blur / np.linalg.norm(middle[1])
        table = _pattern(white, float(sigma[0]), float(sigma[1]))
        at = ((st - GRID[0]) / (GRID[1] - GRID[0])).astype(np.float32)
        pattern, by_s, by_t, by_log_blur = cv2.remap(table, at[:, None, 0], at[:, None, 1], cv2.INTER_LINEAR).reshape(-1, 4).T
        area = along_s[:, 0] * along_t[:, 1] - along_s[:, 1] * along_t[:, 0]
        by_x = (by_s * along_t[:, 1] - by_t * along_s[:, 1]) / area
        by_y = (by_t * along_s[:, 0] - by_s * along_t[:, 0]) / area
        s, t = st.T
        xy, depth = _warp(h, bend, st)
        by_hx, by_hy = -by_x / depth, -by_y / depth
        by_depth = -(by_hx * xy[:, 0] + by_hy * xy[:, 1])
        bulge = 1.0 - s * s
        columns = (by_hx * s, by_hx * t, by_hx, by_hy * s, by_hy * t, by_hy, by_depth * s, by_depth * t)
        bends = (by_hx * bulge, by_hy * bulge, by_depth * bulge)
        return cls(pattern.astype(np.float64), np.stack([*columns, *bends, by_log_blur / blur], axis=1))


def _pattern(white: NDArray[np.bool_], sigma_s: float, sigma_t: float) -> NDArray[np.float32]:
    """Tabulate T, dT/ds, dT/dt and dT/dlog(blur) on `GRID` x `GRID` (t down, s right): cells convolved with a Gaussian in closed form.

    A step at e blurred by sigma is Phi((s - e) / sigma); a derivative by log sigma is sigma^2 times the second one by s (heat equation).
    """
    cells = np.pad(white.astype(np.float64), 1, constant_values=1.0)
    edges = np.linspace(-1.0, 1.0, len(white) + 1)
    factors = []
    for sigma in (sigma_s, sigma_t):
        z = (GRID[:, None] - edges) / sigma
        step = 0.5 * (1.0 + erf(z * np.sqrt(0.5)))
        slope = np.exp(-0.5 * z * z) / (sigma * np.sqrt(2.0 * np.pi))
        bounded = np.pad(step, ((0, 0), (1, 1)), constant_values=((0, 0), (1.0, 0.0)))
        factors.append((bounded, np.pad(slope, ((0, 0), (1, 1))), np.pad(-z * slope * sigma, ((0, 0), (1, 1)))))
    (s0, s1, s2), (t0, t1, t2) = ((f[0][:, :-1] - f[0][:, 1:], f[1][:, :-1] - f[1][:, 1:], f[2][:, :-1] - f[2][:, 1:]) for f in factors)
    cells_s0 = cells @ s0.T
    by_log_blur = t0 @ (cells @ s2.T) + t2 @ cells_s0
    return np.stack([t0 @ cells_s0, t0 @ (cells @ s1.T), t1 @ cells_s0, by_log_blur], axis=-1).astype(np.float32)


def _matrix(h: Array) -> Array:
    return np.append(h, 1.0).reshape(3, 3)


def _project(matrix: Array, points: Array) -> Array:
    """Apply a homography to points (P, 2)."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def _homography_through(corners: Array) -> Array:
    """Return h (8,) of the homography that takes `CORNERS` to ``corners`` (4, 2)."""
    (s, t), (x, y) = CORNERS.T, corners.T
    one, zero = np.ones(4), np.zeros(4)
    rows_x = np.stack([s, t, one, zero, zero, zero, -s * x, -t * x], axis=1)
    rows_y = np.stack([zero, zero, zero, s, t, one, -s * y, -t * y], axis=1)
    return np.linalg.solve(np.concatenate([rows_x, rows_y]), np.concatenate([x, y]))


def _by_homography(h: Array, st: Array) -> Array:
    """Return dH(s, t)/dh (P, 2, 8)."""
    s, t = st[:, 0], st[:, 1]
    depth = h[6] * s + h[7] * t + 1.0
    xy = _project(_matrix(h), st)
    found = np.zeros((len(st), 2, 8))
    for k, factor in enumerate((s / depth, t / depth, 1.0 / depth)):
        found[:, 0, k] = found[:, 1, k + 3] = factor
        if k < 2:
            found[:, :, k + 6] = -xy * factor[:, None]
    return found


def _warp(h: Array, bend: Array, st: Array) -> tuple[Array, Array]:
    """Return W(s, t) (P, 2) and its homogeneous coordinate (P,)."""
    s, t = st.T
    bulge = 1.0 - s * s
    depth = h[6] * s + h[7] * t + 1.0 + bend[2] * bulge
    x = (h[0] * s + h[1] * t + h[2] + bend[0] * bulge) / depth
    y = (h[3] * s + h[4] * t + h[5] + bend[1] * bulge) / depth
    return np.stack([x, y], axis=1), depth


def _jacobian(h: Array, bend: Array, st: Array) -> tuple[Array, Array]:
    """Return dW/ds and dW/dt, (P, 2) each."""
    xy, depth = _warp(h, bend, st)
    s = st[:, :1]
    along_s = (h[[0, 3]] - 2.0 * s * bend[:2] - xy * (h[6] - 2.0 * s * bend[2])) / depth[:, None]
    return along_s, (h[[1, 4]] - xy * h[7]) / depth[:, None]


def _invert(h: Array, bend: Array, xy: Array, st: Array) -> Array:
    """Solve W(s, t) = xy from a start ``st`` (P, 2) by two Newton steps."""
    for _ in range(2):
        off = xy - _warp(h, bend, st)[0]
        along_s, along_t = _jacobian(h, bend, st)
        area = along_s[:, 0] * along_t[:, 1] - along_s[:, 1] * along_t[:, 0]
        s = (off[:, 0] * along_t[:, 1] - off[:, 1] * along_t[:, 0]) / area
        t = (off[:, 1] * along_s[:, 0] - off[:, 0] * along_s[:, 1]) / area
        st = st + np.stack([s, t], axis=1)
    return st
