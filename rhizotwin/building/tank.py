"""Parts of a tank: posts that support the tank, and a magnetically driven carrier for the canister in the tank.

No shaft passes through the floor of the tank, so motor and turntable stay dry. Magnets in the turntable plate below the
floor drive magnets in the carrier above the floor. Slip of the carrier is detected from the markers, like slip of the
turntable.
"""

import math
from dataclasses import replace

import numpy as np
from manifold3d import Manifold

from rhizotwin.building import table
from rhizotwin.building.measures import Measures
from rhizotwin.building.part import FLIPPED, Dimension, Part, moved, round_up
from rhizotwin.building.pot import LEAST_WALL_MM, ring_outer_radius_mm, ring_screws_mm
from rhizotwin.building.shapes import circle, hole, joined, raised, rectangle, union
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene, Tank

CARRIER_MM, GLIDE_MM, PLAY_MM = 8.0, 1.0, 1.0
"""Thickness of the carrier, height of its sliding ring, and air gap between the lower magnets and the tank."""
PAD_MM = table.HUB_MM
"""Height of the ring on the turntable plate, which raises the magnets above the hub of the pinion."""
PAD_WIDE_MM = 16.0
GLIDE_WIDE_MM = 3.0
MAGNETS, MAGNET_PLAY_MM = 6, 0.2
PIN_MM, PIN_HIGH_MM, FOOT_MM, FOOT_HIGH_MM = 8.0, 6.0, 30.0, 0.8
"""Dimensions of the pivot on the floor of the tank: diameter and height of its pin, and diameter and height of its
foot."""
POST_MM, LIP_MM, LIP_HIGH_MM = 40.0, 4.0, 10.0
"""Side length of a post, and thickness and height of the lip that surrounds the corner of the tank."""
LEAST_DRY_MM = 3.9
"""Minimum height of the marker strip above the water in the tank. It is the height of the meniscus on a wetted wall:
sqrt(2) times the capillary length of water (2.7 mm at 20 degrees C)."""


def drop_mm(tank: Tank) -> float:
    """Return the distance by which the turntable must be lowered to make room for the tank."""
    return CARRIER_MM + GLIDE_MM + tank.wall_mm + PLAY_MM + PAD_MM


def floor_mm(scene: Scene, tank: Tank) -> float:
    """Return the height of the lower face of the tank, in the rig frame."""
    return -scene.canister.height_mm - CARRIER_MM - GLIDE_MM - tank.wall_mm


def below(scene: Scene) -> Scene:
    """Return the scene from which the parts of the turntable are computed.

    If the scene has a tank, the canister in the copy is taller by `drop_mm`, which lowers the turntable by this
    distance.
    """
    if scene.tank is None:
        return scene
    lower = replace(scene.canister, height_mm=scene.canister.height_mm + drop_mm(scene.tank))
    return replace(scene, canister=lower)


def magnet_radius_mm(scene: Scene) -> float:
    """Return the radius of the circle on which the centres of the magnets lie."""
    return 0.5 * scene.canister.outer_radius_mm


def magnet_places_mm(scene: Scene) -> list[tuple[float, float]]:
    """Return the positions (x, y) of the magnets.

    They are the same in the turntable plate and in the carrier.
    """
    radius = magnet_radius_mm(scene)
    turn = 2.0 * np.pi * np.arange(MAGNETS) / MAGNETS
    return [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in turn]


def pockets(scene: Scene, measures: Measures, top_mm: float) -> Manifold:
    """Return the solid of all magnet pockets, which is subtracted from a part.

    The upper faces of the magnets are at the height ``top_mm``.
    """
    wide, high = measures.magnet_mm
    return joined(raised(hole(wide + MAGNET_PLAY_MM, at), top_mm - high - MAGNET_PLAY_MM, top_mm + 1.0) for at in magnet_places_mm(scene))


