"""Fast pictures without Mitsuba.

They show the marker strip in exact perspective, the panel, and lines that resemble roots. The strip is outside the
canister, so that rays to it are not refracted. Therefore the ray of every pixel is intersected with the net pot's
cylinder. The lines below the strip are drawn without refraction and do not represent a specimen. These pictures are for
tests of the rig, not of reconstructions.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes import frames
from rhizotwin.scenes.markers import marker_cells, strip_ids
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

INK = 0.05
"""Reflectance of the black cells of a marker, relative to that of the paper."""
MM_PER_TEXEL = 0.125
ROOT = 0.02
BAND = 0.01
"""Difference in the reflectance of ink and the transmittance of roots between successive bands. Pictures in two bands
thus always differ, as those of a real camera do because of noise."""
ROOTS = 5
ROOT_DEPTH_MM = 90.0
_SHIFT = 4  # fractional bits in OpenCV's drawing functions

Light = NDArray[np.float32]


class Sketch:
    """Fast renderer of approximate pictures.

    Parameters
    ----------
    scene
        Scene with camera, strip, net pot and lights.
    distortion
        Distortion coefficients of the true lens: k1, k2, p1, p2, k3.
    canister_from_strip
        True pose of the net pot relative to the canister, 4x4.
    """

    def __init__(self, scene: Scene, *, distortion: tuple[float, float, float, float, float], canister_from_strip: frames.Array) -> None:
        self._scene = scene
        self._canister_from_strip = canister_from_strip
        camera = scene.camera
        (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
        self._matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self._distortion = np.array(distortion)
        self._rays = self._pixel_rays()
        self._paper = _strip_texture(scene)
        self._roots_mm = _root_lines(scene)

    def picture(self, sight: Sight) -> Grey:
        """Return the picture (H, W) that a camera without noise would store."""
        bits = self._scene.camera.bits
        numbers = np.rint(np.minimum(self.light(sight), np.float32(1.0)) * np.float32(2**bits - 1))
        return numbers.astype(np.uint8) if bits <= 8 else numbers.astype(np.uint16) << np.uint16(16 - bits)

    def light(self, sight: Sight) -> Light:
        """Return the picture (H, W) in linear light, where 1 is full scale."""
        width, height = self._scene.camera.image_wh
        lights = self._scene.lights_in(sight.band)
        panel, front = np.float32(sight.panel * lights.backlight_level), np.float32(sight.front * lights.front_level)
        light = np.full((height, width), panel, np.float32)
        cam_from_canister = sight.cam_from_rig @ sight.rig_from_canister
        added = BAND * next((i for i, band in enumerate(self._scene.camera.bands) if band.name == sight.band), 0)
        self._draw_roots(light, cam_from_canister, float(panel) * (ROOT + added), sight.twist_deg)
        self._draw_strip(light, cam_from_canister @ self._canister_from_strip, front, np.float32(added))
        return light * np.float32(sight.exposure)

    def _pixel_rays(self) -> Light:
        """Return the direction (H, W, 3) of the ray through every pixel, in the camera's frame.

        Its z component is 1.
        """
        width, height = self._scene.camera.image_wh
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
        many = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        flat = cv2.undistortPoints(pixels, self._matrix, self._distortion, criteria=many).reshape(height, width, 2)
        return np.concatenate([flat, np.ones((height, width, 1))], axis=2).astype(np.float32)

    def _draw_strip(self, light: Light, cam_from_strip: frames.Array, front: np.float32, added: np.float32) -> None:
        """Draw the printed strip into the pixels whose rays intersect the net pot's skirt.

        The reflectance of the ink is increased by ``added``.
        """
        pot = self._scene.net_pot
        rows, columns = self._bounds(cam_from_strip)
        rays = self._rays[rows, columns] @ cam_from_strip[:3, :3].astype(np.float32)  # rays in the strip's frame
        if rays.size == 0:
            return
        eye = frames.invert(cam_from_strip)[:3, 3].astype(np.float32)
        x, y, z = rays[..., 0], rays[..., 1], rays[..., 2]
        a, b = x * x + y * y, x * eye[0] + y * eye[1]
        inside = b * b - a * np.float32(eye[0] ** 2 + eye[1] ** 2 - pot.outer_radius_mm**2)
        along = (-b - np.sqrt(np.maximum(inside, 0.0))) / a
        at_x, at_y, at_z = eye[0] + along * x, eye[1] + along * y, eye[2] + along * z
        turn = np.arctan2(at_y, at_x) / np.float32(2.0 * np.pi)
        across = np.float32(self._paper.shape[1] - 2) * (turn % 1.0) + np.float32(0.5)
        down = np.float32(1.0 / MM_PER_TEXEL) * (np.float32(pot.top_mm) - at_z) - np.float32(0.5)
        seen = cv2.remap(self._paper, across.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        seen += added * (np.float32(1.0) - seen)
        facing = np.sqrt(np.maximum(inside, 0.0) / (a * np.float32(pot.outer_radius_mm**2)))
        hit = (inside > 0.0) & (along > 0.0) & (at_z <= pot.top_mm) & (at_z >= pot.skirt_bottom_mm)
        light[rows, columns] = np.where(hit, seen * front * np.minimum(facing * np.float32(1.2), 1.0), light[rows, columns])

    def _draw_roots(self, light: Light, cam_from_canister: frames.Array, level: float, twist_deg: float) -> None:
        top_mm = self._scene.net_pot.grid_z_mm
        hanging = [frames.twist(line, (top_mm - line[:, 2]) / ROOT_DEPTH_MM, twist_deg) for line in self._roots_mm]
        lines = [self._project(cam_from_canister, line) for line in hanging]
        for i, line in enumerate(lines):
            if line is not None:
                points = np.rint(line * 2**_SHIFT).astype(np.int32)
                cv2.polylines(light, [points], False, level, thickness=6 if i == 0 else 2, shift=_SHIFT)

    def _project(self, cam_from_b: frames.Array, points_b: frames.Array) -> frames.Array | None:
        """Project points (N, 3) to pixels (N, 2).

        Return None if a point is not in front of the camera or lies far outside the picture.
        """
        points = frames.apply(cam_from_b, points_b)
        if points[:, 2].min() < 1.0:
            return None
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), self._matrix, self._distortion)
        found = np.asarray(pixels).reshape(-1, 2)
        return found if np.abs(found).max() < 1e5 else None

    def _bounds(self, cam_from_strip: frames.Array) -> tuple[slice, slice]:
        """Return the slices of rows and columns that contain the skirt of the net pot."""
        pot = self._scene.net_pot
        height, width = self._rays.shape[:2]
        angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        radius = pot.outer_radius_mm / np.cos(np.pi / 32)
        circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rings = [np.insert(circle, 2, z_mm, axis=1) for z_mm in (pot.skirt_bottom_mm, pot.top_mm)]
        pixels = self._project(cam_from_strip, np.concatenate(rings))
        if pixels is None:
            return slice(0, height), slice(0, width)
        low, high = np.floor(pixels.min(axis=0)).astype(int) - 2, np.ceil(pixels.max(axis=0)).astype(int) + 3
        return slice(*np.clip([low[1], high[1]], 0, height)), slice(*np.clip([low[0], high[0]], 0, width))


def _strip_texture(scene: Scene) -> Light:
    """Draw the unrolled strip, with row 0 at the top of the net pot.

    One column is repeated at each end, so that the picture can be interpolated across the seam.
    """
    strip, pot = scene.strip, scene.net_pot
    around_mm = 2.0 * np.pi * pot.outer_radius_mm
    columns, rows = round(around_mm / MM_PER_TEXEL), round((pot.top_mm - pot.skirt_bottom_mm) / MM_PER_TEXEL)
    s_mm = (np.arange(columns) + 0.5) / columns * around_mm
    down_mm = (np.arange(rows) + 0.5) * MM_PER_TEXEL
    picture, ids = np.ones((rows, columns), np.float32), strip_ids(strip)
    for row in range(strip.rows):
        top_mm = pot.top_mm - (strip.bottom_mm + (strip.rows - 1 - row) * strip.row_pitch_mm + strip.marker_mm)
        for column in range(strip.columns):
            cells = marker_cells(strip.dictionary, int(ids[row, column]))
            left_mm = (column + 0.5) * around_mm / strip.columns - strip.marker_mm / 2.0
            across, down = _share(s_mm, left_mm, strip.marker_mm, len(cells)), _share(down_mm, top_mm, strip.marker_mm, len(cells))
            j, i = np.flatnonzero(down.any(axis=1)), np.flatnonzero(across.any(axis=1))
            picture[np.ix_(j, i)] -= ((1.0 - INK) * (down[j] @ (~cells).astype(float) @ across[i].T)).astype(np.float32)
    return np.concatenate([picture[:, -1:], picture, picture[:, :1]], axis=1)


def _share(texel_mm: NDArray[Any], start_mm: float, side_mm: float, cells: int) -> frames.Array:
    """Return the fraction of each texel that each cell of a marker covers, along one direction."""
    half = (texel_mm[1] - texel_mm[0]) / 2.0
    edges = start_mm + side_mm / cells * np.arange(cells + 1)
    low = np.maximum(texel_mm[:, None] - half, edges[None, :-1])
    high = np.minimum(texel_mm[:, None] + half, edges[None, 1:])
    return np.asarray(np.clip(high - low, 0.0, None) / (2.0 * half))


def _root_lines(scene: Scene) -> list[frames.Array]:
    """Return a taproot and a few laterals as polylines (N, 3) in the canister's frame, mm."""
    top = scene.net_pot.grid_z_mm
    depth = np.linspace(0.0, min(ROOT_DEPTH_MM, top - scene.canister.floor_z_mm - 5.0), 24)
    lines = [np.stack([2.0 * np.sin(depth / 25.0), 2.0 * np.cos(depth / 31.0), top - depth], axis=1)]
    for i in range(ROOTS):
        azimuth = 2.0 * np.pi * i / ROOTS + depth / 80.0
        out = (6.0 + 5.0 * i) * np.sin(np.minimum(depth / 40.0, np.pi / 2.0))
        lines.append(np.stack([out * np.cos(azimuth), out * np.sin(azimuth), top - depth * (1.0 - 0.1 * i)], axis=1))
    return lines
