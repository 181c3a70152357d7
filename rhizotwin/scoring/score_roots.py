"""Comparison of the centre lines of a result with the true centre lines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

NEAR_MM = 0.5
"""Maximum distance between centre lines that match, mm."""
TIP_MM = 1.0
"""Maximum distance between tips that match, mm. It corresponds to two to five root diameters."""
_STEP_MM = 0.1
"""Spacing of the sample points along centre lines, mm. It is a fifth of `NEAR_MM`."""


@dataclass(frozen=True, kw_only=True)
class RootScore:
    """Agreement of the found roots with the true roots. Relative errors are (found / true - 1)."""

    length_mm: float
    """Total length of the found roots, mm."""
    length_true_mm: float
    """Total length of the true roots, mm."""
    length_error: float
    """Relative error of the total length."""
    recall: float
    """Fraction of the true length within `NEAR_MM` of a found centre line."""
    precision: float
    """Fraction of the found length within `NEAR_MM` of a true centre line."""
    distance_median_mm: float
    """Median distance from points on the found centre lines to the nearest true centre line, mm."""
    radius_error_median: float
    """Median relative error of the radius at points where found and true centre lines match."""
    tips: int
    """Number of found tips."""
    tips_true: int
    """Number of true tips."""
    tip_recall: float
    """Fraction of the true tips that match a found tip within `TIP_MM`. Each tip matches at most one other."""
    tip_precision: float
    """Fraction of the found tips that match a true tip within `TIP_MM`. Each tip matches at most one other."""


def compare_roots(found: Sequence[Root], true: Sequence[Root]) -> RootScore:
    """Compare centre lines, radii and tips of two root systems, neither of which is empty."""
    on_found, on_true = (rsml.sample_centre_lines(roots, _STEP_MM) for roots in (found, true))
    away, nearest = cKDTree(on_true.points_mm).query(on_found.points_mm)
    missed = cKDTree(on_found.points_mm).query(on_true.points_mm)[0]
    near = away < NEAR_MM
    ratio = on_found.radius_mm[near] / np.maximum(on_true.radius_mm[nearest[near]], 1e-9)
    tips, true_tips = (np.array([root.points_mm[-1] for root in roots if root.tip_seen]).reshape(-1, 3) for roots in (found, true))
    matched = count_matches(cdist(tips, true_tips) <= TIP_MM)
    length, true_length = rsml.length_mm(found), rsml.length_mm(true)
    return RootScore(
        length_mm=length,
        length_true_mm=true_length,
        length_error=length / true_length - 1.0,
        recall=float((missed < NEAR_MM).mean()),
        precision=float(near.mean()),
        distance_median_mm=float(np.median(away)),
        radius_error_median=float(np.median(ratio)) - 1.0 if near.any() else float("nan"),
        tips=len(tips),
        tips_true=len(true_tips),
        tip_recall=matched / len(true_tips) if len(true_tips) else 0.0,
        tip_precision=matched / len(tips) if len(tips) else 0.0,
    )


def count_matches(near: NDArray[np.bool_]) -> int:
    """Count the pairs of a maximum one-to-one matching, from the table (A, B) of permitted pairs."""
    return int((maximum_bipartite_matching(csr_array(near), perm_type="column") >= 0).sum()) if near.size else 0
