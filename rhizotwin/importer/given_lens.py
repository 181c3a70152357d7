"""Lenses of other programs: lens models of COLMAP and OpenCV.

All coordinates have pixel centres at integers. Rays are directions (x, y, 1) in the camera's frame, x right, y down.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Camera


class LensModel(NamedTuple):
    """Parameters of a lens model of COLMAP (src/colmap/sensor/models.h of version 4.2)."""

    number: int
    """Number of the model in binary files."""
    focal_lengths: int
    """1 if the focal length is the same in x and y, otherwise 2. They precede the principal point."""
    coefficients: tuple[str, ...] = ()
    """Distortion coefficients, which follow the principal point."""
    is_fisheye: bool = False
    """Whether the coefficients belong to OpenCV's fisheye model instead of its ordinary model."""


MODELS = {
    "SIMPLE_PINHOLE": LensModel(0, 1),
    "PINHOLE": LensModel(1, 2),
    "SIMPLE_RADIAL": LensModel(2, 1, ("k1",)),
    "RADIAL": LensModel(3, 1, ("k1", "k2")),
    "OPENCV": LensModel(4, 2, ("k1", "k2", "p1", "p2")),
    "OPENCV_FISHEYE": LensModel(5, 2, ("k1", "k2", "k3", "k4"), True),
    "FULL_OPENCV": LensModel(6, 2, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "SIMPLE_RADIAL_FISHEYE": LensModel(8, 1, ("k1",), True),
    "RADIAL_FISHEYE": LensModel(9, 1, ("k1", "k2"), True),
    "SIMPLE_FISHEYE": LensModel(14, 1, (), True),
    "FISHEYE": LensModel(15, 2, (), True),
}
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Distortion coefficients in OpenCV's order."""
SAME_PX = 0.02
"""Maximum difference between two lenses that count as the same. Marker corners are measured to about 0.05 px."""
WIDEST_TAN = float(np.tan(np.deg2rad(65.0)))
"""Largest tangent of the angle to the optical axis that a picture shows after its conversion to a pinhole camera, which
stretches its edges. A canister in front of a camera spans less than 45 degrees on each side."""
_SAMPLES = 33
"""Number of points along each side of a picture at which lenses are compared."""


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Lens of a picture: OpenCV's ordinary model, with up to eight coefficients, or its fisheye model."""

    image_wh: tuple[int, int]
    focal_px: tuple[float, float]
    principal_px: tuple[float, float]
    distortion: tuple[float, ...] = (0.0,) * 8
    """Values of `COEFFICIENTS`. The fisheye model uses k1 to k4."""
    is_fisheye: bool = False

    @staticmethod
    def of(camera: Camera) -> "Lens":
        """Return the lens of a camera of this project."""
        return Lens(
            image_wh=camera.image_wh,
            focal_px=camera.focal_px,
            principal_px=camera.principal_px,
            distortion=(*camera.distortion, 0.0, 0.0, 0.0),
        )

    def pixels(self, rays: Array) -> Array:
        """Project rays (N, 2), and return pixels (N, 2); NaN where the lens model is not valid."""
        r2 = np.sum(rays * rays, axis=1)
        r = np.sqrt(r2)
        bent = rays * self._radial(r)[:, None]
        if not self.is_fisheye:
            p1, p2 = self.distortion[2:4]
            both = 2.0 * rays[:, 0] * rays[:, 1]
            bent = bent + np.stack([p1 * both + p2 * (r2 + 2.0 * rays[:, 0] ** 2), p2 * both + p1 * (r2 + 2.0 * rays[:, 1] ** 2)], axis=1)
        return np.where((r < self._fold_r)[:, None], bent * self.focal_px + self.principal_px, np.nan)

    def rays(self, px: Array) -> Array:
        """Return the rays (N, 2) of pixels (N, 2), to 1e-6 px; NaN where the lens model shows nothing."""
        bent = np.ascontiguousarray((px - self.principal_px) / self.focal_px, np.float64).reshape(-1, 1, 2)
        k1, k2, _, _, k3, k4, _, _ = self.distortion
        numbers = (k1, k2, k3, k4) if self.is_fisheye else self.distortion
        undistort = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
        many = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-13)
        rays = undistort(bent, np.eye(3), np.array(numbers), criteria=many).reshape(-1, 2)
        with np.errstate(invalid="ignore", over="ignore"):
            return np.where((np.abs(self.pixels(rays) - px).max(axis=1) < 1e-6)[:, None], rays, np.nan)

    def as_camera(self, other: Camera) -> Camera | None:
        """Return the camera of this project with the same lens, to within `SAME_PX`; None if there is none.

        The coefficients k1, k2 and k3 of a fisheye lens, and of a lens with k4, k5 or k6, are fitted at pixels all over
        the picture (linear least squares).
        """
        camera = replace(other, image_wh=self.image_wh, focal_px=self.focal_px, principal_px=self.principal_px)
        k1, k2, p1, p2, k3, *rational = self.distortion
        if not self.is_fisheye and not any(rational):
            return replace(camera, distortion=(k1, k2, p1, p2, k3))
        rays = self.rays(_samples(self.image_wh))
        r = np.linalg.norm(rays, axis=1)
        if not np.isfinite(r).all():
            return None
        powers = r[:, None] ** np.array([3, 5, 7])
        k1, k2, k3 = np.linalg.lstsq(powers, r * (self._radial(r) - 1.0), rcond=None)[0]
        tangential = (0.0, 0.0) if self.is_fisheye else (p1, p2)
        fitted = replace(camera, distortion=(float(k1), float(k2), *tangential, float(k3)))
        return fitted if self.is_same(fitted) else None

    def difference_px(self, camera: Camera) -> float:
        """Return the maximum distance between the pixels of a ray in this lens and in a camera, px.

        It is infinite if the pictures have different sizes, or the lens is not valid in the whole picture.
        """
        px = _samples(self.image_wh)
        away = np.linalg.norm(Lens.of(camera).pixels(self.rays(px)) - px, axis=1)
        return float(away.max()) if self.image_wh == camera.image_wh and np.isfinite(away).all() else np.inf

    def is_same(self, camera: Camera) -> bool:
        """Return whether a camera has this lens, to within `SAME_PX`."""
        return Lens.of(camera) == self or self.difference_px(camera) <= SAME_PX

    def as_pinhole(self, other: Camera) -> Camera:
        """Return the pinhole camera with the same focal length that shows the rows and columns through the middle."""
        (fx, fy), (width, height), (cx, cy) = self.focal_px, self.image_wh, self.principal_px
        edges = self.rays(np.array([[0.0, cy], [width - 1.0, cy], [cx, 0.0], [cx, height - 1.0]]))
        reach = np.fmin(np.abs(edges), WIDEST_TAN)
        left, right, above, below = (int(fx * reach[0, 0]), int(fx * reach[1, 0]), int(fy * reach[2, 1]), int(fy * reach[3, 1]))
        size = (left + right + 1, above + below + 1)
        middle = (float(left), float(above))
        return replace(other, image_wh=size, focal_px=(fx, fy), principal_px=middle, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))

    def _radial(self, r: Array) -> Array:
        """Return the ratio of distorted and undistorted radius for radii (N,) in normalised coordinates."""
        k1, k2, _, _, k3, k4, k5, k6 = self.distortion
        if self.is_fisheye:
            angle = np.arctan(r)
            a2 = angle * angle
            return np.asarray(
                np.where(r > 0.0, angle / np.where(r > 0.0, r, 1.0), 1.0) * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
            )
        r2 = r * r
        return np.asarray((1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))))

    @cached_property
    def _fold_r(self) -> float:
        """Radius beyond which the distorted radius decreases, so that directions beyond would appear in the picture."""
        r = np.tan(np.deg2rad(np.linspace(0.0, 89.0, 8901)))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            falls = ~(np.diff(r * self._radial(r)) > 0.0)
        return float(r[int(np.argmax(falls))]) if falls.any() else float(r[-1])


def _samples(image_wh: tuple[int, int]) -> Array:
    """Return pixels (N, 2) all over a picture."""
    u, v = (np.linspace(0.0, side - 1.0, _SAMPLES) for side in image_wh)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
