"""Measurement of marker corners: least-squares fit of the known pattern, blurred and bent, to the picture.

OpenCV's corner refinements assume straight sides (those on a cylinder are curved) and are off by up to a pixel; some
are biased inwards by blur.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from rhizotwin.scenes.frames import Array

MARGIN: Final = 0.16
"""Width of the part of the quiet zone that is fitted, in half sides."""
TARGET_PX: Final = 90.0
"""Larger markers are downsampled to at most this side."""
GRID: Final = np.linspace(-1.3, 1.3, 209)
"""Sample positions of the tabulated pattern along s and t; a marker covers [-1, 1]."""
FLAT: Final = 6.0
"""Distance from a step, in standard deviations of the blur, beyond which it is flat to 1e-8; smaller factors would
leave the fast range of float32."""
BLUR_PX: Final = (0.25, 6.0)
"""Range of the blur's standard deviation: a pixel alone has 0.29, and 6 is over half a module of the largest
markers."""
FIRST_BLUR_PX: Final = 1.2
"""Initial standard deviation for the first marker; further markers start with that of the preceding one."""
RETABLE: Final = 0.03
"""Relative change of the blur after which the pattern is tabulated again."""
LEAST_PIXELS: Final = 60
"""Minimum number of pixels: three for each of the 18 parameters, and some more."""
MOST_STEPS: Final = 15
"""Maximum number of steps: Gauss-Newton converges fast or diverges."""
MOST_MOVE: Final = 0.15
"""Maximum displacement of a corner per step, in half sides."""
ENOUGH_PX: Final = 0.003
"""Displacement of the corners below which the fit ends: a seventh of the systematic error (`view_fit.FLOOR_PX`)."""
LEAST_CORRELATION: Final = 0.9
"""Minimum correlation. Each wrong module of 64 reduces the correlation of balanced black and white by 2/64: three may
be wrong, by dirt or glare."""
MOST_SHIFT, MOST_SHIFT_PX = 0.1, 2.5
"""Maximum displacement of the corners from the start, in sides and in pixels."""
MOST_BULGE: Final = 0.5
"""Maximum sagitta, in half sides: over half its chord it is tan(a / 4) of an arc a, so that 0.5 is 106 degrees; a
marker of the thesis's strip (13 mm on a radius of 80 mm) has 9 degrees and 0.04."""
FULL: Final = 0.985
"""Fraction of full scale above which a pixel is saturated."""
CORNERS: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Corners of a marker in (s, t)."""


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """Measured corners of one marker."""

    corners_px: Array
    """(4, 2) top left, top right, bottom right, bottom left."""
    covariance_px2: Array
    """(8, 8), from the residual picture."""
    blur_px: float
    """Standard deviation of the blur, including the pixel's own (0.29)."""
    bend: float = 0.0
    """Excess brightness of greys halfway between the marker's black and white, relative to the contrast.

    Blur creates every grey between the two, equally on both sides of an edge, for any symmetric blur: in pictures that
    are linear in light there is no bend (`recon.calibration.curve`)."""


class Scratch:
    """Memory for tabulated patterns, reused from marker to marker: allocation is slower than filling."""

    def __init__(self) -> None:
        self.planes = np.empty((4, len(GRID), len(GRID)), np.float32)
        self.table = np.empty((len(GRID), len(GRID), 4), np.float32)


def fit_marker(
    image: NDArray[np.uint8 | np.uint16],
    white: NDArray[np.bool_],
    start_px: Array,
    *,
    blur_px: float = FIRST_BLUR_PX,
    scratch: Scratch | None = None,
) -> MarkerFit | None:
    """Fit a marker's pattern to the picture.

    The model of the pixel at W(s, t) is ``k(s, t) + w(s, t) T(s, t)`` with T the pattern (1 white, 0 black) blurred by
    a Gaussian in the picture, k and w linear in (s, t). In homogeneous coordinates ``W(s, t) = H (s, t, 1) + b (1 -
    s^2)``: a homography H through the corners and a bulge b (3,), which a cylinder about an axis along t adds to a flat
    marker. All 18 parameters (8 of H, b, the blur, 3 of k, 3 of w) are fitted together by Gauss-Newton.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Grey levels, linear in light.
    white : (n, n) bool array
        True where the pattern is white, border included, row 0 at the top.
    start_px : (4, 2) float64 array
        Corners, accurate to about two pixels.
    blur_px : float
        Initial blur; use that of a neighbour.
    scratch : Scratch or None
        Memory of a previous fit in the same thread.

    Returns
    -------
    MarkerFit or None
        None if the marker leaves the picture, is saturated, or does not match its pattern.
    """
    side_px = float(np.mean(np.linalg.norm(np.roll(start_px, -1, axis=0) - start_px, axis=1)))
    window = _window(image, start_px, side_px)
    fitted = None if window is None else _gauss_newton(window, white, blur_px / window.scale_px, scratch or Scratch())
    if window is None or fitted is None:
        return None
    warp, blur, covariance, correlation, bend = fitted
    corners = _project(_matrix(warp), CORNERS)
    shift_px = float(np.max(np.linalg.norm(corners - window.start, axis=1))) * window.scale_px
    if shift_px > max(MOST_SHIFT_PX, MOST_SHIFT * side_px) or correlation < LEAST_CORRELATION or np.abs(warp[8:]).max() > MOST_BULGE:
        return None
    corners_from_h = _corner_derivatives(warp)
    return MarkerFit(
        corners_px=corners * window.scale_px + window.centre_px,
        covariance_px2=corners_from_h @ covariance[:8, :8] @ corners_from_h.T * window.scale_px**2,
        blur_px=blur * window.scale_px,
        bend=bend,
    )


