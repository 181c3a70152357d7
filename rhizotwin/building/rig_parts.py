"""Printed and purchased parts of a rig with their positions, and detection of collisions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import CrossSection, Manifold

from rhizotwin.building import lamp, lightbox, mounts, pot, table, tank
from rhizotwin.building.measures import Measures
from rhizotwin.building.part import Part
from rhizotwin.building.shapes import circle, joined, raised, rectangle, union
from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.scenes.board import CharucoBoard
from rhizotwin.scenes.model import Scene

BAR_END_MM = 20.0
"""Distance between the panel and the nearer ends of the two profiles below the turntable."""


@dataclass(frozen=True, kw_only=True)
class Bought:
    """Purchased part, which is drawn and included in collision checks."""

    name: str
    solid: Manifold
    """Solid in the rig frame."""
    apart_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement of the part in the exploded view, in the rig frame."""


def parts_of(scene: Scene, *, rig: RigFile, measures: Measures, board: CharucoBoard) -> list[Part]:
    """Create all printed parts of a rig.

    Parameters
    ----------
    scene : Scene
        Scene with canister, net pot, marker strip, panel and first ring.
    rig : RigFile
        Rig with the positions of arm and floor. Without an arm, camera bracket and arm mount are omitted.
    measures : Measures
        Dimensions of purchased parts.
    board : CharucoBoard
        Calibration board.

    Returns
    -------
    list of Part
        Printed parts.

    Raises
    ------
    UserError
        If there is not enough space for a part.
    """
    floor_mm = rig.clearance.floor_z_mm
    under = tank.below(scene)
    parts = [
        pot.net_pot(scene, measures),
        pot.net_pot_grid(scene, measures),
        pot.canister_ring(scene, measures),
        tank.with_magnets(table.table_plate(under, measures), scene, measures),
        table.pinion(under, measures),
        table.table_base(under, measures),
        table.table_foot(under, measures, floor_mm),
        lightbox.lightbox_clip(scene, measures),
        lightbox.panel_holder(scene, measures),
        *lightbox.lightbox_walls(scene, measures),
        lamp.lamp_holder(scene, measures),
        lamp.lamp_wall(scene, measures),
        mounts.board_stand(scene, board, measures, floor_mm),
        *tank.parts(scene, measures, floor_mm),
    ]
    if rig.arm is not None:
        parts += [mounts.camera_bracket(scene, rig.arm, measures), mounts.arm_mount(rig.arm, measures, floor_mm)]
    return [*parts, pot.wire_holder(scene, measures)]


def thesis_rig(scene: Scene | None = None) -> RigFile:
    """Return the default rig with an arm.

    If the scene has a tank, the floor of the rig is lowered by the height that the tank requires.
    """
    rig = RigFile(arm=ArmPart())
    if scene is None or scene.tank is None:
        return rig
    return replace(rig, clearance=replace(rig.clearance, floor_z_mm=rig.clearance.floor_z_mm - tank.drop_mm(scene.tank)))


