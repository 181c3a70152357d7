"""OpenCV camera model as a Mitsuba sensor, with distortion and an optional thin lens.

Pixel i covers [i, i+1] in Mitsuba and [i-0.5, i+0.5] in OpenCV. Only this module converts between both conventions.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera

PLUGIN = "opencv"
"""Name of the sensor in Mitsuba."""
NEWTON_STEPS = 6
"""Number of Newton steps. The convergence is quadratic, so that five steps reduce the error of a distortion of 0.1 to
less than the rounding error of float32."""


def sensor_dict(
    camera: Camera,
    *,
    distortion: tuple[float, float, float, float, float],
    aperture_mm: float = 0.0,
    focus_mm: float = 400.0,
    samples: int = 16,
) -> dict[str, Any]:
    """Return the Mitsuba description of a camera.

    Parameters
    ----------
    camera : Camera
        Camera with image size, focal lengths and principal point. Its ``distortion`` is not used.
    distortion : tuple
        Coefficients k1, k2, p1, p2, k3 of the OpenCV model.
    aperture_mm, focus_mm : float
        Diameter of the lens aperture, mm (0 for a pinhole), and depth of the plane in focus, mm.
    samples : int
        Number of samples per pixel for Mitsuba's own integrators.

    Returns
    -------
    dict
        Description for `mi.load_dict`.
    """
    register()
    width, height = camera.image_wh
    description: dict[str, Any] = {
        "type": PLUGIN,
        "telecentric": camera.kind == "telecentric",
        "mm_per_px": camera.mm_per_px,
        "fx": camera.focal_px[0],
        "fy": camera.focal_px[1],
        "cx": camera.principal_px[0],
        "cy": camera.principal_px[1],
        "aperture_radius": aperture_mm / 2.0,
        "focus": focus_mm,
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "luminance",
            "component_format": "float32",
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }
    return description | dict(zip(("k1", "k2", "p1", "p2", "k3"), distortion, strict=True))


def set_pose(sensor: Any, cam_from_canister: frames.Array) -> None:
    """Set the pose of a sensor to ``cam_from_canister`` (4x4, mm, OpenCV axes).

    The kernel is not recompiled if the pose changes.
    """
    sensor.set_pose(frames.invert(cam_from_canister))


def register() -> None:
    """Register the sensor with Mitsuba's current variant. Repeated calls have no effect."""
    _register_for(mi.variant())


def undistort(xd: Any, yd: Any, k: tuple[Any, Any, Any, Any, Any]) -> tuple[Any, Any]:
    """Invert OpenCV's lens distortion.

    Newton's method is applied to both normalised coordinates together.

    Parameters
    ----------
    xd, yd : mi.Float
        Distorted normalised coordinates.
    k : tuple of mi.Float
        Distortion coefficients k1, k2, p1, p2, k3.

    Returns
    -------
    mi.Float, mi.Float
        Undistorted normalised coordinates.
    """
    k1, k2, p1, p2, k3 = k
    x, y = mi.Float(xd), mi.Float(yd)
    for _ in range(NEWTON_STEPS):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2)  # d radial / d r2
        fx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - xd
        fy = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - yd
        jxx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
        jxy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        jyy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
        det = jxx * jyy - jxy * jxy
        x -= (jyy * fx - jxy * fy) / det
        y -= (jxx * fy - jxy * fx) / det
    return x, y


def _telecentric_ray(sensor: Any, x_px: mi.Float, y_px: mi.Float, sample3: Any) -> tuple[mi.Point3f, mi.Vector3f]:
    """Return the origin and direction of a ray of a telecentric camera.

    The position of the pixel is relative to the principal point.
    """
    right, down, forward = sensor.rotation
    origin = sensor.centre + right * (x_px * sensor.mm_per_px) + down * (y_px * sensor.mm_per_px)
    if sensor.aperture_radius == 0.0:
        return origin, mi.Vector3f(forward)
    # a cone about the parallel chief ray, with its apex in the plane in focus
    on_lens = sensor.aperture_radius * mi.warp.square_to_uniform_disk_concentric(sample3)
    beside = right * on_lens.x + down * on_lens.y
    return origin + beside, dr.normalize(forward * sensor.focus - beside)


def _perspective_ray(sensor: Any, x_px: mi.Float, y_px: mi.Float, sample3: Any) -> tuple[mi.Point3f, mi.Vector3f]:
    """Return the origin and direction of a ray of a perspective camera.

    The position of the pixel is relative to the principal point.
    """
    lens = sensor.lens
    right, down, forward = sensor.rotation
    x, y = x_px / lens["fx"], y_px / lens["fy"]
    if sensor.distorted:
        x, y = undistort(x, y, (lens["k1"], lens["k2"], lens["p1"], lens["p2"], lens["k3"]))
    if sensor.aperture_radius == 0.0:
        return mi.Point3f(sensor.centre), dr.normalize(right * x + down * y + forward)
    on_lens = sensor.aperture_radius * mi.warp.square_to_uniform_disk_concentric(sample3)
    origin = sensor.centre + right * on_lens.x + down * on_lens.y
    aimed = right * (x * sensor.focus - on_lens.x) + down * (y * sensor.focus - on_lens.y) + forward * sensor.focus
    return origin, dr.normalize(aimed)


@cache
def _register_for(variant: str) -> None:
    class OpenCVSensor(mi.Sensor):
        """Telecentric, pinhole or thin-lens camera.

        The pinhole and the thin lens have OpenCV distortion. The camera axes are +z forward, +x right and +y down in
        the image.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.lens = {key: mi.Float(float(props[key])) for key in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")}
            self.distorted = any(float(props[key]) != 0.0 for key in ("k1", "k2", "p1", "p2", "k3"))
            self.telecentric = bool(props["telecentric"])
            self.mm_per_px = mi.Float(float(props["mm_per_px"]))
            self.aperture_radius = float(props["aperture_radius"])
            self.focus = mi.Float(float(props["focus"]))
            self.m_needs_sample_3 = self.aperture_radius > 0.0
            self.rotation = [mi.Vector3f(0.0) for _ in range(3)]
            self.centre = mi.Point3f(0.0)
            dr.make_opaque(self.lens, self.mm_per_px, self.focus)
            self.set_pose(np.eye(4))

        def set_pose(self, world_from_cam: frames.Array) -> None:
            columns = [mi.Vector3f(*(float(v) for v in world_from_cam[:3, i])) for i in range(3)]
            centre = mi.Point3f(*(float(v) for v in world_from_cam[:3, 3]))
            dr.make_opaque(columns, centre)
            self.rotation, self.centre = columns, centre

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> tuple[mi.Ray3f, mi.Spectrum]:
            del sample1, active
            width, height = self.film().size()
            beside = sample2.x * width - 0.5 - self.lens["cx"], sample2.y * height - 0.5 - self.lens["cy"]
            ray = dr.zeros(mi.Ray3f)
            ray.maxt = dr.largest(mi.Float)
            ray.time = time
            ray.o, ray.d = (_telecentric_ray if self.telecentric else _perspective_ray)(self, *beside, sample3)
            return ray, mi.Spectrum(1.0)

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

    del variant
    mi.register_sensor(PLUGIN, OpenCVSensor)
