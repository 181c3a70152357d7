"""Scored cases, as a worker gives them."""

from collections.abc import Callable
from typing import Any

import pytest

from benchmarks.accuracy import describe_case
from benchmarks.cases import Case


@pytest.fixture(scope="session")
def record_of() -> Callable[..., dict[str, Any]]:
    """Make the record of a case with chosen errors."""

    def record(
        case: Case, *, volume_error: float = 0.01, length_error: float = -0.02, tips: float = 0.9, holds: bool = True
    ) -> dict[str, Any]:
        found = {"recall": 0.99, "precision": 0.98, "distance_median_mm": 0.03, "radius_error_median": 0.01}
        length = {"length_mm": 98.0, "length_true_mm": 100.0, "length_error": length_error}
        roots = found | length | {"tips": 9, "tips_true": 10, "tip_recall": tips, "tip_precision": tips}
        volume = {"volume_mm3": 100.0 * (1.0 + volume_error), "volume_true_mm3": 100.0, "volume_error": volume_error}
        interval = {"volume_interval_mm3": [95.0, 105.0] if holds else [110.0, 120.0], "interval_holds_truth": holds}
        voxels = {"extents_error_max": 0.01, "recall": 0.9, "precision": 0.8, "iou": 0.7}
        stages = {
            "surface": {"median_mm": 0.1, "p95_mm": 0.2},
            "poses": {"used": 6, "median_mm": 0.03, "median_deg": 0.004},
            "masks": {"area_error": 0.0, "iou": 0.99},
            "hull": {"recall": 1.0, "volume_error": 0.1},
        }
        tree = {"identity": 0.95, "order_length": 0.96, "main_length": 0.97, "branch_recall": 0.8, "branch_precision": 0.9}
        tree |= {"ghosts_mm": 2.0, "doubled_mm": -1.0, "missing_mm": 3.0}
        has_tree = case.pictures.has_roots and case.method == "coverage"
        stages |= {"roots": roots if has_tree else None, "topology": tree if has_tree else None, "volume_trusted": True}
        score = volume | interval | voxels | stages
        taken = {"wall_s": 30.0, "cpu_s": 50.0, "peak_memory_mib": 2048.0, "load": 1.0, "commit": "0123abcd"}
        return {"case": describe_case(case), "score": score, **taken}

    return record
