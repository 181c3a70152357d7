"""The empty backlight of a ring, from the turn itself, and where the pictures say something about the water."""

import cv2
import numpy as np
from numpy.typing import NDArray

from recon import cameras, refraction
from scenes.model import Scene

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

_DIM = 0.25
"""A background darker than this fraction of the ring's typical one says nothing (flanks, shadows)."""
_SKIRT_MARGIN_MM = 0.5
_STEP = 4


def water_mask(view: cameras.View, optics: refraction.Optics, scene: Scene) -> Mask:
    """Return the pixels (H, W) whose line of sight passes below the net pot's skirt into the water.

    Left out are the outermost 2 % of the canister's width, where the wall reflects nearly everything, and a margin of 0.5 mm
    at the skirt, the grid or water surface and the floor. Lines of sight are followed for one pixel in four each way.
    """
    width, height = view.camera.image_wh
    u, v = np.meshgrid(np.arange(0.5 * _STEP - 0.5, width, _STEP), np.arange(0.5 * _STEP - 0.5, height, _STEP))
    directions = cameras.pixel_directions(view, np.stack([u.ravel(), v.ravel()], axis=1))
    w, p_z = refraction.invariants(view.rho_mm, optics.outer_radius_mm, directions)
    w = np.where(np.abs(w) < 0.98 * optics.w_limit, w, np.nan)
    z_cam = float(view.centre_mm[2])
    line = refraction.trace(optics, view.rho_mm, z_cam, w, p_z)
    r_skirt, b = scene.net_pot.outer_radius_mm, w * optics.outer_radius_mm
    with np.errstate(invalid="ignore"):
        to_skirt = np.sqrt(view.rho_mm**2 - b**2) - np.sqrt(r_skirt**2 - b**2)
        skirt_z = z_cam + p_z / np.sqrt(1.0 - p_z**2) * to_skirt
        far_z = line.entry_z_mm + line.slope * 2.0 * np.sqrt(optics.inner_radius_mm**2 - line.b_mm**2)
        inside = (
            (skirt_z < scene.net_pot.skirt_bottom_mm - _SKIRT_MARGIN_MM)
            & (np.maximum(line.entry_z_mm, far_z) < optics.water_z_mm - _SKIRT_MARGIN_MM)
            & (np.minimum(line.entry_z_mm, far_z) > optics.floor_z_mm + _SKIRT_MARGIN_MM)
        )
    blocks = inside.reshape(u.shape).repeat(_STEP, axis=0).repeat(_STEP, axis=1)
    return blocks[:height, :width]


def estimate(stack: Image, inside: Mask) -> Image:
    """Estimate the picture of the empty canister from the views of one ring, whose camera stood still.

    Each pixel's background is the mean of the views within 4 % of its upper quintile. Where something stands before the panel in
    every view (the taproot on the axis) that is too dark: a smooth surface through the trusted pixels, fitted row by row and
    then over the rows, takes its place.

    Parameters
    ----------
    stack : (V, H, W) linear grey, any scale.
    inside : (H, W) pixels to be filled; others are 0 in the result.

    Returns
    -------
    (H, W) background in the scale of the stack.
    """
    rows = np.flatnonzero(inside.any(axis=1))
    background = np.zeros(stack.shape[1:], np.float32)
    if not len(rows):
        return background
    part = stack[:, rows[0] : rows[-1] + 1]
    rank = min(len(part) - 1, int(0.8 * len(part)))
    upper = np.partition(part, rank, axis=0)[rank]
    near = np.abs(part - upper) <= 0.04 * upper
    mean = np.where(near, part, 0.0).sum(axis=0) / np.maximum(near.sum(axis=0), 1)
    background[rows[0] : rows[-1] + 1] = mean
    background[~inside] = 0.0
    smooth = _smooth_surface(background, inside)
    # Always covered: darker than its surroundings foretell, away from the flanks where the surface is steep.
    covered = inside & (background < 0.96 * smooth)
    return np.where(covered, smooth, background).astype(np.float32)


def _smooth_surface(background: Image, inside: Mask) -> Image:
    """Fit a smooth surface from above: Chebyshev in the position across the canister and the row, dark outliers left out."""
    rows, columns = np.nonzero(inside)
    u = 2.0 * (columns - columns.min()) / max(1, np.ptp(columns)) - 1.0
    v = 2.0 * (rows - rows.min()) / max(1, np.ptp(rows)) - 1.0
    values = background[rows, columns].astype(np.float64)
    step = max(1, len(values) // 40_000)
    sample = np.arange(0, len(values), step)
    core = np.abs(u) < 0.85
    sample = sample[core[sample]]
    degrees = (8, 4)
    basis = np.polynomial.chebyshev.chebvander2d(u[sample], v[sample], degrees)
    trusted = values[sample] > _DIM * np.quantile(values[sample], 0.9) if len(sample) else np.zeros(0, bool)
    coefficients = np.zeros(basis.shape[1])
    surface = np.zeros_like(background)
    if not trusted.any():  # all black: there is no light to fit
        return surface
    for _ in range(8):
        coefficients = np.linalg.lstsq(basis[trusted], values[sample][trusted], rcond=None)[0]
        residual = values[sample] - basis @ coefficients
        scale = 1.4826 * np.median(np.abs(residual[trusted])) + 1e-3 * np.abs(values[sample]).max()
        trusted = residual > -3.0 * scale
    shape = (degrees[0] + 1, degrees[1] + 1)
    surface[rows[core], columns[core]] = np.polynomial.chebyshev.chebval2d(u[core], v[core], coefficients.reshape(shape))
    return surface


def bright_enough(background: Image, inside: Mask) -> Mask:
    """Return the pixels of ``inside`` whose background is bright enough to tell root from none."""
    if not inside.any():
        return inside
    return inside & (background > _DIM * np.quantile(background[inside], 0.9))


def estimate_single(image: Image, inside: Mask) -> Image:
    """Estimate the empty backlight of one picture from itself: dark things up to 31 px wide are closed, wider ones bridged.

    For cameras that moved from view to view. Parameters and result as in `estimate`.
    """
    closed = cv2.morphologyEx(
        np.where(inside, image, 0.0).astype(np.float32), cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (31, 31))
    )
    closed[~inside] = 0.0
    smooth = _smooth_surface(closed, inside)
    covered = inside & (smooth > 0)
    return np.where(covered, smooth, closed).astype(np.float32)
