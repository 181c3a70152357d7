"""A tiny renderer for tests: rays traced from surface to surface by Snell's law as vectors, roots as capsules, nothing of ours.

It shares no code and no formula with `sim` (Mitsuba) or `recon` (conserved invariants of concentric cylinders); a single step
of a ray is that of `benchmarks.projection`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.projection import meet, snell

Array = NDArray[np.float64]

OUTER_MM, INNER_MM = 76.2, 73.025
FLOOR_MM, GRID_MM, SKIRT_MM = -146.4, -8.0, -6.0
N_WALL, N_WATER = 1.49, 1.333
LIGHT = 0.75
"""Of the panel, of full scale."""
SAMPLES = 6
"""Rays along each side of a pixel that a root touches."""


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a line."""

    start_mm: tuple[float, float, float]
    end_mm: tuple[float, float, float]
    radius_mm: float

    def away(self, origin: Array, direction: Array, reach: Array) -> Array:
        """Return how far the axis is from rays (N,) that end after a way, less the radius: the nearest points of two line pieces."""
        a, b = np.array(self.start_mm), np.array(self.end_mm)
        axis = b - a
        for_axis, along, offset = axis @ axis, direction @ axis, origin - a
        slope = np.maximum(for_axis - along**2, 1e-12)
        s = np.clip(((offset @ axis) - along * np.sum(offset * direction, axis=1)) / slope, 0.0, 1.0)
        t = np.clip(np.sum((a + s[:, None] * axis - origin) * direction, axis=1), 0.0, reach)
        s = np.clip((origin + t[:, None] * direction - a) @ axis / for_axis, 0.0, 1.0)
        return np.linalg.norm(origin + t[:, None] * direction - a - s[:, None] * axis, axis=1) - self.radius_mm

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Tell which points (N, 3) are inside."""
        a, axis = np.array(self.start_mm), np.array(self.end_mm) - np.array(self.start_mm)
        s = np.clip((points - a) @ axis / (axis @ axis), 0.0, 1.0)
        return np.linalg.norm(points - a - s[:, None] * axis, axis=1) <= self.radius_mm


def union_mm3(capsules: list[Capsule], *, rng: np.random.Generator, count: int = 1_000_000) -> float:
    """Return the volume of the union, by points drawn evenly from a box around it: a share of one in fifty is known to a percent."""
    ends = np.array([(one.start_mm, one.end_mm) for one in capsules]).reshape(-1, 3)
    reach = max(one.radius_mm for one in capsules)
    low, high = ends.min(axis=0) - reach, ends.max(axis=0) + reach
    points = rng.uniform(low, high, (count, 3))
    return float(np.prod(high - low) * np.mean(np.any([one.holds(points) for one in capsules], axis=0)))


def pose(azimuth_deg: float, *, distance_mm: float, height_mm: float, down_deg: float = 0.0) -> Array:
    """Return cam_from_canister (4, 4), OpenCV axes, of a camera that looks at the canister's axis and down by an angle."""
    turn, down = np.deg2rad([azimuth_deg, down_deg])
    centre = np.array([distance_mm * np.cos(turn), distance_mm * np.sin(turn), height_mm])
    forward = np.array([-np.cos(turn) * np.cos(down), -np.sin(turn) * np.cos(down), -np.sin(down)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    rows = np.stack([right, np.cross(forward, right), forward])
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rows, -rows @ centre
    return made


def into_water(origin: Array, direction: Array, *, n_water: float = N_WATER) -> tuple[Array, Array, Array, Array]:
    """Follow rays (N, 3) from the air into the water; where they begin there, whither, how far, and at what height they hit."""
    level = np.array([1.0, 1.0, 0.0])
    with np.errstate(invalid="ignore"):  # rays that miss a wall, or are reflected by it
        entry = meet(origin, direction, OUTER_MM)
        inside = snell(direction, entry * level / OUTER_MM, 1.0 / N_WALL)
        wet = meet(entry, inside, INNER_MM)
        final = snell(inside, wet * level / INNER_MM, N_WALL / n_water)
    chord = -2.0 * np.sum(wet[:, :2] * final[:, :2], axis=1) / np.sum(final[:, :2] ** 2, axis=1)
    return wet, final, chord, entry[:, 2]


def picture(
    capsules: list[Capsule], cam_from_canister: Array, *, image_wh: tuple[int, int], focal_px: float, rng: np.random.Generator
) -> Array:
    """Return a picture (H, W) of roots before an even panel, with a little noise; light as a share of full scale."""
    width, height = image_wh
    turn, centre = cam_from_canister[:3, :3], -cam_from_canister[:3, :3].T @ cam_from_canister[:3, 3]

    def light(x: Array, y: Array, slack_mm: float = 0.0) -> Array:
        rays = np.stack([(x - (width - 1) / 2.0) / focal_px, (y - (height - 1) / 2.0) / focal_px, np.ones_like(x)], axis=1)
        rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ turn
        wet, into, way, met_z = into_water(np.broadcast_to(centre, rays.shape), rays)
        leaves = wet[:, 2] + way * into[:, 2]
        bright = np.where((met_z > SKIRT_MM) | (wet[:, 2] > GRID_MM) | (leaves > GRID_MM) | (leaves < FLOOR_MM), 0.02, LIGHT)
        known = np.flatnonzero(np.isfinite(way))
        hidden = np.zeros(len(known), bool)
        for capsule in capsules:
            hidden |= capsule.away(wet[known], into[known], way[known]) < slack_mm
        bright[known[hidden]] = 0.0
        return bright

    y, x = (grid.ravel().astype(float) for grid in np.mgrid[:height, :width])
    plain = light(x, y)
    touched = np.flatnonzero(light(x, y, slack_mm=2.0 * 400.0 / focal_px) == 0.0)  # a pixel is less than 400 mm / f wide there
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    finer = [light(x[touched] + dx, y[touched] + dy) for dx in steps for dy in steps]
    plain[touched] = np.mean(finer, axis=0)
    return np.asarray(np.clip(plain + rng.normal(0.0, 0.002, plain.shape), 0.0, 1.0).reshape(height, width))
