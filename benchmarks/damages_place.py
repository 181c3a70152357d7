"""Geometric damages: cameras, pictures in the wrong place, plants that move, and objects in front of the canister."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from benchmarks.damaged_scan import Damage, Light, Scan, over
from rhizotwin.recon.optics import cameras
from rhizotwin.scenes.model import Scene

_DIM, _BUBBLES, _BUBBLE_MM = 0.4, 40, 1.0
"""Light of a grey label, relative to the panel's; number of bubbles on the roots, and their radius."""


def _shift(light: Light, dx_px: float, dy_px: float) -> Light:
    height, width = light.shape
    moved = np.array([[1.0, 0.0, dx_px], [0.0, 1.0, dy_px]])
    return np.asarray(cv2.warpAffine(light, moved, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _below(scan: Scan, k: int, light: Light) -> Light:
    """Return a picture that is changed where all pictures show the water."""
    return np.where(np.logical_and.reduce(scan.water), light, scan.light[k])


def _slip(scan: Scan, k: int) -> Light:
    other = (k + 1) % scan.count
    return _below(scan, k, scan.light[other]) if 2 * k >= scan.count else scan.light[k]


def _sagging(scan: Scan, k: int) -> Light:
    px_per_mm = scan.dataset.scene.camera.focal_px[1] / scan.views[k].rho_mm
    return _below(scan, k, _shift(scan.light[k], 0.0, 1.5 * px_per_mm * k / scan.count))


def _vibrating(scan: Scan, k: int) -> Light:
    height, width = scan.light[k].shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    phase = np.random.default_rng([2, k]).uniform(0.0, 2.0 * np.pi)
    moved = x + np.float32(1.0) * np.sin(2.0 * np.pi * y / 60.0 + phase).astype(np.float32)
    return np.asarray(cv2.remap(scan.light[k], moved, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _shear(scan: Scan, k: int) -> Light:
    """Shear a picture by 3 px from top to bottom, in opposite directions in successive pictures."""
    height, width = scan.light[k].shape
    shear = 3.0 / height * (1.0 if k % 2 else -1.0)
    moved = np.array([[1.0, shear, -shear * height / 2.0], [0.0, 1.0, 0.0]])
    return np.asarray(cv2.warpAffine(scan.light[k], moved, (width, height), borderMode=cv2.BORDER_REPLICATE))


def _interlace(scan: Scan, k: int) -> Light:
    light = scan.light[k].copy()
    light[1::2] = _shift(light, 2.0, 0.0)[1::2]
    return light


def _distort(scan: Scan, k: int) -> Light:
    camera = replace(scan.dataset.scene.camera, distortion=(-0.15, 0.0, 0.0, 0.0, 0.0))
    height, width = scan.light[k].shape
    px = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
    direction = cameras.camera_directions(camera, px)
    source = ((direction @ cameras.matrix(camera).T)[:, :2] / direction[:, 2:]).reshape(height, width, 2).astype(np.float32)
    return np.asarray(cv2.remap(scan.light[k], source[..., 0], source[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _small_print(scan: Scan, k: int) -> Light:
    """Draw the strip at 97 % of its size.

    Each point of the net pot's near side shows the point of the strip that is 1 / 0.97 times as far from its foot and
    seam.
    """
    view, scene = scan.views[k], scan.dataset.scene
    height, width = scan.light[k].shape
    px = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
    pose, centre = view.cam_from_canister, view.centre_mm
    d = cameras.camera_directions(scene.camera, px) @ pose[:3, :3]
    a, b = (d[:, :2] ** 2).sum(axis=1), d[:, :2] @ centre[:2]
    root = b**2 - a * (centre[:2] @ centre[:2] - scene.net_pot.outer_radius_mm**2)
    with np.errstate(invalid="ignore"):
        at = centre + ((-b - np.sqrt(root)) / a)[:, None] * d
    foot = scene.strip.bottom_mm
    azimuth, z = np.arctan2(at[:, 1], at[:, 0]) / 0.97, foot + (at[:, 2] - foot) / 0.97
    other = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) * scene.net_pot.outer_radius_mm
    cam = np.concatenate([other, z[:, None]], axis=1) @ pose[:3, :3].T + pose[:3, 3]
    source = ((cam @ cameras.matrix(scene.camera).T)[:, :2] / cam[:, 2:]).reshape(height, width, 2).astype(np.float32)
    drawn = cv2.remap(scan.light[k], source[..., 0], source[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    near = np.cos(azimuth - scan.azimuth_rad(k)) > scene.net_pot.outer_radius_mm / view.rho_mm
    on_strip = ((root > 0) & near & (z > foot) & (z < scene.net_pot.top_mm)).reshape(height, width)
    return np.where(on_strip, drawn, scan.light[k])


def _bubbles(scan: Scan, k: int) -> Light:
    """Draw bubbles on the roots: dark, with a bright core of half their size."""
    rng = np.random.default_rng(3)
    centres = scan.surface_mm[rng.choice(len(scan.surface_mm), _BUBBLES, replace=False)]
    px = cameras.project_inner(scan.views[k], scan.optics, centres)
    radius_px = _BUBBLE_MM * scan.dataset.scene.camera.focal_px[0] / scan.views[k].rho_mm
    light = scan.light[k]
    bright = float(np.median(light[scan.water[k]]))
    for one in px:
        light = over(light, scan.disc(one, radius_px), 0.05)
        light = over(light, scan.disc(one, 0.4 * radius_px), 0.8 * bright)
    return light


def _half_panel(scan: Scan, k: int) -> Light:
    light = scan.light[k].copy()
    light[:, light.shape[1] // 2 :] *= 0.02
    return light


def _fog(scan: Scan, k: int) -> Light:
    """Draw a growing band of fog on the wall below the net pot, which scatters up to 40 % of the light."""
    height = scan.light[k].shape[0]
    y = np.arange(height)[:, None] / height
    band = np.exp(-(((y - 0.42) / 0.08) ** 2)) * 0.4 * k / scan.count
    return _below(scan, k, (1.0 - band) * scan.light[k] + band * cv2.GaussianBlur(scan.light[k], (0, 0), 6.0))


def _turn(scene: Scene) -> Scene:
    camera = scene.camera
    (fx, fy), (cx, cy), (width, height) = camera.focal_px, camera.principal_px, camera.image_wh
    return replace(scene, camera=replace(camera, image_wh=(height, width), focal_px=(fy, fx), principal_px=(cy, width - 1 - cx)))


def _halve(scene: Scene) -> Scene:
    """State the new size only."""
    width, height = scene.camera.image_wh
    return replace(scene, camera=replace(scene.camera, image_wh=(width // 2, height // 2)))


def _crop(scene: Scene) -> Scene:
    width, height = scene.camera.image_wh
    return replace(scene, camera=replace(scene.camera, image_wh=(width - 40, height - 10)))


def _said_n(scene: Scene) -> Scene:
    return replace(scene, water=replace(scene.water, n_water=1.37))


def _said_wide(scene: Scene) -> Scene:
    return replace(scene, canister=replace(scene.canister, outer_radius_mm=1.03 * scene.canister.outer_radius_mm))


def _said_focal(scene: Scene) -> Scene:
    return replace(scene, camera=scene.camera.focused(1.03))


def _said_strip(scene: Scene) -> Scene:
    strip = scene.strip
    return replace(scene, strip=replace(strip, marker_mm=strip.marker_mm / 0.97, row_pitch_mm=strip.row_pitch_mm / 0.97))


def _order(scan: Scan) -> list[int]:
    return np.random.default_rng(4).permutation(scan.count).tolist()


def _swaying(mm: float) -> Damage:
    """Return swinging roots: each picture shows them displaced in proportion to their depth below the net pot."""

    def light(scan: Scan, k: int) -> Light:
        height, width = scan.light[k].shape
        view, top, low = scan.views[k], scan.surface_mm[:, 2].max(), scan.surface_mm[:, 2].min()
        hang = cameras.project_inner(view, scan.optics, np.array([[0.0, 0.0, top], [0.0, 0.0, low]]))[:, 1]
        x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
        px_per_mm = scan.dataset.scene.camera.focal_px[0] / view.rho_mm
        moved_px = mm * px_per_mm * np.random.default_rng([5, k]).normal() * np.clip((y - hang[0]) / (hang[1] - hang[0]), 0.0, 1.0)
        moved = (x + moved_px).astype(np.float32)
        return _below(scan, k, cv2.remap(scan.light[k], moved, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    return Damage(name=f"swaying-{mm:g}", why=f"roots swing after each step of the table: tips {mm:g} mm (standard deviation)", light=light)


def _mirrored_below(scan: Scan, k: int) -> Light:
    return _below(scan, k, scan.light[k][:, ::-1]) if k == 5 else scan.light[k]


def _stale(scan: Scan, k: int) -> Light:
    return scan.light[5] if 6 <= k <= 9 else scan.light[k]


PLACE = (
    Damage(
        name="reversed",
        why="the pictures were named in reverse order",
        table_deg=lambda scan, k: scan.frames[-k % scan.count].table_deg,
    ),
    Damage(name="wrong-order", why="the pictures are in random order", light=lambda scan, k: scan.light[_order(scan)[k]]),
    Damage(
        name="turned-90",
        why="the camera is in portrait orientation, as stated in the scene",
        light=lambda scan, k: np.rot90(scan.light[k]),
        scene=_turn,
    ),
    Damage(name="turned-180", why="the camera is upside down", light=lambda scan, k: scan.light[k][::-1, ::-1]),
    Damage(name="mirrored", why="pictures of a mirror image", light=lambda scan, k: scan.light[k][:, ::-1]),
    Damage(name="one-mirrored", why="one picture shows the roots mirrored", light=_mirrored_below),
    Damage(
        name="step-other",
        why="the table turns by 18.5 degrees instead of the stated 18",
        table_deg=lambda scan, k: (scan.frames[k].table_deg or 0.0) * 18.0 / 18.5,
    ),
    Damage(name="repeated", why="the camera returned the same picture five times", light=_stale),
    Damage(name="stopped", why="the last third of the turn is missing", keeps=lambda scan, k: 3 * k < 2 * scan.count),
    Damage(
        name="cropped",
        why="40 columns and 10 rows cropped, and only the size changed in the scene",
        scene=_crop,
        light=lambda scan, k: scan.light[k][10:, 40:],
    ),
    Damage(
        name="halved",
        why="pictures reduced by half, and only the size changed in the scene",
        scene=_halve,
        light=lambda scan, k: cv2.resize(scan.light[k], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
    ),
    Damage(name="distorted", why="an uncalibrated lens of k1 = -0.15", light=_distort),
    Damage(name="focal-said-3-more", why="the focal length is stated 3 % too large", scene=_said_focal),
    Damage(name="strip-97", why="a marker strip printed at 97 %", light=_small_print),
    Damage(name="strip-said-3-more", why="markers and rows are stated 3 % too large", scene=_said_strip),
    Damage(name="n-said-1.37", why="the liquid is stated to be syrup", scene=_said_n),
    Damage(name="radius-said-3-more", why="the canister's radius is stated 3 % too large", scene=_said_wide),
    Damage(name="vibrating", why="the arm vibrates under a rolling shutter: 1 px", light=_vibrating),
    Damage(name="sheared", why="the table swings under a rolling shutter: 3 px from top to bottom", light=_shear),
    Damage(name="interlaced", why="every second row is 2 px off", light=_interlace),
    Damage(name="slipped", why="the plant slips in its pot half-way, by a step of the table", light=_slip),
    Damage(name="sagging", why="the roots sink by 1.5 mm during the scan", light=_sagging),
    *(_swaying(mm) for mm in (0.1, 0.3, 0.6, 1.2)),
    Damage(name="bubbles", why="40 bubbles of 2 mm on the roots", light=_bubbles),
    Damage(name="half-panel", why="the panel is behind the left half only", light=_half_panel),
    Damage(name="fogged", why="the wall fogs up during the scan", light=_fog),
    Damage(
        name="label",
        why="a grey label on the canister",
        light=lambda scan, k: over(scan.light[k], scan.wall_patch(k, (0.3, 0.7), (-75.0, -45.0)), _DIM),
    ),
    Damage(
        name="tape",
        why="a strip of dark tape around half of the canister, in front of the roots",
        light=lambda scan, k: over(scan.light[k], scan.wall_patch(k, (0.0, np.pi), (-62.0, -56.0)), 0.05),
    ),
)


def exchange_picture(other: Callable[[], Scan]) -> Damage:
    """Return a scan with one picture of another scan, whose pictures have the same size."""
    return Damage(
        name="one-of-another-scan",
        why="one picture of another plant",
        light=lambda scan, k: other().light[5] if k == 5 else scan.light[k],
    )
