"""Silhouettes of a shoot in front of the panel and the net pot.

The shoot is dark in front of the panel, and bright in front of the net pot's black top. In front of the marker strip,
its coverage is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rhizotwin.recon.coverage import silhouettes
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import NetPot, Scene
from rhizotwin.scenes.picture_codec import Grey

_PANEL_ORDER = 4
"""Degree of the polynomial in column and row that is fitted to the brightness of the diffuse panel."""
_LIT = 0.95
"""Minimum brightness of a pixel that shows the bare panel, relative to the fitted polynomial. The pixel's brightness is
its `_UPPER` percentile over a turn."""
_UPPER = 90.0
"""Percentile of a pixel's brightness over a turn that represents the bare panel behind the plant."""
_EDGE_PX = 3
"""Distance from the net pot's rim within which the coverage is not measured because of blur, px. The position of the
rim is known more accurately than this from the markers."""
_RIM_STEPS = 180
"""Number of corners of the polygon that approximates the net pot's rim. The polygon deviates from the circle by less
than 0.02 % of the radius, which is far below a pixel."""
_LEVELS = 64
"""Number of heights, from the foot of the canister to the rim of the net pot, at which the outline is tried."""
_OPAQUE = 0.5
"""Minimum opacity of the pixels that belong to the plant's interior. The brightness of the plant is measured in the
interior."""

_FAINT = 0.1
"""Minimum brightness of pixels that show the plant in front of the net pot's top. It is measured above the brightness
of the felt, and relative to the brightness of a leaf. As for roots, coverage below a tenth is ignored. The noise of a
bench is a hundredth."""
_FELT_ORDER, _FELT_ROUNDS, _FELT_MADS, _LEAST_FELT = 2, 6, 4.0, 100
"""Four parameters of the polynomial fit to the brightness of the felt: the degree, the number of fits, the rejection
threshold in median absolute deviations, and the minimum number of pixels. Four fits exclude a plant in front of a
quarter of the net pot's top."""
_INSIDE_PX = 2.5
"""Maximum distance from a pixel on the outline to the pixel of the plant's interior that provides its full brightness,
px. The interior begins one pixel away, or two pixels away across a corner."""


def ring_silhouettes(images: Sequence[Grey], views: Sequence[View], scene: Scene) -> list[Silhouette]:
    """Measure the coverage of each pixel by the shoot in the pictures of one ring.

    Parameters
    ----------
    images : sequence of (H, W)
        Pictures, linear in light.
    views : sequence of View
        Cameras of the pictures.
    scene : Scene
        Scene with the net pot. The parts of the pictures in front of the panel, the net pot's top, and strip and
        canister are determined from its dimensions.

    Returns
    -------
    list of Silhouette
        Silhouettes of the pictures. Only pixels in front of the panel are usable, because only there does an empty
        pixel exclude a shoot. In front of the net pot's top, a shaded leaf may be missed. At the rim, the coverage of
        the nearest pixels is used. In front of the strip and the canister, the coverage is unknown.
    """
    stack = np.stack([image.astype(np.float32) for image in images])
    pot = [_pot_masks(view, scene, stack.shape[1:]) for view in views]
    below, top = (np.stack([part[k] for part in pot]) for k in (0, 1))
    panel, lit = _fit_panel(stack, below | top)
    gain = np.array([np.median((image / panel)[lit & ~hidden]) for image, hidden in zip(stack, below | top, strict=True)])
    return [
        _measure_silhouette(image / np.float32(g), panel, lit & ~hidden & ~before, before & ~hidden)
        for image, g, hidden, before in zip(stack, gain, below, top, strict=True)
    ]


