"""Images of points in the water, as seen by a camera without a tank, in float64 NumPy.

An image is a ray from the camera to the point, with the invariants w and p_z of `recon.optics.refraction`. The two
equations of a projection,

    f1 = P . nu - b = 0,    f2 = z_line(P) - P_z = 0,

are solved one inside the other: f2 for p_z at a given w, and f1 for w.
"""

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.refraction import Array, Optics

_SINGLE = 0.97
"""Maximum distance from the axis of points for which `find_single_image` is valid, in units of R_o / n_water. These
points have exactly one image. For points farther from the axis, `find_images` finds all images."""
_NEWTON_STEPS = 12
"""Maximum number of Newton steps of `find_single_image`. If a ray then still misses its point by more than a thousand
times `_CLOSE_MM`, the result is NaN."""
_START = 0.9
"""Upper limit of the initial impact parameter in `find_single_image`, as a fraction of the largest possible impact
parameter. Beyond this limit, the first Newton step may leave the valid range."""
_SCANNED = 96
"""Number of intervals of the impact parameter in which `find_images` searches for images. If an interval contains two
images, they are found by `_near_fold`."""
_MOST_IMAGES = 3
"""Number of images for which memory is allocated per point. Points beyond 0.75 of the radius may have two images, and
other points have one. A third image would reveal an error."""
_CLOSE_MM = 1e-7
"""Distance of the ray from the point below which Newton's method ends, mm. It is far below the tolerance of the fast
kernel, 3e-4 mm."""


def _p_z_through(optics: Optics, rho: float, z_cam: float, w: Array, points: Array) -> Array:
    """Return the p_z of rays with the impact parameter w that pass given points at the height of the points.

    The equation f2 = 0 is solved by Newton's method. f2 is monotonic in p_z.
    """
    p_z = np.zeros(np.broadcast(w, points[..., 2]).shape)
    step = 1e-6
    for _ in range(12):
        f = refraction.height_at(optics, refraction.trace(optics, rho, z_cam, w, p_z), points[..., :2]) - points[..., 2]
        f_up = refraction.height_at(optics, refraction.trace(optics, rho, z_cam, w, p_z + step), points[..., :2]) - points[..., 2]
        p_z = np.clip(p_z - f * step / (f_up - f), -0.99, 0.99)
        if np.abs(f).max(initial=0.0) < 1e-11:
            break
    return p_z


def _horizontal_miss(optics: Optics, rho: float, z_cam: float, w: Array, points: Array) -> tuple[Array, Array]:
    """Return the horizontal distance f1 = P . nu - b between points and lines, and the p_z of the lines.

    Each line has the impact parameter w, and passes its point at the height of the point.
    """
    p_z = _p_z_through(optics, rho, z_cam, w, points)
    line = refraction.trace(optics, rho, z_cam, w, p_z)
    return np.sum(points[..., :2] * line.nu, axis=-1) - line.b_mm, p_z


def find_images(optics: Optics, rho_mm: float, z_cam_mm: float, points_mm: Array) -> tuple[Array, Array]:
    """Find all images of points in the water, as seen by one camera.

    Images are found by a search over w, and refined by bisection.

    Parameters
    ----------
    optics : Optics
        Canister and water, without a tank.
    rho_mm, z_cam_mm : float
        Horizontal distance of the camera from the axis, and height of the camera in the canister frame, mm.
    points_mm : (N, 3) float64 array
        Points with x^2 + y^2 < R_i^2, azimuth frame, mm.

    Returns
    -------
    w, p_z : (N, 3) float64 array
        Invariants of the rays to the images, ordered by w; NaN for missing images.
    """
    n = len(points_mm)
    grid = np.sin(np.linspace(-np.pi / 2, np.pi / 2, _SCANNED + 1)) * optics.w_limit
    at = np.repeat(points_mm[:, None, :], len(grid), axis=1)
    f = _horizontal_miss(optics, rho_mm, z_cam_mm, np.broadcast_to(grid, (n, len(grid))), at)[0]
    row, cell = np.nonzero(np.signbit(f[:, :-1]) != np.signbit(f[:, 1:]))
    low, high = grid[cell], grid[cell + 1]
    f_low = f[row, cell]
    row_2, low_2, high_2, f_low_2 = _near_fold(optics, rho_mm, z_cam_mm, points_mm, grid, f)
    row = np.concatenate([row, row_2])
    low, high, f_low = np.concatenate([low, low_2]), np.concatenate([high, high_2]), np.concatenate([f_low, f_low_2])
    order = np.lexsort((low, row))
    row, low, high, f_low = row[order], low[order], high[order], f_low[order]
    p_z = np.zeros_like(low)
    for _ in range(60):
        middle = 0.5 * (low + high)
        f_mid, p_z = _horizontal_miss(optics, rho_mm, z_cam_mm, middle, points_mm[row])
        same = np.signbit(f_mid) == np.signbit(f_low)
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    found_w = np.full((n, _MOST_IMAGES), np.nan)
    found_p = np.full((n, _MOST_IMAGES), np.nan)
    rank = np.arange(len(row)) - np.searchsorted(row, row, side="left")
    keep = rank < _MOST_IMAGES
    line = refraction.trace(optics, rho_mm, z_cam_mm, 0.5 * (low + high), p_z)
    keep &= refraction.enters(optics, line)
    found_w[row[keep], rank[keep]] = 0.5 * (low + high)[keep]
    found_p[row[keep], rank[keep]] = p_z[keep]
    order = np.argsort(found_w, axis=1)  # NaN last
    return np.take_along_axis(found_w, order, 1), np.take_along_axis(found_p, order, 1)


