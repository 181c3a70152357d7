"""The rig as a Mitsuba scene, in the canister's frame and in millimetres: one surface for every optical interface.

The canister stands still; camera and lights move round it, so that turning the table rebuilds nothing but three rectangles.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenes import frames
from scenes.model import Lights, Scene
from sim import dirt, strip
from sim.specimen import SpecimenSolid
from sim.world import TrueCamera, World

SPECIMEN = "specimen"
ROOT_REFLECTANCE = 0.35
FELT_REFLECTANCE = 0.02
FLOOR_REFLECTANCE = 0.10
ALGAE_GAP_MM = 0.05
TURBID_ALBEDO = 0.7
TURBID_FORWARD = 0.9


def build(scene: Scene, world: World, solid: SpecimenSolid | None) -> mi.Scene:
    """Return the Mitsuba scene of a world, without a sensor; `place_lights` puts its lights where a view has them.

    Parameters
    ----------
    scene, world
        The nominal rig and its drawn disturbances.
    solid : SpecimenSolid or None
        Closed surface in the canister's frame, mm; None for an empty canister.
    """
    water = _water_medium(scene)
    items: dict[str, Any] = {"type": "scene"}
    items |= _canister(scene, world.n_water, water)
    items |= _net_pot(scene, world)
    items |= _lights(scene, world)
    if world.algae:
        items["algae"] = _algae(scene, world)
    for number, bubble in enumerate(world.bubbles):
        items[f"bubble_{number}"] = _bubble(bubble, world.n_water, water)
    if world.fibres:
        items["fibres"] = _mesh("fibres", *_tubes(world.fibres), _diffuse(FELT_REFLECTANCE))
    if solid is not None:
        items[SPECIMEN] = _specimen(solid, scene.disturbances.root_mu_per_mm, water)
    return mi.load_dict(items)


def place_lights(scene: mi.Scene, lights: Lights, camera: TrueCamera) -> None:
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


def _canister(scene: Scene, n_water: float, water: Any) -> dict[str, Any]:
    can, level = scene.canister, scene.water.level_mm
    inside = {"interior": water} if water is not None else {}
    parts: dict[str, Any] = {
        "outer_wall": _cylinder(can.outer_radius_mm, can.floor_z_mm, 0.0, _dielectric(can.n_wall, 1.0)),
        "inner_wall": _cylinder(can.inner_radius_mm, can.floor_z_mm, level, _dielectric(n_water, can.n_wall)) | inside,
        "water_surface": _disk(can.inner_radius_mm, level, _dielectric(n_water, 1.0)) | inside,
        "floor": _disk(can.outer_radius_mm, can.floor_z_mm, _diffuse(FLOOR_REFLECTANCE)),
        "base_side": _cylinder(can.outer_radius_mm, -can.height_mm, can.floor_z_mm, _diffuse(FLOOR_REFLECTANCE)),
        "base_bottom": _disk(can.outer_radius_mm, -can.height_mm, _diffuse(FLOOR_REFLECTANCE)),
        "rim": _disk(can.outer_radius_mm, 0.0, _diffuse(FELT_REFLECTANCE)),
        "grid": _disk(can.inner_radius_mm, scene.net_pot.grid_z_mm, _diffuse(FELT_REFLECTANCE)),
    }
    if level < 0.0:
        parts["dry_wall"] = _cylinder(can.inner_radius_mm, level, 0.0, _dielectric(1.0, can.n_wall))
    return parts


def _net_pot(scene: Scene, world: World) -> dict[str, Any]:
    pot = scene.net_pot
    seat = world.canister_from_strip
    paper = {"type": "diffuse", "reflectance": _bitmap(strip.strip_picture(scene.strip, pot))}
    sided = {"type": "twosided", "outside": paper, "inside": _diffuse(FELT_REFLECTANCE)}
    return {
        "strip": _cylinder(pot.outer_radius_mm, pot.skirt_bottom_mm, pot.top_mm, sided, seat),
        "pot_top": _disk(pot.outer_radius_mm, pot.top_mm, _diffuse(FELT_REFLECTANCE), seat),
    }


def _lights(scene: Scene, world: World) -> dict[str, Any]:
    level = scene.lights.backlight_level
    radiance: Any = level
    if world.backlight is not None:
        radiance = _bitmap((level * world.backlight).astype(np.float32), wrap="clamp")
    return {
        "panel": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(rig_from_panel(scene.lights)),
            "bsdf": _diffuse(0.0),
            "emitter": {"type": "area", "radiance": radiance},
        },
        "front": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(rig_from_front(scene.lights)),
            "bsdf": _diffuse(0.0),
            "emitter": {"type": "area", "radiance": front_radiance(scene)},
        },
    }


def _algae(scene: Scene, world: World) -> dict[str, Any]:
    can = scene.canister
    radius_mm = can.inner_radius_mm - ALGAE_GAP_MM
    z_range_mm = (can.floor_z_mm, scene.water.level_mm)
    opacity = dirt.opacity_map(world.algae, radius_mm=radius_mm, z_range_mm=z_range_mm, mm_per_texel=0.2)
    film = {"type": "mask", "opacity": _bitmap(opacity), "film": {"type": "twosided", "bsdf": _diffuse(0.08)}}
    return _cylinder(radius_mm, *z_range_mm, film)


def _bubble(bubble: dirt.Bubble, n_water: float, water: Any) -> dict[str, Any]:
    ball = {
        "type": "sphere",
        "center": [bubble.x_mm, bubble.y_mm, bubble.z_mm],
        "radius": bubble.radius_mm,
        "bsdf": _dielectric(1.0, n_water),
    }
    return ball | ({"exterior": water} if water is not None else {})


def _specimen(solid: SpecimenSolid, mu_per_mm: float | None, water: Any) -> mi.Mesh:
    if mu_per_mm is None:
        return _mesh(SPECIMEN, solid.vertices, solid.faces, _diffuse(ROOT_REFLECTANCE))
    flesh = mi.load_dict({"type": "homogeneous", "albedo": 0.0, "sigma_t": mu_per_mm})
    return _mesh(SPECIMEN, solid.vertices, solid.faces, {"type": "null"}, interior=flesh, exterior=water)


def _mesh(name: str, vertices: NDArray[Any], faces: NDArray[Any], bsdf: dict[str, Any], *, interior: Any = None, exterior: Any = None) -> mi.Mesh:
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    if interior is not None:
        props["interior"] = interior
    if exterior is not None:
        props["exterior"] = exterior
    mesh = mi.Mesh(name, vertex_count=len(vertices), face_count=len(faces), props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
    parameters.update()
    mesh.set_id(name)
    return mesh


def _tubes(fibres: tuple[dirt.Fibre, ...], *, sides: int = 6) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices and faces of open tubes round the fibres' centrelines."""
    vertices, faces, start = [], [], 0
    turn = np.arange(sides) * 2.0 * np.pi / sides
    for fibre in fibres:
        count = len(fibre.points_mm)
        tangent = np.gradient(fibre.points_mm, axis=0)
        across = np.cross(tangent, [1.0, 0.0, 0.0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        other = np.cross(tangent, across)
        other /= np.maximum(np.linalg.norm(other, axis=1, keepdims=True), 1e-9)
        ring = np.cos(turn)[None, :, None] * across[:, None] + np.sin(turn)[None, :, None] * other[:, None]
        vertices.append((fibre.points_mm[:, None] + fibre.radius_mm * ring).reshape(-1, 3))
        i, j = (a.ravel() for a in np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij"))
        a, b = start + i * sides + j, start + i * sides + (j + 1) % sides
        faces += [np.stack([a, b, b + sides], axis=1), np.stack([a, b + sides, a + sides], axis=1)]
        start += count * sides
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def _water_medium(scene: Scene) -> Any:
    sigma_t = scene.disturbances.turbidity_per_mm
    if sigma_t == 0.0:
        return None
    phase = {"type": "hg", "g": TURBID_FORWARD}
    return mi.load_dict({"type": "homogeneous", "albedo": TURBID_ALBEDO, "sigma_t": sigma_t, "phase": phase})


def _cylinder(radius_mm: float, low_mm: float, high_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    to_world = (np.eye(4) if seat is None else seat) @ frames.translation(0.0, 0.0, low_mm) @ np.diag([radius_mm, radius_mm, high_mm - low_mm, 1.0])
    return {"type": "cylinder", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def _disk(radius_mm: float, z_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    to_world = (np.eye(4) if seat is None else seat) @ frames.translation(0.0, 0.0, z_mm) @ np.diag([radius_mm, radius_mm, 1.0, 1.0])
    return {"type": "disk", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def _dielectric(n_inside: float, n_outside: float) -> dict[str, Any]:
    """Return a smooth interface; ``n_outside`` is on the side that the surface's normal points to."""
    return {"type": "dielectric", "int_ior": n_inside, "ext_ior": n_outside}


def _diffuse(reflectance: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}


def _bitmap(picture: NDArray[np.float32], *, wrap: str = "repeat") -> dict[str, Any]:
    """Return a texture whose row 0 is at the top of a cylinder or rectangle (v = 1), column 0 at u = 0."""
    upside_down = np.ascontiguousarray(picture[::-1, :, None])
    return {"type": "bitmap", "bitmap": mi.Bitmap(upside_down), "raw": True, "filter_type": "bilinear", "wrap_mode": wrap}
