"""Silhouettes of a shoot: dark before the panel, bright before the net pot's black top, unknown before the strip."""

from __future__ import annotations

from collections.abc import Sequence

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
from rhizotwin.scenes.pictures import Grey

_PANEL_ORDER = 4
"""Degree of the polynomial in column and row that a diffuse panel's light follows."""
_LIT = 0.95
"""The panel is bare where a pixel's upper quantile reaches this share of the polynomial."""
_UPPER = 90.0
"""Percentile over a turn that shows the bare panel behind the plant."""
_EDGE_PX = 3
"""The pot's rim is blurred, and its place is known from the markers to less than this."""
_RIM_STEPS = 180
"""Corners of the drawn rim, which lies within 0.02 % of its radius, far below a pixel."""
_OPAQUE = 0.5
"""Opacity, of what the plant's inside shows, beyond which a pixel counts as inside when that is measured."""

_FAINT = 0.1
"""Rise above the felt, over a leaf's, from which a pixel before the pot's top shows the plant: coverage below a tenth
is never plant, as for roots, and a bench's noise is a hundredth."""
_FELT_ORDER, _FELT_ROUNDS, _FELT_MADS, _LEAST_FELT = 2, 6, 4.0, 100
"""Degree of the polynomial that the felt's light follows; how often it is fitted without what is so many median
deviations off, by at least so many pixels: of a plant before a quarter of the top nothing is left after four rounds."""
_INSIDE_PX = 2.5
"""A pixel of the outline has the plant's inside this near: one pixel on, or two across a corner."""


def of_ring(images: Sequence[Grey], views: Sequence[View], scene: Scene) -> list[Silhouette]:
    """Measure how much of each pixel the shoot covers in the pictures of one ring.

    Parameters
    ----------
    images : sequence of (H, W)
        Linear in light.
    views : sequence of View
        Their cameras.
    scene : Scene
        Its net pot tells where the pictures show panel, pot top, or strip and canister.

    Returns
    -------
    list of Silhouette
        ``seen`` where panel stands behind: only there an empty pixel proves that nothing is in its way. Before the
        pot's top a shaded leaf looks like none; before its rim the nearest pixels are taken; before strip and canister
        nothing is told.
    """
    stack = np.stack([image.astype(np.float32) for image in images])
    pot = [_pot(view, scene, stack.shape[1:]) for view in views]
    below, top = (np.stack([part[k] for part in pot]) for k in (0, 1))
    panel, lit = _panel(stack, below | top)
    gain = np.array([np.median((image / panel)[lit & ~hidden]) for image, hidden in zip(stack, below | top, strict=True)])
    return [
        _silhouette(image / np.float32(g), panel, lit & ~hidden & ~before, before & ~hidden)
        for image, g, hidden, before in zip(stack, gain, below, top, strict=True)
    ]


def _pot(view: View, scene: Scene, shape: tuple[int, ...]) -> tuple[Mask, Mask]:
    """Return where a picture (H, W) shows strip and canister, and where the pot's top."""
    pot = scene.net_pot
    rim, foot = _outline(view, pot, pot.top_mm), _outline(view, pot, -scene.canister.height_mm)
    top, whole = (np.zeros(shape, np.uint8) for _ in range(2))
    cv2.fillPoly(top, [np.round(rim).astype(np.int32)], 1)
    hull = cv2.convexHull(np.concatenate([rim, foot]).astype(np.float32))
    cv2.fillPoly(whole, [np.round(hull).astype(np.int32)], 1)
    margin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _EDGE_PX + 1,) * 2)
    inner, outer = cv2.erode(top, margin) > 0, cv2.dilate(whole, margin) > 0
    return outer & ~inner, inner


def _outline(view: View, pot: NetPot, z_mm: float) -> NDArray[np.float64]:
    """Return the pixels (N, 2) of the pot's circle at a height."""
    angle = np.arange(_RIM_STEPS) * 2.0 * np.pi / _RIM_STEPS
    circle = np.stack([pot.outer_radius_mm * np.cos(angle), pot.outer_radius_mm * np.sin(angle), np.full(_RIM_STEPS, z_mm)], axis=1)
    return cameras.direction_pixels(
        view, frames.apply(view.azimuth_from_canister, circle) - np.array([view.rho_mm, 0.0, view.centre_mm[2]])
    )


