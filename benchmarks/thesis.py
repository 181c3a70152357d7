"""The thesis's own method, put together from the pipeline's stages: the baseline to beat.

Single-view PnP for each camera by itself; silhouettes by Otsu's threshold, hysteresis on the Sobel gradient and opening (T3.4.2);
a strict AND over all views that ignores blind directions (T3.4.4); the volume by counting leaves.
"""

from pathlib import Path

from recon.pipeline import reconstruct


def reconstruct_thesis(dataset_folder: Path, result_folder: Path, *, voxel_mm: float) -> None:
    """Reconstruct a dataset by the thesis's method into ``result_folder``."""
    reconstruct(dataset_folder, result_folder, voxel_mm=voxel_mm, method="thesis", progress=False)
