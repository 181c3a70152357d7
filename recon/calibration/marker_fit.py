"""Measurement of marker corners by a least-squares fit of the known marker pattern to the picture.

The model includes the blur of the picture and the curvature of the strip. OpenCV's corner refinement methods assume
straight sides, although the sides of markers on a cylinder are curved, and deviate by up to a pixel. Some methods are
also biased inwards by blur.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from rhizotwin.scenes.frames import Array

MARGIN: Final = 0.16
"""Width of the part of the quiet zone around a marker that is included in the fit, as a fraction of half the marker's
side."""
TARGET_PX: Final = 90.0
"""Maximum side of a marker for the fit, px. Larger markers are downsampled."""
GRID: Final = np.linspace(-1.3, 1.3, 209)
"""Values of s and of t at which the pattern is tabulated. The marker itself covers the range [-1, 1] in both
coordinates."""
FLAT: Final = 6.0
"""Distance from an edge of the pattern beyond which the blurred edge is treated as constant, in standard deviations of
the blur. The error is below 1e-8. Smaller factors would lead to denormal float32 numbers, which are slow."""
BLUR_PX: Final = (0.25, 6.0)
"""Minimum and maximum standard deviation of the blur in the fit, px. The square pixel alone causes a standard deviation
of 0.29 px. The maximum exceeds half a module of the largest markers."""
FIRST_BLUR_PX: Final = 1.2
"""Initial standard deviation of the blur for the first marker of a picture, px. The fit of each further marker starts
with the blur of the preceding marker."""
RETABLE: Final = 0.03
"""Relative change of the blur, since the pattern was last tabulated, above which the pattern is tabulated again."""
LEAST_PIXELS: Final = 60
"""Minimum number of pixels to which a marker is fitted. It corresponds to at least three pixels for each of the 18
parameters."""
MOST_STEPS: Final = 15
"""Maximum number of Gauss-Newton steps. The iteration either converges in a few steps or diverges."""
MOST_MOVE: Final = 0.15
"""Maximum displacement of a marker corner per step of the fit, in halves of the marker's side."""
ENOUGH_PX: Final = 0.003
"""Displacement of the corners per step below which the fit ends, px. The value is a seventh of the systematic error of
a corner (`view_fit.FLOOR_PX`)."""
LEAST_CORRELATION: Final = 0.9
"""Minimum correlation between the fitted pattern and the picture for a marker to be accepted. Each wrong module of 64
reduces the correlation of a balanced pattern by 2/64, so dirt or glare may cover up to three modules."""
MOST_SHIFT, MOST_SHIFT_PX = 0.1, 2.5
"""Two limits for the total displacement of the corners from their initial positions. The first is a fraction of the
marker's side, and the second is given in pixels. A marker is rejected if its displacement exceeds both limits."""
MOST_BULGE: Final = 0.5
"""Maximum sagitta of a marker's curved sides in the picture, as a fraction of half the marker's side. The sagitta of an
arc with the angle a is tan(a / 4) times half its chord, so the limit corresponds to an arc of 106 degrees. A marker of
the thesis's strip (13 mm on a radius of 80 mm) spans 9 degrees and has a sagitta of 0.04."""
FULL: Final = 0.985
"""Brightness above which a pixel is saturated, as a fraction of full scale."""
CORNERS: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""(4, 2) coordinates (s, t) of a marker's corners: top left, top right, bottom right, bottom left."""
_HOMOGRAPHY, _BULGE, _BLUR = [0, 1, 2, 4, 5, 6, 8, 9], [3, 7, 11], 10
"""Indices of the parameters of the warp. Its 12 parameters are the elements of the matrix M (3, 4), row by row, with
``W = M (s, t, 1, 1 - s^2)`` in homogeneous coordinates. The blur takes the place of the element that is always 1."""


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """Result of the fit of one marker."""

    corners_px: Array
    """(4, 2) corners, px: top left, top right, bottom right, bottom left."""
    covariance_px2: Array
    """(8, 8) covariance of the x and y coordinates of the four corners, px^2, estimated from the residuals."""
    blur_px: float
    """Standard deviation of the blur, px, including 0.29 px of the pixel itself."""
    bend: float = 0.0
    """Amount by which mid-greys at the edges of the marker are too bright, relative to the contrast between black and
    white.

    A symmetric blur produces the greys between black and white equally on both sides of an edge. In pictures that are
    linear in light, the bend is therefore zero (`recon.calibration.curve`)."""