@dataclass(frozen=True)
class _Window:
    """Pixels around a marker; positions are (px - centre_px) / scale_px."""

    light: Array
    """(P,) fraction of full scale."""
    xy: Array
    """(2, P)."""
    start: Array
    """(4, 2) initial corners."""
    centre_px: Array
    scale_px: float
    pixel: float
    """Width of one (downsampled) pixel in units of scale_px."""


def _window(image: NDArray[np.uint8 | np.uint16], start_px: Array, side_px: float) -> _Window | None:
    """Crop a marker with its margin, downsampled to below `TARGET_PX`; None if it leaves the picture."""
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
    xy = (np.stack(np.meshgrid(u, v)).reshape(2, -1) - centre_px[:, None]) / scale_px
    unsaturated = light.ravel() < FULL
    return _Window(light.ravel()[unsaturated], xy[:, unsaturated], (start_px - centre_px) / scale_px, centre_px, scale_px, fold / scale_px)


def _gauss_newton(
    window: _Window, white: NDArray[np.bool_], blur: float, scratch: Scratch
) -> tuple[Array, float, Array, float, float] | None:
    """Return H and b, the blur, the covariance of all, the correlation and the bend.

    H and b are (11,), the covariance is (18, 18); None if the fit diverges.

    Long sums use `_products`: a threaded BLAS would compete for the cores with threads that measure other pictures.
    """
    warp, xy, light = np.append(_homography_through(window.start), np.zeros(3)), window.xy, window.light
    table, tabled, rows = scratch.table, np.zeros(2), np.empty((19, 0))
    s, t = _start_st(warp, xy)
    for iteration in range(MOST_STEPS):
        if iteration < 2:
            inside = np.maximum(np.abs(s), np.abs(t)) < 1.0 + MARGIN
            if np.count_nonzero(inside) < LEAST_PIXELS:
                return None
            xy, light, s, t = xy[:, inside], light[inside], s[inside], t[inside]
        sigma = blur / np.linalg.norm(np.reshape(_slope(warp, np.zeros(1), np.zeros(1)), (2, 2)), axis=1)
        if np.any(np.abs(sigma - tabled) > RETABLE * tabled):
            table, tabled = _pattern(white, float(sigma[0]), float(sigma[1]), scratch), sigma
        with np.errstate(all="ignore"):  # a diverging fit may fold the marker
            s, t, to_h = _invert(warp, xy, s, t)
        if not (np.isfinite(s).all() and np.isfinite(t).all()):
            return None
        at = [np.clip((c - GRID[0]) / (GRID[1] - GRID[0]), -1e6, 1e6).astype(np.float32) for c in (s, t)]
        pattern, by_s, by_t, by_log_blur = cv2.remap(table, *at, cv2.INTER_LINEAR).reshape(-1, 4).T.astype(np.float64)
        if rows.shape[1] != len(s):
            rows = np.empty((19, len(s)))
        rows[12], rows[13], rows[14], rows[18] = 1.0, s, t, light
        np.multiply(rows[12:15], pattern, out=rows[15:18])
        products = _products(rows[12:])
        try:
            amounts = np.linalg.solve(products[:6, :6] + 1e-12 * np.eye(6), products[:6, 6])
        except np.linalg.LinAlgError:
            return None
        contrast = amounts[3] + amounts[4] * s + amounts[5] * t
        _fill_warp_derivatives(rows, contrast * by_s, contrast * by_t, warp, s, t, xy, to_h)
        rows[11] = contrast * by_log_blur / blur
        products = _products(rows)
        normal = products[:18, :18]
        left = np.concatenate([np.zeros(12), -amounts, [1.0]])
        try:
            step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), products[:18] @ left)[:12]
        except np.linalg.LinAlgError:
            return None
        moved = float(np.abs(_project(_matrix(warp + step[:11]), CORNERS) - _project(_matrix(warp), CORNERS)).max())
        step = step * min(1.0, MOST_MOVE / max(moved, 1e-12))
        warp = warp + step[:11]
        blur = float(np.clip(blur + step[11], BLUR_PX[0] * window.pixel, BLUR_PX[1] * window.pixel))
        if not np.isfinite(moved) or np.abs(warp).max() > 10.0 or contrast.mean() <= 0.0:  # diverged: corners are at 1
            return None
        if iteration > 2 and moved * window.scale_px < ENOUGH_PX:
            break
    variance, spread = float(left @ products @ left) / (len(light) - 18), float(np.var(light))
    correlation = float(np.sqrt(max(0.0, 1.0 - variance / spread))) if spread > 0.0 else 0.0
    inverse = np.linalg.pinv(normal)
    bend = _bend(rows, left, np.asarray(inverse, np.float64), 4.0 * contrast * pattern * (1.0 - pattern))
    return warp, blur, np.asarray(inverse * variance, np.float64), correlation, bend


