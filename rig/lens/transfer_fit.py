"""Measurement of a camera's transfer curve from pictures of a static scene at several exposure times.

A pixel value v in picture j corresponds to the light ``f(v) = E t_j``, where only the exposure time t differs between
pictures. With g = ln f, every pixel i yields ``g(v_ij) = ln E_i + ln t_j`` (Debevec and Malik 1997, equation 2). The
function g is piecewise linear between knots, regularised to be smooth, and 0 at full scale. The problem is linear least
squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import lsqr

from rhizotwin.rig.errors import RigError
from rhizotwin.scenes import transfer
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.transfer import Curve

KNOTS = 65
PIXELS = 2000
"""Number of pixels used in the fit. They are distributed evenly over the brightness ranks of the picture with the
median exposure."""
USABLE = 0.02, 0.98
"""Range of pixel values used in the fit, as fractions of full scale. Values outside this range are noisy or clipped."""
SMOOTH = 2.0
"""Weight of the second differences of the logarithmic curve g = log f, relative to the equation of a pixel. The noise
of a pixel is about 0.01 in g, and the changes of slope between adjacent knots are smaller."""
LEAST_PICTURES, LEAST_RANGE = 3, 3.0
MOST_RESIDUAL = 0.01
"""Maximum residual, as a fraction of the light. With a larger residual, the pixel values are no function of the light,
for example because the camera adapts its curve to each picture, or the noise of dark pixels is too large."""
LEVELS = 8
"""Number of ranges of pixel values per picture in which residuals are averaged, so that noise counts as residual only
where it changes the mean of the logarithm."""
STOPS = 3
"""Number of steps per factor of two of a camera's shutter."""
ROUNDED = 0.10
"""Maximum relative difference between the exposure time on a camera's scale and the true one, which is a power of
2^(1/3): 1/60 s is 1/64 s, and 15 s are 16 s."""
CLEARLY = 0.5
"""Ratio of residuals below which the true exposure times of the scale replace the stated ones."""
KNOWN = 0.01
"""Maximum difference at which the measured curve is replaced by a known curve. The curves are compared after scaling by
a factor, because exposure times determine the curve only up to a factor."""


@dataclass(frozen=True, kw_only=True)
class TransferFit:
    """Measured transfer curve, with its residual and range."""

    curve: Curve
    residual: float
    """Root mean square of the mean residuals in `LEVELS` ranges of pixel values of each picture, as a fraction of the
    light."""
    rounded: bool
    """Whether the stated exposure times were rounded values of a shutter scale. The powers of 2^(1/3) were used
    instead."""
    reached: tuple[float, float]
    """Lowest and highest pixel value in the fit, as fractions of full scale. The curve is extrapolated outside this
    range."""


