"""Mounts for arm, camera and calibration board on a frame of aluminium profiles."""

import numpy as np
from manifold3d import CrossSection

from rhizotwin.building.measures import Measures
from rhizotwin.building.part import FLIPPED, Dimension, Part, moved, round_up
from rhizotwin.building.pot import M3_MM
from rhizotwin.building.shapes import circle, hole, joined, polygon, raised, rounded, slot, turned, union
from rhizotwin.building.table import M4_MM
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.scenes.board import CharucoBoard
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

PLATE_MM = 4.0
POST_MM = 7.0
TAP_M25_MM = 2.1
"""Diameter of a hole in plastic for a self-tapping M2.5 screw."""
M5_MM = 5.5
"""Diameter of the clearance hole for an M5 screw (ISO 273, medium)."""
LEAST_POST_MM = 8.0
"""Minimum height of the posts, which leaves space for the ribbon cable behind the camera board."""
DRIVER_MM = 10.0
"""Diameter of the passage for the head of an M5 screw and a screwdriver."""
BASE_SLIDE_MM = 4.0
"""Distance by which the screws of the arm's base can be moved in each direction."""
MOUNT_WALL_MM, MOUNT_TOP_MM, MOUNT_FOOT_MM = 5.0, 6.0, 6.0
STAND_LEAN_DEG = 15.0
"""Angle by which the calibration board in its stand is inclined backwards from the vertical."""
STAND_DEEP_MM, STAND_WIDE_MM = 12.0, 24.0