def _panel(stack: NDArray[np.float32], pot: NDArray[np.bool_]) -> tuple[Image, Mask]:
    """Return the bare panel's light (H, W), and where it shines: smooth through what pixels mostly show."""
    usual = np.percentile(stack, _UPPER, axis=0).astype(np.float32)
    open_ = ~pot.any(axis=0)
    bright = open_ & (usual > 0.5 * np.percentile(usual[open_], 95.0))
    height, width = usual.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    terms = _terms(2.0 * x / width - 1.0, 2.0 * y / height - 1.0, _PANEL_ORDER)
    fitted = bright
    for _ in range(4):  # the plant's middle hides the panel from most of a turn: it is left out step by step
        some = np.flatnonzero(fitted)[:: max(1, int(fitted.sum()) // 20_000)]
        found = np.linalg.lstsq(terms.reshape(len(terms), -1)[:, some].T, usual.ravel()[some].astype(np.float64), rcond=None)[0]
        smooth = np.tensordot(found, terms, axes=1).astype(np.float32)
        fitted = bright & (usual > _LIT * smooth)
    lit = open_ | (usual > _LIT * smooth)
    return np.maximum(np.where(fitted, usual, smooth), 1e-6).astype(np.float32), lit & (smooth > 0.5 * float(np.median(usual[fitted])))


def _terms(x: NDArray[np.float64], y: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    return np.stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])


def _silhouette(image: Image, panel: Image, before_panel: Mask, before_pot: Mask) -> Silhouette:
    """Return coverage: light absorbed before the panel, and sent back before the pot, over that of its inside."""
    dark = silhouettes.opacity(image, panel, before_panel)
    wide = cv2.erode((dark > _OPAQUE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    felt = _felt(image, before_pot)
    green = np.float32(np.median(image[wide])) if wide.any() else np.float32(0.0)
    told = before_pot & (green > 2.0 * felt)  # green as dark as the pot tells nothing before it
    inside = _inside(np.where(dark > _OPAQUE, dark, np.float32(0.0)))
    before_light = np.where(inside, np.float32(1.0), silhouettes.measure(dark, before_panel).coverage)
    coverage = np.maximum(before_light, _before_felt(image, felt, green, told))
    away_px, (row, column) = ndimage.distance_transform_edt(~(before_panel | told), return_indices=True)
    coverage = np.where(away_px <= _EDGE_PX + 0.5, coverage[row, column], 0.0)
    rim = _near(before_panel) & _near(told) & ~before_panel & ~told
    return Silhouette(np.where(rim, _at_rim(image, panel, felt, green), coverage).astype(np.float32), before_panel)


def _felt(image: Image, before_pot: Mask) -> Image:
    """Return the light (H, W) of the pot's bare top: smooth through the pixels that are no brighter than it."""
    height, width = image.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    terms, bare = _terms(2.0 * x / width - 1.0, 2.0 * y / height - 1.0, _FELT_ORDER), before_pot
    smooth = np.full(image.shape, np.median(image[before_pot]) if before_pot.any() else 0.0, np.float32)
    for _ in range(_FELT_ROUNDS):
        away = np.abs(image - smooth)
        bare = before_pot & (away <= _FELT_MADS * max(float(np.median(away[before_pot])) if before_pot.any() else 0.0, 1e-6))
        if bare.sum() < _LEAST_FELT:
            break
        found = np.linalg.lstsq(terms[:, bare].T, image[bare].astype(np.float64), rcond=None)[0]
        smooth = np.tensordot(found, terms, axes=1).astype(np.float32)
    return np.maximum(smooth, 0.0)


def _before_felt(image: Image, felt: Image, green: np.float32, told: Mask) -> Image:
    """Return coverage (H, W) before the pot's top: light above the felt's, over that of the plant's inside nearby.

    A stem in the shadow of a leaf sends back half of what the leaf does, and covers as much.
    """
    rise = np.where(told, image - felt, 0.0).astype(np.float32)
    plant = rise > _FAINT * (green - felt)
    inside = _inside(np.where(plant, rise, 0.0).astype(np.float32))
    whole = green - felt
    if inside.any():
        away_px, (row, column) = ndimage.distance_transform_edt(~inside, return_indices=True)
        whole = np.where(away_px < _INSIDE_PX, rise[row, column], whole)
    return np.where(plant, np.clip(rise / np.maximum(whole, 1e-6), 0.0, 1.0), 0.0).astype(np.float32)


def _inside(signal: Image) -> Mask:
    """Return the pixels (H, W) that lie within the plant with all that are next to them.

    The signal is how much darker than the panel a pixel is, or how much brighter than the felt; 0 where nothing stands
    out. Within is over half of the strongest nearby, for light changes over a leaf and from leaf to stem.
    """
    most = cv2.dilate(signal, np.ones((5, 5), np.uint8))
    return cv2.erode(((signal > 0.5 * most) & (signal > 0.0)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _near(told: Mask) -> Mask:
    """Return the pixels (H, W) from which what is told is no farther than the rim is wide."""
    return cv2.dilate(told.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (4 * _EDGE_PX + 3,) * 2)) > 0


def _at_rim(image: Image, panel: Image, felt: Image, green: np.float32) -> Image:
    """Return which pixels (H, W) show the plant where the panel ends behind the pot's far rim.

    It is darker than the panel and brighter than the felt, each by half; so is the rim's own line of mixed pixels,
    which is one pixel wide and is opened away.
    """
    plant = (image < 0.5 * (panel + green)) & (image > 0.5 * (felt + green))
    return cv2.morphologyEx(plant.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 1), np.uint8)).astype(np.float32)
