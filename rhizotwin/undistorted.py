"""Pictures as a pinhole camera in the water would see them (the virtual camera of the thesis's figure 5.4).

Refraction at a round wall has no single centre: where a point shows depends on its depth along the ray, and no pinhole
is right for all. Here pictures are mapped so that they are exact on the upright plane through the canister's axis that
faces the camera. Before and behind it, points are off by what the wall's astigmatism leaves: horizontally the rays of a
picture meet farther away than vertically. The pinhole stands at the distance from the axis where that is least.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import minimize_scalar

from rhizotwin.recon.optics.cameras import View, project_inner
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8 | np.uint16]

_STEP_PX = 4
"""The map is worked out at every fourth pixel; between, it is interpolated to 0.01 px."""
_NEAR_AXIS = 0.6
"""Points of so much of the water's radius decide where the pinhole stands: the wall shows some of the others twice."""
_NODES = 41
"""Nodes along each side of the plane, for the way back from pixels to the plane."""


@dataclass(frozen=True)
class VirtualCamera:
    """A pinhole in water that stands for one picture's camera."""

    view: View
    optics: Optics
    distance_mm: float
    """From the axis to the pinhole, horizontally."""
    heights_mm: tuple[float, float]
    """Lowest and highest point of the water."""
    focal_px: float | None = None
    """Focal length; None: with it, the scale on the plane through the axis is the picture's."""

    @property
    def cam_from_canister(self) -> Array:
        """Return its pose (4, 4): level, looking at the axis from the camera's azimuth and height."""
        level = frames.level_camera(distance_mm=self.distance_mm, height_mm=float(self.view.centre_mm[2]), tilt_deg=0.0)
        return level @ frames.rotation_z(-self._azimuth_rad)

    @cached_property
    def lens(self) -> Camera:
        """Return its lens, without distortion."""
        (width, height), focal = self.view.camera.image_wh, self.focal_px
        if focal is None:
            middle = np.array([0.0, 0.0, float(np.mean(self.heights_mm))])
            px = project_inner(self.view, self.optics, np.stack([middle - self._right, middle + self._right]))
            focal = self.distance_mm * float(np.linalg.norm(px[1] - px[0])) / 2.0
        return Camera(image_wh=(width, height), focal_px=(focal, focal), principal_px=((width - 1) / 2.0, (height - 1) / 2.0))

    def pixels(self, points_mm: Array) -> Array:
        """Return where the pinhole sees points (N, 3): (N, 2)."""
        x, y, z = frames.apply(self.cam_from_canister, points_mm).T
        (focal, _), (cx, cy) = self.lens.focal_px, self.lens.principal_px
        return np.stack([focal * x / z + cx, focal * y / z + cy], axis=1)

    def undistort(self, picture: Picture) -> Picture:
        """Return a picture (H, W) as the pinhole sees it; 0 where the water has no image."""
        width, height = self.lens.image_wh
        (focal, _), (cx, cy) = self.lens.focal_px, self.lens.principal_px
        u, v = np.arange(0.0, width + _STEP_PX, _STEP_PX), np.arange(0.0, height + _STEP_PX, _STEP_PX)
        aside, up = (u - cx) * self.distance_mm / focal, float(self.view.centre_mm[2]) - (v - cy) * self.distance_mm / focal
        on_plane = self._plane(*np.meshgrid(aside, up))
        low, high = self.heights_mm
        within = (np.abs(aside)[None, :] < self.optics.inner_radius_mm) & (up[:, None] > low) & (up[:, None] < high)
        source = np.zeros((*within.shape, 3))
        source[within, :2] = project_inner(self.view, self.optics, on_plane[within])
        source[..., 2] = within & np.isfinite(source).all(axis=-1)
        source[source[..., 2] == 0.0] = 0.0
        rows, columns = np.mgrid[0:height, 0:width]
        px = RegularGridInterpolator((v, u), source)(np.stack([rows, columns], axis=-1).reshape(-1, 2)).reshape(height, width, 3)
        px[px[..., 2] < 1.0 - 1e-9] = -1e4  # where a corner of the cell has no image
        x, y = px[..., 0].astype(np.float32), px[..., 1].astype(np.float32)
        return np.asarray(cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0))

    def shown(self, points_mm: Array) -> Array:
        """Return where the undistorted picture shows points (N, 3) in the water: (N, 2); NaN where it does not.

        On the plane through the axis this is where the pinhole sees them.
        """
        px = project_inner(self.view, self.optics, points_mm)
        plane = self.pixels(self._to_plane(px))
        return np.where(np.isfinite(px), plane, np.nan)

    def _to_plane(self, px: Array) -> Array:
        """Return the points (N, 3) on the plane whose images are pixels (N, 2), by Newton steps from a linear fit."""
        radius, (low, high) = 0.98 * self.optics.inner_radius_mm, self.heights_mm
        nodes = np.meshgrid(np.linspace(-radius, radius, _NODES), np.linspace(low, high, _NODES))
        seen = project_inner(self.view, self.optics, self._plane(*nodes).reshape(-1, 3))
        good = np.isfinite(seen).all(axis=1)
        design = np.column_stack([seen[good], np.ones(good.sum())])
        linear = np.linalg.lstsq(design, np.stack([node.ravel()[good] for node in nodes], axis=1), rcond=None)[0]
        at = np.column_stack([px, np.ones(len(px))]) @ linear
        for _ in range(8):
            here, right, up = (
                project_inner(self.view, self.optics, self._plane(at[:, 0] + aside, at[:, 1] + above))
                for aside, above in ((0.0, 0.0), (0.01, 0.0), (0.0, 0.01))
            )
            slope = np.stack([right - here, up - here], axis=-1) / 0.01
            slope[~np.isfinite(slope).all(axis=(1, 2))] = np.eye(2)
            at = at + np.linalg.solve(slope, (px - here)[..., None])[..., 0]
        return self._plane(at[:, 0], at[:, 1])

    def _plane(self, aside_mm: Array, height_mm: Array) -> Array:
        """Return points (..., 3) of the plane through the axis that faces the camera."""
        return aside_mm[..., None] * self._right + height_mm[..., None] * np.array([0.0, 0.0, 1.0])

    @cached_property
    def _azimuth_rad(self) -> float:
        return float(np.arctan2(self.view.centre_mm[1], self.view.centre_mm[0]))

    @property
    def _right(self) -> Array:
        """To the right in the picture, (3,)."""
        return np.array([-np.sin(self._azimuth_rad), np.cos(self._azimuth_rad), 0.0])


def best_distance_mm(view: View, optics: Optics, heights_mm: tuple[float, float]) -> tuple[float, float]:
    """Return where a pinhole in water does best, and the root mean square in px that is left off the plane.

    Parameters
    ----------
    view : View
        A camera.
    optics : Optics
        Canister and water.
    heights_mm : tuple of float
        Lowest and highest point of the water.
    """
    rng, radius = np.random.default_rng(0), _NEAR_AXIS * optics.inner_radius_mm
    points = rng.uniform((-radius, -radius, heights_mm[0]), (radius, radius, heights_mm[1]), (400, 3))
    points = points[np.hypot(points[:, 0], points[:, 1]) < radius]

    def left_px(distance_mm: float) -> float:
        camera = VirtualCamera(view, optics, float(distance_mm), heights_mm)
        return float(np.sqrt(np.nanmean(np.square(camera.shown(points) - camera.pixels(points)))))

    real = float(np.hypot(*view.centre_mm[:2]))
    found = minimize_scalar(left_px, bounds=(optics.inner_radius_mm * 1.05, 3.0 * real), method="bounded", options={"xatol": 0.5})
    return float(found.x), float(found.fun)
