"""Elongation of a root over time: its length at a given age, and the age at which it has a given length."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def length_at(age_days: Array, *, max_length_mm: Array, elongation_mm_per_day: Array) -> Array:
    """Return the length of a root at a given age.

    It is k (1 - exp(-r t / k)), Leitner et al. 2010 eq. 1.

    Parameters
    ----------
    age_days : (N,) array
        Time since the emergence of the root, days.
    max_length_mm : (N,) array
        Final length k, mm.
    elongation_mm_per_day : (N,) array
        Initial growth rate r, mm/day.

    Returns
    -------
    (N,) array
        Length, mm.
    """
    return max_length_mm * -np.expm1(-elongation_mm_per_day * np.maximum(age_days, 0.0) / max_length_mm)


def age_at(length_mm: Array, *, max_length_mm: Array, elongation_mm_per_day: Array) -> Array:
    """Return the age at which a root has a given length.

    The function is the inverse of `length_at`.

    Parameters
    ----------
    length_mm : (N,) array
        Length, mm, smaller than the final length.
    max_length_mm : (N,) array
        Final length k, mm.
    elongation_mm_per_day : (N,) array
        Initial growth rate r, mm/day.

    Returns
    -------
    (N,) array
        Age, days.
    """
    return -max_length_mm / elongation_mm_per_day * np.log1p(-length_mm / max_length_mm)
