"""Colour of a shoot: reflectance of its leaves in each band of the camera, and vegetation indices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.silhouettes import Mask, Silhouette
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.recon.shoots.blades import STEP_MM, Blades
from rhizotwin.scenes import frames
from rhizotwin.scenes.bands import bands_by_range, vegetation_indices
from rhizotwin.scenes.dataset import Frame, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plan import marker_corners

_INSIDE_PX = 3
"""Distance inside the outline from which the brightness of leaves is measured, px. Within two pixels of the outline,
blur adds light from the background."""
_FACING = 0.7
"""Minimum cosine of the angle between the normal of the paper and the line of sight."""
_LEAST_LIGHT, _FULL = 0.02, 0.99
"""Minimum and maximum brightness of white paper, as a fraction of full scale. Below the minimum, noise would dominate.
Above the maximum, the camera is saturated (`rig.scanning.preflight.FULL`)."""
_ALL = -1
"""Number of all leaves together, where leaves are numbered from 0."""
_LEAST_PX = 30
"""Minimum number of pixels of a leaf in a picture from which its brightness is measured."""
_MOST_FULL = 0.01
"""Maximum fraction of the leaves' pixels that are saturated. Their true brightness is unknown, and without these
pixels, which are the brightest, the mean would be too small."""


@dataclass(frozen=True, kw_only=True)
class Colour:
    """Reflectance of a shoot's leaves, and vegetation indices."""

    values: Mapping[str, float]
    """Reflectances of the leaves in the ranges of `scenes.bands.RANGES_NM`, and vegetation indices. A reflectance is
    relative to the white paper of the strip, and averaged over the leaves. The keys are the field names in
    `scenes.trait_table.COLOURS`."""
    leaves: tuple[Mapping[str, float], ...] = ()
    """The same values for each leaf of `blades.Blades`. A value is missing if no picture shows it."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""


def measure_colour(pictures: Pictures, drawn: Mapping[int, Silhouette], views: Mapping[int, View], blades: Blades) -> Colour:
    """Measure the reflectance of a shoot's leaves in all bands in which the panel is off.

    Leaves and paper are lit by the same lamp, and cover the same pixels in all bands of a view. The strength of the
    light and the inclination of the leaves therefore cancel in the vegetation indices, which are computed from views
    with both bands. Bands in which the panel is on are excluded, because leaves transmit half of its near infrared
    light, which would be measured as reflected light.

    Parameters
    ----------
    pictures : Pictures
        Pictures in the band from which the silhouettes were measured.
    drawn, views : mapping of Silhouette, mapping of View
        Silhouettes and cameras of these pictures, keyed by frame number.
    blades : Blades
        Blades of the shoot.

    Returns
    -------
    Colour
        Reflectances and vegetation indices; empty if no view was taken in another band.
    """
    scene, unread, saturated = pictures.dataset.scene, list[str](), Counter[str]()
    ranges = {band: name for name, band in _dark_bands(scene).items()}
    number = {pictures.frames[k].view: k for k in drawn}
    shown = {k: _label_leaves(views[k], blades, silhouette.coverage.shape) for k, silhouette in drawn.items()}
    # reflectances by leaf (all leaves together are _ALL), wavelength range and frame number
    ratios: dict[int, dict[str, dict[int, float]]] = {leaf: {} for leaf in range(_ALL, len(blades.areas_mm2))}
    for frame in pictures.dataset.frames:
        if frame.kind != "shoot" or frame.band not in ranges:
            continue
        ratios[_ALL].setdefault(ranges[frame.band], {})
        if (k := number.get(frame.view)) is None:
            continue
        try:
            light = _measure_light(pictures, frame, drawn[k], views[k], shown[k])
        except UserError as error:
            unread.append(f"{frame.file} is not used for the colour of the shoot: {error}")
            continue
        if light is None:
            continue
        if light.saturated > _MOST_FULL:
            saturated[frame.band] += 1
        elif _LEAST_LIGHT <= light.paper <= _FULL:
            for leaf, brightness in light.leaves.items():
                ratios[leaf].setdefault(ranges[frame.band], {})[k] = brightness / light.paper
    warnings = [
        f"{count} of {len(drawn)} pictures in the band {band} are not used for the colour, because the leaves are overexposed; "
        "reduce front_level of the band, or the exposure"
        for band, count in saturated.items()
    ]
    warnings += [
        f"the reflectance in the range {name} could not be determined, because no view shows both leaves and paper well exposed"
        for name, found in ratios[_ALL].items()
        if not found
    ]
    whole, *leaves = (_average(found) for found in ratios.values())
    return Colour(values=whole, leaves=tuple(leaves), warnings=(*unread, *warnings, *_lit_bands(scene)))


def _average(ratios: Mapping[str, Mapping[int, float]]) -> dict[str, float]:
    """Average the reflectances over the views, and compute vegetation indices.

    An index is computed from the views that were taken in both of its bands. ``ratios`` is keyed by wavelength range,
    then by frame number.
    """
    values = {f"reflectance_{name}": float(np.mean([*found.values()])) for name, found in ratios.items() if found}
    for other in ("red", "red_edge"):
        near, far = ratios.get("nir", {}), ratios.get(other, {})
        if both := near.keys() & far.keys():
            values |= vegetation_indices({"nir": sum(near[k] for k in both), other: sum(far[k] for k in both)})
    return values


def _dark_bands(scene: Scene) -> dict[str, str]:
    """Return the names of the bands in which the panel is off, keyed by wavelength range."""
    return bands_by_range([band for band in scene.camera.bands if scene.lights_in(band.name).backlight_level == 0.0])


def _lit_bands(scene: Scene) -> tuple[str, ...]:
    """Return a warning about bands from which an index could be computed if the panel were off in them."""
    needed, dark = bands_by_range(scene.camera.bands), _dark_bands(scene)
    lit = [needed[name] for name in ("red", "red_edge", "nir") if name in needed and name not in dark]
    if not lit or "nir" not in needed:
        return ()
    bands = "bands" if len(lit) > 1 else "band"
    return (
        f"the panel is on in the {bands} {', '.join(lit)}. Leaves transmit its light, so reflectance and vegetation indices could not be "
        f"determined. Set panel_level = 0 for the {bands}, and switch the panel off.",
    )


@dataclass(frozen=True, kw_only=True)
class _Light:
    """Brightness in one picture, as fractions of full scale."""

    leaves: Mapping[int, float]
    """Mean brightness of all leaves (`_ALL`) and of each leaf in the picture."""
    saturated: float
    """Fraction of the leaves' pixels that are saturated."""
    paper: float
    """Median brightness of the strip's paper."""