class Scratch:
    """Preallocated memory for tabulated patterns.

    The memory is reused between markers, because allocation takes longer than filling.
    """

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
    """Fit the known pattern of a marker to the picture.

    The model of the pixel at W(s, t) is ``k(s, t) + w(s, t) T(s, t)``, where T is the pattern (1 white, 0 black)
    blurred by a Gaussian in the picture, and k and w are linear in (s, t). In homogeneous coordinates, ``W(s, t) = H
    (s, t, 1) + b (1 - s^2)`` with a homography H through the corners and a bulge b (3,), which represents the curvature
    of a marker on a cylinder whose axis is parallel to t. All 18 parameters (8 of H, 3 of b, the blur, 3 of k, 3 of w)
    are fitted together by Gauss-Newton.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Grey levels, linear in light.
    white : (n, n) bool array
        True where the pattern is white, including the marker's border; row 0 is at the top.
    start_px : (4, 2) float64 array
        Initial corners, px, accurate to about two pixels.
    blur_px : float
        Initial standard deviation of the blur, px. The blur of a neighbouring marker is a good initial value.
    scratch : Scratch or None
        Memory of a previous fit in the same thread; by default, new memory is allocated.

    Returns
    -------
    MarkerFit or None
        Fitted corners. None if the marker extends beyond the picture, is saturated, or does not match the pattern.
    """
    side_px = float(np.mean(np.linalg.norm(np.roll(start_px, -1, axis=0) - start_px, axis=1)))
    window = _window(image, start_px, side_px)
    fitted = None if window is None else _gauss_newton(window, white, blur_px / window.scale_px, scratch or Scratch())
    if window is None or fitted is None:
        return None
    warp, covariance, correlation, bend = fitted
    corners = _corners(warp)
    shift_px = float(np.max(np.linalg.norm(corners - window.start, axis=1))) * window.scale_px
    if shift_px > max(MOST_SHIFT_PX, MOST_SHIFT * side_px) or correlation < LEAST_CORRELATION or np.abs(warp[_BULGE]).max() > MOST_BULGE:
        return None
    depth = np.repeat((_matrix(warp) @ _basis(*CORNERS.T))[2], 2)
    corners_from_h = _corner_rows(corners) / depth[:, None]  # corners do not depend on the bulge
    return MarkerFit(
        corners_px=corners * window.scale_px + window.centre_px,
        covariance_px2=corners_from_h @ covariance[np.ix_(_HOMOGRAPHY, _HOMOGRAPHY)] @ corners_from_h.T * window.scale_px**2,
        blur_px=float(warp[_BLUR]) * window.scale_px,
        bend=bend,
    )


@dataclass(frozen=True)
class _Window:
    """Pixels around a marker.

    Positions are normalised to (px - centre_px) / scale_px.
    """

    light: Array
    """(P,) brightness of the pixels, as a fraction of full scale."""
    xy: Array
    """(2, P) normalised positions of the pixels."""
    start: Array
    """(4, 2) normalised initial corners."""
    centre_px: Array
    """(2,) centre of the marker, px."""
    scale_px: float
    """Half the side of the marker, px."""
    pixel: float
    """Width of one pixel, after downsampling, in units of ``scale_px``."""


def _window(image: NDArray[np.uint8 | np.uint16], start_px: Array, side_px: float) -> _Window | None:
    """Crop a marker and part of its quiet zone, and downsample it to at most `TARGET_PX`.

    Return None if the marker extends beyond the picture.
    """
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


def _gauss_newton(window: _Window, white: NDArray[np.bool_], blur: float, scratch: Scratch) -> tuple[Array, Array, float, float] | None:
    """Fit the marker model to the cropped pixels by Gauss-Newton.

    Return the parameters of the warp (12,), the covariance (18, 18) of all parameters, the correlation between model
    and picture, and the bend (`MarkerFit.bend`), or None if the fit diverges. Long sums use `_products`, because a
    multi-threaded BLAS would compete with threads that measure other pictures.
    """
    warp, xy, light = np.zeros(12), window.xy, window.light
    warp[_HOMOGRAPHY], warp[_BLUR] = np.linalg.solve(_corner_rows(window.start), window.start.ravel()), blur
    table, tabled, rows, zero = scratch.table, np.zeros(2), np.empty((19, 0)), np.zeros(1)
    back = np.linalg.inv(_matrix(warp)[:, :3])
    s, t = (back[:2, :2] @ xy + back[:2, 2:]) / (back[2, :2] @ xy + back[2, 2])
    for iteration in range(MOST_STEPS):
        if iteration < 2:
            inside = np.maximum(np.abs(s), np.abs(t)) < 1.0 + MARGIN
            if np.count_nonzero(inside) < LEAST_PIXELS:
                return None
            xy, light, s, t = xy[:, inside], light[inside], s[inside], t[inside]
        sigma = warp[_BLUR] / np.linalg.norm(_warp(warp, zero, zero)[1:], axis=1)[:, 0]
        if np.any(np.abs(sigma - tabled) > RETABLE * tabled):
            table, tabled = _pattern(white, float(sigma[0]), float(sigma[1]), scratch), sigma
        with np.errstate(all="ignore"):  # a diverging fit may fold the marker
            s, t, s_xy, t_xy = _invert(warp, xy, s, t)
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
        contrast = amounts[3:] @ rows[12:15]
        basis = _basis(s, t)
        change = -contrast * (by_s * s_xy + by_t * t_xy) / (_matrix(warp)[2] @ basis)
        change = np.vstack([change, -(change * xy).sum(axis=0)])
        np.multiply(change[:, None], basis, out=rows[:12].reshape(3, 4, -1))
        rows[_BLUR] = contrast * by_log_blur / warp[_BLUR]
        products, left = _products(rows), np.concatenate([np.zeros(12), -amounts, [1.0]])
        normal = products[:18, :18]
        try:
            step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), products[:18] @ left)[:12]
        except np.linalg.LinAlgError:
            return None
        moved = float(np.abs(_corners(warp + step) - _corners(warp)).max())
        warp = warp + step * min(1.0, MOST_MOVE / max(moved, 1e-12))
        warp[_BLUR] = np.clip(warp[_BLUR], BLUR_PX[0] * window.pixel, BLUR_PX[1] * window.pixel)
        if not np.isfinite(moved) or np.abs(warp).max() > 10.0 or contrast.mean() <= 0.0:  # diverged: corners are near 1
            return None
        if iteration > 2 and moved * window.scale_px < ENOUGH_PX:
            break
    variance, spread = float(left @ products @ left) / (len(light) - 18), float(np.var(light))
    correlation = float(np.sqrt(max(0.0, 1.0 - variance / spread))) if spread > 0.0 else 0.0
    inverse = np.linalg.pinv(normal)
    bend = _bend(rows, left, np.asarray(inverse, np.float64), 4.0 * contrast * pattern * (1.0 - pattern))
    return warp, np.asarray(inverse * variance, np.float64), correlation, bend


