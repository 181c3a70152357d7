"""Comparison of the closed-form projection with brute-force ray tracing.

Rays are refracted by the vector form of Snell's law at each wall, independently of `recon`.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.metric import Metric
from rhizotwin.recon.optics import cameras, projection, refraction
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Camera, Scene

Array = NDArray[np.float64]

RAYS = 4000
STARTS = 5
"""Number of initial rays from which the images of a point are searched, over the canister's width."""
_LENS = Camera(distortion=(-0.05, 0.02, 0.001, -0.002, 0.001))


def snell(direction: Array, normal: Array, ratio: float) -> Array:
    """Refract unit directions (N, 3) at unit normals that face the incoming rays; ratio is n_from / n_to.

    Parameters
    ----------
    direction : (N, 3) array
        Unit vectors along the rays.
    normal : (N, 3) array
        Unit normals, against the rays.
    ratio : float
        Ratio of refractive indices n_from / n_to.

    Returns
    -------
    (N, 3) array
        Refracted unit vectors; NaN for total reflection.
    """
    cosine = -np.sum(direction * normal, axis=1, keepdims=True)
    refracted: Array = ratio * direction + (ratio * cosine - np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal
    return refracted


def meet(origin: Array, direction: Array, radius_mm: float) -> Array:
    """Return the first intersections (N, 3) with a cylinder about z; NaN for a miss.

    Parameters
    ----------
    origin : (3,) or (N, 3) array
        Origins of the rays, mm.
    direction : (N, 3) array
        Unit vectors.
    radius_mm : float
        Radius of the cylinder.

    Returns
    -------
    (N, 3) array
        Points on the cylinder, mm.
    """
    a = np.sum(direction[:, :2] ** 2, axis=1)
    b = np.sum(origin[:, :2] * direction[:, :2], axis=1)
    c = np.sum(origin[:, :2] ** 2, axis=1) - radius_mm**2
    with np.errstate(invalid="ignore"):
        met: Array = origin + ((-b - np.sqrt(b * b - a * c)) / a)[:, None] * direction
    return met


def into_water(origin: Array, direction: Array, optics: refraction.Optics) -> tuple[Array, Array]:
    """Trace rays from the camera (3,) into the water: entry points and unit directions (N, 3), canister frame.

    Parameters
    ----------
    origin : (3,) array
        Centre of the camera, canister frame, mm.
    direction : (N, 3) array
        Unit vectors, canister frame.
    optics : refraction.Optics
        Canister and water.

    Returns
    -------
    (N, 3), (N, 3) arrays
        Entry points (mm) and unit directions in the water.
    """
    at = meet(np.broadcast_to(origin, direction.shape), direction, optics.outer_radius_mm)
    turned = snell(direction, at * [1, 1, 0] / optics.outer_radius_mm, 1.0 / optics.n_wall)
    at = meet(at, turned, optics.inner_radius_mm)
    return at, snell(turned, at * [1, 1, 0] / optics.inner_radius_mm, optics.n_wall / optics.n_water)


def random_view(rng: np.random.Generator, camera: Camera = _LENS) -> cameras.View:
    """Return a camera at a random height, tilt and azimuth that faces the canister."""
    tilt = rng.uniform(-12.0, 25.0)
    level = frames.level_camera(distance_mm=rng.uniform(350, 450), height_mm=-50.0 + 6.5 * tilt, tilt_deg=tilt)
    off = frames.from_rotvec(rng.normal(0.0, 0.01, 3), rng.normal(0.0, 2.0, 3))
    return cameras.View(camera=camera, cam_from_canister=off @ level @ frames.rotation_z(rng.uniform(-np.pi, np.pi)))


def points_on_rays(view: cameras.View, optics: refraction.Optics, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Return random pixels (N, 2) that show water, and on the traced ray of each a random point (N, 3) in the water.

    Parameters
    ----------
    view : cameras.View
        Camera and pose.
    optics : refraction.Optics
        Canister and water.
    rng : np.random.Generator
        Random generator of pixels and depths.
    count : int
        Number of pixels.

    Returns
    -------
    (N, 2), (N, 3) arrays
        Pixels, and the corresponding points (mm, canister frame).
    """
    width, height = view.camera.image_wh
    px = rng.uniform([0, 0], [width, height], (count, 2))
    px = px[cameras.water_lines(view, optics, px)[1]]
    directions = cameras.camera_directions(view.camera, px) @ view.cam_from_canister[:3, :3]
    entry, water = into_water(view.centre_mm, directions, optics)
    leave = -2.0 * np.sum(entry[:, :2] * water[:, :2], axis=1) / np.sum(water[:, :2] ** 2, axis=1)
    return px, entry + water * (rng.uniform(0.01, 0.99, len(entry)) * leave)[:, None]


def all_images(view: cameras.View, optics: refraction.Optics, points_mm: Array) -> tuple[Array, NDArray[np.int64]]:
    """Project points in the water into a view, and find all images of each point.

    The images are found by Newton's method from several initial rays.

    Parameters
    ----------
    view : cameras.View
        Camera and pose.
    optics : refraction.Optics
        Canister and water, without a tank.
    points_mm : (N, 3) array
        Points, canister frame.

    Returns
    -------
    px : (N, 3, 2) array
        Pixels of up to three images; NaN for missing images.
    count : (N,) int array
        Number of images; 0 where the view is blind.
    """
    points = cameras.apply_sway(view, optics, points_mm)
    straight = cameras.straight_rays(view, optics, points)
    b_mm = np.sin(np.linspace(-np.pi / 2, np.pi / 2, STARTS)) * optics.w_limit * optics.outer_radius_mm
    starts = [np.column_stack([b / view.rho_mm * np.sqrt(1.0 - straight[:, 1] ** 2), straight[:, 1]]) for b in 0.9999 * b_mm]
    q = np.stack([cameras.find_rays(view, optics, points, start)[0] for start in starts], axis=1)
    q = np.take_along_axis(q, np.argsort(q[..., :1], axis=1), axis=1)  # NaN last
    new = np.isfinite(q[..., 0])
    new[:, 1:] &= ~(np.diff(q[..., 0], axis=1) < 1e-7)
    px = np.stack([cameras.cam_pixels(view.camera, cameras.ray_directions(view, optics, part)) for part in q.transpose(1, 0, 2)], axis=1)
    px[~new] = np.nan
    first = np.argsort(~new, axis=1, kind="stable")[:, :3, None]
    px = np.take_along_axis(px, first, axis=1)
    return px, np.asarray(np.isfinite(px[..., 0]).sum(axis=1), np.int64)


def images_swept(view: cameras.View, optics: refraction.Optics, points: Array, rays: int = 40001) -> NDArray[np.int64]:
    """Count the images (N,) of points at the camera's own height.

    They are found by a dense sweep of horizontal rays over the canister's width.

    Parameters
    ----------
    view : cameras.View
        Camera and pose.
    optics : refraction.Optics
        Canister and water.
    points : (N, 3) array
        Points at the camera's height, canister frame, mm.
    rays : int
        Number of rays over the canister's width.

    Returns
    -------
    (N,) int array
        Number of images of each point.
    """
    centre = view.centre_mm
    inward = -centre[:2] / np.linalg.norm(centre[:2])
    sine = np.sin(np.linspace(-np.pi / 2, np.pi / 2, rays))[1:-1] * optics.outer_radius_mm / view.rho_mm
    cosine = np.sqrt(1 - sine**2)
    flat = [inward[0] * cosine - inward[1] * sine, inward[1] * cosine + inward[0] * sine, np.zeros_like(sine)]
    entry, water = into_water(centre, np.stack(flat, axis=1), optics)
    count = np.zeros(len(points), np.int64)
    for k, point in enumerate(points):
        side = (point[0] - entry[:, 0]) * water[:, 1] - (point[1] - entry[:, 1]) * water[:, 0]
        count[k] = (np.signbit(side[1:]) != np.signbit(side[:-1])).sum()
    return count


def measure() -> list[Metric]:
    """Return the maximum error in pixels of visible points, and the fraction of points whose visibility is wrong."""
    import drjit as dr
    import mitsuba as mi

    rng = np.random.default_rng(0)
    optics = refraction.Optics.from_scene(Scene())
    worst, lost, kernel_worst, kernel_wrong, given_away, total = 0.0, 0, 0.0, 0, 0, 0
    swept_wrong, swept = 0, 0
    for _ in range(6):
        view = random_view(rng)
        px, points = points_on_rays(view, optics, rng, RAYS)
        found, count = all_images(view, optics, points)
        error = np.linalg.norm(found - px[:, None], axis=-1)
        nearest = np.where(np.isnan(error), np.inf, error).min(axis=1)
        lost += int((nearest > 1e-3).sum())
        worst = max(worst, float(nearest[nearest < 1.0].max(initial=0.0)))
        bank = projection.ViewBank.pack([view], optics)
        kernel = projection.project(bank, dr.zeros(mi.UInt32, len(points)), mi.Point3f(points.T.astype(np.float32)), mi.Bool(True))
        seen = np.array(kernel.visible)
        kernel_worst = max(kernel_worst, float(np.abs(np.array(kernel.px).T[seen] - found[seen, 0]).max()))
        kernel_wrong += int((count[seen] != 1).sum())
        given_away += int(((count == 1) & ~seen).sum())
        total += len(points)
        # at the camera's own height a sweep counts the images independently
        level = cameras.View(
            camera=view.camera, cam_from_canister=frames.level_camera(distance_mm=view.rho_mm, height_mm=-60.0, tilt_deg=0.0)
        )
        angle, radius = rng.uniform(-np.pi, np.pi, 100), optics.inner_radius_mm * np.sqrt(rng.uniform(0.3, 0.999, 100))
        flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(100, float(level.centre_mm[2]))], axis=1)
        swept_wrong += int((all_images(level, optics, flat)[1] != images_swept(level, optics, flat)).sum())
        swept += len(flat)
    rows = [
        ("max_px", worst, "px", 1e-6),
        ("lost", lost / total, "1", 0.0),
        ("visibility_disagreement", swept_wrong / swept, "1", 0.0),
        ("kernel_max_px", kernel_worst, "px", 5e-4),
        ("kernel_seen_wrongly", kernel_wrong / total, "1", 0.0),
        ("kernel_given_away", given_away / total, "1", 0.005),
    ]
    return [Metric(key=f"projection/{name}", value=value, unit=unit, direction="down", abs_tol=tol) for name, value, unit, tol in rows]