def find_single_image(optics: Optics, rho_mm: float, z_cam_mm: float, points_mm: Array) -> tuple[Array, Array]:
    """Find one image of each point in the water, as seen by one camera, by Newton's method.

    This function is faster than `find_images`. The initial value is computed as if the point were near the axis.

    Parameters
    ----------
    optics : Optics
        Canister and water, without a tank.
    rho_mm, z_cam_mm : float
        Horizontal distance of the camera from the axis, and height of the camera in the canister frame, mm.
    points_mm : (N, 3) float64 array
        Points with x^2 + y^2 < R_i^2, azimuth frame, mm.

    Returns
    -------
    w, p_z : (N,) float64 array
        Invariants of the rays. NaN for points far from the axis, which may have two images or none, and for points that
        no ray reaches.
    """
    single_mm = _SINGLE * optics.outer_radius_mm / optics.n_water
    w = np.clip(points_mm[:, 1] * optics.n_water / optics.outer_radius_mm, -_START * optics.w_limit, _START * optics.w_limit)
    step = 1e-6
    for _ in range(_NEWTON_STEPS):
        f, p_z = _horizontal_miss(optics, rho_mm, z_cam_mm, w, points_mm)
        slope = (_horizontal_miss(optics, rho_mm, z_cam_mm, w + step, points_mm)[0] - f) / step
        w = np.clip(w - f / slope, -0.999 * optics.w_limit, 0.999 * optics.w_limit)
        if np.abs(f).max(initial=0.0) < _CLOSE_MM:
            break
    line = refraction.trace(optics, rho_mm, z_cam_mm, w, p_z)
    found = (np.hypot(points_mm[:, 0], points_mm[:, 1]) < single_mm) & (np.abs(f) < 1e3 * _CLOSE_MM)
    found &= refraction.enters(optics, line)
    return np.where(found, w, np.nan), np.where(found, p_z, np.nan)


def _near_fold(
    optics: Optics, rho: float, z_cam: float, points_mm: Array, grid: Array, f: Array
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Find pairs of images that lie within two intervals of the search.

    Such pairs are close to the caustic, next to a local extremum of f1. Return, for each image, the row index of its
    point, the lower and upper bound of w, and f1 at the lower bound.
    """
    size, same = np.abs(f), np.signbit(f)
    dip = (size[:, 1:-1] < size[:, :-2]) & (size[:, 1:-1] <= size[:, 2:])
    dip &= (same[:, 1:-1] == same[:, :-2]) & (same[:, 1:-1] == same[:, 2:])
    row, cell = np.nonzero(dip)
    left, right = grid[cell], grid[cell + 2]
    sign = np.where(same[row, cell], -1.0, 1.0)
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    low, high = left.copy(), right.copy()
    for _ in range(45):
        a, b = high - golden * (high - low), low + golden * (high - low)
        f_a, f_b = (sign * _horizontal_miss(optics, rho, z_cam, w, points_mm[row])[0] for w in (a, b))
        low, high = np.where(f_a < f_b, low, a), np.where(f_a < f_b, b, high)
    middle = 0.5 * (low + high)
    f_mid = _horizontal_miss(optics, rho, z_cam, middle, points_mm[row])[0]
    pair = np.signbit(f_mid) != same[row, cell]
    row, left, right, middle, f_left, f_mid = row[pair], left[pair], right[pair], middle[pair], f[row[pair], cell[pair]], f_mid[pair]
    return np.concatenate([row, row]), np.concatenate([left, middle]), np.concatenate([middle, right]), np.concatenate([f_left, f_mid])
