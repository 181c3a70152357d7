"""Housing of the front lamp: two holders, each screwed to an upright profile, and walls between them.

The lamp can be inclined about the two screws, so that it faces the centre of the canister's rim.
"""

import numpy as np
from manifold3d import Manifold

from rhizotwin.building.lightbox import HOLDER_DEEP_MM, HOLDER_WALL_MM, WALL_LONG_MM, back_mm, channel, slots
from rhizotwin.building.measures import Measures
from rhizotwin.building.mounts import M5_MM
from rhizotwin.building.part import Dimension, Part
from rhizotwin.building.shapes import hole, raised
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene

LEAST_LAMP_MM = 40.0
"""Minimum width and height of the lamp. The grooves of the holders end before those of the walls; 19 mm are left."""


def rig_from_lamp(scene: Scene) -> Array:
    """Return the pose (4, 4) of the lamp in the rig frame.

    The origin is the centre of the diffuser's front face. The x axis is its normal, which points to the centre of the
    canister's rim, and the y axis is that of the rig.
    """
    x_mm, z_mm = scene.lights.front_xz_mm
    normal = -np.array([x_mm, 0.0, z_mm]) / np.hypot(x_mm, z_mm)
    across = np.array([0.0, 1.0, 0.0])
    pose = np.eye(4)
    pose[:3] = np.stack([normal, across, np.cross(normal, across), np.array([x_mm, 0.0, z_mm])], axis=1)
    return pose


def _piece(scene: Scene, measures: Measures, at_mm: tuple[float, float], open_yz: tuple[float, float]) -> Array:
    """Return the pose (4, 4) in the rig frame of a channel at an edge of the lamp.

    ``at_mm`` is the middle of the edge, and ``open_yz`` the direction in which the channel opens, both in the y-z plane
    of the lamp.
    """
    (y, z), (open_y, open_z) = at_mm, open_yz
    lamp_from_part = np.array(
        [[1.0, 0.0, 0.0, -back_mm(measures)], [0.0, open_y, -open_z, y], [0.0, open_z, open_y, z], [0.0, 0.0, 0.0, 1.0]]
    )
    return np.asarray(rig_from_lamp(scene) @ lamp_from_part)


def _screw_x_mm(measures: Measures) -> float:
    """Return the distance of a holder's screw from its back. The screw is between LED board and diffuser."""
    board, diffuser = slots(measures)
    return (board[1] + diffuser[0]) / 2.0


def lamp_holder(scene: Scene, measures: Measures) -> Part:
    """Create the holder of LED board and diffuser at the left and right end of the lamp.

    Raises
    ------
    UserError
        If the lamp is too small.
    """
    wide, high = scene.lights.front_wh_mm
    if min(wide, high) < LEAST_LAMP_MM:
        raise UserError(
            f"the front lamp (lights.front_wh_mm) of {wide:g} x {high:g} mm is too small for the printed holders; "
            f"use a lamp of at least {LEAST_LAMP_MM:g} x {LEAST_LAMP_MM:g} mm"
        )
    half = (high - measures.fit_mm) / 2.0
    wall = HOLDER_WALL_MM
    screw = _screw_x_mm(measures)
    fins = half - HOLDER_DEEP_MM - measures.fit_mm
    bore = raised(hole(M5_MM), -wall - 1.0, 1.0).transform(np.array([[1.0, 0.0, 0.0, screw], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]]))
    return Part(
        name="lamp_holder",
        about="Holds LED board and diffuser of the front lamp; an M5 screw between them passes into the T-nut of an upright profile.",
        solid=raised(channel(measures, deep=0.0), -half, half) + raised(channel(measures), -fins, fins) - bore,
        bed_from_part=np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
        rig_from_part=tuple(_piece(scene, measures, (side * wide / 2.0, 0.0), (-side, 0.0)) for side in (-1.0, 1.0)),
        apart_mm=(40.0, 0.0, 60.0),
        dimensions=(
            Dimension(name="length", from_mm=(0.0, -wall, -half), to_mm=(0.0, -wall, half)),
            Dimension(name="back to screw", from_mm=(0.0, -wall, 0.0), to_mm=(screw, -wall, 0.0)),
        ),
        numbers=(
            ("length_mm", 2.0 * half, "height of lights.front_wh_mm, minus fit_mm"),
            ("screw_mm", screw, "from the back, in the middle between LED board and diffuser"),
            ("inclined_deg", float(np.degrees(np.arctan2(scene.lights.front_xz_mm[1], scene.lights.front_xz_mm[0]))), "lights.front_xz_mm"),
        ),
    )


def lamp_wall(scene: Scene, measures: Measures) -> Part:
    """Create the wall piece that closes the lamp above and below, between the holders."""
    wide, high = scene.lights.front_wh_mm
    count = int(np.ceil(wide / WALL_LONG_MM))
    cut = wide / count - measures.fit_mm
    places = [
        _piece(scene, measures, (wide * ((k + 0.5) / count - 0.5), edge * high / 2.0), (0.0, -edge))
        for edge in (-1.0, 1.0)
        for k in range(count)
    ]
    return Part(
        name="lamp_wall",
        about="Closes the front lamp above and below; glue it to the LED board.",
        solid=raised(channel(measures), -cut / 2.0, cut / 2.0),
        rig_from_part=tuple(places),
        apart_mm=(40.0, 0.0, 60.0),
        dimensions=(Dimension(name="length", from_mm=(0.0, -HOLDER_WALL_MM, -cut / 2.0), to_mm=(0.0, -HOLDER_WALL_MM, cut / 2.0)),),
        numbers=(
            ("length_mm", cut, "a fraction of the width of lights.front_wh_mm, minus fit_mm"),
            ("pieces", float(len(places)), "above and below"),
        ),
    )


def sheets(scene: Scene, measures: Measures) -> list[tuple[str, Manifold]]:
    """Return name and solid of LED board and diffuser in the rig frame."""
    wide, high = scene.lights.front_wh_mm
    back = -measures.diffuser_mm - measures.diffuser_gap_mm - measures.fit_mm
    return [
        (name, Manifold.cube((thick, wide, high)).translate((front - thick, -wide / 2.0, -high / 2.0)).transform(rig_from_lamp(scene)[:3]))
        for name, front, thick in (("lamp diffuser", 0.0, measures.diffuser_mm), ("lamp LED board", back, measures.panel_board_mm))
    ]


def post_places_mm(scene: Scene, measures: Measures) -> list[tuple[float, float, float]]:
    """Return the points (x, y, z) at the height of the screws on the axes of the two upright profiles, rig frame."""
    x, _, z = (rig_from_lamp(scene) @ np.array([_screw_x_mm(measures) - back_mm(measures), 0.0, 0.0, 1.0]))[:3]
    y = scene.lights.front_wh_mm[0] / 2.0 + HOLDER_WALL_MM + measures.profile_mm / 2.0
    return [(float(x), side * y, float(z)) for side in (-1.0, 1.0)]