def _bend(rows: Array, left: Array, inverse: Array, between: Array) -> float:
    """Return the excess brightness of halfway greys relative to the model (`MarkerFit.bend`).

    Parameters
    ----------
    rows : (19, P) float64 array
        Columns of the model, and the picture.
    left : (19,) float64 array
        Coefficients of the residual picture with respect to the rows.
    inverse : (18, 18) float64 array
        Inverse of the normal equations.
    between : (P,) float64 array
        Change of each pixel by a bend of one.
    """
    common = rows @ between  # projections on the model's columns and on the picture
    alone = float(between @ between - common[:18] @ inverse @ common[:18])
    return float(left @ np.append(common[:18], common[18])) / alone if alone > 0.0 else 0.0


def _products(rows: Array) -> Array:
    """Return ``rows @ rows.T``, computed in one thread."""
    return np.asarray(cv2.mulTransposed(rows, aTa=False), np.float64)


def _start_st(warp: Array, xy: Array) -> tuple[Array, Array]:
    """Return the pattern coordinates of pixels (2, P) from the homography without the bulge."""
    back = np.linalg.inv(_matrix(warp))
    s, t, _ = _warp(np.append(back.ravel()[:8] / back[2, 2], np.zeros(3)), xy[0], xy[1])
    return s, t


def _fill_warp_derivatives(
    rows: Array, by_s: Array, by_t: Array, warp: Array, s: Array, t: Array, xy: Array, to_h: tuple[Array, ...]
) -> None:
    """Fill rows 0 to 10 with the derivatives of the model by H and b, at fixed pixels."""
    s_x, s_y, t_x, t_y = to_h
    bulge = 1.0 - s * s
    depth = warp[6] * s + warp[7] * t + 1.0 + warp[10] * bulge
    rows[2] = -(by_s * s_x + by_t * t_x) / depth
    rows[5] = -(by_s * s_y + by_t * t_y) / depth
    by_depth = -(rows[2] * xy[0] + rows[5] * xy[1])
    for first, change in ((0, rows[2]), (3, rows[5]), (6, by_depth)):
        np.multiply(change, s, out=rows[first])
        np.multiply(change, t, out=rows[first + 1])
    for row, change in ((8, rows[2]), (9, rows[5]), (10, by_depth)):
        np.multiply(change, bulge, out=rows[row])


