"""Comparison of each of several plants in a result with the ground truth."""

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
"""Distance of the sample points along roots: a fifth of the tolerance of a centre line."""


@dataclass(frozen=True, kw_only=True)
class PlantScore:
    """Score of one of several plants. Relative errors are found / true - 1."""

    plant: str
    volume_mm3: float
    volume_true_mm3: float
    volume_error: float
    interval_holds_truth: bool
    length_mm: float
    length_true_mm: float
    length_error: float
    rightly_given: float
    """Fraction of the plant's found length on true roots that lies on roots of this plant."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of the text table."""
        return [
            (f"plant {self.plant}", f"{self.volume_mm3:.1f} mm3, true {self.volume_true_mm3:.1f} mm3: {100.0 * self.volume_error:+.2f} %"),
            ("  length", f"{self.length_mm:.1f} mm, true {self.length_true_mm:.1f} mm: {100.0 * self.length_error:+.2f} %"),
            ("  rightly given", f"{100.0 * self.rightly_given:.2f} % of the length"),
        ]


def compare_plants(
    found: Sequence[PlantResult], roots: Sequence[Root], truth: Mapping[str, Mapping[str, Any]], true: Sequence[Root]
) -> tuple[PlantScore, ...]:
    """Compare each plant that occurs in both result and ground truth.

    Parameters
    ----------
    found : sequence of OfPlant
        Plants of the result.
    roots, true : sequence of Root
        Found and true roots, with their plants.
    truth : mapping
        True values by plant, as `scenes.truth.Truth.plants`.
    """
    told = [one for one in found if one.subject.plant in truth]
    if not told:
        return ()
    points, owner = _points(true)
    tree = cKDTree(points)
    scores = []
    for one in told:
        name = one.subject.plant
        own, length_true = rsml.plant_roots(roots, name), rsml.length_mm(rsml.plant_roots(true, name))
        away, nearest = tree.query(_points(own)[0])
        near = away < NEAR_MM
        low, high = one.volume_interval_mm3
        volume_true, length = float(truth[name]["volume_mm3"]), rsml.length_mm(own)
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


def _points(roots: Sequence[Root]) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Sample points (N, 3) every fifth of `NEAR_MM` along roots, with the plant (N,) of each."""
    points, plants = [], []
    for root in roots:
        way = polyline.arc_length_mm(root.points_mm)
        at = polyline.middles(way, _STEP_MM)
        points.append(polyline.interpolate(root.points_mm, way, at))
        plants += [root.plant] * len(at)
    return np.concatenate([np.zeros((0, 3)), *points]), np.array(plants)
