"""Detection of a vessel that is not round, from its width in the views."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics.cameras import View, cam_pixels
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

Array = NDArray[np.float64]

HEIGHTS = 16
"""Number of heights at which the vessel's edges are searched."""
STEP_MM = 0.5
"""Distance between the samples of a profile, mm. It is a tenth of the smallest difference that is detected."""
NEAREST = 0.3
"""Distance from the axis at which the search begins, relative to the radius of the net pot."""
MARGIN = 0.1
"""Part of the visible height at the floor and at the net pot in which edges are not searched."""
BARE = 1.05, 1.25
"""Distances from the axis at which the bare panel is beside the vessel, relative to the radius of the net pot, which
encloses the corners of the vessel."""
DROP = 0.85
"""Brightness relative to the bare panel at the edge of a vessel. Glass without edge passes at least 0.92."""
PANEL = 75.0, 0.5
"""Percentile of the picture's pixels that shows the panel, and minimum brightness beside the vessel relative to it. If
it is darker there, the panel is no wider than the vessel."""
UPRIGHT_MM = 2.0
"""Maximum deviation of an edge from a vertical line, mm. Roots beside the axis deviate more."""
UPRIGHT_SHARE = 0.75
"""Minimum fraction of the heights at which an edge is within `UPRIGHT_MM`."""
LEAST_VIEWS = 5
"""Minimum number of views with two edges. The widths of a square in fewer views may be equal."""
RANGE = 10.0, 50.0, 90.0
"""Percentiles of the widths in the views: smallest, median and largest. Up to a tenth of the widths may be wrong."""
MOST_SPREAD = 0.06
"""Maximum difference between the widths of a round vessel in the views, relative to their median. Oval canisters, whose
diameters differ by 2 %, are below it. The widths of a square differ by up to 41 %."""


def refuse_corners(views: Sequence[View], images: Sequence[Grey], scene: Scene) -> None:
    """Raise an error if the width of the vessel differs between the views, so that it is not round.

    Parameters
    ----------
    views : sequence of View
        Cameras of the views, in the frame of the strip.
    images : (H, W) sequence of uint8 or uint16 array
        Picture of each view.
    scene : Scene
        Scene with the net pot and the height of the canister.

    Raises
    ------
    UserError
        If the vessel is not round. The message states the widths.
    """
    found = [_half_width_mm(view, image, scene, side) for view, image in zip(views, images, strict=True) for side in (-1.0, 1.0)]
    widths = np.array(found).reshape(-1, 2).sum(axis=1)
    widths = widths[np.isfinite(widths)]
    if len(widths) < LEAST_VIEWS:
        return
    low, middle, high = np.percentile(widths, RANGE)
    if high - low > MOST_SPREAD * middle:
        raise UserError(
            f"the vessel is not round: its width in the pictures is {low:.0f} to {high:.0f} mm, depending on the view; rectangular vessels "
            "are not supported, so grow the plant in a round canister"
        )


def _half_width_mm(view: View, image: Grey, scene: Scene, side: float) -> float:
    """Return the distance of the vessel's outermost edge from the axis, mm, or NaN if it is not visible."""
    pot_mm = scene.net_pot.outer_radius_mm
    away_mm = np.arange(NEAREST * pot_mm, BARE[1] * pot_mm, STEP_MM)
    low, high = scene.canister.floor_z_mm, min(scene.net_pot.skirt_bottom_mm, scene.water.level_mm)
    z_mm = np.linspace(low + MARGIN * (high - low), high - MARGIN * (high - low), HEIGHTS)
    across = side * np.array([-view.centre_mm[1], view.centre_mm[0]]) / max(float(np.hypot(*view.centre_mm[:2])), 1e-9)
    aside = np.broadcast_to(away_mm[:, None] * across, (HEIGHTS, len(away_mm), 2))
    points = np.concatenate([aside, np.broadcast_to(z_mm[:, None, None], (*aside.shape[:2], 1))], axis=2).reshape(-1, 3)
    px = cam_pixels(view.camera, frames.apply(view.cam_from_canister, points)).reshape(HEIGHTS, -1, 2).astype(np.float32)
    width, height = view.camera.image_wh
    seen = ((px >= 0) & (px <= np.array([width - 1, height - 1]))).all(axis=(1, 2))
    if seen.sum() < HEIGHTS / 2:
        return np.nan
    profile = cv2.remap(image.astype(np.float32), px[seen, :, 0], px[seen, :, 1], cv2.INTER_LINEAR).astype(np.float64)
    bare = np.median(profile[:, away_mm > BARE[0] * pot_mm], axis=1, keepdims=True)
    if float(np.median(bare)) < PANEL[1] * float(np.percentile(image[1::3, 1::3], PANEL[0])):
        return np.nan
    dark = profile < DROP * bare
    edges = np.where(dark.any(axis=1), away_mm[dark.shape[1] - 1 - np.argmax(dark[:, ::-1], axis=1)], 0.0)
    middle = float(np.median(edges))
    return middle if np.mean(np.abs(edges - middle) < UPRIGHT_MM) >= UPRIGHT_SHARE else np.nan
