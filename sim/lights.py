"""Backlight panel and front light: area emitters that stand in the rig while the canister turns."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Lights, Scene
from rhizotwin.sim import strip
from rhizotwin.sim.textures import bitmap
from rhizotwin.sim.world import TrueCamera, World


def lights(scene: Scene, world: World) -> dict[str, Any]:
    """Return the two lights of a scene, for canister and rig in line; a panel seen directly has the radiance ``backlight_level``."""
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
    """Move panel and front light to where they stand as seen from the canister of this view."""
    canister_from_rig = frames.invert(camera.rig_from_canister)
    parameters = mi.traverse(scene)
    parameters["panel.to_world"] = mi.Transform4f(canister_from_rig @ rig_from_panel(lights))
    parameters["front.to_world"] = mi.Transform4f(canister_from_rig @ rig_from_front(lights))
    parameters.update()


def rig_from_panel(lights: Lights) -> NDArray[np.float64]:
    """Return the 4x4 map of the square [-1, 1]^2 (normal +z) onto the backlight panel, which faces +x."""
    width_mm, height_mm = lights.backlight_wh_mm
    matrix = np.eye(4)
    matrix[:3, 0] = [0.0, width_mm / 2.0, 0.0]
    matrix[:3, 1] = [0.0, 0.0, height_mm / 2.0]
    matrix[:3, 2] = [1.0, 0.0, 0.0]
    matrix[:3, 3] = [-lights.backlight_distance_mm, 0.0, lights.backlight_z_mm]
    return matrix


def rig_from_front(lights: Lights) -> NDArray[np.float64]:
    """Return the 4x4 map of the square [-1, 1]^2 (normal +z) onto the front light, which faces the rim's centre."""
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
    """Return the radiance of the front light that brings white paper on the strip, facing the camera, to ``front_level``.

    Paper of reflectance rho sends out ``rho / pi * E``; E is the integral of ``L cos cos' / d^2`` over the light (by midpoints).
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
