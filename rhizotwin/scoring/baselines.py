"""Baseline methods: Kliman's thesis (2022), the regularised visual hull (Zheng et al. 2011) and the visual hull.

The baselines are composed of stages of the reconstruction and use the same pictures and settings. They compute no
error budget, so their volumes are never marked as trusted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from skimage import filters

from rhizotwin.recon import carved_hull, shaping
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.measure import Coverage, Outline, measure_coverage
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.read_pictures import Pictures, read_pictures
from rhizotwin.recon.reconstruct import gather
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.uncertainty.budget import Budget
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.monitor import Listener, Monitor
from rhizotwin.scoring import regularised_hull

Baseline = Literal["thesis", "regularised", "hull"]
SEARCH_PX = 2.0
"""Dilation of the silhouettes before carving, in pixels.

Cells inside the dilated silhouettes may be added to the hull. With 1 px the hull of a radish is divided into 20
disconnected parts, and with 2 px into 2 parts. With 4 px there are four times as many cells
(docs/log/silhouettes-from-coverage.md).
"""


def reconstruct_baseline(
    dataset: Dataset | Path | str,
    method: Baseline,
    *,
    settings: Settings | None = None,
    monitor: Monitor | type[Any] | Listener | None = None,
) -> Result:
    """Reconstruct a dataset with a baseline method.

    Parameters
    ----------
    dataset : Dataset or path
        Pictures and scene.
    method : {"thesis", "regularised", "hull"}
        Baseline method.
    settings : Settings, optional
        Voxel size and selection of pictures; the visual hull also uses the settings of calibration and coverage.
    monitor : Monitor, type of tqdm, callable or None
        Receiver of the progress.

    Returns
    -------
    Result
        Result in memory, whose volume is marked as not trusted.
    """
    settings = settings or Settings()
    watch = Monitor.of(monitor)
    loaded = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    return _result(method, _METHODS[method](loaded, settings, watch), settings=settings, monitor=watch)


def thesis_silhouette(image: Image, usable: Mask) -> Silhouette:
    """Segment roots as in section T3.4.2 of the thesis; return a binary silhouette (H, W).

    The method combines an Otsu threshold with a hysteresis threshold on Sobel edges, followed by morphological opening.
    """
    if not usable.any():
        return Silhouette(np.zeros(image.shape, np.float32), usable)
    dark = image < filters.threshold_otsu(image[usable])
    joined = ((dark | thesis_edges(image, usable)) & usable).astype(np.uint8)
    opened = cv2.morphologyEx(joined, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return Silhouette(opened.astype(np.float32), usable)


def thesis_edges(image: Image, usable: Mask) -> Mask:
    """Return the Sobel edges (H, W) of a picture by hysteresis, as in section T3.4.2 of the thesis."""
    steep = filters.sobel(np.where(usable, image, np.median(image[usable])))
    high = filters.threshold_otsu(steep[usable])
    return np.asarray(filters.apply_hysteresis_threshold(steep, 0.5 * high, high) & usable)


class _Shape(NamedTuple):
    """Hull and intermediate results of a baseline method."""

    pictures: Pictures
    carved: carved_hull.CarvedHull
    coverage: Coverage
    volume_mm3: float


def _thesis(dataset: Dataset, settings: Settings, watch: Monitor) -> _Shape:
    """Carve the hull with the method of Kliman's thesis (2022).

    The camera of each picture is estimated separately from OpenCV's marker corners (T3.4.1). Silhouettes come from
    Otsu's threshold, hysteresis on the Sobel gradient and opening (T3.4.2), and rays are refracted through the canister
    (T3.4.3). A voxel is retained only if it lies in the silhouettes of all views, so a view in which the voxel is
    outside the picture removes it (T3.4.4, fig. 4.4). The volume is that of the retained leaves (T3.5). Unusable parts
    of the pictures are excluded, as the masks of the thesis do.
    """
    pictures, carved, coverage = _carve_strictly(
        dataset, settings, watch, slack_px=0.0, outline=lambda image, _, seen: thesis_silhouette(image, seen)
    )
    return _Shape(pictures, carved, coverage, _counted_mm3(carved.hull.leaves))


def _regularised(dataset: Dataset, settings: Settings, watch: Monitor) -> _Shape:
    """Compute the regularised visual hull of Zheng et al. (2011), which thesis section T5.3 suggests.

    Cameras are those of the thesis. Silhouettes are extracted against a modelled background, as in the paper, here as
    the outline of coverage. A voxel is retained if its centre lies in the silhouettes of all views. Voxels are then
    added where they contradict the fewest views, until all silhouette pixels of one picture are explained and separate
    parts are connected. The volume is that of all voxels.
    """
    pictures, carved, coverage = _carve_strictly(dataset, settings, watch, slack_px=SEARCH_PX, outline=None)
    with watch.stage("mend"):
        leaves = regularised_hull.regularise(carved.bank, carved.silhouettes, carved.hull)
    mended = replace(carved, hull=Hull(leaves, leaves.occupancy, carved.hull.moved_in_mm3, carved.hull.blind_mm3))
    return _Shape(pictures, mended, coverage, _counted_mm3(leaves))


def _carve_strictly(
    dataset: Dataset, settings: Settings, monitor: Monitor, *, slack_px: float, outline: Outline | None
) -> tuple[Pictures, carved_hull.CarvedHull, Coverage]:
    """Estimate the camera of each picture, extract the silhouettes, and carve the hull.

    A cell is removed if it lies outside the silhouette of any view.

    Parameters
    ----------
    slack_px : float
        Dilation of the silhouettes before carving, px.
    outline : Outline, optional
        Function that extracts the silhouette of a picture; default: outline of coverage.

    Returns
    -------
    tuple of (Pictures, CarvedHull, Coverage)
        Pictures of the dataset, hull with its cameras and silhouettes, and coverage.
    """
    pictures = read_pictures(dataset, settings=settings.pictures, monitor=monitor)
    cameras = find_cameras(pictures, monitor=monitor, measure=False, single_view=True)
    cameras = cameras.hold_out(settings.pictures.hold_out)
    cameras, coverage = measure_coverage(pictures, cameras, monitor=monitor, outline=outline)
    cameras = cameras.leave_out({}, unread=pictures.left_out)
    everyone = len(cameras.order)  # a view that does not show a cell removes it
    carved = carved_hull.carve_hull(
        pictures.dataset, cameras, coverage, finest_mm=settings.voxel_mm, slack_px=slack_px, min_votes=everyone, monitor=monitor
    )
    return pictures, carved, coverage


def _counted_mm3(leaves: Leaves) -> float:
    """Return the total volume of all leaves (cells of the octree) in mm3.

    Each leaf counts with its full volume, even if its occupancy is below 1.
    """
    return float((leaves.size.astype(np.float64) ** 3).sum() * leaves.grid.size_mm**3)


def _hull(dataset: Dataset, settings: Settings, watch: Monitor) -> _Shape:
    """Carve the visual hull of the silhouettes (Laurentini 1994) without trimming.

    Cameras, silhouettes and refraction are those of the reconstruction. Where thin roots cross, the hull contains
    spurious volume that no silhouette excludes.
    """
    pictures = verify_curve(read_pictures(dataset, settings=settings.pictures, monitor=watch), monitor=watch)
    cameras = find_cameras(pictures, settings=settings.calibration, monitor=watch).hold_out(settings.pictures.hold_out)
    cameras, coverage = measure_coverage(pictures, cameras, settings=settings.coverage, monitor=watch)
    cameras = cameras.leave_out({}, unread=pictures.left_out)
    carved = carved_hull.find_hull(pictures.dataset, cameras, coverage, settings, monitor=watch)
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
    """Convert the hull of a baseline method to a result.

    Its volume is marked as not reliable.
    """
    pictures, carved, coverage, volume_mm3 = shape
    cameras, reason = carved.cameras, f"{TITLES[method]} is a baseline without an error budget"
    budget = Budget(volume_mm3=volume_mm3, terms=(), views=len(cameras.order))
    with monitor.stage("surface"):
        solid = shaping.measure(
            carved.hull,
            carved.hull.leaves,
            shaping.make_surface(carved.hull.leaves),
            budget.volume((volume_mm3, volume_mm3)).distrust([reason]),
            voxel_mm=settings.voxel_mm,
            untrimmed_mm3=volume_mm3,
        )
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
