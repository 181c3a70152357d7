"""Measured opacity of the pictures with which a result is compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from rhizotwin.recon.calibration.cameras import HELD_OUT, Camera, Cameras
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.coverage.silhouettes import TRACE, Image, Mask, Silhouette, blur_coverage
from rhizotwin.recon.hull.carve import spread
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.recon.results.result import Result
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.settings import CoverageSettings, PictureSettings
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.verification.synthesis import calibrated_camera

_MOST_USED = 8
"""Maximum number of used pictures that are measured, spread over a revolution. The refraction is tested in them, too:
they double the number of pictures of a small scan. If no picture was held out, they are compared as well."""
_SMOOTH_PX = 1.0
"""Standard deviation of the Gaussian that is applied to opacities before they are compared with the noise, px, as in
`recon.coverage.silhouettes.suppress_noise`."""
_FAR_PX = 5
"""Distance from all rendered roots beyond which a pixel shows the noise of the background, px."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture to compare, with its camera in the result and its measured opacity."""

    camera: Camera
    view: View
    light: Grey
    """(H, W) linear light."""
    opacity: Image
    """(H, W) light absorbed by roots, relative to an opaque root."""
    usable: Mask
    """(H, W) usable pixels."""
    is_compared: bool
    """Whether the roots of the picture are compared, or only the refraction is tested."""

    @property
    def smooth(self) -> Image:
        """Return the smoothed opacity (H, W)."""
        return smooth(self.opacity, self.usable)

    def trace_level(self, rendered: Image) -> float:
        """Return the smoothed opacity above which a pixel shows a root: of a thin root, and above the noise.

        Parameters
        ----------
        rendered : (H, W) float32 array
            Rendered opacity, which excludes the roots from the noise.
        """
        far = self.usable & (cv2.dilate((rendered > 0.0).astype(np.uint8), np.ones((2 * _FAR_PX + 1,) * 2, np.uint8)) == 0)
        values = self.smooth[far]
        noise = MAD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0
        return max(TRACE, CoverageSettings().noise_sigmas * noise)


def smooth(opacity: Image, usable: Mask) -> Image:
    """Smooth an opacity (H, W), using usable pixels only."""
    return blur_coverage(Silhouette(opacity, usable), _SMOOTH_PX)


def measure_pictures(result: Result, dataset: Dataset, *, monitor: Monitor) -> tuple[tuple[Picture, ...], Optics, bool]:
    """Measure the opacity of the pictures that the reconstruction did not use.

    Some of the used pictures are measured as well.

    Returns
    -------
    pictures : tuple of Picture
        Measured pictures.
    optics : Optics
        Calibrated optics of the result.
    held_out : bool
        Whether the pictures were held out of the reconstruction.

    Raises
    ------
    UserError
        If the dataset contains masks, or no picture has a camera.
    """
    if dataset.masks:
        raise UserError(f"{dataset.folder} contains masks without light, which the twin cannot render; give pictures of the backlit roots")
    chosen = result.settings.get("pictures") or {}
    band = next(iter(result.bands), chosen.get("band", ""))
    settings = PictureSettings(leave_out=tuple(chosen.get("leave_out", ())), tolerant=True, band=band)
    read = verify_curve(read_pictures(dataset, settings=settings, monitor=monitor), monitor=monitor)
    known = {camera.file: camera for camera in result.cameras if camera.used or camera.reason == HELD_OUT}
    every = tuple(known.get(frame.file, Camera(file=frame.file, ring=0, used=False)) for frame in read.frames)
    order = tuple(k for k, camera in enumerate(every) if camera.cam_from_canister is not None)
    if not order:
        raise UserError(f"{dataset.folder}: no picture has a camera in the result; repeat the reconstruction")
    optics = Optics.from_scene(dataset.scene)
    if (n_water := result.rig.get("n_water")) is not None:
        optics = replace(optics, n_water=float(n_water))
    cameras = Cameras(lens=calibrated_camera(result, dataset.scene).as_pinhole(), optics=optics, all=every, order=order)
    cameras, coverage = measure_coverage(read, cameras, monitor=monitor)
    measured = coverage.silhouettes
    held = [k for k in cameras.order if k in measured and every[k].reason == HELD_OUT]
    used = [k for k in cameras.order if k in measured and every[k].used]
    pictures = []
    for k in (*held, *(used[place] for place in spread(len(used))[:_MOST_USED])):
        shown = measured[k]
        is_compared = k in held or not held
        pictures.append(Picture(every[k], cameras.by_frame[k], read.images[k], _opacity(shown), shown.usable, is_compared))
    return tuple(pictures), optics, bool(held)


def _opacity(silhouette: Silhouette) -> Image:
    return silhouette.coverage if silhouette.opacity is None else silhouette.opacity.astype(np.float32)
