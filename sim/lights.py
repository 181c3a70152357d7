"""Backlight panel and front light.

They are area emitters that are fixed in the rig while the canister rotates.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Lights, Scene
from rhizotwin.sim import strip
from rhizotwin.sim.textures import bitmap
from rhizotwin.sim.world import TrueCamera, World


def lights(scene: Scene, world: World) -> dict[str, Any]:
    """Return the two lights as Mitsuba objects.

    Their positions are correct if the canister frame coincides with the rig frame. `place` moves them in each view. The
    radiance of the panel is ``backlight_level``, as a fraction of full scale.
    """
    level = scene.lights.backlight_level
    radiance: Any = level
    if world.backlight is not None:
        radiance = bitmap((level * world.backlight).astype(np.float32), wrap="clamp")
    return {
        "panel": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(rig_from_panel(scene.lights)),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": radiance},
        },
        "front": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(rig_from_front(scene.lights)),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": front_radiance(scene)},
        },
    }


def place(scene: mi.Scene, lights: Lights, camera: TrueCamera) -> None:
    """Move the panel and the front light to their positions in the canister frame of a view.

    Parameters
    ----------
    scene : mi.Scene
        Mitsuba scene created by `sim.optics.build` with lamps.
    lights : Lights
        Lights with their positions in the rig.
    camera : TrueCamera
        True camera with the pose of the canister in this view.
    """
    canister_from_rig = frames.invert(camera.rig_from_canister)
    parameters = mi.traverse(scene)
    parameters["panel.to_world"] = mi.Transform4f(canister_from_rig @ rig_from_panel(lights))
    parameters["front.to_world"] = mi.Transform4f(canister_from_rig @ rig_from_front(lights))
    parameters.update()


class Lamps:
    """Analytic model of the two lights for `sim.backlit`.

    The lights can be moved without rebuilding the scene.

    Parameters
    ----------
    scene, world : Scene, World
        Nominal rig, and its drawn disturbances.
    """

    SAMPLES = 2
    """Number of points at which each light is sampled to compute the irradiance."""

    def __init__(self, scene: Scene, world: World) -> None:
        level = scene.lights.backlight_level
        self.rig_from_lamp = (rig_from_panel(scene.lights), rig_from_front(scene.lights))
        self.levels = [level, front_radiance(scene)]
        self.side_level = scene.lights.side_level * world.n_water**2  # radiance in water, which decreases again in air
        self.side = mi.Vector3f(0.0)  # unit vector in the canister frame from the side light at the right to that at the left
        self.picture = None
        if world.backlight is not None:
            self.picture = mi.load_dict(bitmap((level * world.backlight).astype(np.float32), wrap="clamp"))
        dr.make_opaque(self.levels)
        self.lamp_from_canister: list[Any] = []
        self.canister_from_lamp: list[Any] = []

    def place(self, camera: TrueCamera) -> None:
        """Move the lights to their positions in the canister frame of a view."""
        to_canister = [frames.invert(camera.rig_from_canister) @ rig_from_lamp for rig_from_lamp in self.rig_from_lamp]
        self.canister_from_lamp = [mi.Matrix4f(matrix) for matrix in to_canister]
        self.lamp_from_canister = [mi.Matrix4f(np.linalg.inv(matrix)) for matrix in to_canister]
        self.side = mi.Vector3f(frames.invert(camera.rig_from_canister)[:3, 1].tolist())
        dr.make_opaque(self.canister_from_lamp, self.lamp_from_canister, self.side)

    def meet(self, ray: Any, t: Any) -> tuple[Any, Any]:
        """Return which light a ray meets before the distance ``t``, and its radiance.

        The light is 1 for the panel, 2 for the front light and 0 if the ray meets neither. The rear sides of the lights
        are black.
        """
        lamp, glow = mi.UInt32(0), mi.Spectrum(0.0)
        for number, to_lamp in enumerate(self.lamp_from_canister):
            o, d = _multiply(to_lamp, ray.o, 1.0), _multiply(to_lamp, ray.d, 0.0)
            t_lamp = -o.z / d.z
            at = mi.Point2f(o.x + t_lamp * d.x, o.y + t_lamp * d.y)
            met = (t_lamp > 0.0) & (t_lamp < t) & (dr.abs(at.x) <= 1.0) & (dr.abs(at.y) <= 1.0)
            lamp[met] = number + 1
            glow[met] = dr.select(d.z < 0.0, self._radiance(number, at, met), 0.0)
            t = dr.select(met, t_lamp, t)
        return lamp, glow

    def irradiance(self, p: Any, n: Any) -> Any:
        """Return the irradiance at points with given normals.

        Shadows are not taken into account.
        """
        total = mi.Spectrum(0.0)
        for number, to_canister in enumerate(self.canister_from_lamp):
            across, up = (mi.Vector3f(*(to_canister[row, column] for row in range(3))) for column in (0, 1))
            area = dr.cross(across, up)  # a quarter of the rectangle's area, along its normal
            for k in range(self.SAMPLES):
                at = mi.Point2f(2.0 * (k + 0.5) / self.SAMPLES - 1.0, 2.0 * ((0.5 + (k + (1 - number) * self.SAMPLES) * 0.618) % 1.0) - 1.0)
                towards = _multiply(to_canister, mi.Point3f(at.x, at.y, 0.0), 1.0) - p
                distance2 = dr.squared_norm(towards)
                facing = dr.maximum(-dr.dot(towards, area), 0.0) * dr.maximum(dr.dot(towards, n), 0.0)
                total += self._radiance(number, at, mi.Bool(True)) * 4.0 * facing / (distance2 * distance2 * self.SAMPLES)
        return total

    def _radiance(self, number: int, at: Any, active: Any) -> Any:
        if number == 1 or self.picture is None:
            return mi.Spectrum(self.levels[number])
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv = mi.Point2f(0.5 + 0.5 * at.x, 0.5 + 0.5 * at.y)
        return self.picture.eval(si, active)


def _multiply(matrix: Any, v: Any, w: float) -> Any:
    """Multiply a 4x4 matrix with the vector (v, w), and return the first three components of the product."""
    return mi.Vector3f(*(matrix[row, 0] * v.x + matrix[row, 1] * v.y + matrix[row, 2] * v.z + matrix[row, 3] * w for row in range(3)))


def rig_from_panel(lights: Lights) -> NDArray[np.float64]:
    """Return the 4x4 transform, mm, from the square [-1, 1]^2 (normal +z) to the backlight panel.

    The panel faces +x.
    """
    width_mm, height_mm = lights.backlight_wh_mm
    matrix = np.eye(4)
    matrix[:3, 0] = [0.0, width_mm / 2.0, 0.0]
    matrix[:3, 1] = [0.0, 0.0, height_mm / 2.0]
    matrix[:3, 2] = [1.0, 0.0, 0.0]
    matrix[:3, 3] = [-lights.backlight_distance_mm, 0.0, lights.backlight_z_mm]
    return matrix


def rig_from_front(lights: Lights) -> NDArray[np.float64]:
    """Return the 4x4 transform, mm, from the square [-1, 1]^2 (normal +z) to the front light.

    The front light faces the centre of the canister's rim.
    """
    width_mm, height_mm = lights.front_wh_mm
    at = np.array([lights.front_xz_mm[0], 0.0, lights.front_xz_mm[1]])
    normal = -at / np.linalg.norm(at)
    across = np.array([0.0, 1.0, 0.0])
    matrix = np.eye(4)
    matrix[:3, 0] = across * width_mm / 2.0
    matrix[:3, 1] = np.cross(normal, across) * height_mm / 2.0
    matrix[:3, 2] = normal
    matrix[:3, 3] = at
    return matrix


def front_radiance(scene: Scene) -> float:
    """Return the radiance of the front light.

    It is chosen so that the strip's white paper has the level ``front_level`` in the picture where it faces the camera.
    The radiance of paper with reflectance rho is ``rho / pi * E``, where E is the integral of ``L cos cos' / d^2`` over
    the light (midpoint rule).
    """
    middle_mm = scene.strip.bottom_mm + ((scene.strip.rows - 1) * scene.strip.row_pitch_mm + scene.strip.marker_mm) / 2.0
    paper = np.array([scene.net_pot.outer_radius_mm, 0.0, middle_mm])
    map_ = rig_from_front(scene.lights)
    grid = (np.arange(32) + 0.5) / 16.0 - 1.0
    u, v = (a.ravel() for a in np.meshgrid(grid, grid))
    points = frames.apply(map_, np.stack([u, v, np.zeros_like(u)], axis=1))
    towards = points - paper
    distance = np.linalg.norm(towards, axis=1)
    cosines = (towards[:, 0] / distance) * (-(towards @ map_[:3, 2]) / distance)
    area = 4.0 * np.linalg.norm(map_[:3, 0]) * np.linalg.norm(map_[:3, 1])
    per_radiance = float(np.mean(np.clip(cosines, 0.0, None) / distance**2) * area)
    return scene.lights.front_level * np.pi / (strip.PAPER * max(per_radiance, 1e-6))