def bought_of(scene: Scene, *, rig: RigFile, measures: Measures) -> list[Bought]:
    """Create the solids of all purchased parts at their positions on the rig.

    The parts are the canister, motor, tank, some frame profiles, and LED board and diffuser of panel and front lamp.
    """
    can = scene.canister
    floor_mm = rig.clearance.floor_z_mm
    under = tank.below(scene)
    drive = table.drive_of(scene, measures)
    cup = raised(circle(can.outer_radius_mm), -can.height_mm, 0.0) - raised(circle(can.inner_radius_mm), can.floor_z_mm, 1.0)
    face = table.base_top_mm(under) - table.BASE_MM
    half = measures.motor_face_mm / 2.0
    body = raised(rectangle((-half, -half), (half, half)), face - measures.motor_length_mm, face)
    shaft = raised(_shaft(measures), face, face + measures.shaft_length_mm)
    motor = joined([body, shaft.rotate((0.0, 0.0, table.pinion_turn_deg(drive)))]).translate((0.0, -drive.centres_mm, 0.0))
    things = [
        Bought(name="canister", solid=cup, apart_mm=(0.0, 0.0, 0.0)),
        Bought(name="motor", solid=motor, apart_mm=(0.0, -60.0, -170.0)),
        *([] if scene.tank is None else [Bought(name="tank", solid=tank.solid(scene, scene.tank))]),
        *(
            Bought(
                name="bar",
                solid=_bar(
                    measures, 2.0 * (scene.lights.backlight_distance_mm - BAR_END_MM), (0.0, y, floor_mm - measures.profile_mm / 2.0)
                ),
                apart_mm=(0.0, 0.0, -190.0),
            )
            for y in sorted({y for _, y in table.foot_places_mm(drive)})
        ),
    ]
    wide, high = scene.lights.backlight_wh_mm
    bright = -scene.lights.backlight_distance_mm
    z = scene.lights.backlight_z_mm
    back = bright - measures.diffuser_mm - measures.diffuser_gap_mm - measures.fit_mm
    for name, front, thick in (("diffuser", bright, measures.diffuser_mm), ("LED board", back, measures.panel_board_mm)):
        sheet = Manifold.cube((thick, wide, high)).translate((front - thick, -wide / 2.0, z - high / 2.0))
        things.append(Bought(name=name, solid=sheet))
    things += [Bought(name=name, solid=sheet, apart_mm=(40.0, 0.0, 60.0)) for name, sheet in lamp.sheets(scene, measures)]
    for x, y, high_mm in lamp.post_places_mm(scene, measures):
        long_mm = high_mm + measures.profile_mm - floor_mm
        upright = _bar(measures, long_mm, (0.0, 0.0, 0.0)).rotate((0.0, 90.0, 0.0)).translate((x, y, floor_mm + long_mm / 2.0))
        things.append(Bought(name="bar", solid=upright, apart_mm=(40.0, 0.0, -40.0)))
    return things


def _shaft(measures: Measures) -> CrossSection:
    radius = measures.shaft_mm / 2.0
    return circle(radius, sides=48) ^ rectangle((-radius, -radius), (measures.shaft_flat_mm - radius, radius))


def _bar(measures: Measures, long_mm: float, at_mm: tuple[float, float, float]) -> Manifold:
    """Create an aluminium profile along x.

    Its slots are narrow grooves of constant width. The wide inner part of real slots is omitted.
    """
    side = measures.profile_mm
    slot = measures.slot_mm
    deep = 3.0 * measures.slot_lip_mm
    slots = union(
        CrossSection.square((slot, 2.0 * deep), center=True).translate((0.0, side / 2.0)).rotate(turn) for turn in (0.0, 90.0, 180.0, 270.0)
    )
    outline = CrossSection.square((side, side), center=True) - slots
    along_x = np.array([[0.0, 0.0, 1.0, -long_mm / 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    return outline.extrude(long_mm).transform(along_x).translate(at_mm)


def collisions(parts: Sequence[Part], bought: Sequence[Bought], *, least_mm3: float = 1e-2) -> list[tuple[str, str, float]]:
    """Find the pairs of parts that overlap on the rig, and return their names and the volume of the overlap in mm3.

    Overlaps of at most ``least_mm3`` are ignored, so that parts may touch.
    """
    things = [(part.name, solid) for part in parts for solid in part.placed()] + [(one.name, one.solid) for one in bought]
    found = []
    for i, (name, solid) in enumerate(things):
        for other, another in things[i + 1 :]:
            if _apart(solid, another):
                continue
            shared = (solid ^ another).volume()
            if shared > least_mm3:
                found.append((name, other, shared))
    return found


def _apart(a: Manifold, b: Manifold) -> bool:
    box_a, box_b = a.bounding_box(), b.bounding_box()
    return any(box_a[k] >= box_b[k + 3] or box_b[k] >= box_a[k + 3] for k in range(3))
