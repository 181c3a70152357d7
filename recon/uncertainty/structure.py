"""What the fitted tubes leave of the pictures.

Noise, or structure that no tube makes (bright cores, hairs, roots that moved).
"""

from __future__ import annotations

import cv2
import numpy as np

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.robust import MAD
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes import tube_picture

_DRAWN = 0.03
"""Coverage by the tubes above this, and two pixels about it, is theirs to explain."""
_SMOOTH_PX = 1.0
"""Noise of single pixels averages out over this; what a root does to the light does not."""


def left_by(seen: Evidence, system: RootSystem) -> float:
    """Return what is left beside the tubes, smoothed and without the noise, over what they cover.

    Both are root mean squares.

    A tube whose radius is off by a tenth leaves about a tenth.
    """
    at = seen.project(system.tubes.centre_mm)
    depth, difference = tube_picture.compared(seen, system.tubes, at, system.blur_px)
    (width, height), count = seen.image_wh, seen.bank.count
    rest = np.array(difference).reshape(count, height, width)
    known = np.array(seen.seen).reshape(count, height, width) > 0
    drawn = (1.0 - np.exp(-np.array(depth).reshape(count, height, width))) * known
    left, covered, noise = [], [], []
    for picture, residual, told in zip(drawn, rest, known, strict=True):
        near = (cv2.dilate((picture > _DRAWN).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0) & told
        smooth = cv2.GaussianBlur(residual, (0, 0), _SMOOTH_PX)
        far = told & ~near
        if near.any() and far.any():
            left.append(float(np.mean(smooth[near] ** 2)))
            covered.append(float(np.mean(picture[near] ** 2)))
            noise.append((MAD * float(np.median(np.abs(smooth[far])))) ** 2)
    if not left:
        return 0.0
    more = max(0.0, float(np.mean(left)) - float(np.mean(noise)))
    return float(np.sqrt(more / max(float(np.mean(covered)), 1e-9)))