def _measure_light(pictures: Pictures, frame: Frame, silhouette: Silhouette, view: View, shown: NDArray[np.int64]) -> _Light | None:
    """Measure the brightness of leaves and paper in a picture; None if one of them is not visible.

    ``shown`` (H, W) is the leaf that each pixel shows (`_label_leaves`).
    """
    curve = pictures.curve
    picture = read_image(pictures.dataset, frame, curve=None if curve is None or curve.warning is None else curve.curve)
    image = picture.astype(np.float32) / np.float32(np.iinfo(picture.dtype).max)
    leaves = _interior_mask(silhouette)
    paper = _paper_pixels(view, pictures.dataset.scene, image.shape)
    if not leaves.any() or not len(paper):
        return None
    on_leaves, on_paper = image[leaves], image[paper[:, 1], paper[:, 0]]
    saturated = float((on_leaves > _FULL).mean())
    brightness = {_ALL: float(on_leaves.mean())}
    count = np.bincount(shown[leaves] + 1)
    total = np.bincount(shown[leaves] + 1, on_leaves)
    brightness |= {leaf: float(total[leaf + 1] / count[leaf + 1]) for leaf in np.flatnonzero(count[1:] >= _LEAST_PX).tolist()}
    return _Light(leaves=brightness, saturated=saturated, paper=float(np.median(on_paper)))


def _label_leaves(view: View, blades: Blades, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the index of the nearest leaf in each pixel (H, W), or -1 in pixels that show no leaf."""
    labels, cam = np.full(shape, -1), frames.apply(view.cam_from_canister, blades.points_mm)
    if not len(cam):
        return labels
    reach = int(np.ceil(STEP_MM * max(view.camera.focal_px) / cam[:, 2].min()))
    beside = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
    far_first = np.argsort(-cam[:, 2])
    px = np.round(cameras.cam_pixels(view.camera, cam[far_first])).astype(np.int64)[:, None] + beside
    leaf = np.broadcast_to(blades.leaf[far_first, None], px.shape[:2])
    within = ((px >= 0) & (px < shape[::-1])).all(axis=2)
    x, y = px[within].T
    labels[y, x] = leaf[within]  # of repeated pixels, the last one counts
    return labels


def _interior_mask(silhouette: Silhouette) -> Mask:
    """Return the mask (H, W) of pixels inside the shoot, at least `_INSIDE_PX` from its outline."""
    covered = ((silhouette.coverage > 0.99) & silhouette.usable).astype(np.uint8)
    return cv2.erode(covered, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _INSIDE_PX + 1,) * 2)) > 0


def _paper_pixels(view: View, scene: Scene, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the pixels (N, 2) that show white paper, as x and y.

    The paper is sampled halfway between neighbouring markers of a row, where it faces the camera.
    """
    strip, pot = scene.strip, scene.net_pot
    markers_mm = np.array([corners.mean(axis=0) for corners in marker_corners(strip, pot).values()])
    between = frames.apply(frames.rotation_z(np.pi / strip.columns), markers_mm)
    outward = between * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = pot.outer_radius_mm * outward + between * [0.0, 0.0, 1.0]
    toward = view.centre_mm - points
    points = points[(outward * toward).sum(axis=1) > _FACING * np.linalg.norm(toward, axis=1)]
    px = cameras.cam_pixels(view.camera, frames.apply(view.cam_from_canister, points))
    pixels = np.round(px[np.isfinite(px).all(axis=1)]).astype(np.int64)
    within = (pixels >= 0).all(axis=1) & (pixels[:, 0] < shape[1]) & (pixels[:, 1] < shape[0])
    return pixels[within]