def _pot_masks(view: View, scene: Scene, shape: tuple[int, ...]) -> tuple[Mask, Mask]:
    """Return two masks (H, W): the strip together with the canister, and the top of the net pot.

    The canister is masked from the lowest height that the lens projects, which is below the picture.
    """
    pot = scene.net_pot
    top, whole = (np.zeros(shape, np.uint8) for _ in range(2))
    heights_mm = np.linspace(-scene.canister.height_mm, pot.top_mm, _LEVELS)
    circles = [circle for z in heights_mm if np.isfinite(circle := _outline(view, pot, float(z))).all()]
    if not circles:
        return whole > 0, top > 0
    foot, rim = circles[0], circles[-1]
    cv2.fillPoly(top, [np.round(rim).astype(np.int32)], 1)
    hull = cv2.convexHull(np.concatenate([rim, foot]).astype(np.float32))
    cv2.fillPoly(whole, [np.round(hull).astype(np.int32)], 1)
    margin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _EDGE_PX + 1,) * 2)
    inner, outer = cv2.erode(top, margin) > 0, cv2.dilate(whole, margin) > 0
    return outer & ~inner, inner


def _outline(view: View, pot: NetPot, z_mm: float) -> NDArray[np.float64]:
    """Return pixel coordinates (N, 2) of points on the net pot's circular outline at the height ``z_mm``.

    They are NaN behind the camera, and where the lens distortion is not valid.
    """
    angle = np.arange(_RIM_STEPS) * 2.0 * np.pi / _RIM_STEPS
    circle = np.stack([pot.outer_radius_mm * np.cos(angle), pot.outer_radius_mm * np.sin(angle), np.full(_RIM_STEPS, z_mm)], axis=1)
    return cameras.cam_pixels(view.camera, frames.apply(view.cam_from_canister, circle))


def _fit_panel(stack: NDArray[np.float32], pot: NDArray[np.bool_]) -> tuple[Image, Mask]:
    """Return the brightness (H, W) of the bare panel, and the mask (H, W) of the panel.

    Where the plant hides the panel, its brightness is that of a polynomial fitted to the visible parts.
    """
    usual = np.percentile(stack, _UPPER, axis=0).astype(np.float32)
    open_ = ~pot.any(axis=0)
    bright = open_ & (usual > 0.5 * np.percentile(usual[open_], 95.0))
    fitted = bright
    for _ in range(4):  # the plant's middle hides the panel in most of a turn, and is excluded step by step
        smooth = _fit_polynomial(usual, fitted, _PANEL_ORDER)
        fitted = bright & (usual > _LIT * smooth)
    lit = open_ | (usual > _LIT * smooth)
    return np.maximum(np.where(fitted, usual, smooth), 1e-6).astype(np.float32), lit & (smooth > 0.5 * float(np.median(usual[fitted])))


def _fit_polynomial(image: Image, where: Mask, order: int) -> Image:
    """Return the polynomial in column and row (H, W) that is fitted to some pixels of an image.

    At most 40 000 pixels are used, evenly spaced.
    """
    terms = _polynomial_terms(image.shape, order)
    some = np.flatnonzero(where)[:: max(1, int(where.sum()) // 20_000)]
    found = np.linalg.lstsq(terms.reshape(len(terms), -1)[:, some].T, image.ravel()[some].astype(np.float64), rcond=None)[0]
    return np.asarray(np.tensordot(found, terms, axes=1), np.float32)


@lru_cache(maxsize=2)
def _polynomial_terms(shape: tuple[int, ...], order: int) -> NDArray[np.float64]:
    y, x = (2.0 * at / size - 1.0 for at, size in zip(np.indices(shape, np.float64), shape, strict=True))
    return np.stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])


