"""Baselines: the method of the thesis, the regularised visual hull of 2011, and the plain visual hull.

They are put together from the reconstruction's stages, on the same pictures and settings. None has an error budget, so
that none calls a volume trusted.
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
from rhizotwin.recon.coverage.measure import Coverage, Outline, measure_coverage
from rhizotwin.recon.hull import regularised
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.pictures import Pictures, read_pictures
from rhizotwin.recon.reconstruct import gather
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.uncertainty.budget import Budget
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.monitor import Listener, Monitor

Baseline = Literal["thesis", "regularised", "hull"]
SEARCH_PX = 2.0
"""By how much silhouettes are grown to find the cells that may be added: with 1 px, a radish stays
in 20 parts, with 2 in 2; with 4 px there are four times as many cells (docs/log/regularised-hull.md)."""


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
    pictures, carved, coverage = _carve_strictly(
        dataset, settings, watch, slack_px=0.0, outline=lambda image, _, seen: silhouettes.thesis(image, seen)
    )
    volume_mm3 = _counted_mm3(carved.hull.leaves)
    return _result("thesis", pictures.dataset, carved, coverage, volume_mm3=volume_mm3, settings=settings, monitor=watch)


def reconstruct_regularised(dataset: Dataset | Path | str, *, settings: Settings | None = None, monitor: Listener | None = None) -> Result:
    """Reconstruct a dataset as the regularised visual hull of Zheng et al. (2011), the remedy of T5.3.

    Poses as in the thesis, silhouettes against a modelled background as in the paper (ours: the outline of coverage),
    and a strict AND over the voxels' centres. Then every pixel of one picture gets a voxel, and separate parts are
    joined, where the views object least; the volume counts voxels.

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
    pictures, carved, coverage = _carve_strictly(dataset, settings, watch, slack_px=SEARCH_PX, outline=None)
    with watch.stage("mend"):
        leaves = regularised.regularise(carved.bank, carved.silhouettes, carved.hull)
    mended = replace(carved, hull=Hull(leaves, leaves.occupancy, carved.hull.moved_in_mm3, carved.hull.blind_mm3))
    return _result("regularised", pictures.dataset, mended, coverage, volume_mm3=_counted_mm3(leaves), settings=settings, monitor=watch)


def _carve_strictly(
    dataset: Dataset | Path | str, settings: Settings, monitor: Monitor, *, slack_px: float, outline: Outline | None
) -> tuple[Pictures, shaping.Carved, Coverage]:
    """Find a pose a picture, silhouettes, and the hull that no view may miss, as the thesis does."""
    pictures = read_pictures(_loaded(dataset), settings=settings.pictures, monitor=monitor)
    cameras = find_cameras(pictures, monitor=monitor, measure=False, single_view=True)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor, outline=outline)
    cameras = cameras.without({}, unread=pictures.left_out)
    carved = shaping.carve_hull(
        pictures.dataset, cameras, coverage, finest_mm=settings.voxel_mm, slack_px=slack_px, ignore_blindness=True, monitor=monitor
    )
    return pictures, carved, coverage


def _counted_mm3(leaves: Leaves) -> float:
    """Return the volume of all leaves, however much of them is occupied."""
    return float((leaves.size.astype(np.float64) ** 3).sum() * leaves.grid.size_mm**3)


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


METHODS: dict[Baseline, Callable[..., Result]] = {
    "thesis": reconstruct_thesis,
    "regularised": reconstruct_regularised,
    "hull": reconstruct_hull,
}
TITLES: dict[Baseline, str] = {
    "thesis": "the method of the thesis of 2022",
    "regularised": "the regularised visual hull of 2011",
    "hull": "the untrimmed visual hull",
}


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
