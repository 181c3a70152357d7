"""The rig as a Mitsuba scene, in the canister's frame and in millimetres: one surface for every optical interface.

The canister stands still; camera and lights move round it, so that turning the table rebuilds nothing but two rectangles.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from rhizotwin.sim import dirt, lights, strip
from rhizotwin.sim.backlit import Room
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.textures import bitmap
from rhizotwin.sim.world import World

SPECIMEN = "specimen"
STRIP = "strip"
ROOT_REFLECTANCE = 0.35
FELT_REFLECTANCE = 0.02
FLOOR_REFLECTANCE = 0.10
ALGAE_GAP_MM = 0.05
TURBID_ALBEDO = 0.7
TURBID_FORWARD = 0.9


def build(scene: Scene, world: World, solid: SpecimenSolid | None, *, lamps: bool = True) -> mi.Scene:
    """Return the Mitsuba scene of a world, without a sensor.

    Parameters
    ----------
    scene, world
        The nominal rig and its drawn disturbances.
    solid : SpecimenSolid or None
        Closed surface in the canister's frame, mm; None for an empty canister.
    lamps : bool
        With the two lights, which `sim.lights.place` puts where a view has them; without them it is the same scene for all views.
    """
    water = _water_medium(scene)
    items: dict[str, Any] = {"type": "scene"}
    items |= _canister(scene, world.n_water, water)
    items |= _net_pot(scene, world)
    if lamps:
        items |= lights.lights(scene, world)
    if world.algae:
        items["algae"] = _algae(scene, world)
    for number, bubble in enumerate(world.bubbles):
        items[f"bubble_{number}"] = _bubble(bubble, world.n_water, water)
    if world.fibres:
        items["fibres"] = _mesh("fibres", *_tubes(world.fibres), _diffuse(FELT_REFLECTANCE))
    if solid is not None:
        items[SPECIMEN] = _specimen(solid, scene.disturbances.root_mu_per_mm, water)
    return _load_quietly(items)


def fine_things(world: World, solid: SpecimenSolid | None, *, slack_mm: float) -> mi.Scene | None:
    """Return all that can hide between the corners of a pixel, or None where there is nothing: specimen, fibres and bubbles.

    Parameters
    ----------
    world, solid
        As for `build`.
    slack_mm : float
        Fibres and bubbles are this much larger than they are, so that rays at this distance from each other cannot miss one.
    """
    items: dict[str, Any] = {"type": "scene"}
    for number, bubble in enumerate(world.bubbles):
        items[f"bubble_{number}"] = _bubble(replace(bubble, radius_mm=bubble.radius_mm + slack_mm), 1.0, None)
    if world.fibres:
        thick = tuple(replace(fibre, radius_mm=fibre.radius_mm + slack_mm) for fibre in world.fibres)
        items["fibres"] = _mesh("fibres", *_tubes(thick), _diffuse(FELT_REFLECTANCE))
    if solid is not None:
        items[SPECIMEN] = _specimen(solid, None, None)
    return _load_quietly(items) if len(items) > 1 else None


def room_of(scene: Scene, world: World, solid: SpecimenSolid | None, *, margin_mm: float) -> Room:
    """Return the room in the canister that holds the fine things and a margin round them, as far as the canister reaches."""
    points = [fibre.points_mm for fibre in world.fibres] + ([solid.vertices] if solid is not None else [])
    points += [
        np.array([[bubble.x_mm, bubble.y_mm, bubble.z_mm + side]])
        for bubble in world.bubbles
        for side in (-bubble.radius_mm, bubble.radius_mm)
    ]
    at = np.concatenate(points)
    inner_mm = scene.canister.inner_radius_mm
    reach_mm = inner_mm if world.bubbles else float(np.hypot(at[:, 0], at[:, 1]).max()) + margin_mm
    return Room(min(reach_mm, inner_mm), float(at[:, 2].min()) - margin_mm, float(at[:, 2].max()) + margin_mm)


def _load_quietly(items: dict[str, Any]) -> mi.Scene:
    """Load a scene without Mitsuba's warning that a leaning cylinder is not round: it sees the rounding of single precision."""
    logger = mi.logger()
    level = logger.log_level()
    logger.set_log_level(mi.LogLevel.Error)
    try:
        return mi.load_dict(items)
    finally:
        logger.set_log_level(level)


def _canister(scene: Scene, n_water: float, water: Any) -> dict[str, Any]:
    can, level = scene.canister, scene.water.level_mm
    inside = {"interior": water} if water is not None else {}
    parts: dict[str, Any] = {
        "outer_wall": _cylinder(can.outer_radius_mm, can.floor_z_mm, 0.0, _dielectric(can.n_wall, scene.surroundings.n)),
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
    paper = {"type": "diffuse", "reflectance": bitmap(strip.strip_picture(scene.strip, pot))}
    sided = {"type": "twosided", "outside": paper, "inside": _diffuse(FELT_REFLECTANCE)}
    return {
        STRIP: _cylinder(pot.outer_radius_mm, pot.skirt_bottom_mm, pot.top_mm, sided, seat),
        "pot_top": _disk(pot.outer_radius_mm, pot.top_mm, _diffuse(FELT_REFLECTANCE), seat),
    }


def _algae(scene: Scene, world: World) -> dict[str, Any]:
    can = scene.canister
    radius_mm = can.inner_radius_mm - ALGAE_GAP_MM
    z_range_mm = (can.floor_z_mm, scene.water.level_mm)
    opacity = dirt.opacity_map(world.algae, radius_mm=radius_mm, z_range_mm=z_range_mm, mm_per_texel=0.2)
    film = {"type": "mask", "opacity": bitmap(opacity), "film": {"type": "twosided", "bsdf": _diffuse(0.08)}}
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


def _mesh(
    name: str, vertices: NDArray[Any], faces: NDArray[Any], bsdf: dict[str, Any], *, interior: Any = None, exterior: Any = None
) -> mi.Mesh:
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
    local = frames.translation(0.0, 0.0, low_mm) @ np.diag([radius_mm, radius_mm, high_mm - low_mm, 1.0])
    to_world = local if seat is None else seat @ local
    return {"type": "cylinder", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def _disk(radius_mm: float, z_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    local = frames.translation(0.0, 0.0, z_mm) @ np.diag([radius_mm, radius_mm, 1.0, 1.0])
    to_world = local if seat is None else seat @ local
    return {"type": "disk", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def _dielectric(n_inside: float, n_outside: float) -> dict[str, Any]:
    """Return a smooth interface; ``n_outside`` is on the side that the surface's normal points to."""
    return {"type": "dielectric", "int_ior": n_inside, "ext_ior": n_outside}


def _diffuse(reflectance: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}
