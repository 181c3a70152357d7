"""The thesis's own method, put together from the reconstruction's stages: the baseline to beat.

Corners as OpenCV returns them and a pose a picture (T3.4.1); silhouettes by Otsu's threshold, hysteresis on the Sobel
gradient and opening (T3.4.2); rays refracted through the canister (T3.4.3); a strict AND over all views, so that a view
that does not see a voxel carves it (T3.4.4, fig. 4.4); the volume by counting leaves (T3.5). The pictures' unseen parts
are left out here too: the thesis masks them.
"""

from pathlib import Path

import numpy as np

from rhizotwin.recon import shaping
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.pictures import read_pictures
from rhizotwin.recon.reconstruct import gather
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.uncertainty.budget import Budget
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.monitor import Monitor


def reconstruct_thesis(dataset_folder: Path, result_folder: Path, *, voxel_mm: float) -> Result:
    """Reconstruct a dataset by the thesis's method into ``result_folder``.

    Parameters
    ----------
    dataset_folder : Path
        Pictures and scene.
    result_folder : Path
        New folder.
    voxel_mm : float
        Edge of the voxels.

    Returns
    -------
    Result
        What was written.
    """
    monitor, dataset = Monitor(), load_dataset(dataset_folder)
    pictures = read_pictures(dataset, monitor=monitor)
    cameras = find_cameras(pictures, monitor=monitor, measure=False, single_view=True)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor, outline=lambda image, _, seen: silhouettes.thesis(image, seen))
    carved = shaping.carve_hull(dataset, cameras, coverage, finest_mm=voxel_mm, slack_px=0.0, ignore_blindness=True, monitor=monitor)
    hull = carved.hull
    counted = float((hull.leaves.size.astype(np.float64) ** 3).sum() * voxel_mm**3)
    solid = shaping.measure(
        hull,
        hull.leaves,
        voxel_mm=voxel_mm,
        budget=Budget(volume_mm3=counted, terms=(), views=len(cameras.order)),
        bounds_mm3=(counted, counted),
        untrimmed_mm3=counted,
        monitor=monitor,
    )
    recorded = {"method": "thesis", "voxel_mm": voxel_mm}
    warnings = (*cameras.warnings, *solid.warnings)
    result = gather(dataset, cameras, coverage, solid, warnings=warnings, settings=recorded, monitor=monitor)
    result.save(result_folder)
    return result
