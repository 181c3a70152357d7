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
"""Number of sample points on each surface. The sampling error of the median distance is below 1 % of the spread of the
distances."""


@dataclass(frozen=True, kw_only=True)
class VoxelScore:
    """Overlap of the occupied voxels with the true solid.

    The voxels of a leaf of the octree count as occupied if its occupancy is at least one half.
    """

    recall: float
    """Of the voxels with their centres in the true solid, the fraction that is occupied."""
    precision: float
    """Of the occupied voxels, the fraction with their centres in the true solid."""
    iou: float
    """Intersection over union of the occupied voxels and the voxels whose centres are in the true solid."""
    recall_weighted: float
    """Fraction of the true volume that is contained in the reconstructed volume. Leaves are weighted with their
    occupancies, and the true solid is sampled with 2^3 points per voxel."""
    precision_weighted: float
    """Fraction of the reconstructed volume that is contained in the true volume, computed with the same weights and
    samples."""
    iou_weighted: float
    """Intersection over union of the reconstructed and the true volume, computed with the same weights and samples."""


@dataclass(frozen=True, kw_only=True)
class HullScore:
    """Agreement of the visual hull, before it was trimmed, with the true solid."""

    recall: float
    """Fraction of the voxel centres in the true solid that the hull contains. The remaining voxels were carved by
    mistake."""
    volume_mm3: float
    """Volume of the hull, mm3."""
    volume_error: float
    """Relative error of the hull's volume. It is usually positive, because the hull contains all points that are
    consistent with the silhouettes."""
    kept_recall: float
    """Fraction of the voxel centres in the true solid that the trimmed shape contains. If it is smaller than the recall
    of the hull, parts of the solid were trimmed by mistake."""
    leaf_count_volume_mm3: float
    """Volume of the leaves with an occupancy of at least one half, mm3. These leaves are counted as full, as in the
    thesis."""


@dataclass(frozen=True, kw_only=True)
class SurfaceScore:
    """Distances between the reconstructed and the true surface, measured at uniformly distributed points."""

    median_mm: float
    """Median distance between the surfaces, measured at points on both surfaces, mm."""
    p95_mm: float
    """95th percentile of the distance between the surfaces, measured at points on both surfaces, mm."""
    result_to_truth_median_mm: float
    """Median distance from points on the reconstructed surface to the true surface, mm. It increases if there are
    artefacts or if roots are too thick."""
    result_to_truth_p95_mm: float
    """95th percentile of the distance from points on the reconstructed surface to the true surface, mm."""
    truth_to_result_median_mm: float
    """Median distance from points on the true surface to the reconstructed surface, mm. It increases if parts are
    missing."""
    truth_to_result_p95_mm: float
    """95th percentile of the distance from points on the true surface to the reconstructed surface, mm."""

    @staticmethod
    def of(to_truth: Array, to_result: Array) -> SurfaceScore:
        """Compute the statistics of the distances (A,) from result to truth and (B,) from truth to result, mm."""
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
    """Compare the trimmed shape and the visual hull with a closed mesh, on the voxel grid of the shape.

    Raises
    ------
    ValueError
        If the mesh is not closed.
    """
    solid = (truth.vertices_mm, truth.faces)
    origin = leaves.origin_mm
    voxel = leaves.voxel_mm
    voxels_in_leaf = leaves.size.astype(np.float64) ** 3
    occupied = leaves.occupancy >= 0.5

    true_count = voxelise.count_inside(*solid, origin_mm=origin, voxel_mm=voxel)
    inside = voxelise.count_in_boxes(*solid, leaves.low, leaves.size, origin_mm=origin, voxel_mm=voxel)
    both, found = float(inside[occupied].sum()), float(voxels_in_leaf[occupied].sum())

    share = voxelise.fraction(*solid, leaves.low, leaves.size, origin_mm=origin, voxel_mm=voxel)
    true_share = voxelise.count_inside(*solid, origin_mm=origin, voxel_mm=voxel / voxelise.SAMPLES) / voxelise.SAMPLES**3
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
    """Compare two surfaces by the distances of random sample points.

    The random seed is fixed, so that the points are the same in each call.
    """
    rng = np.random.default_rng(0)
    on_shape = surface_sample.sample(shape.vertices_mm, shape.faces, count=SURFACE_SAMPLES, rng=rng)[0]
    on_truth = surface_sample.sample(truth.vertices_mm, truth.faces, count=SURFACE_SAMPLES, rng=rng)[0]
    to_truth = surface_distance.distances(on_shape, truth.vertices_mm, truth.faces)
    to_shape = surface_distance.distances(on_truth, shape.vertices_mm, shape.faces)
    return SurfaceScore.of(to_truth, to_shape)
