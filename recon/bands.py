"""Signal-to-noise ratio of the roots or the shoot in each band of the camera, from which the band is selected."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.robust import MAD
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Dataset, Frame, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor

_VIEWS = 6
"""Number of views in which the bands are compared, evenly spaced over the scan."""
_WIDEST = 20
"""Ratio of the width of the picture to the maximum width of a structure that contributes to the signal. Wider
structures are treated as background."""
_SIGMAS = 4.0
"""Minimum darkening that contributes to the signal, in standard deviations of the noise. The default threshold for
silhouettes is the same (`CoverageSettings.noise_sigmas`)."""


def measure_bands(dataset: Dataset, kind: str, *, monitor: Monitor) -> dict[str, float]:
    """Measure the signal-to-noise ratio in each band of the camera.

    A band is measured only if the panel and the front light are on and every view was photographed in this band. The
    signal is the Euclidean norm, over all pixels, of the darkening by narrow structures, as for a matched filter in
    white noise (Kay 1998, Detection Theory, section 4.3).

    Parameters
    ----------
    dataset : Dataset
        Dataset with scene and frames.
    kind : {"root", "shoot"}
        Whether the pictures show the roots or the shoot.
    monitor : Monitor
        Receives progress messages.

    Returns
    -------
    dict of float
        Signal-to-noise ratio of each band, keyed by the band's name, in decreasing order. The dict is empty if the
        camera has no bands or the dataset has no pictures of this kind.

    Raises
    ------
    UserError
        If the camera has bands, but none of them has a picture of every view with both lights on.
    """
    scene, listed = dataset.scene, [frame for frame in dataset.frames if frame.kind == kind]
    if not scene.camera.bands or not listed:
        return {}
    views = sorted({frame.view for frame in listed}, key=lambda view: view or 0)
    by_band = {band.name: {f.view: f for f in listed if f.band == band.name} for band in scene.camera.bands if scene.is_lit(band.name)}
    complete = {name: taken for name, taken in by_band.items() if len(taken) == len(views)}
    if not complete:
        raise UserError(
            f"{dataset.folder / 'dataset.json'}: no band in which the panel and the front light are on has a picture of every {kind} view. "
            "Add the missing pictures, or correct panel_level and front_level of [[camera.bands]]."
        )
    chosen = views[:: max(1, len(views) // _VIEWS)]
    with monitor.stage("bands"):
        ratios = {name: float(np.median([_ratio(dataset, taken[view]) for view in chosen])) for name, taken in complete.items()}
    return dict(sorted(ratios.items(), key=lambda item: -item[1]))


def _ratio(dataset: Dataset, frame: Frame) -> float:
    """Return the signal-to-noise ratio of one picture.

    The ratio of an unreadable picture is 0. `read_pictures` reports such pictures later.
    """
    try:
        picture = read_image(dataset, frame)
    except UserError:
        return 0.0
    light = picture[_rows(dataset.scene, frame)].astype(np.float32) / np.float32(np.iinfo(picture.dtype).max)
    side = max(3, light.shape[1] // _WIDEST) | 1
    dark = cv2.morphologyEx(light, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)) - light
    dark -= np.median(dark)  # closing selects the maximum of the noise nearby
    step = np.diff(light, axis=1)
    least = 2.0**-dataset.scene.camera.bits / 12.0**0.5  # rounding noise
    noise = max(MAD * float(np.median(np.abs(step - np.median(step)))) / 2.0**0.5, least)
    return float(np.linalg.norm(dark[dark > _SIGMAS * noise])) / noise


def _rows(scene: Scene, frame: Frame) -> slice:
    """Return the picture rows that show the roots, below the net pot, or the shoot, above it.

    The rows are predicted from the camera's nominal position according to the capture plan.
    """
    ring, pot, lens = scene.plan.rings[frame.ring], scene.net_pot, scene.camera.as_pinhole()
    z_mm = pot.skirt_bottom_mm if frame.kind == "root" else pot.top_mm
    rim = np.array([[pot.outer_radius_mm, 0.0, z_mm], [-pot.outer_radius_mm, 0.0, z_mm]])
    level = frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)
    points: NDArray[np.float64] = frames.apply(scene.camera.pinhole_pose(level), rim)
    rows = lens.focal_px[1] * points[:, 1] / points[:, 2] + lens.principal_px[1]
    height = lens.image_wh[1]
    edge = int(np.clip(rows.max() if frame.kind == "root" else rows.min(), 0, height))
    found = slice(edge, height) if frame.kind == "root" else slice(0, edge)
    return found if found.stop - found.start >= height // 8 else slice(0, height)