def fit_transfer(images: Sequence[Grey], exposures_s: Sequence[float]) -> TransferFit:
    """Measure the transfer curve of a camera from an exposure series.

    Parameters
    ----------
    images : (H, W) sequence of uint8 or uint16 array
        Stored pictures of a static scene from a static camera.
    exposures_s : sequence of float
        Exposure times of the pictures, s.

    Raises
    ------
    RigError
        If there are too few pictures or well exposed pixels, the exposure times are too similar, the pictures differ
        in size, or the residual exceeds `MOST_RESIDUAL`.
    """
    times = np.asarray(exposures_s, np.float64)
    if len(images) < LEAST_PICTURES or times.max() < LEAST_RANGE * times.min():
        raise RigError(
            f"{len(images)} pictures of {times.min():g} to {times.max():g} s do not determine a curve; take at least {LEAST_PICTURES} "
            f"pictures, with the longest exposure at least {LEAST_RANGE:g} times the shortest"
        )
    if len({image.shape for image in images}) > 1:
        raise RigError("the pictures differ in size; take all pictures of one scene with one camera")
    order = np.argsort(images[int(np.argsort(times)[len(times) // 2])], axis=None, kind="stable")
    chosen = order[np.linspace(0, order.size - 1, min(PIXELS, order.size)).astype(np.int64)]
    number = np.stack([image.ravel()[chosen] / float(np.iinfo(image.dtype).max) for image in images])
    use = (number > USABLE[0]) & (number < USABLE[1])
    use &= use.sum(axis=0) >= 2
    if use.sum() < 10 * KNOTS:
        raise RigError(
            "too few pixels are well exposed (neither dark nor clipped) in at least two pictures; use a scene with all levels from dark "
            "to bright"
        )
    g, left = _solve(number, use, times)
    scale = 2.0 ** (np.round(STOPS * np.log2(times)) / STOPS)
    g_scale, left_scale = _solve(number, use, scale) if np.abs(scale / times - 1.0).max() < ROUNDED else (g, np.inf)
    if rounded := left_scale < CLEARLY * left:
        g, left = g_scale, left_scale
    if left > MOST_RESIDUAL:
        raise RigError(
            f"the pixel values are no function of the light: the residual is {100.0 * left:.1f} % of the light, at most "
            f"{100.0 * MOST_RESIDUAL:g} % are permitted; use raw files or the lowest ISO, switch off automatic contrast and flickering "
            "lamps, and check the exposure times"
        )
    share = np.linspace(0.0, 1.0, KNOTS)
    light = np.maximum.accumulate(np.where(share > 0.0, np.exp(g - g[-1]), 0.0))
    curve = Curve("the measured curve", tuple(light.tolist()))
    known = (one for one in (transfer.LINEAR, transfer.SRGB) if _apart(light, one.of(share)) < KNOWN)
    reached = float(number[use].min()), float(number[use].max())
    return TransferFit(curve=next(known, curve), residual=left, rounded=rounded, reached=reached)


def _apart(light: NDArray[np.float64], known: NDArray[np.float64]) -> float:
    """Return the maximum difference of two curves (KNOTS,) within `USABLE`.

    The second curve is first scaled by the factor that minimises the squared differences.
    """
    inside = np.s_[int(np.ceil(USABLE[0] * KNOTS)) : int(USABLE[1] * KNOTS)]
    factor = float(light[inside] @ known[inside]) / float(known[inside] @ known[inside])
    return float(np.abs(light[inside] - factor * known[inside]).max())


def _solve(number: NDArray[np.float64], use: NDArray[np.bool_], times: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the logarithm of the curve at its knots (KNOTS,), and the residual.

    The arguments are the pixel values (J, I) of I pixels in J pictures, a mask (J, I) of the values to use, and the
    exposure times.
    """
    picture, pixel = np.nonzero(use)
    place = number[use] * (KNOTS - 1)
    low = np.minimum(place.astype(np.int64), KNOTS - 2)
    part = place - low
    weight = np.minimum(number[use], 1.0 - number[use])  # Debevec's hat function: both ends are less certain
    row = np.arange(len(place))
    bend = len(place) + np.arange(KNOTS - 2)
    last = len(place) + KNOTS - 2
    smooth = SMOOTH * np.ones(KNOTS - 2)
    k = np.arange(KNOTS - 2)
    rows = np.concatenate([row, row, row, bend, bend, bend, [last]])
    columns = np.concatenate([low, low + 1, KNOTS + pixel, k, k + 1, k + 2, [KNOTS - 1]])
    values = np.concatenate([weight * (1.0 - part), weight * part, -weight, smooth, -2.0 * smooth, smooth, [100.0]])
    matrix = coo_matrix((values, (rows, columns)), shape=(last + 1, KNOTS + number.shape[1])).tocsr()
    right = np.zeros(last + 1)
    right[row] = weight * np.log(times[picture])
    found = lsqr(matrix, right, atol=1e-10, btol=1e-10, iter_lim=5000)[0]
    left = (matrix @ found - right)[row] / weight
    level = picture * LEVELS + (number[use] * LEVELS).astype(np.int64)
    total = np.bincount(level, weight**2)
    mean = np.bincount(level, weight**2 * left)[total > 0.0] / total[total > 0.0]
    return np.asarray(found[:KNOTS]), float(np.sqrt(np.average(mean**2, weights=total[total > 0.0])))