def _pattern(white: NDArray[np.bool_], sigma_s: float, sigma_t: float, scratch: Scratch) -> NDArray[np.float32]:
    """Tabulate T, dT/ds, dT/dt and dT/dlog(blur) on `GRID` x `GRID` (t down, s right).

    Cells are convolved with a Gaussian in closed form.

    A step at e blurred by sigma is Phi((s - e) / sigma); a derivative by log sigma is sigma^2 times the second
    derivative by s (heat equation).
    """
    cells = np.pad(white.astype(np.float32), 1, constant_values=1.0)
    edges = np.linspace(-1.0, 1.0, len(white) + 1)
    factors: list[list[NDArray[np.float32]]] = []
    for sigma in (sigma_s, sigma_t):
        z = np.clip((GRID[:, None] - edges) / sigma, -FLAT, FLAT)
        step = np.ones((len(GRID), len(edges) + 2))
        step[:, 1:-1], step[:, -1] = 0.5 * (1.0 + erf(z * np.sqrt(0.5))), 0.0
        slope, bend = np.zeros_like(step), np.zeros_like(step)
        slope[:, 1:-1] = np.exp(-0.5 * z * z) / (sigma * np.sqrt(2.0 * np.pi))
        bend[:, 1:-1] = -z * slope[:, 1:-1] * sigma
        factors.append([(f[:, :-1] - f[:, 1:]).astype(np.float32) for f in (step, slope, bend)])
    (s0, s1, s2), (t0, t1, t2) = factors
    cells_s0, t0_cells = cells @ s0.T, t0 @ cells
    planes = scratch.planes  # five small products: BLAS would divide a larger one among threads that wait for each other
    for left, right, plane in ((t0, cells_s0, 0), (t0_cells, s1.T, 1), (t1, cells_s0, 2), (t0_cells, s2.T, 3)):
        np.matmul(left, right, out=planes[plane])
    planes[3] += t2 @ cells_s0
    return np.asarray(cv2.merge(list(planes), scratch.table), np.float32)


def _matrix(warp: Array) -> Array:
    return np.append(warp[:8], 1.0).reshape(3, 3)


def _project(matrix: Array, points: Array) -> Array:
    """Apply a homography to points (P, 2)."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def _homography_through(corners: Array) -> Array:
    """Return h (8,) of the homography that maps `CORNERS` to ``corners`` (4, 2)."""
    (s, t), (x, y) = CORNERS.T, corners.T
    one, zero = np.ones(4), np.zeros(4)
    rows_x = np.stack([s, t, one, zero, zero, zero, -s * x, -t * x], axis=1)
    rows_y = np.stack([zero, zero, zero, s, t, one, -s * y, -t * y], axis=1)
    return np.linalg.solve(np.concatenate([rows_x, rows_y]), np.concatenate([x, y]))


def _corner_derivatives(warp: Array) -> Array:
    """Return the derivatives of the corners (8: x, y of each) by h (8); the bulge does not move them."""
    found = np.zeros((4, 2, 8))
    for k, ((s, t), (x, y)) in enumerate(zip(CORNERS, _project(_matrix(warp), CORNERS), strict=True)):
        depth = warp[6] * s + warp[7] * t + 1.0
        found[k, 0] = np.array([s, t, 1.0, 0.0, 0.0, 0.0, -s * x, -t * x]) / depth
        found[k, 1] = np.array([0.0, 0.0, 0.0, s, t, 1.0, -s * y, -t * y]) / depth
    return found.reshape(8, 8)


def _warp(warp: Array, s: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return x, y and the homogeneous coordinate of W(s, t)."""
    bulge = 1.0 - s * s
    depth = warp[6] * s + warp[7] * t + 1.0 + warp[10] * bulge
    x = (warp[0] * s + warp[1] * t + warp[2] + warp[8] * bulge) / depth
    return x, (warp[3] * s + warp[4] * t + warp[5] + warp[9] * bulge) / depth, depth


def _slope(warp: Array, s: Array, t: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return (dx/ds, dy/ds), (dx/dt, dy/dt)."""
    x, y, depth = _warp(warp, s, t)
    depth_s = warp[6] - 2.0 * warp[10] * s
    by_s = (warp[0] - 2.0 * warp[8] * s - x * depth_s) / depth, (warp[3] - 2.0 * warp[9] * s - y * depth_s) / depth
    return by_s, ((warp[1] - x * warp[7]) / depth, (warp[4] - y * warp[7]) / depth)


def _invert(warp: Array, xy: Array, s: Array, t: Array) -> tuple[Array, Array, tuple[Array, Array, Array, Array]]:
    """Solve W(s, t) = xy by two Newton steps from a near start; return s, t and ds/dx, ds/dy, dt/dx, dt/dy."""
    for _ in range(2):
        x, y, _depth = _warp(warp, s, t)
        (x_s, y_s), (x_t, y_t) = _slope(warp, s, t)
        area = x_s * y_t - y_s * x_t
        s_x, s_y, t_x, t_y = y_t / area, -x_t / area, -y_s / area, x_s / area
        off_x, off_y = xy[0] - x, xy[1] - y
        s, t = s + s_x * off_x + s_y * off_y, t + t_x * off_x + t_y * off_y
    return s, t, (s_x, s_y, t_x, t_y)
