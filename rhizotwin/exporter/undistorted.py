"""Removal of refraction from pictures, as if taken by a pinhole camera in water (virtual camera, thesis fig. 5.4).

Refraction at a round wall has no single centre of projection. The image position of a point depends on its depth along
the ray, so no pinhole camera is exact for all points. The mapping here is exact on the vertical plane through the
canister's axis that faces the camera. Points in front of and behind this plane have a residual error due to the wall's
astigmatism, because the rays of a picture converge farther away horizontally than vertically. The distance of the
pinhole from the axis minimises this error.
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
"""Spacing of the pixels for which the mapping between real and undistorted picture is computed. The mapping is
interpolated between them, with an error of 0.01 px."""
_NEAR_AXIS = 0.6
"""Radius of the region around the axis in which the pinhole camera is fitted to the real camera, relative to the radius
of the water. Points outside this region may appear twice in a picture."""
_NODES = 41
"""Number of grid points along each side of the plane through the axis. The linear mapping from pixels to this plane is
fitted to these points."""


@dataclass(frozen=True)
class VirtualCamera:
    """Pinhole camera in water that approximates the real camera of a picture."""

    view: View
    optics: Optics
    distance_mm: float
    """Horizontal distance from the canister's axis to the pinhole, in mm."""
    heights_mm: tuple[float, float]
    """Height of the lowest and of the highest point of the water, in the canister frame."""
    focal_px: float | None = None
    """Focal length in pixels. If it is None, it is computed so that the plane through the axis has the same scale as in
    the real picture."""

    @property
    def cam_from_canister(self) -> Array:
        """Pose (4, 4) of the pinhole camera.

        The camera has the azimuth and height of the real camera. It is tilted towards the middle of the part of the
        axis that the real picture shows.
        """
        height_mm = float(self.view.centre_mm[2])
        tilt_deg = float(np.rad2deg(np.arctan2(height_mm - self._aim_mm, self.distance_mm)))
        upright = frames.level_camera(distance_mm=self.distance_mm, height_mm=height_mm, tilt_deg=tilt_deg)
        return np.asarray(upright @ frames.rotation_z(-self._azimuth_rad))

    @cached_property
    def lens(self) -> Camera:
        """Lens of the pinhole camera, without distortion."""
        (width, height), focal = self.view.camera.image_wh, self.focal_px
        if focal is None:
            middle = np.array([0.0, 0.0, float(np.mean(self.heights_mm))])
            px = project_inner(self.view, self.optics, np.stack([middle - self._right, middle + self._right]))
            depth_mm = float(frames.apply(self.cam_from_canister, middle)[2])
            focal = depth_mm * float(np.linalg.norm(px[1] - px[0])) / 2.0
        return Camera(image_wh=(width, height), focal_px=(focal, focal), principal_px=((width - 1) / 2.0, (height - 1) / 2.0))

    def pixels(self, points_mm: Array) -> Array:
        """Project points (N, 3) with the pinhole camera, without refraction, and return the pixels (N, 2)."""
        x, y, z = frames.apply(self.cam_from_canister, points_mm).T
        (focal, _), (cx, cy) = self.lens.focal_px, self.lens.principal_px
        return np.stack([focal * x / z + cx, focal * y / z + cy], axis=1)

    def undistort(self, picture: Picture) -> Picture:
        """Compute the picture (H, W) that the pinhole camera would take.

        Pixels that show no water are 0.
        """
        width, height = self.lens.image_wh
        u, v = np.arange(0.0, width + _STEP_PX, _STEP_PX), np.arange(0.0, height + _STEP_PX, _STEP_PX)
        on_plane = self._points_at(*np.meshgrid(u, v))
        low, high = self.heights_mm
        within = np.hypot(on_plane[..., 0], on_plane[..., 1]) < self.optics.inner_radius_mm
        within &= (on_plane[..., 2] > low) & (on_plane[..., 2] < high)
        source = np.zeros((*within.shape, 3))
        source[within, :2] = project_inner(self.view, self.optics, on_plane[within])
        source[..., 2] = within & np.isfinite(source).all(axis=-1)
        source[source[..., 2] == 0.0] = 0.0
        rows, columns = np.mgrid[0:height, 0:width]
        px = RegularGridInterpolator((v, u), source)(np.stack([rows, columns], axis=-1).reshape(-1, 2)).reshape(height, width, 3)
        px[px[..., 2] < 1.0 - 1e-9] = -1e4  # a corner of the interpolation cell has no image
        x, y = px[..., 0].astype(np.float32), px[..., 1].astype(np.float32)
        return np.asarray(cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0))

    def _points_at(self, u: Array, v: Array) -> Array:
        """Return the points (..., 3) on the plane through the axis that the pinhole camera shows at pixels."""
        canister_from_cam = frames.invert(self.cam_from_canister)
        (focal, _), (cx, cy) = self.lens.focal_px, self.lens.principal_px
        rays = np.stack([(u - cx) / focal, (v - cy) / focal, np.ones_like(u)], axis=-1) @ canister_from_cam[:3, :3].T
        towards = np.array([np.cos(self._azimuth_rad), np.sin(self._azimuth_rad), 0.0])
        return np.asarray(canister_from_cam[:3, 3] - self.distance_mm / (rays @ towards)[..., None] * rays)

    def shown(self, points_mm: Array) -> Array:
        """Return the pixels (N, 2) at which the undistorted picture shows points (N, 3) in the water.

        The pixel is NaN if the point is not visible. For points on the plane through the axis, the pixels equal those
        of the pinhole projection `pixels`.
        """
        px = project_inner(self.view, self.optics, points_mm)
        plane = self.pixels(self._to_plane(px))
        return np.where(np.isfinite(px), plane, np.nan)

    def _to_plane(self, px: Array) -> Array:
        """Return the points (N, 3) on the plane through the axis that appear at pixels (N, 2) of the real picture.

        The first estimate is a linear function of the pixels, which is refined by Newton's method.
        """
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
        """Return the points (..., 3) for two coordinates on the plane that contains the axis and faces the camera.

        The coordinates are the horizontal distance from the axis and the height.
        """
        return aside_mm[..., None] * self._right + height_mm[..., None] * np.array([0.0, 0.0, 1.0])

    @cached_property
    def _aim_mm(self) -> float:
        """Height of the point on the axis at which the pinhole camera looks."""
        heights = np.linspace(*self.heights_mm, _NODES)
        px = project_inner(self.view, self.optics, self._plane(np.zeros(_NODES), heights))
        with np.errstate(invalid="ignore"):
            inside = ((px >= 0.0) & (px <= np.array(self.view.camera.image_wh) - 1.0)).all(axis=1)
        seen = heights[inside] if inside.any() else heights
        return float(seen[0] + seen[-1]) / 2.0

    @cached_property
    def _azimuth_rad(self) -> float:
        return float(np.arctan2(self.view.centre_mm[1], self.view.centre_mm[0]))

    @property
    def _right(self) -> Array:
        """Unit vector (3,) in the canister frame that points right in the picture."""
        return np.array([-np.sin(self._azimuth_rad), np.cos(self._azimuth_rad), 0.0])


