"""Comparison of several plants in a result with the ground truth, separately for each plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.results.by_plant import PlantResult
from rhizotwin.scenes import polyline, rsml
from rhizotwin.scenes.rsml import Root
from rhizotwin.scoring.score_roots import NEAR_MM

_STEP_MM = 0.1
"""Spacing of the sample points along roots, mm. It is a fifth of the maximum distance between centre lines that
match."""


@dataclass(frozen=True, kw_only=True)
class PlantScore:
    """Agreement of a plant with the ground truth. Relative errors are (found / true - 1)."""

    plant: str
    """Name of the plant."""
    volume_mm3: float
    """Volume of the plant, mm3."""
    volume_true_mm3: float
    """True volume of the plant, mm3."""
    volume_error: float
    """Relative error of the volume."""
    interval_holds_truth: bool
    """Whether the 90 % interval of the volume contains the true volume."""
    length_mm: float
    """Total length of the plant's roots, mm."""
    length_true_mm: float
    """True total length of the plant's roots, mm."""
    length_error: float
    """Relative error of the length."""
    rightly_given: float
    """Fraction of the root length assigned to this plant that belongs to this plant. Roots that match no true root are
    excluded."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows (name, text) of the score's text table."""
        return [
            (f"plant {self.plant}", f"{self.volume_mm3:.1f} mm3, true {self.volume_true_mm3:.1f} mm3: {100.0 * self.volume_error:+.2f} %"),
            ("  length", f"{self.length_mm:.1f} mm, true {self.length_true_mm:.1f} mm: {100.0 * self.length_error:+.2f} %"),
            ("  assigned correctly", f"{100.0 * self.rightly_given:.2f} % of the length"),
        ]


def compare_plants(
    found: Sequence[PlantResult], roots: Sequence[Root], truth: Mapping[str, Mapping[str, Any]], true: Sequence[Root]
) -> tuple[PlantScore, ...]:
    """Compare each plant that occurs in both the result and the ground truth.

    Parameters
    ----------
    found : sequence of PlantResult
        Plants of the result.
    roots, true : sequence of Root
        Found and true roots with the names of their plants.
    truth : mapping
        True values, keyed by plant name, see `scenes.truth.Truth.plants`.
    """
    told = [one for one in found if one.subject.plant in truth]
    if not told:
        return ()
    points, owner = _sample_roots(true)
    tree = cKDTree(points)
    scores = []
    for one in told:
        name = one.subject.plant
        own = rsml.plant_roots(roots, name)
        length_true = rsml.length_mm(rsml.plant_roots(true, name))
        away, nearest = tree.query(_sample_roots(own)[0])
        near = away < NEAR_MM
        low, high = one.volume_interval_mm3
        volume_true = float(truth[name]["volume_mm3"])
        length = rsml.length_mm(own)
        scores.append(
            PlantScore(
                plant=name,
                volume_mm3=one.volume_mm3,
                volume_true_mm3=volume_true,
                volume_error=one.volume_mm3 / volume_true - 1.0,
                interval_holds_truth=low <= volume_true <= high,
                length_mm=length,
                length_true_mm=length_true,
                length_error=length / length_true - 1.0 if length_true > 0.0 else float("nan"),
                rightly_given=float((owner[nearest[near]] == name).mean()) if near.any() else float("nan"),
            )
        )
    return tuple(scores)


def _sample_roots(roots: Sequence[Root]) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Sample points along roots.

    Return the points (N, 3), mm, and the name (N,) of the plant to which each point belongs.
    """
    points, plants = [], []
    for root in roots:
        way = polyline.arc_length_mm(root.points_mm)
        at = polyline.middles(way, _STEP_MM)
        points.append(polyline.interpolate(root.points_mm, way, at))
        plants += [root.plant] * len(at)
    return np.concatenate([np.zeros((0, 3)), *points]), np.array(plants)
