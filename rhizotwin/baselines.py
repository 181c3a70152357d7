"""Baselines: the method of the thesis, the regularised visual hull of 2011, and the plain visual hull.

They are put together from the reconstruction's stages, on the same pictures and settings. None has an error budget, so
that none calls a volume trusted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from rhizotwin.recon import shaping
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.measure import Coverage, Outline, measure_coverage
from rhizotwin.recon.hull import regularised
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.read_pictures import Pictures, read_pictures
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


def reconstruct_baseline(
    dataset: Dataset | Path | str,
    method: Baseline,
    *,
    settings: Settings | None = None,
    monitor: Monitor | type[Any] | Listener | None = None,
) -> Result:
    """Reconstruct a dataset by a baseline.

    Parameters
    ----------
    dataset : Dataset or path
        Pictures and scene.
    method : {"thesis", "regularised", "hull"}
        Which baseline.
    settings : Settings, optional
        Voxels, and which pictures are used; the hull also has the cameras and silhouettes of the reconstruction.
    monitor : Monitor, type of tqdm, callable or None
        Hears how far the work is.

    Returns
    -------
    Result
        The result, not saved; its volume is not trusted.
    """
    settings, watch = settings or Settings(), Monitor.of(monitor)
    loaded = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    return _result(method, _METHODS[method](loaded, settings, watch), settings=settings, monitor=watch)


class _Shape(NamedTuple):
    """What a baseline found."""

    pictures: Pictures
    carved: shaping.CarvedHull
    coverage: Coverage
    volume_mm3: float


def _thesis(dataset: Dataset, settings: Settings, watch: Monitor) -> _Shape:
    """Carve as Kliman's thesis (2022) does.

    Corners as OpenCV returns them and a pose a picture (T3.4.1); silhouettes by Otsu's threshold, hysteresis on the
    Sobel gradient and opening (T3.4.2); rays refracted through the canister (T3.4.3); a strict AND over all views, so
    that a view that does not see a voxel carves it (T3.4.4, fig. 4.4); the volume by counting leaves (T3.5). The
    pictures' unseen parts are left out here too: the thesis masks them.
    """
    pictures, carved, coverage = _carve_strictly(
        dataset, settings, watch, slack_px=0.0, outline=lambda image, _, seen: silhouettes.thesis(image, seen)
    )
    return _Shape(pictures, carved, coverage, _counted_mm3(carved.hull.leaves))


def _regularised(dataset: Dataset, settings: Settings, watch: Monitor) -> _Shape:
    """Carve as the regularised visual hull of Zheng et al. (2011), the remedy of T5.3.

    Poses as in the thesis, silhouettes against a modelled background as in the paper (ours: the outline of coverage),
    and a strict AND over the voxels' centres. Then every pixel of one picture gets a voxel, and separate parts are
    joined, where the views object least; the volume counts voxels.
    """
    pictures, carved, coverage = _carve_strictly(dataset, settings, watch, slack_px=SEARCH_PX, outline=None)
    with watch.stage("mend"):
        leaves = regularised.regularise(carved.bank, carved.silhouettes, carved.hull)
    mended = replace(carved, hull=Hull(leaves, leaves.occupancy, carved.hull.moved_in_mm3, carved.hull.blind_mm3))
    return _Shape(pictures, mended, coverage, _counted_mm3(leaves))


def _carve_strictly(
    dataset: Dataset, settings: Settings, monitor: Monitor, *, slack_px: float, outline: Outline | None
) -> tuple[Pictures, shaping.CarvedHull, Coverage]:
    """Find a pose a picture, silhouettes, and the hull that no view may miss, as the thesis does."""
    pictures = read_pictures(dataset, settings=settings.pictures, monitor=monitor)
    cameras = find_cameras(pictures, monitor=monitor, measure=False, single_view=True)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor, outline=outline)
    cameras = cameras.leave_out({}, unread=pictures.left_out)
    carved = shaping.carve_hull(
        pictures.dataset, cameras, coverage, finest_mm=settings.voxel_mm, slack_px=slack_px, ignore_blindness=True, monitor=monitor
    )
    return pictures, carved, coverage


def _counted_mm3(leaves: Leaves) -> float:
    """Return the volume of all leaves, however much of them is occupied."""
    return float((leaves.size.astype(np.float64) ** 3).sum() * leaves.grid.size_mm**3)


def _hull(dataset: Dataset, settings: Settings, watch: Monitor) -> _Shape:
    """Carve the visual hull of the silhouettes (Laurentini 1994), untrimmed.

    Cameras, silhouettes and refraction are those of the reconstruction; where thin roots cross, the hull holds what no
    silhouette can exclude.
    """
    pictures = verify_curve(read_pictures(dataset, settings=settings.pictures, monitor=watch), monitor=watch)
    cameras = find_cameras(pictures, settings=settings.calibration, monitor=watch)
    cameras, coverage = measure_coverage(pictures, cameras, settings=settings.coverage, monitor=watch)
    cameras = cameras.leave_out({}, unread=pictures.left_out)
    carved = shaping.find_hull(pictures.dataset, cameras, coverage, settings, monitor=watch)
    return _Shape(pictures, carved, coverage, carved.hull.leaves.volume_mm3())


_METHODS: dict[Baseline, Callable[[Dataset, Settings, Monitor], _Shape]] = {
    "thesis": _thesis,
    "regularised": _regularised,
    "hull": _hull,
}
TITLES: dict[Baseline, str] = {
    "thesis": "the method of the thesis of 2022",
    "regularised": "the regularised visual hull of 2011",
    "hull": "the untrimmed visual hull",
}


def _result(method: Baseline, shape: _Shape, *, settings: Settings, monitor: Monitor) -> Result:
    """Return a hull as a result whose volume is not trusted."""
    pictures, carved, coverage, volume_mm3 = shape
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
    solid = replace(solid, volume=solid.volume.distrust([reason]))
    recorded = {"method": method, "voxel_mm": settings.voxel_mm}
    return gather(
        pictures,
        cameras,
        coverage,
        solid,
        warnings=(*cameras.warnings, *solid.warnings, reason),
        settings=recorded,
        monitor=monitor,
    )