def best_distance_mm(view: View, optics: Optics, heights_mm: tuple[float, float]) -> tuple[float, float]:
    """Find the distance from the axis at which a pinhole camera in water best approximates a real camera.

    Parameters
    ----------
    view : View
        Real camera.
    optics : Optics
        Optical properties of canister and water.
    heights_mm : tuple of float
        Lowest and highest point of the water, canister frame.

    Returns
    -------
    tuple of float
        Distance of the pinhole from the axis, mm, and RMS error, px, of points in the water near the axis.
    """
    rng = np.random.default_rng(0)
    radius = _NEAR_AXIS * optics.inner_radius_mm
    points = rng.uniform((-radius, -radius, heights_mm[0]), (radius, radius, heights_mm[1]), (400, 3))
    points = points[np.hypot(points[:, 0], points[:, 1]) < radius]

    def left_px(distance_mm: float) -> float:
        camera = VirtualCamera(view, optics, float(distance_mm), heights_mm)
        return float(np.sqrt(np.nanmean(np.square(camera.shown(points) - camera.pixels(points)))))

    real = float(np.hypot(*view.centre_mm[:2]))
    minimum = minimize_scalar(left_px, bounds=(optics.inner_radius_mm * 1.05, 3.0 * real), method="bounded", options={"xatol": 0.5})
    return float(minimum.x), float(minimum.fun)
