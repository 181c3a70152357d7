"""Twin of a result: the reconstructed shape in the calibrated rig, seen through ray-traced walls and water.

The light paths are those of `sim`, so that an error in the closed-form optics of `recon` cannot hide here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rhizotwin.recon.calibration.cameras import Camera
from rhizotwin.recon.coverage.silhouettes import Image
from rhizotwin.recon.results.result import Result
from rhizotwin.scenes import frames
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.sim import sensor, tank
from rhizotwin.sim.render import Renderer
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.world import TrueCamera, World, draw_world

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RING = Ring(views=1)
"""Ring of the capture plan of the twin, whose cameras are those of the result."""
_WALL = "outer_wall"
"""Name of the canister's outer wall in the twin."""


@dataclass(frozen=True)
class Rays:
    """Lines of sight of some pixels in the water, canister frame."""

    origin_mm: Array
    """(N, 3) points on the rays, mm."""
    direction: Array
    """(N, 3) unit vectors, away from the camera."""
    known: Mask
    """(N,) whether a ray passes through the water around the roots."""

    def offset_mm(self, points_mm: Array) -> Array:
        """Return the vectors (N, 3) from points to their nearest points on the rays, mm."""
        apart = self.origin_mm - points_mm
        return np.asarray(apart - np.sum(apart * self.direction, axis=1)[:, None] * self.direction)


@dataclass(frozen=True, eq=False)
class Surface:
    """Points of the roots in a picture."""

    px: NDArray[np.int64]
    """(N, 2) pixels around all roots."""
    points_mm: Array
    """(N, 3) points of the roots on the central lines of sight of these pixels, mm. Some pixels show no root."""
    nearest: NDArray[np.int64]
    """(H, W) index of the nearest pixel whose central line of sight meets a root, or -1 if there is none."""
    distance_px: Array
    """(H, W) distance to this pixel, px."""

    def at(self, px: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
        """Return the nearest pixels (M, 2) with a root, and its points (M, 3), mm, for some pixels (M, 2)."""
        chosen = self.nearest[px[:, 1], px[:, 0]]
        return self.px[chosen], self.points_mm[chosen]


def true_camera(camera: Camera, scene: Scene) -> TrueCamera:
    """Return the camera of a result as a camera of the twin.

    The rig's x axis points to the camera, or is that of the tank. A telecentric camera, which results describe as a
    distant pinhole camera, is moved along its optical axis to the distance of the ring.
    """
    pose = camera.cam_from_canister
    if pose is None:
        raise ValueError(f"{camera.file} has no camera pose")
    if camera.cam_from_tank is None:
        x, y, _ = frames.invert(pose)[:3, 3]
        rig_from_canister = frames.rotation_z(-float(np.arctan2(y, x)))
    else:
        rig_from_canister = frames.invert(camera.cam_from_tank) @ pose
    cam_from_rig = pose @ frames.invert(rig_from_canister)
    if scene.camera.kind == "telecentric":
        cam_from_rig[2, 3] = _RING.distance_mm
    return TrueCamera(cam_from_rig=cam_from_rig, rig_from_canister=rig_from_canister, table_deg=0.0)


class Synthesis:
    """Twin that renders a result.

    Parameters
    ----------
    result : Result
        Result with the calibrated rig and the shape.
    scene : Scene
        Scene of the dataset.
    n_water_error, wall_error_mm : float
        Changes of the refractive index of the water and of the thickness of the wall.
    """

    def __init__(self, result: Result, scene: Scene, *, n_water_error: float = 0.0, wall_error_mm: float = 0.0) -> None:
        self.scene, self.world = _build_world(result, scene, n_water_error, wall_error_mm)
        mesh = result.solid.surface
        solid = SpecimenSolid(vertices=mesh.vertices_mm, faces=mesh.faces.astype(np.int32), volume_mm3=result.volume_mm3)
        # lines of sight are traced up to opaque roots, because they continue behind translucent ones
        self.roots = Renderer(replace(self.scene, disturbances=Disturbances()), self.world, solid)
        self.translucent = None if result.solid.mu_per_mm is None else Renderer(self.scene, self.world, solid)

    @cached_property
    def empty(self) -> Renderer:
        """Renderer of the canister without roots, whose coverage is that by the outer wall."""
        renderer = Renderer(self.scene, self.world, None)
        renderer.targets = [_WALL]
        return renderer

    def opacity(self, camera: TrueCamera) -> Image:
        """Render the opacity of the roots (H, W), which is 0 for the empty backlight and 1 for an opaque root."""
        if self.translucent is None:
            return self.roots.look(camera, ring=0)[1]
        light, _ = self.translucent.look(camera, ring=0)
        empty, _ = self.empty.look(camera, ring=0)
        return np.clip(1.0 - light / np.maximum(empty, np.float32(1e-6)), 0.0, 1.0).astype(np.float32)

    def canister(self, camera: TrueCamera) -> tuple[Image, Image]:
        """Render the light (H, W) of the canister without roots, and the coverage (H, W) by its outer wall."""
        return self.empty.look(camera, ring=0)

    def rays(self, camera: TrueCamera, px: NDArray[Any]) -> Rays:
        """Trace the lines of sight of pixels (N, 2) into the water."""
        if not len(px):
            return Rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool))
        renderer = self.roots
        wh = np.array(self.roots.image_wh)
        eye = renderer.sensors[0]
        backlit = renderer.backlit
        sensor.set_pose(eye, camera.cam_from_canister)
        renderer.lamps.place(camera)
        tank.place(backlit.scene, self.scene, camera.rig_from_canister, radius_mm=self.world.canister.outer_radius_mm)
        u, v = (mi.Float(at.astype(np.float32)) for at in ((px + 0.5) / wh).T)
        primary, _ = eye.sample_ray(0.0, 0.0, mi.Point2f(u, v), mi.Point2f(0.5))
        way = backlit.follow(primary)
        dr.eval(way.start, way.heading, way.spans)
        start, heading = (np.array(part, np.float64).T for part in (way.start, way.heading))
        return Rays(start, heading, np.array(way.spans) == 1)

    def mm_per_px(self, camera: TrueCamera, px: Array) -> float:
        """Return the scale of a picture on the canister's axis, mm per pixel, at a pixel (2,)."""
        rays = self.rays(camera, px + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        if not rays.known.all():
            return math.nan
        start, along = rays.origin_mm[:1], rays.direction[:1]
        near_axis = start - along * np.sum(start[:, :2] * along[:, :2]) / np.sum(along[:, :2] ** 2)
        aside, down = rays.offset_mm(near_axis)[1:]
        return float(np.linalg.norm(np.cross(aside, down)) ** 0.5)

    def surface(self, camera: TrueCamera, rendered: Image) -> Surface:
        """Find the points of the roots that each pixel of a rendered opacity (H, W) shows."""
        around = np.argwhere(ndimage.binary_dilation(rendered > 0.0))[:, ::-1]
        rays = self.rays(camera, around.astype(np.float64))
        number = np.full(rendered.shape, -1)
        if self.roots.fine is None or not len(around):
            return Surface(around, np.zeros((0, 3)), number, np.full(rendered.shape, np.inf))
        origin, direction = (part.T.astype(np.float32) for part in (rays.origin_mm, rays.direction))
        met = self.roots.fine.ray_intersect(mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction)))
        there = np.array(met.is_valid()) & rays.known
        number[around[there, 1], around[there, 0]] = np.flatnonzero(there)
        if not there.any():
            return Surface(around, np.zeros((0, 3)), number, np.full(rendered.shape, np.inf))
        distance, nearest = ndimage.distance_transform_edt(number < 0, return_indices=True)
        points = rays.origin_mm + np.where(there, np.array(met.t, np.float64), 0.0)[:, None] * rays.direction
        return Surface(around, points, number[tuple(nearest)], distance)


