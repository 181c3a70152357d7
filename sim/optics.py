"""Build the rig as a Mitsuba scene.

The scene is in the canister frame in mm, with one surface for each optical interface. The canister is static while the
camera and the lights move around it, so that only the two rectangles of the lights are rebuilt for each view.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Scene
from rhizotwin.sim import dirt, lights, strip, tank
from rhizotwin.sim.backlit import Room
from rhizotwin.sim.specimen import Sleeve, SpecimenSolid
from rhizotwin.sim.textures import bitmap
from rhizotwin.sim.world import World, narrowest_mm

SPECIMEN, HAIRS, SHOOT, OUTER_DIRT = "specimen", "hairs", "shoot", "outer_dirt"
STRIP = "strip"
"""Names of shapes in the Mitsuba scene."""
ROOT_REFLECTANCE = 0.35
"""Reflectance of wet white roots. If it is increased by 0.1, roots become brighter by 0.0065 of full scale
(`sim.backlit.AMBIENT`)."""
FELT_REFLECTANCE = 0.02
"""Reflectance of black felt. Felt would be darker than all roots even if its reflectance were 0.05."""
FLOOR_REFLECTANCE = 0.10
"""Reflectance of the dark surface below the canister. Few rays meet this surface."""
ALGAE_GAP_MM = 0.05
"""Distance between the algae films and the wall, mm. It is much larger than the rounding errors of rays and much
smaller than a pixel."""
OUTER_GAP_MM = 0.05
"""Distance between the outer wall and the dirt on it, mm. It is larger than the rounding errors of rays and smaller
than a pixel."""
DIRT_TEXEL_MM = 0.1
"""Edge of a texel of the map of dust and scratches, mm. It is half the width of a pixel on the wall at 800x600
pixels."""
OVAL_SIDES = 1440
"""Number of facets of an oval wall. The facets deviate from the oval by at most 0.2 um. Their normals are exact."""
TURBID_ALBEDO = 0.7
"""Albedo of turbid water, which is the fraction of the extinction that is due to scattering. The value is assumed."""
TURBID_FORWARD = 0.9
"""Mean cosine of the scattering angle in turbid water. The value is high, because particles larger than the wavelength
scatter forward."""


def build(scene: Scene, world: World, solid: SpecimenSolid | None, hairs: Sleeve | None = None) -> mi.Scene:
    """Build the complete Mitsuba scene of a rig with its drawn disturbances, for Mitsuba's integrators.

    It contains no sensor. The two lights are moved by `sim.lights.place`.

    Parameters
    ----------
    scene, world : Scene, World
        Nominal rig, and its drawn disturbances.
    solid : SpecimenSolid or None
        Closed surface of the specimen, mm, canister frame. None: empty canister.
    hairs : Sleeve or None
        Region of the specimen's root hairs.

    Returns
    -------
    mi.Scene
        Scene without a sensor.
    """
    water = _water_medium(scene)
    specimen = {} if solid is None else _specimen_items(scene, world, solid, hairs, water)
    return _load_scene(_rig_items(scene, world, water, dirt_reach_mm=None) | lights.lights(scene, world) | specimen)


def build_rig(scene: Scene, world: World, *, dirt_reach_mm: float | None = None) -> mi.Scene:
    """Build the Mitsuba scene of a rig without lights and specimen, which is the same for all views.

    Parameters
    ----------
    scene, world : Scene, World
        See `build`.
    dirt_reach_mm : float or None
        Distance, mm, by which dirt on the outside is dilated to an opaque area, so that rays with this spacing meet all
        dirt. None: true dirt.

    Returns
    -------
    mi.Scene
        Scene without a sensor.
    """
    return _load_scene(_rig_items(scene, world, _water_medium(scene), dirt_reach_mm=dirt_reach_mm))


def build_specimen(scene: Scene, world: World, solid: SpecimenSolid, hairs: Sleeve | None) -> mi.Scene:
    """Build the Mitsuba scene of a specimen without the rig.

    Parameters
    ----------
    scene, world, solid, hairs : Scene, World, SpecimenSolid, Sleeve or None
        See `build`.

    Returns
    -------
    mi.Scene
        Scene without a sensor.
    """
    return _load_scene(_specimen_items(scene, world, solid, hairs, _water_medium(scene)))


def _rig_items(scene: Scene, world: World, water: Any, *, dirt_reach_mm: float | None) -> dict[str, Any]:
    wrong = scene.disturbances
    items = _canister(scene, world, water) | _net_pot(scene, world)
    if scene.tank is not None:
        items |= {name: _mesh(name, *shape) for name, shape in tank.meshes(scene, scene.tank).items()}
    if wrong.seam_opacity > 0.0 or wrong.dust_specks or wrong.scratches:
        items[OUTER_DIRT] = _outer_dirt(scene, world, dirt_reach_mm)
    if world.algae:
        items["algae"] = _algae(scene, world)
    for number, bubble in enumerate(world.bubbles):
        items[f"bubble_{number}"] = _bubble(bubble, world.n_water, water)
    if world.fibres:
        items["fibres"] = _mesh("fibres", *_tubes(world.fibres), _diffuse(FELT_REFLECTANCE))
    return items


def _specimen_items(scene: Scene, world: World, solid: SpecimenSolid, hairs: Sleeve | None, water: Any) -> dict[str, Any]:
    wrong = scene.disturbances
    haze = mi.load_dict({"type": "homogeneous", "albedo": 0.0, "sigma_t": wrong.root_hair_mu_per_mm}) if hairs is not None else None
    items: dict[str, Any] = {SPECIMEN: _specimen(solid, wrong, world.n_water, haze or water)}
    if hairs is not None:
        items[HAIRS] = _mesh(HAIRS, hairs.vertices, hairs.faces, {"type": "null"}, _Media(interior=haze, exterior=water))
    if solid.shoot is not None and scene.shoot is not None:
        green = {"type": "twosided", "bsdf": _diffuse(scene.shoot.reflectance)}
        items[SHOOT] = _mesh(SHOOT, solid.shoot.vertices, solid.shoot.faces, green)
    return items


def fine_things(world: World, solid: SpecimenSolid | None, hairs: Sleeve | None = None, *, slack_mm: float) -> mi.Scene | None:
    """Build a scene of the fine structures that rays through the corners of a pixel may miss.

    The result is None if there are no such structures.

    Fine structures are the specimen, fibres and bubbles.

    Parameters
    ----------
    world, solid, hairs : World, SpecimenSolid or None, Sleeve or None
        World, specimen and root hairs, see `build`.
    slack_mm : float
        Increase of the radii of fibres and bubbles, mm, so that rays with this spacing meet all of them.

    Returns
    -------
    mi.Scene or None
        Mitsuba scene for intersection tests only.
    """
    items: dict[str, Any] = {}
    for number, bubble in enumerate(world.bubbles):
        items[f"bubble_{number}"] = _bubble(replace(bubble, radius_mm=bubble.radius_mm + slack_mm), 1.0, None)
    if world.fibres:
        thick = tuple(replace(fibre, radius_mm=fibre.radius_mm + slack_mm) for fibre in world.fibres)
        items["fibres"] = _mesh("fibres", *_tubes(thick), _diffuse(FELT_REFLECTANCE))
    if solid is not None:
        items[SPECIMEN] = _mesh(SPECIMEN, solid.vertices, solid.faces, _diffuse(ROOT_REFLECTANCE))
    if hairs is not None:
        items[HAIRS] = _mesh(HAIRS, hairs.vertices, hairs.faces, _diffuse(ROOT_REFLECTANCE))
    return _load_scene(items) if items else None


def fine_things_room(world: World, solid: SpecimenSolid | None, *, margin_mm: float) -> Room:
    """Return a vertical cylinder that contains all fine structures and a margin around them.

    The radius of the cylinder is at most the inner radius of the canister.

    Parameters
    ----------
    world : World
        World with fibres and bubbles.
    solid : SpecimenSolid or None
        Specimen. None: empty canister.
    margin_mm : float
        Margin on all sides, mm.

    Returns
    -------
    Room
        Vertical cylinder.
    """
    points = [fibre.points_mm for fibre in world.fibres] + ([solid.vertices] if solid is not None else [])
    points += [
        np.array([[bubble.x_mm, bubble.y_mm, bubble.z_mm + side]])
        for bubble in world.bubbles
        for side in (-bubble.radius_mm, bubble.radius_mm)
    ]
    at = np.concatenate(points)
    inner_mm = world.canister.inner_radius_mm
    reach_mm = inner_mm if world.bubbles else float(np.hypot(at[:, 0], at[:, 1]).max()) + margin_mm
    return Room(min(reach_mm, inner_mm), float(at[:, 2].min()) - margin_mm, float(at[:, 2].max()) + margin_mm)


def _load_scene(items: dict[str, Any]) -> mi.Scene:
    """Load a scene without Mitsuba's warning that a tilted cylinder is not round.

    The warning is caused by rounding errors.
    """
    logger = mi.logger()
    level = logger.log_level()
    logger.set_log_level(mi.LogLevel.Error)
    try:
        return mi.load_dict({"type": "scene"} | items)
    finally:
        logger.set_log_level(level)


def _canister(scene: Scene, world: World, water: Any) -> dict[str, Any]:
    can, level, n_water = world.canister, scene.water.level_mm, world.n_water
    wide_mm = None if can.half_width_mm is None else can.half_width_mm - can.outer_radius_mm

    def disk(radius_mm: float, z_mm: float, bsdf: dict[str, Any]) -> dict[str, Any]:
        return _disk(radius_mm, z_mm, bsdf) if wide_mm is None else _plate((radius_mm, radius_mm + wide_mm), z_mm, bsdf)

    def wall(radius_mm: float, low_mm: float, high_mm: float, bsdf: dict[str, Any], medium: dict[str, Any] | None = None) -> Any:
        if wide_mm is not None:
            return _plane_walls((radius_mm, radius_mm + wide_mm), (low_mm, high_mm), bsdf, (medium or {}).get("interior"))
        if (oval_mm := scene.disturbances.canister_out_of_round_mm) > 0.0:
            return _oval(radius_mm, oval_mm, world.oval_rad, (low_mm, high_mm), bsdf, (medium or {}).get("interior"))
        return _cylinder(radius_mm, low_mm, high_mm, bsdf) | (medium or {})

    inside = {"interior": water} if water is not None else {}
    parts: dict[str, Any] = {
        "outer_wall": wall(can.outer_radius_mm, can.floor_z_mm, 0.0, _dielectric(can.n_wall, scene.surroundings.n)),
        "inner_wall": wall(can.inner_radius_mm, can.floor_z_mm, level, _dielectric(n_water, can.n_wall), inside),
        "water_surface": disk(can.inner_radius_mm, level, _dielectric(n_water, 1.0)) | inside,
        "floor": disk(can.outer_radius_mm, can.floor_z_mm, _diffuse(FLOOR_REFLECTANCE)),
        "base_side": wall(can.outer_radius_mm, -can.height_mm, can.floor_z_mm, _diffuse(FLOOR_REFLECTANCE)),
        "base_bottom": disk(can.outer_radius_mm, -can.height_mm, _diffuse(FLOOR_REFLECTANCE)),
        "rim": disk(can.outer_radius_mm, 0.0, _diffuse(FELT_REFLECTANCE)),
        "grid": disk(can.inner_radius_mm, scene.net_pot.grid_z_mm, _diffuse(FELT_REFLECTANCE)),
    }
    if scene.tank is not None:
        around = scene.tank
        parts["outer_wall"] = wall(can.outer_radius_mm, can.floor_z_mm, around.level_mm, _dielectric(can.n_wall, around.n_liquid))
        parts["outer_dry_wall"] = wall(can.outer_radius_mm, around.level_mm, 0.0, _dielectric(can.n_wall, 1.0))
    if level < 0.0:
        parts["dry_wall"] = wall(can.inner_radius_mm, level, 0.0, _dielectric(1.0, can.n_wall))
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
    radius_mm = narrowest_mm(scene) - ALGAE_GAP_MM
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


def _outer_dirt(scene: Scene, world: World, reach_mm: float | None) -> dict[str, Any]:
    """Return a film just outside the canister that contains dust, scratches and the seam.

    If ``reach_mm`` is given, the dirt is dilated by this distance and opaque.
    """
    radius_mm = world.canister.outer_radius_mm + scene.disturbances.canister_out_of_round_mm + OUTER_GAP_MM
    z_range_mm = (scene.canister.floor_z_mm, scene.net_pot.skirt_bottom_mm)
    opacity = dirt.outer_opacity(
        world.dirt,
        seam_rad=world.seam_rad,
        seam_opacity=scene.disturbances.seam_opacity,
        radius_mm=radius_mm,
        z_range_mm=z_range_mm,
        mm_per_texel=DIRT_TEXEL_MM,
    )
    if reach_mm is not None:
        opacity = dirt.dilate_opacity(opacity, reach_texels=round(reach_mm / DIRT_TEXEL_MM))
    film = {"type": "mask", "opacity": bitmap(opacity), "film": {"type": "twosided", "bsdf": _diffuse(FELT_REFLECTANCE)}}
    return _cylinder(radius_mm, *z_range_mm, film)


def _specimen(solid: SpecimenSolid, wrong: Disturbances, n_water: float, water: Any) -> mi.Mesh:
    if wrong.root_mu_per_mm is None:
        return _mesh(SPECIMEN, solid.vertices, solid.faces, _diffuse(ROOT_REFLECTANCE))
    media = _Media(interior=mi.load_dict({"type": "homogeneous", "albedo": 0.0, "sigma_t": wrong.root_mu_per_mm}), exterior=water)
    if wrong.root_n is None:
        return _mesh(SPECIMEN, solid.vertices, solid.faces, {"type": "null"}, media)
    glass = _dielectric(wrong.root_n, n_water)
    return _mesh(SPECIMEN, solid.vertices, solid.faces, glass, media, normals=solid.normals)


def _oval(
    radius_mm: float, oval_mm: float, oval_rad: float, z_range_mm: tuple[float, float], bsdf: dict[str, Any], interior: Any
) -> mi.Mesh:
    """Return a vertical wall with exact normals.

    Its radius is ``radius + oval cos(2 (azimuth - oval_rad))``.
    """
    azimuth = np.arange(OVAL_SIDES) * 2.0 * np.pi / OVAL_SIDES
    radius = radius_mm + oval_mm * np.cos(2.0 * (azimuth - oval_rad))
    slope = -2.0 * oval_mm * np.sin(2.0 * (azimuth - oval_rad))
    c, s = np.cos(azimuth), np.sin(azimuth)
    ring, out = np.stack([radius * c, radius * s], axis=1), np.stack([radius * c + slope * s, radius * s - slope * c], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(OVAL_SIDES, z)]) for z in z_range_mm])
    normals = np.tile(np.column_stack([out / np.linalg.norm(out, axis=1, keepdims=True), np.zeros(OVAL_SIDES)]), (2, 1))
    a = np.arange(OVAL_SIDES)
    b = (a + 1) % OVAL_SIDES
    faces = np.concatenate([np.stack([a, b, b + OVAL_SIDES], axis=1), np.stack([a, b + OVAL_SIDES, a + OVAL_SIDES], axis=1)])
    return _mesh(f"oval_{radius_mm:g}_{z_range_mm[0]:g}", vertices, faces, bsdf, _Media(interior=interior), normals=normals)


def _plane_walls(half_mm: tuple[float, float], z_range_mm: tuple[float, float], bsdf: dict[str, Any], interior: Any) -> mi.Mesh:
    """Return the four vertical walls of a box about the axis, with outward normals."""
    (x, y), name = half_mm, f"plane_{half_mm[0]:g}_{z_range_mm[0]:g}"
    ring = np.array([[x, -y], [x, y], [-x, y], [-x, -y]])
    vertices = np.concatenate([np.column_stack([ring, np.full(4, z)]) for z in z_range_mm])
    a = np.arange(4)
    b = (a + 1) % 4
    faces = np.concatenate([np.stack([a, b, b + 4], axis=1), np.stack([a, b + 4, a + 4], axis=1)])
    return _mesh(name, vertices, faces, bsdf, _Media(interior=interior))


def _plate(half_mm: tuple[float, float], z_mm: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    """Return a horizontal rectangle about the axis, whose normal points upwards."""
    local = frames.translation(0.0, 0.0, z_mm) @ np.diag([*half_mm, 1.0, 1.0])
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(local), "bsdf": bsdf}


@dataclass(frozen=True, kw_only=True)
class _Media:
    """Media on both sides of a surface; None for a medium without attenuation."""

    interior: Any = None
    exterior: Any = None


def _mesh(
    name: str,
    vertices: NDArray[Any],
    faces: NDArray[Any],
    bsdf: dict[str, Any],
    media: _Media = _Media(),
    *,
    normals: NDArray[Any] | None = None,
) -> mi.Mesh:
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    for side, medium in vars(media).items():
        if medium is not None:
            props[side] = medium
    smooth = normals is not None
    mesh = mi.Mesh(name, vertex_count=len(vertices), face_count=len(faces), props=props, has_vertex_normals=smooth)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(normals, dtype=np.float32).ravel()
    parameters.update()
    mesh.set_id(name)
    return mesh


def _tubes(fibres: tuple[dirt.Fibre, ...], *, sides: int = 6) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices (V, 3), mm, and faces (F, 3) of tubes around the centre lines of fibres.

    The tubes are open at both ends.
    """
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
    turbidity = scene.disturbances.turbidity_per_mm
    sigma_t = turbidity + scene.water.absorption_per_mm
    if sigma_t == 0.0:
        return None
    phase = {"type": "hg", "g": TURBID_FORWARD}
    return mi.load_dict({"type": "homogeneous", "albedo": TURBID_ALBEDO * turbidity / sigma_t, "sigma_t": sigma_t, "phase": phase})


def _cylinder(radius_mm: float, low_mm: float, high_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    local = frames.translation(0.0, 0.0, low_mm) @ np.diag([radius_mm, radius_mm, high_mm - low_mm, 1.0])
    to_world = local if seat is None else seat @ local
    return {"type": "cylinder", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def _disk(radius_mm: float, z_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    local = frames.translation(0.0, 0.0, z_mm) @ np.diag([radius_mm, radius_mm, 1.0, 1.0])
    to_world = local if seat is None else seat @ local
    return {"type": "disk", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def _dielectric(n_inside: float, n_outside: float) -> dict[str, Any]:
    """Return a smooth dielectric interface.

    ``n_outside`` is the refractive index on the side to which the surface's normal points.
    """
    return {"type": "dielectric", "int_ior": n_inside, "ext_ior": n_outside}


def _diffuse(reflectance: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}
