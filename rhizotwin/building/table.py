"""Parts of the turntable: plate with a ring gear, base, feet on the frame, and pinion of the motor.

The canister stands on top of the plate. A bolt through the centre of the plate runs in a ball bearing in the base and
centres the plate, and loose balls between plate and base support the weight. The motor is mounted below the base,
beside the plate, out of the camera's view.
"""

import math
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection

from rhizotwin.building.measures import Measures
from rhizotwin.building.part import FLIPPED, Dimension, Part, moved
from rhizotwin.building.pot import LEAST_WALL_MM, M3_MM, ring_outer_radius_mm, ring_screws_mm
from rhizotwin.building.shapes import circle, gear, hole, joined, polygon, raised, rectangle, rounded, slot, teardrop, turned, union
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

MODULE_MM = 1.0
"""Module of the gears, which is the pitch diameter divided by the number of teeth. It is the smallest module for which
a 0.4 mm nozzle prints clean flanks."""
PINION_TEETH = 18
"""Number of teeth of the pinion. At a pressure angle of 20 degrees, a gear needs at least 17 teeth to avoid
undercut."""
BACKLASH_MM = 0.15
"""Amount by which the teeth are thinner than without backlash. Backlash does not affect a scan, which approaches all
angles from the same side."""
PLATE_MM, BASE_MM = 8.0, 8.0
LEAST_FLOOR_MM = 1.0
"""Minimum thickness of the material below a groove or a pocket."""
PLATE_GAP_MM = 2.0
"""Gap between the turntable plate and the base. It is large enough that they do not touch even if the ball grooves are
0.5 mm too deep."""
TAP_M3_MM, TAP_M4_MM = 2.6, 3.4
"""Diameters of holes in plastic for self-tapping M3 and M4 screws."""
M4_MM = 4.5
"""Diameter of the clearance hole for an M4 screw (ISO 273, medium)."""
COUNTERSINK_M4_MM = 9.4
"""Diameter of the countersink in the base. It encloses the head of an M4 screw (ISO 10642: at most 8.96), because the
plate rotates directly above."""
HEAD_M3_MM, HEAD_M3_HIGH_MM = 6.2, 3.2
"""Pockets for the heads of the motor's screws below the plate: width and depth. ISO 4762 specifies a diameter of at
most 5.68 and a height of 3."""
HEX_M8_MM, HEX_M8_HIGH_MM = 13.3, 5.6
"""Pocket for the head of an M8 bolt: width across flats, and depth. ISO 4017 specifies a width of 13 and a height of
5.3."""
SLIDE_MM = 1.5
"""Distance by which the motor can be moved in each direction to adjust the backlash."""
FOOT_MM = 24.0
"""Length of a foot along the profile."""
HUB_MM = 6.0
"""Height of the pinion's hub, which contains a grub screw."""
TONGUE_MM = 2.0


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Gears and ball track of the turntable drive."""

    teeth: int
    """Number of teeth of the ring gear."""
    race_radius_mm: float
    """Radius of the ball track."""
    foot_xy_mm: tuple[float, float]
    """Distance of the feet from the axis of the turntable along x and along y."""

    @property
    def ratio(self) -> float:
        """Gear ratio, which is the number of turns of the motor per turn of the turntable."""
        return self.teeth / PINION_TEETH

    @property
    def centres_mm(self) -> float:
        """Distance between the axes of turntable and motor."""
        return MODULE_MM * (self.teeth + PINION_TEETH) / 2.0

    @property
    def tip_radius_mm(self) -> float:
        """Tip radius of the ring gear."""
        return MODULE_MM * (self.teeth / 2.0 + 1.0)


def drive_of(scene: Scene, measures: Measures) -> Drive:
    """Return the drive for which the canister ring fits on the turntable plate.

    Its gear ratio is the smallest integer for which this is the case.
    """
    needed = 2.0 * (ring_outer_radius_mm(scene, measures) + 1.0 + 1.25 * MODULE_MM) / MODULE_MM
    teeth = PINION_TEETH * int(np.ceil(needed / PINION_TEETH))
    race_mm = round(0.7 * scene.canister.outer_radius_mm)
    screw_mm = race_mm + _groove_mm(measures) + LEAST_WALL_MM + COUNTERSINK_M4_MM / 2.0
    y_mm = round(0.83 * race_mm)
    return Drive(teeth=teeth, race_radius_mm=race_mm, foot_xy_mm=(math.ceil(math.sqrt(screw_mm**2 - y_mm**2)), y_mm))


def top_mm(scene: Scene) -> float:
    """Return the height of the upper face of the turntable plate, in the rig frame."""
    return -scene.canister.height_mm


def base_top_mm(scene: Scene) -> float:
    """Return the height of the upper face of the base, in the rig frame."""
    return top_mm(scene) - PLATE_MM - PLATE_GAP_MM


def foot_places_mm(drive: Drive) -> list[tuple[float, float]]:
    """Return the positions (x, y) of the feet.

    On each of the two frame profiles, the feet form a row along x. The countersinks of their screws are outside the
    ball groove.
    """
    reach_x, reach_y = drive.foot_xy_mm
    return [(x, y) for x in (-reach_x, reach_x) for y in (-reach_y, reach_y)]


def _groove_mm(measures: Measures) -> float:
    """Return the depth of the ball grooves, which equals half their width in the face."""
    return measures.ball_mm / math.sqrt(2.0) - PLATE_GAP_MM / 2.0


def _groove(drive: Drive, measures: Measures, z: float, into: float) -> list[tuple[float, float]]:
    """Return the outline of the V-shaped ball groove in a horizontal face, as points (radius, z).

    The face is at height ``z``. ``into`` is the vertical direction into the material: -1 for a face that points up, 1
    for a face that points down.
    """
    deep = _groove_mm(measures)
    r = drive.race_radius_mm
    past = 0.5
    return [(r - deep - past, z - into * past), (r, z + into * deep), (r + deep + past, z - into * past)]


def table_plate(scene: Scene, measures: Measures) -> Part:
    """Create the turntable plate with its ring gear.

    The upper face of the plate is at z = 0.

    Raises
    ------
    UserError
        If the balls are too small or too large.
    """
    drive = drive_of(scene, measures)
    if measures.ball_mm / np.sqrt(2.0) <= PLATE_GAP_MM / 2.0 + 0.5:
        raise UserError(
            f"ball_mm {measures.ball_mm:g} is too small for the gap of {PLATE_GAP_MM:g} mm between plate and base; use larger balls"
        )
    if _groove_mm(measures) > min(PLATE_MM, BASE_MM) - LEAST_FLOOR_MM:
        raise UserError(
            f"ball_mm {measures.ball_mm:g} is too large, because its grooves would be {_groove_mm(measures):.1f} mm deep in plate and "
            f"base, which are {PLATE_MM:g} mm thick; use smaller balls"
        )
    outline = gear(drive.teeth, MODULE_MM, backlash_mm=BACKLASH_MM) - union(hole(TAP_M3_MM, at) for at in ring_screws_mm(scene, measures))
    body = raised(outline - hole(measures.bearing_mm[0] + 0.4), -PLATE_MM, 0.0)
    head = CrossSection.circle(HEX_M8_MM / np.sqrt(3.0), 6)
    solid = body - turned(_groove(drive, measures, -PLATE_MM, 1.0)) - raised(head, -HEX_M8_HIGH_MM, 1.0)
    tip = drive.tip_radius_mm
    step_deg = 1.8 / drive.ratio
    return Part(
        name="table_plate",
        about="Supports the canister; its ring gear is driven by the pinion of the motor, and it runs on loose balls.",
        solid=solid,
        rig_from_part=(moved(0.0, 0.0, top_mm(scene)),),
        apart_mm=(0.0, 0.0, -80.0),
        dimensions=(
            Dimension(name="over the teeth", from_mm=(-tip, 0.0, 0.0), to_mm=(tip, 0.0, 0.0)),
            Dimension(name="balls' track", from_mm=(-drive.race_radius_mm, 0.0, -PLATE_MM), to_mm=(drive.race_radius_mm, 0.0, -PLATE_MM)),
        ),
        numbers=(
            ("module_mm", MODULE_MM, "ISO 53, 20 degrees"),
            ("ring_teeth", drive.teeth, "smallest multiple of the pinion's teeth that carries the canister ring"),
            ("pinion_teeth", PINION_TEETH, ""),
            ("full_step_deg", step_deg, "1.8 / (ring_teeth / pinion_teeth); turntable.full_step_deg of the rig file"),
            ("steps_per_deg", 32.0 / step_deg, "at 1/32 microsteps; DEFAULT_AXIS_STEPS_PER_UNIT of the board"),
            ("race_radius_mm", drive.race_radius_mm, "0.7 canister.outer_radius_mm"),
            ("balls", float(int(2.0 * np.pi * drive.race_radius_mm / (3.0 * measures.ball_mm))), "one per three diameters"),
        ),
    )


def pinion(scene: Scene, measures: Measures) -> Part:
    """Create the pinion of the motor.

    Its teeth start at z = 0, and its hub is above them.
    """
    shaft = circle(measures.shaft_mm / 2.0 + 0.1, sides=48) ^ rectangle(
        (-measures.shaft_mm, -measures.shaft_mm), (measures.shaft_flat_mm - measures.shaft_mm / 2.0 + 0.1, measures.shaft_mm)
    )
    teeth = raised(gear(PINION_TEETH, MODULE_MM, backlash_mm=BACKLASH_MM), 0.0, PLATE_MM)
    hub_radius = MODULE_MM * (PINION_TEETH / 2.0 - 1.25)
    hub = raised(circle(hub_radius, sides=96), 0.0, PLATE_MM + HUB_MM)
    screw = (
        teardrop(TAP_M3_MM).extrude(2.0 * hub_radius).transform(np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, 1, 0, PLATE_MM + HUB_MM / 2]]))
    )
    drive = drive_of(scene, measures)
    centre = drive.centres_mm
    place = moved(0.0, -centre, top_mm(scene) - PLATE_MM, turn_deg=pinion_turn_deg(drive))
    return Part(
        name="pinion",
        about="On the motor shaft; an M3 grub screw in its hub presses on the flat of the shaft.",
        solid=joined([teeth, hub]) - raised(shaft, -1.0, PLATE_MM + HUB_MM + 1.0) - screw,
        rig_from_part=(place,),
        apart_mm=(0.0, -60.0, -80.0),
        dimensions=(
            Dimension(
                name="over the teeth",
                from_mm=(-MODULE_MM * (PINION_TEETH / 2.0 + 1.0), 0.0, 0.0),
                to_mm=(MODULE_MM * (PINION_TEETH / 2.0 + 1.0), 0.0, 0.0),
            ),
        ),
        numbers=(("centres_mm", centre, "module_mm (ring_teeth + pinion_teeth) / 2"), ("height_mm", PLATE_MM + HUB_MM, "")),
    )


def pinion_turn_deg(drive: Drive) -> float:
    """Return the rotation angle of the pinion at which its teeth mesh with those of the ring gear.

    The axis of the pinion is displaced towards -y from that of the turntable.
    """
    pitch_ring = 360.0 / drive.teeth
    pitch = 360.0 / PINION_TEETH
    ring_phase = (-90.0 / pitch_ring) % 1.0  # angle of the ring's teeth at -y, from a tooth
    return 90.0 + pitch * (0.5 + ring_phase)


def table_base(scene: Scene, measures: Measures) -> Part:
    """Create the base below the turntable plate.

    The upper face of the base is at z = 0.

    Raises
    ------
    UserError
        If the bearing is too wide for the base.
    """
    drive = drive_of(scene, measures)
    centre, bearing = drive.centres_mm, measures.bearing_mm
    around_screws_mm = math.hypot(*drive.foot_xy_mm) + COUNTERSINK_M4_MM / 2.0 + LEAST_WALL_MM
    disc = circle(max(drive.race_radius_mm + measures.ball_mm + 8.0, around_screws_mm))
    seat = rounded(measures.motor_face_mm + 2.0 * SLIDE_MM + 4.0, measures.motor_face_mm + 2.0 * SLIDE_MM + 4.0, 4.0).translate(
        (0.0, -centre)
    )
    half = measures.motor_holes_mm / 2.0
    screws = [(x, y - centre) for x in (-half, half) for y in (-half, half)]
    slots, sunk_m3 = (union(slot(wide, (x, y - SLIDE_MM), (x, y + SLIDE_MM)) for x, y in screws) for wide in (M3_MM, HEAD_M3_MM))
    boss = slot(measures.motor_boss_mm + 1.0, (0.0, -centre - SLIDE_MM), (0.0, -centre + SLIDE_MM))
    outline = CrossSection.batch_hull([disc, seat]) - union(
        [slots, boss, hole(bearing[1] - 4.0), *(hole(M4_MM, at) for at in foot_places_mm(drive))]
    )
    if bearing[2] > BASE_MM - 1.0:
        raise UserError(
            f"bearing_mm: a bearing with a width of {bearing[2]:g} mm does not fit the base, which is {BASE_MM:g} mm thick; "
            "use a 608 ball bearing"
        )
    pocket = raised(hole(bearing[1] + 0.1), -bearing[2], 1.0) + raised(sunk_m3, -HEAD_M3_HIGH_MM, 1.0)
    sunk, small = COUNTERSINK_M4_MM / 2.0, M4_MM / 2.0
    # rotated, so that no vertex coincides with the hole, which would create an edge with four faces
    head = turned([(0.0, 1.0), (sunk, 1.0), (sunk, 0.0), (small, small - sunk), (0.0, small - sunk)], sides=48).rotate((0.0, 0.0, 1.9))
    heads = joined(head.translate((x, y, 0.0)) for x, y in foot_places_mm(drive))
    solid = raised(outline, -BASE_MM, 0.0) - pocket - heads - turned(_groove(drive, measures, 0.0, -1.0))
    return Part(
        name="table_base",
        about="Holds the balls, the bearing and the motor below it; the slots of the motor allow the backlash to be adjusted.",
        solid=solid,
        rig_from_part=(moved(0.0, 0.0, base_top_mm(scene)),),
        apart_mm=(0.0, 0.0, -110.0),
        dimensions=(
            Dimension(name="turntable axis to motor axis", from_mm=(0.0, 0.0, 0.0), to_mm=(0.0, -centre, 0.0)),
            Dimension(name="bearing", from_mm=(-bearing[1] / 2.0, 0.0, 0.0), to_mm=(bearing[1] / 2.0, 0.0, 0.0)),
        ),
        numbers=(
            ("thickness_mm", BASE_MM, ""),
            ("bearing_pocket_mm", bearing[1] + 0.1, "bearing_mm"),
            ("motor_slide_mm", SLIDE_MM, "each way"),
        ),
    )


def table_foot(scene: Scene, measures: Measures, floor_mm: float) -> Part:
    """Create a foot of the base.

    The upper face of the foot is at z = 0, and its tongue fits the slot of the profile below.

    Raises
    ------
    UserError
        If the floor is too high for the turntable, or the motor reaches below the frame.
    """
    drive = drive_of(scene, measures)
    high = base_top_mm(scene) - BASE_MM - floor_mm
    if high < 10.0:
        raise UserError(
            f"clearance.floor_z_mm {floor_mm:g} leaves {high:.1f} mm for the feet of the turntable, but 10 mm are needed; set it to "
            f"{math.floor(base_top_mm(scene) - BASE_MM - 10.0)} or lower"
        )
    if measures.motor_length_mm > high + measures.profile_mm:
        raise UserError(
            f"the motor with a length of {measures.motor_length_mm:g} mm extends below the frame, because feet and profile have a "
            f"height of only {high + measures.profile_mm:.0f} mm; "
            "use a shorter motor (motor_length_mm), or a lower clearance.floor_z_mm"
        )
    wide = measures.slot_mm - 2.0 * 0.15
    # the tongue starts inside the foot and narrows slightly below it, so that no edge lies in a face of the foot
    tongue = [
        (-wide / 2.0, -high + 1.0),
        (wide / 2.0, -high + 1.0),
        (wide / 2.0, -high - 0.2),
        (wide / 2.0 - 0.6, -high - TONGUE_MM),
        (-wide / 2.0 + 0.6, -high - TONGUE_MM),
        (-wide / 2.0, -high - 0.2),
    ]
    long = FOOT_MM - 1.0
    along_x = np.array([[0.0, 0.0, 1.0, -long / 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    tap = TAP_M4_MM / 2.0
    deep = min(high - 5.0, 20.0)
    screw = turned([(0.0, 1.0), (tap, 1.0), (tap, -deep), (0.0, -deep - tap)], sides=48)
    body = raised(rounded(FOOT_MM, measures.profile_mm, 2.0), -high, 0.0)
    solid = joined([body, polygon(tongue).extrude(long).transform(along_x)]) - screw
    return Part(
        name="table_foot",
        about="Four feet support the base on two profiles of the frame; each is fastened by an M4 screw from above.",
        solid=solid,
        bed_from_part=FLIPPED,
        rig_from_part=tuple(moved(x, y, base_top_mm(scene) - BASE_MM) for x, y in foot_places_mm(drive)),
        apart_mm=(0.0, 0.0, -140.0),
        dimensions=(Dimension(name="height", from_mm=(0.0, 0.0, -high), to_mm=(0.0, 0.0, 0.0)),),
        numbers=(("height_mm", high, "from the base to clearance.floor_z_mm"), ("tongue_mm", wide, "slot_mm - 0.3")),
    )
