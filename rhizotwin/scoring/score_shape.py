"""Comparison of a reconstructed shape with the true solid, by voxels and by surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon import surface_sample
from rhizotwin.recon.results.parts import Leaves, Mesh
from rhizotwin.scoring import surface_distance, voxelise

Array = NDArray[np.float64]

SURFACE_SAMPLES = 20_000
"""Number of sample points on each surface. The sampling error of the median distance is below 1 % of the spread."""


@dataclass(frozen=True, kw_only=True)
class VoxelScore:
    """Overlap of the occupied voxels with the true solid. A leaf is occupied from an occupancy of one half."""

    recall: float
    """Fraction of the voxel centres in the true solid that are occupied."""
    precision: float
    """Fraction of the occupied voxels whose centre is in the true solid."""
    iou: float
    """Number of voxels in the intersection divided by number of voxels in the union."""
    recall_weighted: float
    """Recall of the volume, with each leaf weighted by its occupancy and the true solid sampled with 2^3 points per
    voxel."""
    precision_weighted: float
    """Precision of the volume with the same weights."""
    iou_weighted: float
    """Intersection over union of the volumes with the same weights."""


@dataclass(frozen=True, kw_only=True)
class HullScore:
    """Agreement of the visual hull before trimming with the true solid."""

    recall: float
    """Fraction of the voxel centres in the true solid that lie in leaves of the hull. The rest was carved by
    mistake."""
    volume_mm3: float
    """Volume of the hull, mm3."""
    volume_error: float
    """Relative error of the hull's volume. Silhouettes do not determine the excess volume."""
    kept_recall: float
    """Fraction of the voxel centres in the true solid that lie in leaves of the trimmed shape. The difference from the
    recall of the hull was trimmed by mistake."""
    leaf_count_volume_mm3: float
    """Volume of the leaves that are at least half occupied, counted as full, mm3. This is the volume measure of the
    thesis."""


@dataclass(frozen=True, kw_only=True)
class SurfaceScore:
    """Distances between the reconstructed and the true surface at uniformly distributed points, mm."""

    median_mm: float
    """Median distance of the points on both surfaces, mm."""
    p95_mm: float
    """95th percentile of the distance of the points on both surfaces, mm."""
    result_to_truth_median_mm: float
    """Median distance of points on the reconstructed surface, mm. Artefacts and thickening increase it."""
    result_to_truth_p95_mm: float
    """95th percentile of the distance of points on the reconstructed surface, mm."""
    truth_to_result_median_mm: float
    """Median distance of points on the true surface, mm. Missing parts increase it."""
    truth_to_result_p95_mm: float
    """95th percentile of the distance of points on the true surface, mm."""

    @staticmethod
    def of(to_truth: Array, to_result: Array) -> SurfaceScore:
        """Compute the statistics of the distances from result to truth (A,) and from truth to result (B,), mm."""
        both = np.concatenate([to_truth, to_result])
        return SurfaceScore(
            median_mm=float(np.median(both)),
            p95_mm=float(np.percentile(both, 95.0)),
            result_to_truth_median_mm=float(np.median(to_truth)),
            result_to_truth_p95_mm=float(np.percentile(to_truth, 95.0)),
            truth_to_result_median_mm=float(np.median(to_result)),
            truth_to_result_p95_mm=float(np.percentile(to_result, 95.0)),
        )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else 0.0


def compare_voxels(leaves: Leaves, hull: Leaves, truth: Mesh) -> tuple[VoxelScore, HullScore]:
    """Compare the leaves of the trimmed shape and of the hull with a closed mesh, on the grid of the leaves.

    Raises
    ------
    ValueError
        If the mesh is not closed.
    """
    solid, origin, voxel = (truth.vertices_mm, truth.faces), leaves.origin_mm, leaves.voxel_mm
    voxels_in_leaf = leaves.size.astype(np.float64) ** 3
    occupied = leaves.occupancy >= 0.5

    true_count = voxelise.count_inside(*solid, origin_mm=origin, voxel_mm=voxel)
    inside = voxelise.count_in_boxes(*solid, leaves.low, leaves.size, origin_mm=origin, voxel_mm=voxel)
    both, found = float(inside[occupied].sum()), float(voxels_in_leaf[occupied].sum())

    share = voxelise.fraction(*solid, leaves.low, leaves.size, origin_mm=origin, voxel_mm=voxel, samples=2)
    true_share = voxelise.count_inside(*solid, origin_mm=origin, voxel_mm=voxel / 2.0) / 8.0
    common = float((np.minimum(share, leaves.occupancy) * voxels_in_leaf).sum())
    found_share = float((leaves.occupancy * voxels_in_leaf).sum())
    voxels = VoxelScore(
        recall=_ratio(both, true_count),
        precision=_ratio(both, found),
        iou=_ratio(both, true_count + found - both),
        recall_weighted=_ratio(common, true_share),
        precision_weighted=_ratio(common, found_share),
        iou_weighted=_ratio(common, true_share + found_share - common),
    )
    hull_mm3 = float((hull.occupancy * hull.size.astype(np.float64) ** 3).sum()) * voxel**3
    in_hull = voxelise.count_in_boxes(*solid, hull.low, hull.size, origin_mm=origin, voxel_mm=voxel)
    carved = HullScore(
        recall=_ratio(float(in_hull.sum()), true_count),
        volume_mm3=hull_mm3,
        volume_error=_ratio(hull_mm3, true_share * voxel**3) - 1.0,
        kept_recall=_ratio(float(inside.sum()), true_count),
        leaf_count_volume_mm3=found * voxel**3,
    )
    return voxels, carved


def compare_surfaces(shape: Mesh, truth: Mesh) -> SurfaceScore:
    """Compare two surfaces by the distances of sample points, which are identical in each call."""
    rng = np.random.default_rng(0)
    on_shape = surface_sample.sample(shape.vertices_mm, shape.faces, count=SURFACE_SAMPLES, rng=rng)[0]
    on_truth = surface_sample.sample(truth.vertices_mm, truth.faces, count=SURFACE_SAMPLES, rng=rng)[0]
    to_truth = surface_distance.distances(on_shape, truth.vertices_mm, truth.faces)
    to_shape = surface_distance.distances(on_truth, shape.vertices_mm, shape.faces)
    return SurfaceScore.of(to_truth, to_shape)
