"""Rays of `rhizotwin export --rays` with the silhouettes of a benchmark, for methods that accept rays."""

import runpy
from pathlib import Path

import numpy as np
from PIL import Image

MARGIN_MM = 2.0
NEAR_AXIS = 0.6  # as for `rhizotwin export --undistorted`


def read(folder, masks, central=False):
    """Return origins (N, 3) and directions (N, 3) of the rays of all pictures, and whether (N,) they meet a root."""
    pictures = []
    for file, rays in runpy.run_path(str(Path(folder) / "load_rays.py"))["load"](folder):
        mask = np.asarray(Image.open(Path(masks) / f"{Path(file).stem}.png")) > 0
        known = np.isfinite(rays["length_mm"])
        lines = rays["origin_mm"][known].astype(float), rays["direction"][known].astype(float)
        pictures.append((*(centralised(*lines) if central else lines), mask[known]))
    return tuple(np.concatenate(part) for part in zip(*pictures, strict=True))


def nearest_to_axis(origin, direction):
    """Return the point (N, 3) of each ray that is nearest to the canister's axis."""
    level = direction[:, :2]
    return origin - ((origin[:, :2] * level).sum(1) / (level**2).sum(1))[:, None] * direction


def centralised(origin, direction):
    """Return the rays of the best camera with a single centre of projection.

    A camera's rays have slopes that are linear functions of their places on a plane across the direction of view. Here
    it is the plane through the canister's axis. The function is fitted to the given rays near the axis.
    """
    middle = nearest_to_axis(origin, direction)
    away = np.hypot(middle[:, 0], middle[:, 1])
    near = away < NEAR_AXIS * away.max()
    forward = direction[near].mean(axis=0) / np.linalg.norm(direction[near].mean(axis=0))
    right = np.cross(forward, [0.0, 0.0, 1.0]) / np.hypot(forward[0], forward[1])
    across = np.stack([right, np.cross(right, forward)])
    slope = direction @ across.T / (direction @ forward)[:, None]
    place = middle @ across.T - (middle @ forward)[:, None] * slope
    spread = place[near] - place[near].mean(axis=0)
    rate = (spread * slope[near]).sum() / (spread**2).sum()
    aimed = forward + (slope[near].mean(axis=0) + rate * (place - place[near].mean(axis=0))) @ across
    aimed /= np.linalg.norm(aimed, axis=1)[:, None]
    start = place @ across
    return start - np.linalg.norm(start - origin, axis=1)[:, None] * aimed, aimed


def box_around(origin, direction, root):
    """Return the corners (2, 3) of a box around all roots, and the radius of a cylinder around them, mm.

    In a full turn, each point of a root is once seen almost tangentially. Therefore, the rays to roots extend as far
    from the axis as the roots.
    """
    middle = nearest_to_axis(origin[root], direction[root])
    radius = np.hypot(middle[:, 0], middle[:, 1]).max() + MARGIN_MM
    rise = radius * np.abs(direction[root, 2]) / np.hypot(direction[root, 0], direction[root, 1])
    low, high = (middle[:, 2] - rise).min(), (middle[:, 2] + rise).max()
    return np.array([[-radius, -radius, low - MARGIN_MM], [radius, radius, high + MARGIN_MM]]), radius