def with_magnets(plate: Part, scene: Scene, measures: Measures) -> Part:
    """Return the turntable plate with a ring on top that contains the magnets.

    Without a tank, the plate is returned unchanged.

    Raises
    ------
    UserError
        If the magnets are too large for the ring or the carrier.
    """
    if scene.tank is None:
        return plate
    most_wide = PAD_WIDE_MM - 2.0 * LEAST_WALL_MM - MAGNET_PLAY_MM
    most_high = CARRIER_MM - table.LEAST_FLOOR_MM - MAGNET_PLAY_MM
    if measures.magnet_mm[0] > most_wide or measures.magnet_mm[1] > most_high:
        raise UserError(
            f"magnet_mm: magnets with a diameter of {measures.magnet_mm[0]:g} and a height of {measures.magnet_mm[1]:g} mm do not fit the "
            f"turntable and the carrier in the tank; use magnets of at most {most_wide:g} x {most_high:g} mm"
        )
    radius = magnet_radius_mm(scene)
    half = PAD_WIDE_MM / 2.0
    pad = raised(circle(radius + half) - circle(radius - half), -1.0, PAD_MM)
    return replace(plate, solid=joined([plate.solid, pad]) - pockets(scene, measures, PAD_MM))


def parts(scene: Scene, measures: Measures, ground_mm: float) -> list[Part]:
    """Create the carrier, pivot and posts of the tank.

    Parameters
    ----------
    scene : Scene
        Scene with canister, tank and marker strip.
    measures : Measures
        Dimensions of purchased parts.
    ground_mm : float
        Height of the floor below the rig, rig frame.

    Returns
    -------
    list of Part
        Printed parts; empty if the scene has no tank.

    Raises
    ------
    UserError
        If the water of the tank would wet the marker strip, or the tank is too low for the posts.
    """
    if scene.tank is None:
        return []
    dry = scene.strip.bottom_mm - scene.tank.level_mm
    if scene.strip.rows and dry < LEAST_DRY_MM:
        raise UserError(
            f"the marker strip (strip.bottom_mm) is only {dry:.1f} mm above the water of the tank (tank.level_mm), which rises by "
            f"{LEAST_DRY_MM:g} mm at a wall; reduce tank.level_mm to {-round_up(LEAST_DRY_MM - scene.strip.bottom_mm):g} or less, or "
            "glue the strip higher"
        )
    return [_carrier(scene, measures, dry), _pivot(scene, scene.tank), _post(scene, scene.tank, ground_mm)]


def solid(scene: Scene, tank: Tank) -> Manifold:
    """Create the solid of the tank in the rig frame."""
    low = floor_mm(scene, tank)
    outside = rectangle((-tank.front_mm, -tank.half_width_mm), (tank.front_mm, tank.half_width_mm))
    x, y = tank.front_mm - tank.wall_mm, tank.half_width_mm - tank.wall_mm
    box = raised(outside, low, tank.level_mm + 1.0) - raised(rectangle((-x, -y), (x, y)), low + tank.wall_mm, tank.level_mm + 2.0)
    return box.rotate((0.0, 0.0, tank.turn_deg))


