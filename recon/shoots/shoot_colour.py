"""Colour of a shoot: reflectance of its leaves in each band of the camera, and vegetation indices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.silhouettes import Mask, Silhouette
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.scenes import frames
from rhizotwin.scenes.bands import bands_by_range, vegetation_indices
from rhizotwin.scenes.dataset import Frame, read_image
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plan import marker_corners

_INSIDE_PX = 3
"""Distance from the outline at which leaves are measured: within two pixels of it, blur adds light from the background.
"""
_FACING = 0.7
"""Minimum cosine of the angle between the paper's normal and the line of sight."""
_FRONT_OFF = 0.02
"""Brightness of paper, as a fraction of full scale, below which it is considered unlit, as noise would dominate."""


@dataclass(frozen=True, kw_only=True)
class Colour:
    """Colour of a shoot."""

    reflectances: Mapping[str, float]
    """Reflectances by the band's range (`scenes.bands.RANGES_NM`), relative to the strip's white paper, mean over the
    leaves."""
    warnings: tuple[str, ...] = ()

    def fields(self) -> dict[str, float]:
        """Return reflectances and their vegetation indices, by the field's name in the table of traits."""
        named = {f"reflectance_{name}": value for name, value in self.reflectances.items()}
        return named | vegetation_indices(self.reflectances)


def measure_colour(pictures: Pictures, drawn: Mapping[int, Silhouette], views: Mapping[int, View]) -> Colour:
    """Measure the colour of a shoot in all bands whose panel is off.

    Leaves and paper are lit by the same lamp and cover the same pixels in all bands, so that the strength of the light
    and the inclination of the leaves cancel in the indices. Bands with the panel on are excluded: leaves transmit half
    of its near infrared, which would count as reflected light.

    Parameters
    ----------
    pictures : Pictures
        Pictures in the band of the silhouettes.
    drawn, views : mapping of Silhouette, mapping of View
        Silhouettes and cameras of these pictures, by number of the frame.

    Returns
    -------
    Colour
        Colour of the leaves; empty if no view was taken in another band.
    """
    dataset, known = pictures.dataset, {band.name: band for band in pictures.dataset.scene.camera.bands}
    others = {(frame.view, frame.band): frame for frame in dataset.frames if frame.kind == "shoot" and frame.band in known}
    dark = [band for band in known.values() if dataset.scene.lights_in(band.name).backlight_level == 0.0]
    reflectances, missing = dict[str, float](), list[str]()
    for name, band in bands_by_range(dark).items():
        ratios = []
        for k, silhouette in drawn.items():
            frame = others.get((pictures.frames[k].view, band))
            if frame is not None and (ratio := _ratio(pictures, frame, silhouette, views[k])) is not None:
                ratios.append(ratio)
        if ratios:
            reflectances[name] = float(np.mean(ratios))
        elif any(taken == band for _, taken in others):
            missing.append(band)
    warnings = [f"no view shows both leaves and lit paper in the band {band}; its reflectance could not be determined" for band in missing]
    return Colour(reflectances=reflectances, warnings=(*warnings, *_lit_bands(dataset.scene)))


def _lit_bands(scene: Scene) -> tuple[str, ...]:
    """Return a warning for bands that would give an index if the panel were off."""
    needed = bands_by_range(scene.camera.bands)
    lit = [needed[name] for name in ("red", "red_edge", "nir") if name in needed and scene.is_lit(needed[name])]
    if not lit or "nir" not in needed:
        return ()
    return (
        f"the panel is on in the band{'s' if len(lit) > 1 else ''} {', '.join(lit)}: leaves transmit its light, so that reflectance and "
        "vegetation indices could not be determined there; set panel_level = 0 for these bands and switch the panel off",
    )


def _ratio(pictures: Pictures, frame: Frame, silhouette: Silhouette, view: View) -> float | None:
    """Return the ratio of the mean light of the leaves to that of the strip's paper; None if either is not visible."""
    picture = read_image(pictures.dataset, frame)
    image = picture.astype(np.float32) / np.float32(np.iinfo(picture.dtype).max)
    leaves = _inside(silhouette)
    paper = _paper_pixels(view, pictures.dataset.scene, image.shape)
    if not leaves.any() or not len(paper):
        return None
    white = float(np.median(image[paper[:, 1], paper[:, 0]]))
    return None if white < _FRONT_OFF else float(image[leaves].mean()) / white


def _inside(silhouette: Silhouette) -> Mask:
    """Return the pixels (H, W) well inside the shoot."""
    covered = ((silhouette.coverage > 0.99) & silhouette.usable).astype(np.uint8)
    return cv2.erode(covered, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _INSIDE_PX + 1,) * 2)) > 0


def _paper_pixels(view: View, scene: Scene, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return pixels (N, 2), x and y, of the white paper between markers of one row that face the camera."""
    strip, pot = scene.strip, scene.net_pot
    half_rad = np.pi / strip.columns
    middles = []
    for corners in marker_corners(strip, pot).values():
        x, y, z = corners.mean(axis=0)
        azimuth = np.arctan2(y, x) + half_rad
        middles.append([pot.outer_radius_mm * np.cos(azimuth), pot.outer_radius_mm * np.sin(azimuth), z])
    points = np.array(middles)
    outward = points * [1.0, 1.0, 0.0] / pot.outer_radius_mm
    toward = view.centre_mm - points
    points = points[(outward * toward).sum(axis=1) > _FACING * np.linalg.norm(toward, axis=1)]
    pixels = np.round(cameras.cam_pixels(view.camera, frames.apply(view.cam_from_canister, points))).astype(np.int64)
    within = (pixels >= 0).all(axis=1) & (pixels[:, 0] < shape[1]) & (pixels[:, 1] < shape[0])
    return pixels[within]
