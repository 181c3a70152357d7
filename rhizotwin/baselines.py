"""Baselines to compare the reconstruction with: the thesis's method, and the plain visual hull.

Both are put together from the reconstruction's stages, on the same pictures and settings. Neither has an error budget,
so that neither calls a volume trusted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from rhizotwin.recon import shaping
from rhizotwin.recon.calibration.curve import read_by_edges
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.measure import Coverage, measure_coverage
from rhizotwin.recon.pictures import read_pictures
from rhizotwin.recon.reconstruct import gather
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.uncertainty.budget import Budget
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.monitor import Listener, Monitor

Baseline = Literal["thesis", "hull"]


def reconstruct_thesis(dataset: Dataset | Path | str, *, settings: Settings | None = None, monitor: Listener | None = None) -> Result:
    """Reconstruct a dataset by the method of Kliman's thesis (2022).

    Corners as OpenCV returns them and a pose a picture (T3.4.1); silhouettes by Otsu's threshold, hysteresis on the
    Sobel gradient and opening (T3.4.2); rays refracted through the canister (T3.4.3); a strict AND over all views, so
    that a view that does not see a voxel carves it (T3.4.4, fig. 4.4); the volume by counting leaves (T3.5). The
    pictures' unseen parts are left out here too: the thesis masks them.

    Parameters
    ----------
    dataset : Dataset or path
        Pictures and scene.
    settings : Settings, optional
        Voxels, and which pictures are used.
    monitor : Monitor, callable or None
        Hears how far the work is.

    Returns
    -------
    Result
        The result, not saved; its volume is not trusted.
    """
    settings, watch = settings or Settings(), Monitor.of(monitor)
    pictures = read_pictures(_loaded(dataset), settings=settings.pictures, monitor=watch)
    cameras = find_cameras(pictures, monitor=watch, measure=False, single_view=True)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=watch, outline=lambda image, _, seen: silhouettes.thesis(image, seen))
    cameras = cameras.without({}, unread=pictures.left_out)
    carved = shaping.carve_hull(
        pictures.dataset, cameras, coverage, finest_mm=settings.voxel_mm, slack_px=0.0, ignore_blindness=True, monitor=watch
    )
    counted_mm3 = float((carved.hull.leaves.size.astype(np.float64) ** 3).sum() * settings.voxel_mm**3)
    return _result("thesis", pictures.dataset, carved, coverage, volume_mm3=counted_mm3, settings=settings, monitor=watch)


def reconstruct_hull(dataset: Dataset | Path | str, *, settings: Settings | None = None, monitor: Listener | None = None) -> Result:
    """Reconstruct a dataset as the visual hull of its silhouettes (Laurentini 1994), untrimmed.

    Cameras, silhouettes and refraction are those of the reconstruction; where thin roots cross, the hull holds what no
    silhouette can exclude.

    Parameters
    ----------
    dataset, settings, monitor : Dataset, Settings, Monitor
        As in `reconstruct_thesis`.

    Returns
    -------
    Result
        The result, not saved; its volume is not trusted.
    """
    settings, watch = settings or Settings(), Monitor.of(monitor)
    pictures = read_by_edges(read_pictures(_loaded(dataset), settings=settings.pictures, monitor=watch), monitor=watch)
    cameras = find_cameras(pictures, settings=settings.calibration, monitor=watch)
    cameras, coverage = measure_coverage(pictures, cameras, settings=settings.coverage, monitor=watch)
    cameras = cameras.without({}, unread=pictures.left_out)
    carved = shaping.find_hull(pictures.dataset, cameras, coverage, settings, monitor=watch)
    return _result("hull", pictures.dataset, carved, coverage, volume_mm3=carved.hull.leaves.volume_mm3(), settings=settings, monitor=watch)


METHODS: dict[Baseline, Callable[..., Result]] = {"thesis": reconstruct_thesis, "hull": reconstruct_hull}
TITLES: dict[Baseline, str] = {"thesis": "the method of the thesis of 2022", "hull": "the untrimmed visual hull"}


def _loaded(dataset: Dataset | Path | str) -> Dataset:
    return dataset if isinstance(dataset, Dataset) else load_dataset(dataset)


def _result(
    method: Baseline,
    dataset: Dataset,
    carved: shaping.Carved,
    coverage: Coverage,
    *,
    volume_mm3: float,
    settings: Settings,
    monitor: Monitor,
) -> Result:
    """Return a hull as a result whose volume is not trusted."""
    cameras = carved.cameras
    solid = shaping.measure(
        carved.hull,
        carved.hull.leaves,
        voxel_mm=settings.voxel_mm,
        budget=Budget(volume_mm3=volume_mm3, terms=(), views=len(cameras.order)),
        bounds_mm3=(volume_mm3, volume_mm3),
        untrimmed_mm3=volume_mm3,
        monitor=monitor,
    )
    reason = f"{TITLES[method]} is a baseline without an error budget"
    solid = replace(solid, volume=solid.volume.distrusted([reason]))
    recorded = {"method": method, "voxel_mm": settings.voxel_mm}
    return gather(
        dataset, cameras, coverage, solid, warnings=(*cameras.warnings, *solid.warnings, reason), settings=recorded, monitor=monitor
    )