def calibrated_camera(result: Result, scene: Scene) -> Any:
    """Return the camera of a scene with the scale and the focus that the reconstruction estimated."""
    given = scene.camera
    return replace(given, mm_per_px=result.rig.get("mm_per_px") or given.mm_per_px).focused(result.rig.get("focal_scale") or 1.0)


def _build_world(result: Result, scene: Scene, n_water_error: float, wall_error_mm: float) -> tuple[Scene, World]:
    """Return the calibrated rig as a scene, and as a world without disturbances."""
    rig, can = result.rig, scene.canister
    twin = replace(
        scene,
        camera=calibrated_camera(result, scene),
        canister=replace(can, wall_mm=can.wall_mm + wall_error_mm),
        plan=CapturePlan(rings=(_RING,)),
        tank=None if scene.tank is None else replace(scene.tank, turn_deg=0.0),  # the pose of the tank includes it
        plants=(),
        shoot=None,
        disturbances=Disturbances(root_mu_per_mm=result.solid.mu_per_mm),
    )
    world = draw_world(twin, seed=0)
    n_water = world.n_water if rig.get("n_water") is None else float(rig["n_water"]) * scene.surroundings.n
    seat = rig.get("canister_from_strip")
    seat = world.canister_from_strip if seat is None else np.array(seat, np.float64)
    return twin, replace(world, n_water=n_water + n_water_error, canister_from_strip=seat)
