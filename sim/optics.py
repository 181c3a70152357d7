"""Build the rig as a Mitsuba scene.

The scene is in the canister frame in mm, with one surface for each optical interface. The canister is static while the
camera and the lights move around it, so that only the two rectangles of the lights are rebuilt for each view.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Scene
from rhizotwin.sim import dirt, lights, shapes, strip, tank
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
        items |= {name: shapes.mesh(name, *shape) for name, shape in tank.meshes(scene, scene.tank).items()}
    if wrong.seam_opacity > 0.0 or wrong.dust_specks or wrong.scratches:
        items[OUTER_DIRT] = _outer_dirt(scene, world, dirt_reach_mm)
    if world.algae:
        items["algae"] = _algae(scene, world)
    for number, bubble in enumerate(world.bubbles):
        items[f"bubble_{number}"] = _bubble(bubble, world.n_water, water)
    if world.fibres:
        items["fibres"] = shapes.mesh("fibres", *shapes.fibre_tubes(world.fibres), shapes.diffuse(FELT_REFLECTANCE))
    return items


def _specimen_items(scene: Scene, world: World, solid: SpecimenSolid, hairs: Sleeve | None, water: Any) -> dict[str, Any]:
    wrong = scene.disturbances
    haze = mi.load_dict({"type": "homogeneous", "albedo": 0.0, "sigma_t": wrong.root_hair_mu_per_mm}) if hairs is not None else None
    items: dict[str, Any] = {SPECIMEN: _specimen(solid, wrong, world.n_water, haze or water)}
    if hairs is not None:
        items[HAIRS] = shapes.mesh(HAIRS, hairs.vertices, hairs.faces, {"type": "null"}, shapes.Media(interior=haze, exterior=water))
    if solid.shoot is not None and scene.shoot is not None:
        green = {"type": "twosided", "bsdf": shapes.diffuse(scene.shoot.reflectance)}
        items[SHOOT] = shapes.mesh(SHOOT, solid.shoot.vertices, solid.shoot.faces, green)
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
        items["fibres"] = shapes.mesh("fibres", *shapes.fibre_tubes(thick), shapes.diffuse(FELT_REFLECTANCE))
    if solid is not None:
        items[SPECIMEN] = shapes.mesh(SPECIMEN, solid.vertices, solid.faces, shapes.diffuse(ROOT_REFLECTANCE))
    if hairs is not None:
        items[HAIRS] = shapes.mesh(HAIRS, hairs.vertices, hairs.faces, shapes.diffuse(ROOT_REFLECTANCE))
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
        return shapes.disk(radius_mm, z_mm, bsdf) if wide_mm is None else shapes.plate((radius_mm, radius_mm + wide_mm), z_mm, bsdf)

    def wall(radius_mm: float, low_mm: float, high_mm: float, bsdf: dict[str, Any], medium: dict[str, Any] | None = None) -> Any:
        if wide_mm is not None:
            return shapes.plane_walls((radius_mm, radius_mm + wide_mm), (low_mm, high_mm), bsdf, (medium or {}).get("interior"))
        if (oval_mm := scene.disturbances.canister_out_of_round_mm) > 0.0:
            return shapes.oval_wall(radius_mm, oval_mm, world.oval_rad, (low_mm, high_mm), bsdf, (medium or {}).get("interior"))
        return shapes.cylinder(radius_mm, low_mm, high_mm, bsdf) | (medium or {})

    inside = {"interior": water} if water is not None else {}
    parts: dict[str, Any] = {
        "outer_wall": wall(can.outer_radius_mm, can.floor_z_mm, 0.0, shapes.dielectric(can.n_wall, scene.surroundings.n)),
        "inner_wall": wall(can.inner_radius_mm, can.floor_z_mm, level, shapes.dielectric(n_water, can.n_wall), inside),
        "water_surface": disk(can.inner_radius_mm, level, shapes.dielectric(n_water, 1.0)) | inside,
        "floor": disk(can.outer_radius_mm, can.floor_z_mm, shapes.diffuse(FLOOR_REFLECTANCE)),
        "base_side": wall(can.outer_radius_mm, -can.height_mm, can.floor_z_mm, shapes.diffuse(FLOOR_REFLECTANCE)),
        "base_bottom": disk(can.outer_radius_mm, -can.height_mm, shapes.diffuse(FLOOR_REFLECTANCE)),
        "rim": disk(can.outer_radius_mm, 0.0, shapes.diffuse(FELT_REFLECTANCE)),
        "grid": disk(can.inner_radius_mm, scene.net_pot.grid_z_mm, shapes.diffuse(FELT_REFLECTANCE)),
    }
    if scene.tank is not None:
        around = scene.tank
        parts["outer_wall"] = wall(can.outer_radius_mm, can.floor_z_mm, around.level_mm, shapes.dielectric(can.n_wall, around.n_liquid))
        parts["outer_dry_wall"] = wall(can.outer_radius_mm, around.level_mm, 0.0, shapes.dielectric(can.n_wall, 1.0))
    if level < 0.0:
        parts["dry_wall"] = wall(can.inner_radius_mm, level, 0.0, shapes.dielectric(1.0, can.n_wall))
    return parts


def _net_pot(scene: Scene, world: World) -> dict[str, Any]:
    pot = scene.net_pot
    seat = world.canister_from_strip
    paper = {"type": "diffuse", "reflectance": bitmap(strip.strip_picture(scene.strip, pot))}
    sided = {"type": "twosided", "outside": paper, "inside": shapes.diffuse(FELT_REFLECTANCE)}
    return {
        STRIP: shapes.cylinder(pot.outer_radius_mm, pot.skirt_bottom_mm, pot.top_mm, sided, seat),
        "pot_top": shapes.disk(pot.outer_radius_mm, pot.top_mm, shapes.diffuse(FELT_REFLECTANCE), seat),
    }


def _algae(scene: Scene, world: World) -> dict[str, Any]:
    can = scene.canister
    radius_mm = narrowest_mm(scene) - ALGAE_GAP_MM
    z_range_mm = (can.floor_z_mm, scene.water.level_mm)
    opacity = dirt.opacity_map(world.algae, radius_mm=radius_mm, z_range_mm=z_range_mm, mm_per_texel=0.2)
    film = {"type": "mask", "opacity": bitmap(opacity), "film": {"type": "twosided", "bsdf": shapes.diffuse(0.08)}}
    return shapes.cylinder(radius_mm, *z_range_mm, film)


def _bubble(bubble: dirt.Bubble, n_water: float, water: Any) -> dict[str, Any]:
    ball = {
        "type": "sphere",
        "center": [bubble.x_mm, bubble.y_mm, bubble.z_mm],
        "radius": bubble.radius_mm,
        "bsdf": shapes.dielectric(1.0, n_water),
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
    film = {"type": "mask", "opacity": bitmap(opacity), "film": {"type": "twosided", "bsdf": shapes.diffuse(FELT_REFLECTANCE)}}
    return shapes.cylinder(radius_mm, *z_range_mm, film)


def _specimen(solid: SpecimenSolid, wrong: Disturbances, n_water: float, water: Any) -> mi.Mesh:
    if wrong.root_mu_per_mm is None:
        return shapes.mesh(SPECIMEN, solid.vertices, solid.faces, shapes.diffuse(ROOT_REFLECTANCE))
    media = shapes.Media(interior=mi.load_dict({"type": "homogeneous", "albedo": 0.0, "sigma_t": wrong.root_mu_per_mm}), exterior=water)
    if wrong.root_n is None:
        return shapes.mesh(SPECIMEN, solid.vertices, solid.faces, {"type": "null"}, media)
    glass = shapes.dielectric(wrong.root_n, n_water)
    return shapes.mesh(SPECIMEN, solid.vertices, solid.faces, glass, media, normals=solid.normals)


def _water_medium(scene: Scene) -> Any:
    turbidity = scene.disturbances.turbidity_per_mm
    sigma_t = turbidity + scene.water.absorption_per_mm
    if sigma_t == 0.0:
        return None
    phase = {"type": "hg", "g": TURBID_FORWARD}
    return mi.load_dict({"type": "homogeneous", "albedo": TURBID_ALBEDO * turbidity / sigma_t, "sigma_t": sigma_t, "phase": phase})
