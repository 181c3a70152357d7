"""The thesis's own method, put together from the reconstruction's stages: the baseline to beat.

Corners as OpenCV returns them and a pose a picture (T3.4.1); silhouettes by Otsu's threshold, hysteresis on the Sobel gradient and opening
(T3.4.2); rays refracted through the canister (T3.4.3); a strict AND over all views, so that a view that does not see a voxel carves it
(T3.4.4, fig. 4.4); the volume by counting leaves (T3.5). The pictures' unseen parts are left out here too: the thesis masks them.
"""

from pathlib import Path

import numpy as np

from rhizotwin.recon import drawing, pipeline, shaping
from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.run import Run
from rhizotwin.recon.uncertainty.budget import Budget


def reconstruct_thesis(dataset_folder: Path, result_folder: Path, *, voxel_mm: float) -> Result:
    """Reconstruct a dataset by the thesis's method into ``result_folder``."""
    run = Run.of(dataset_folder, progress=False)
    found, rig = pipeline.find_cameras(run, measure=False, single_view=True)
    views = pipeline.usable(run, found)
    optics = Optics.of(run.dataset.scene)
    drawn = drawing.draw(run, views, optics, outline=lambda image, _, seen: silhouettes.thesis(image, seen))
    hull = shaping.carve_hull(run, drawn, views, optics, finest_mm=voxel_mm, slack_px=0.0, ignore_blindness=True).hull
    counted = float((hull.leaves.size.astype(np.float64) ** 3).sum() * voxel_mm**3)
    budget = Budget(volume_mm3=counted, terms=(), views=len(views))
    shape = shaping.measure(run, hull, hull.leaves, voxel_mm=voxel_mm, budget=budget, bounds_mm3=(counted, counted), untrimmed_mm3=counted)
    return pipeline.finish(run, found, rig, drawn, shape, result_folder, settings={"method": "thesis", "voxel_mm": voxel_mm})
