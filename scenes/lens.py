"""Validity of the OpenCV model of lens distortion."""

from collections.abc import Sequence

import numpy as np


def fold_r2(distortion: Sequence[float]) -> float:
    """Return the squared radius, in normalised coordinates, at which a lens distortion folds.

    Beyond it, the distorted radius ``r (1 + k1 r^2 + k2 r^4 + k3 r^6)`` decreases, so that the model would project
    directions far outside the picture into it.

    Parameters
    ----------
    distortion : (5,) sequence of float
        Coefficients k1, k2, p1, p2, k3 of the OpenCV model.

    Returns
    -------
    float
        Squared radius before distortion. It is infinite for most lenses, whose distortion does not fold.
    """
    k1, k2, _, _, k3 = distortion
    roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # of the derivative with respect to r, as a polynomial in r^2
    return float(roots.real[np.isreal(roots) & (roots.real > 0.0)].min(initial=np.inf))
