"""Comparison of the branching of a result with the true branching."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rhizotwin.scenes.rsml import Root, sample_centre_lines
from rhizotwin.scoring.score_roots import NEAR_MM

_STEP_MM = 0.25
"""Spacing of the sample points at which roots are matched, mm. It is half of `NEAR_MM`."""


@dataclass(frozen=True, kw_only=True)
class TopologyScore:
    """Agreement of the branching with the true branching.

    A true root is matched with the found root that lies within `NEAR_MM` of it over the largest length.
    """

    roots: int
    """Number of found roots."""
    roots_true: int
    """Number of true roots."""
    matched: float
    """Fraction of the true roots that are matched. A true root is matched if at least half of its length lies on a
    single found root."""
    parents: float
    """Fraction of the matched true roots with the correct parent. Roots whose true parent is not matched are
    excluded."""
    orders: float
    """Fraction of the matched true roots with the correct order."""


def compare_topology(found: Sequence[Root], true: Sequence[Root]) -> TopologyScore:
    """Compare parents and orders of two root systems, neither of which is empty."""
    match = _matches(found, true)
    known = [k for k, one in enumerate(match) if one >= 0]
    parents = [
        found[match[k]].parent == (match[true[k].parent] if true[k].parent >= 0 else -1)
        for k in known
        if true[k].parent < 0 or match[true[k].parent] >= 0
    ]
    orders = [found[match[k]].order == true[k].order for k in known]
    return TopologyScore(
        roots=len(found),
        roots_true=len(true),
        matched=len(known) / len(true),
        parents=float(np.mean(parents)) if parents else 0.0,
        orders=float(np.mean(orders)) if orders else 0.0,
    )


def _matches(found: Sequence[Root], true: Sequence[Root]) -> list[int]:
    """Return for each true root the index of the matching found root.

    The found root must cover at least half of the true root. The index is -1 if no found root does.
    """
    on_found = sample_centre_lines(found, _STEP_MM)
    tree = cKDTree(on_found.points_mm)
    match = []
    for root in true:
        away, nearest = tree.query(sample_centre_lines([root], _STEP_MM).points_mm, distance_upper_bound=NEAR_MM)
        near = np.isfinite(away)
        most = np.bincount(on_found.root[nearest[near]], minlength=len(found))
        match.append(int(most.argmax()) if most.max() >= 0.5 * len(near) else -1)
    return match