def _measure_silhouette(image: Image, panel: Image, before_panel: Mask, before_pot: Mask) -> Silhouette:
    """Measure the coverage in one picture, relative to the plant's interior.

    The coverage is the absorption in front of the panel, and the reflection in front of the net pot's top.
    """
    dark = silhouettes.opacity(image, panel, before_panel)
    wide = cv2.erode((dark > _OPAQUE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    felt = _fit_felt(image, before_pot)
    green = np.float32(np.median(image[wide])) if wide.any() else np.float32(0.0)
    told = before_pot & (green > 2.0 * felt)  # plants as dark as the pot cannot be distinguished from it
    inside = _interior_mask(np.where(dark > _OPAQUE, dark, np.float32(0.0)))
    before_light = silhouettes.suppress_noise(silhouettes.opaque_coverage(dark, before_panel), dark, before_panel).coverage
    before_light[inside] = 1.0
    coverage = np.maximum(before_light, _felt_coverage(image, felt, green, told))
    away_px, (row, column) = ndimage.distance_transform_edt(~(before_panel | told), return_indices=True)
    coverage = np.where(away_px <= _EDGE_PX + 0.5, coverage[row, column], 0.0)
    rim = _near_mask(before_panel) & _near_mask(told) & ~before_panel & ~told
    return Silhouette(np.where(rim, _rim_mask(image, panel, felt, green), coverage).astype(np.float32), before_panel)


def _fit_felt(image: Image, before_pot: Mask) -> Image:
    """Return the brightness (H, W) of the net pot's bare top.

    It is a polynomial fitted to the pixels that do not show the plant.
    """
    smooth = np.full(image.shape, np.median(image[before_pot]) if before_pot.any() else 0.0, np.float32)
    for _ in range(_FELT_ROUNDS):
        away = np.abs(image - smooth)
        bare = before_pot & (away <= _FELT_MADS * max(float(np.median(away[before_pot])) if before_pot.any() else 0.0, 1e-6))
        if bare.sum() < _LEAST_FELT:
            break
        smooth = _fit_polynomial(image, bare, _FELT_ORDER)
    return np.maximum(smooth, 0.0)


def _felt_coverage(image: Image, felt: Image, green: np.float32, told: Mask) -> Image:
    """Return the coverage (H, W) in front of the net pot's top.

    The coverage is the brightness above the felt, relative to that of the plant's interior nearby. At the same
    coverage, a stem in the shadow of a leaf reflects half as much light as the leaf.
    """
    rise = np.where(told, image - felt, 0.0).astype(np.float32)
    plant = rise > _FAINT * (green - felt)
    inside = _interior_mask(np.where(plant, rise, 0.0).astype(np.float32))
    whole = green - felt
    if inside.any():
        away_px, (row, column) = ndimage.distance_transform_edt(~inside, return_indices=True)
        whole = np.where(away_px < _INSIDE_PX, rise[row, column], whole)
    return np.where(plant, np.clip(rise / np.maximum(whole, 1e-6), 0.0, 1.0), 0.0).astype(np.float32)


def _interior_mask(signal: Image) -> Mask:
    """Return the mask (H, W) of pixels whose neighbours are all inside the plant.

    ``signal`` is the darkening relative to the panel, or the brightening relative to the felt, and 0 for the
    background. A pixel is inside the plant if its signal exceeds half of the strongest signal nearby, because light
    varies over a leaf and from leaf to stem.
    """
    most = cv2.dilate(signal, np.ones((5, 5), np.uint8))
    return cv2.erode(((signal > 0.5 * most) & (signal > 0.0)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _near_mask(told: Mask) -> Mask:
    """Return the mask (H, W), dilated by a little more than the width of the net pot's rim.

    The mask marks the pixels with known coverage.
    """
    return cv2.dilate(told.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (4 * _EDGE_PX + 3,) * 2)) > 0


def _rim_mask(image: Image, panel: Image, felt: Image, green: np.float32) -> Image:
    """Return the mask (H, W) of plant pixels at the lower edge of the panel, behind the far rim of the net pot.

    These pixels are darker than the mean brightness of panel and plant, and brighter than the mean brightness of felt
    and plant. The mixed pixels of the rim itself have the same brightness, but form a line one pixel wide, which is
    removed by a morphological opening.
    """
    plant = (image < 0.5 * (panel + green)) & (image > 0.5 * (felt + green))
    return cv2.morphologyEx(plant.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 1), np.uint8)).astype(np.float32)
