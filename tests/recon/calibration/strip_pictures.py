"""An independent little renderer of the marker strip, so that corners and poses are measured against a known truth."""

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics.cameras import matrix
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Scene

Array = NDArray[np.float64]


def render_strip(scene: Scene, cam_from_canister: Array, *, blur_px: float, full_well_e: float, seed: int) -> NDArray[np.uint16]:
    """Render the strip before an even backlight as a linear 16-bit picture (H, W): each pixel the mean of 4 x 4 rays."""
    samples = 4
    camera, pot = scene.camera, scene.net_pot
    width, height = camera.image_wh
    left, right, top, bottom = _box(scene, cam_from_canister)
    directions = _rays(camera, np.arange(left, right), np.arange(top, bottom), (np.arange(samples) + 0.5) / samples - 0.5)
    canister_from_cam = frames.invert(cam_from_canister)
    d = directions @ canister_from_cam[:3, :3].T
    o = canister_from_cam[:3, 3]
    a, b = d[..., 0] ** 2 + d[..., 1] ** 2, o[0] * d[..., 0] + o[1] * d[..., 1]
    discriminant = b * b - a * (o[0] ** 2 + o[1] ** 2 - pot.outer_radius_mm**2)
    t = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / a
    azimuth = np.mod(np.arctan2(o[1] + t * d[..., 1], o[0] + t * d[..., 0]), 2.0 * np.pi)
    z = o[2] + t * d[..., 2]
    on_pot = (discriminant > 0.0) & (z > pot.skirt_bottom_mm) & (z < pot.top_mm)
    facing = np.sqrt(np.maximum(discriminant, 0.0)) / (np.sqrt(a) * pot.outer_radius_mm)
    paper = np.where(_is_white(scene, azimuth, z), 0.85, 0.04)
    light = np.where(on_pot, 0.5 * paper * (0.3 + 0.7 * facing), 0.75)
    picture = np.full((height, width), 0.75)
    picture[top:bottom, left:right] = light.reshape(bottom - top, samples, right - left, samples).mean(axis=(1, 3))
    picture, rng = cv2.GaussianBlur(picture, (0, 0), blur_px), np.random.default_rng(seed)
    picture = (rng.poisson(picture * full_well_e) + rng.normal(0.0, 3.0, picture.shape)) / full_well_e
    return (np.clip(np.round(picture * 4095.0), 0, 4095) * 16).astype(np.uint16)


def _box(scene: Scene, cam_from_canister: Array) -> tuple[int, int, int, int]:
    """Return the columns and rows of a picture between which the net pot lies, with a margin for the lens."""
    camera, pot, turn = scene.camera, scene.net_pot, np.linspace(0.0, 2.0 * np.pi, 90)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * pot.outer_radius_mm
    rim = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (pot.top_mm, pot.skirt_bottom_mm)])
    px = cv2.projectPoints(rim, cam_from_canister[:3, :3], cam_from_canister[:3, 3], matrix(camera), np.array(camera.distortion))[0][:, 0]
    low, high = np.maximum(px.min(axis=0) - 5.0, 0.0).astype(int), np.minimum(px.max(axis=0) + 5.0, camera.image_wh).astype(int)
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])


def _rays(camera: Camera, columns: NDArray[np.int64], rows: NDArray[np.int64], sub: Array) -> Array:
    """Return camera-frame directions of the pixels' samples, on a sheared lattice: no two of a pixel share a column or a row."""
    u, v = np.meshgrid((columns[:, None] + sub).ravel(), (rows[:, None] + sub).ravel())
    lattice_u, lattice_v = np.meshgrid(np.tile(sub, len(columns)), np.tile(sub, len(rows)))
    px = np.stack([u + lattice_v / len(sub), v + lattice_u / len(sub)], axis=-1)
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    xy = (px - [cx, cy]) / [fx, fy]
    k1, k2, p1, p2, k3 = camera.distortion
    bent = xy
    for _ in range(12):
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift = np.stack([2.0 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=-1)
        xy = (bent - shift) / radial[..., None]
    return np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1)


def _is_white(scene: Scene, azimuth: Array, z: Array) -> NDArray[np.bool_]:
    strip, radius_mm = scene.strip, scene.net_pot.outer_radius_mm
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{strip.dictionary}"))
    side = dictionary.markerSize + 2
    cells = np.stack([cv2.aruco.generateImageMarker(dictionary, strip.first_id + k, side) > 127 for k in range(strip.rows * strip.columns)])
    pitch = 2.0 * np.pi / strip.columns
    column = np.clip((azimuth / pitch).astype(int), 0, strip.columns - 1)
    across = ((azimuth - (column + 0.5) * pitch) * radius_mm / strip.marker_mm + 0.5) * side
    white = np.ones(z.shape, bool)
    for row in range(strip.rows):
        top = strip.bottom_mm + (strip.rows - 1 - row) * strip.row_pitch_mm + strip.marker_mm
        down = (top - z) / strip.marker_mm * side
        inside = (across >= 0) & (across < side) & (down >= 0) & (down < side)
        j, i, c = down[inside].astype(int), across[inside].astype(int), column[inside]
        white[inside] = cells[row * strip.columns + c, j, i]
    return white