def camera_bracket(scene: Scene, arm: ArmPart, measures: Measures) -> Part:
    """Create the bracket of the camera.

    It is a plate on the arm's roll servo, with four posts for the camera board. The horn (mounting disc) of the servo
    is at z = 0, and the lens points along +z.

    Raises
    ------
    UserError
        If the last link of the arm is too short for the bracket.
    """
    deep = arm.links_mm[3] - measures.roll_face_mm - measures.camera_centre_mm
    if deep < PLATE_MM + LEAST_POST_MM:
        raise UserError(
            f"the last value of arm.links_mm leaves {deep:.1f} mm between the mounting disc of the roll servo and the camera board, "
            f"but {PLATE_MM + LEAST_POST_MM:g} mm are needed; set it to at least "
            f"{round_up(measures.roll_face_mm + measures.camera_centre_mm + PLATE_MM + LEAST_POST_MM):g}"
        )
    low, high = measures.horn_holes_mm[0] / 2.0, measures.horn_holes_mm[1] / 2.0
    slots = [slot(M3_MM, (low * x, low * y), (high * x, high * y)) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    half = measures.camera_holes_mm / 2.0
    corners = [(x, y) for x in (-half, half) for y in (-half, half)]
    plate = rounded(measures.camera_board_mm + 2.0, measures.camera_board_mm + 2.0, POST_MM / 2.0) - union([*slots, hole(7.0)])
    posts = [
        raised(circle(POST_MM / 2.0, at, sides=48), 0.0, deep) - raised(hole(TAP_M25_MM, at), deep - 8.0, deep + 1.0) for at in corners
    ]
    ring = scene.plan.rings[0]
    # the lens looks along -x at the canister; the tilt of the ring is not drawn
    place = np.array(
        [
            [0.0, 0.0, -1.0, ring.distance_mm + measures.camera_centre_mm + deep],
            [1.0, 0.0, 0.0, 0.0],
            [0.0, -1.0, 0.0, ring.height_mm],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return Part(
        name="camera_bracket",
        about="Holds the camera board on the horn of the arm's roll servo, at the distance given by the last link in the rig file.",
        solid=joined([raised(plate, 0.0, PLATE_MM), *posts]),
        rig_from_part=(place,),
        apart_mm=(40.0, 0.0, 0.0),
        dimensions=(
            Dimension(name="horn to camera board", from_mm=(half, 0.0, 0.0), to_mm=(half, 0.0, deep)),
            Dimension(name="board's holes", from_mm=(-half, half, deep), to_mm=(half, half, deep)),
        ),
        numbers=(
            ("horn_to_board_mm", deep, "last of arm.links_mm - roll_face_mm - camera_centre_mm"),
            ("board_holes_mm", measures.camera_holes_mm, "camera_holes_mm"),
        ),
    )


def arm_mount(arm: ArmPart, measures: Measures, floor_mm: float) -> Part:
    """Create the block whose top, at z = 0, supports the base of the arm above two profiles of the frame.

    Raises
    ------
    UserError
        If the base of the arm is too close to the floor.
    """
    high, least = arm.position_mm[2] - floor_mm, measures.profile_mm + MOUNT_TOP_MM + 4.0
    if high < least:
        raise UserError(
            f"the base of the arm (arm.position_mm) is {high:.0f} mm above the floor (clearance.floor_z_mm), but the printed mount "
            f"needs {least:g} mm; screw the arm directly to the frame"
        )
    along, across = measures.arm_base_mm
    foot, wall = measures.profile_mm, MOUNT_WALL_MM
    wide = max(across + 2.0 * 12.0, 2.0 * foot + 10.0)
    left = wide / 2.0
    inner, inside = left - wall, foot - wall
    outline = polygon(
        [
            *((-left, 0.0), (-left, -high), (-left + foot, -high), (-left + foot, -high + MOUNT_FOOT_MM)),
            *((-inner, -high + MOUNT_FOOT_MM + inside), (-inner, -MOUNT_TOP_MM), (inner, -MOUNT_TOP_MM)),
            *(
                (inner, -high + MOUNT_FOOT_MM + inside),
                (left - foot, -high + MOUNT_FOOT_MM),
                (left - foot, -high),
                (left, -high),
                (left, 0.0),
            ),
        ]
    )
    long = along + 2.0 * 10.0
    body = raised(outline, -long / 2.0, long / 2.0).transform(np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]))
    corners = [(x, y) for x in (-along / 2.0, along / 2.0) for y in (-across / 2.0, across / 2.0)]
    base = union(slot(M4_MM, (x - BASE_SLIDE_MM, y), (x + BASE_SLIDE_MM, y)) for x, y in corners)
    bars = [(x, side * (left - foot / 2.0)) for x in _bar_screws_mm(along) for side in (-1, 1)]
    small, large, seat = M5_MM / 2.0, DRIVER_MM / 2.0, -high + MOUNT_FOOT_MM
    screw = turned(
        [(0.0, -high - 1.0), (small, -high - 1.0), (small, seat - large + small), (large, seat), (large, 1.0), (0.0, 1.0)], sides=48
    )
    solid = body - raised(base, -MOUNT_TOP_MM - 1.0, 1.0) - joined(screw.translate((x, y, 0.0)) for x, y in bars)
    return Part(
        name="arm_mount",
        about="Supports the base of the arm at the height given in the rig file; M5 screws pass through it into T-nuts of two profiles.",
        solid=solid,
        bed_from_part=FLIPPED,
        rig_from_part=(moved(*arm.position_mm),),
        apart_mm=(60.0, 0.0, -40.0),
        dimensions=(
            Dimension(name="height", from_mm=(long / 2.0, left, -high), to_mm=(long / 2.0, left, 0.0)),
            Dimension(name="bars apart", from_mm=(0.0, -left + foot / 2.0, -high), to_mm=(0.0, left - foot / 2.0, -high)),
        ),
        numbers=(
            ("height_mm", high, "z of arm.position_mm - clearance.floor_z_mm"),
            ("bars_apart_mm", wide - foot, "centre to centre, from arm_base_mm and profile_mm"),
            ("base_holes_along_mm", along, "arm_base_mm; slots of 8"),
            ("base_holes_across_mm", across, "arm_base_mm"),
        ),
    )


def _bar_screws_mm(along_mm: float) -> list[float]:
    """Return the positions of the screws of a profile along the arm, whose base has holes ``along_mm`` apart.

    The passages of the outer screws end before the slots of the base.
    """
    outer = min(along_mm / 3.0, along_mm / 2.0 - BASE_SLIDE_MM - (M4_MM + DRIVER_MM) / 2.0 - 1.2)
    return [-outer, 0.0, outer] if outer > DRIVER_MM + 1.2 else [0.0]


def board_stand(scene: Scene, board: CharucoBoard, measures: Measures, floor_mm: float) -> Part:
    """Create one of the two legs of the stand for the calibration board.

    The stand holds the centre of the board at the height of the camera in the first ring.

    Parameters
    ----------
    scene : Scene
        Scene whose first ring determines the height of the board.
    board : CharucoBoard
        Calibration board.
    measures : Measures
        Thickness of the plate under the board, and clearances.
    floor_mm : float
        Height of the floor in the rig frame.

    Returns
    -------
    Part
        Leg of the stand.

    Raises
    ------
    UserError
        If the camera is too low for the board.
    """
    lean = np.deg2rad(STAND_LEAN_DEG)
    middle = scene.plan.rings[0].height_mm - floor_mm
    edge = middle - board.size_mm[1] / 2.0 * np.cos(lean)
    if edge < 20.0:
        raise UserError(
            f"the lower edge of the calibration board would be {edge:.0f} mm above the floor (clearance.floor_z_mm), but the stand "
            "needs 20 mm; use a smaller board, or raise the stand"
        )
    thick = measures.stand_board_mm + measures.fit_mm
    foot = max(60.0, 0.8 * middle)
    block = polygon([(-foot / 2.0, 0.0), (foot / 2.0, 0.0), (thick + 10.0, edge + STAND_DEEP_MM), (-thick - 6.0, edge + STAND_DEEP_MM)])
    groove = CrossSection.square((thick, 3.0 * STAND_DEEP_MM)).translate((-thick / 2.0, 0.0)).rotate(-STAND_LEAN_DEG).translate((0.0, edge))
    window = polygon([(-foot / 2.0 + 14.0, 8.0), (foot / 2.0 - 14.0, 8.0), (4.0, max(edge - 14.0, 9.0)), (-4.0, max(edge - 14.0, 9.0))])
    outline = block - groove - (window if edge > 40.0 else CrossSection())
    return Part(
        name="board_stand",
        about=(
            "Two of them hold the calibration board in front of the camera, inclined "
            "backwards, with its centre at the height of the camera."
        ),
        solid=raised(outline, 0.0, STAND_WIDE_MM),
        dimensions=(
            Dimension(name="groove's floor", from_mm=(-foot / 2.0, 0.0, 0.0), to_mm=(-foot / 2.0, edge, 0.0)),
            Dimension(name="foot", from_mm=(-foot / 2.0, 0.0, 0.0), to_mm=(foot / 2.0, 0.0, 0.0)),
        ),
        numbers=(
            ("groove_mm", thick, "stand_board_mm + fit_mm"),
            ("groove_floor_mm", edge, "first ring's height_mm - clearance.floor_z_mm - half the height of the inclined board"),
            ("lean_deg", STAND_LEAN_DEG, ""),
            ("pieces", 2.0, ""),
        ),
    )