def _carrier(scene: Scene, measures: Measures, dry_mm: float) -> Part:
    """Create the carrier, a disc on which the canister stands in the tank.

    The upper face of the disc is at z = 0.
    """
    outer = ring_outer_radius_mm(scene, measures)
    glide = 0.7 * scene.canister.outer_radius_mm
    screws = union(hole(table.TAP_M3_MM, at) for at in ring_screws_mm(scene, measures))
    disc = raised(circle(outer) - screws, -CARRIER_MM, 0.0)
    ring = circle(glide + GLIDE_WIDE_MM / 2.0) - circle(glide - GLIDE_WIDE_MM / 2.0)
    under = pockets(scene, measures, CARRIER_MM).transform(FLIPPED[:3])
    pin = raised(hole(PIN_MM + measures.fit_mm), -CARRIER_MM - 1.0, -CARRIER_MM + PIN_HIGH_MM + 1.0)
    body = joined([disc, raised(ring, -CARRIER_MM - GLIDE_MM, -CARRIER_MM + 1.0)]) - under - pin
    return Part(
        name="tank_carrier",
        about="Supports the canister in the tank; its magnets follow the magnets in the turntable plate below the tank.",
        solid=body,
        bed_from_part=FLIPPED,
        rig_from_part=(moved(0.0, 0.0, -scene.canister.height_mm),),
        apart_mm=(0.0, 0.0, -60.0),
        dimensions=(Dimension(name="outside", from_mm=(-outer, 0.0, 0.0), to_mm=(outer, 0.0, 0.0)),),
        numbers=(
            ("magnets", float(MAGNETS), "in the carrier, and the same number in the plate; opposite poles face each other"),
            ("glide_radius_mm", glide, "0.7 canister.outer_radius_mm"),
            ("strip_above_water_mm", dry_mm, f"strip.bottom_mm - tank.level_mm; at least {LEAST_DRY_MM:g}, the height of the meniscus"),
        ),
    )


def _pivot(scene: Scene, tank: Tank) -> Part:
    """Create the pivot of the carrier, a pin on the floor of the tank.

    The lower face of the pivot is at z = 0.
    """
    pin = raised(circle(PIN_MM / 2.0, sides=96), 0.0, FOOT_HIGH_MM + PIN_HIGH_MM)
    return Part(
        name="tank_pivot",
        about="Glued to the floor of the tank at the turntable axis; centres the carrier.",
        solid=joined([raised(circle(FOOT_MM / 2.0), 0.0, FOOT_HIGH_MM), pin]),
        rig_from_part=(moved(0.0, 0.0, floor_mm(scene, tank) + tank.wall_mm),),
        apart_mm=(0.0, 0.0, -75.0),
        dimensions=(Dimension(name="pin", from_mm=(-PIN_MM / 2.0, 0.0, 5.0), to_mm=(PIN_MM / 2.0, 0.0, 5.0)),),
    )


def _post(scene: Scene, tank: Tank, ground_mm: float) -> Part:
    """Create a post that supports one corner of the tank.

    The lower corner of the tank is at the origin.

    Raises
    ------
    UserError
        If there is not enough space between floor and tank.
    """
    high = floor_mm(scene, tank) - ground_mm
    if high < 10.0:
        raise UserError(
            f"clearance.floor_z_mm {ground_mm:g} leaves {high:.1f} mm for the posts of the tank, but 10 mm are needed; set it to "
            f"{math.floor(floor_mm(scene, tank) - 10.0)} or lower"
        )
    edge = LIP_MM + 0.2
    column = raised(rectangle((-POST_MM, -POST_MM), (edge, edge)), -high, LIP_HIGH_MM)
    corner = raised(rectangle((-POST_MM - 1.0, -POST_MM - 1.0), (0.2, 0.2)), 0.0, LIP_HIGH_MM + 1.0)
    x, y = tank.front_mm, tank.half_width_mm
    turned = frames.rotation_z(np.deg2rad(tank.turn_deg))
    corners = [(x, y, 0.0), (-x, y, 90.0), (-x, -y, 180.0), (x, -y, 270.0)]
    return Part(
        name="tank_post",
        about="Four posts support the corners of the tank above the turntable.",
        solid=column - corner,
        rig_from_part=tuple(turned @ moved(a, b, floor_mm(scene, tank), turn_deg=turn) for a, b, turn in corners),
        apart_mm=(0.0, 0.0, -150.0),
        dimensions=(Dimension(name="height", from_mm=(edge, edge, -high), to_mm=(edge, edge, 0.0)),),
        numbers=(("height_mm", high, "lower face of the tank to clearance.floor_z_mm"),),
    )