def _bend(rows: Array, left: Array, inverse: Array, between: Array) -> float:
    """Return the bend of a marker, which is the excess brightness of mid-greys at its edges (`MarkerFit.bend`).

    Parameters
    ----------
    rows : (19, P) float64 array
        18 derivatives of the model with respect to its parameters at each pixel, followed by the picture.
    left : (19,) float64 array
        Coefficients of the residual picture with respect to ``rows``.
    inverse : (18, 18) float64 array
        Inverse of the normal matrix.
    between : (P,) float64 array
        Change of each pixel for a bend of one.
    """
    common = rows @ between  # projections on the model's columns and on the picture
    alone = float(between @ between - common[:18] @ inverse @ common[:18])
    return float(left @ common) / alone if alone > 0.0 else 0.0


def _products(rows: Array) -> Array:
    """Return ``rows @ rows.T``, computed in a single thread."""
    return np.asarray(cv2.mulTransposed(rows, aTa=False), np.float64)


def _pattern(white: NDArray[np.bool_], sigma_s: float, sigma_t: float, scratch: Scratch) -> NDArray[np.float32]:
    """Tabulate T, dT/ds, dT/dt and dT/dlog(blur) on `GRID` x `GRID` (rows along t, columns along s).

    The modules of the pattern are convolved with a Gaussian in closed form.

    A step at e, blurred by sigma, is Phi((s - e) / sigma). Its derivative with respect to log sigma is sigma^2 times
    the second derivative with respect to s (heat equation).
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
    """Return the matrix M (3, 4) of a warp."""
    matrix = warp.reshape(3, 4).copy()
    matrix[2, 2] = 1.0
    return matrix


def _basis(s: Array, t: Array) -> Array:
    return np.stack([s, t, np.ones_like(s), 1.0 - s * s])


def _corners(warp: Array) -> Array:
    """Return the corners (4, 2) of a warped marker."""
    return _warp(warp, *CORNERS.T)[0].T


def _corner_rows(corners: Array) -> Array:
    """Return the matrix (8, 8) of the equations that a homography maps `CORNERS` to the given corners (4, 2).

    The unknowns are the first 8 elements h of the homography. The derivatives of the corners with respect to h are the
    rows of this matrix, divided by the homogeneous coordinates of the corners.
    """
    rows = np.zeros((4, 2, 8))
    rows[:, 0, :3] = rows[:, 1, 3:6] = np.column_stack([CORNERS, np.ones(4)])
    rows[:, :, 6:] = -corners[:, :, None] * CORNERS[:, None, :]
    return rows.reshape(8, 8)


def _warp(warp: Array, s: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return W(s, t) (2, P), and its derivatives (2, P) with respect to s and t."""
    matrix = _matrix(warp)
    mapped, by_s = matrix @ _basis(s, t), matrix[:, :1] - 2.0 * s * matrix[:, 3:]
    at = mapped[:2] / mapped[2]
    return at, (by_s[:2] - at * by_s[2]) / mapped[2], (matrix[:2, 1:2] - at * matrix[2, 1]) / mapped[2]


def _invert(warp: Array, xy: Array, s: Array, t: Array) -> tuple[Array, Array, Array, Array]:
    """Solve W(s, t) = xy with a Newton step from initial values near the solution.

    Return s (P,), t (P,), and their derivatives (2, P) with respect to x and y.
    """
    at, (x_s, y_s), (x_t, y_t) = _warp(warp, s, t)
    area, (off_x, off_y) = x_s * y_t - y_s * x_t, xy - at
    s_x, s_y, t_x, t_y = y_t / area, -x_t / area, -y_s / area, x_s / area
    return s + s_x * off_x + s_y * off_y, t + t_x * off_x + t_y * off_y, np.stack([s_x, s_y]), np.stack([t_x, t_y])
